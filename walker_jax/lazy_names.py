"""Public names that are loaded on their first use, as some modules take long to load."""

import ast
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any


def load_lazily(package: dict[str, Any]) -> tuple[Callable, Callable, list[str]]:
    """Return `__getattr__`, `__dir__` and `__all__` for the globals of a package.

    The stub `__init__.pyi`, which type checkers read, imports each public name from its module.
    """
    stub = ast.parse(Path(package["__file__"]).with_suffix(".pyi").read_text())
    modules = {
        name.name: statement.module or ""
        for statement in stub.body
        if isinstance(statement, ast.ImportFrom)
        for name in statement.names
    }

    def load(name: str) -> Any:
        if name not in modules:
            raise AttributeError(f"module {package['__name__']!r} has no attribute {name!r}")
        value = package[name] = getattr(import_module(modules[name]), name)
        return value

    others = {"__version__"} & package.keys()
    return load, lambda: sorted({*modules, *others}), sorted(modules)

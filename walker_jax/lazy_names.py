"""Public names that are loaded on their first use, as some modules take long to load."""

import ast
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any


def load_lazily(package: dict[str, Any]) -> tuple[Callable, Callable, list[str]]:
    """Return `__getattr__`, `__dir__` and `__all__` for the globals of a package.

    The stub `__init__.pyi`, which type checkers read, imports each public name from its module.
    Modules that it imports from the package itself are loaded in the same way, but are not in
    `__all__`.
    """
    own = package["__name__"]
    stub = ast.parse(Path(package["__file__"]).with_suffix(".pyi").read_text())
    modules = {
        name.name: statement.module or ""
        for statement in stub.body
        if isinstance(statement, ast.ImportFrom)
        for name in statement.names
    }

    def load(name: str) -> Any:
        if name not in modules:
            raise AttributeError(f"module {own!r} has no attribute {name!r}")
        if modules[name] == own:
            return import_module(f"{own}.{name}")
        value = package[name] = getattr(import_module(modules[name]), name)
        return value

    others = {"__version__"} & package.keys()
    names = sorted(name for name, module in modules.items() if module != own)
    return load, lambda: sorted({*modules, *others}), names

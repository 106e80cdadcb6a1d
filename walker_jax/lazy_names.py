"""Public names that are loaded on their first use, as some modules take long to load."""

import ast
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any


def load_lazily(package: dict[str, Any]) -> tuple[Callable, Callable, list[str]]:
    """Return `__getattr__`, `__dir__` and `__all__` for the globals of a package.

    The stub beside it, which type checkers read, imports each public name from its module. Modules
    are loaded in the same way; those of the package itself are not in `__all__`.
    """
    own = package["__name__"]
    stub = ast.parse(Path(package["__file__"]).with_suffix(".pyi").read_text())
    paths = {
        one.asname or one.name: f"{getattr(statement, 'module', '')}.{one.name}".lstrip(".")
        for statement in stub.body
        if isinstance(statement, ast.Import | ast.ImportFrom)
        for one in statement.names
    }

    def load(name: str) -> Any:
        if name not in paths:
            raise AttributeError(f"module {own!r} has no attribute {name!r}")
        home, _, last = paths[name].rpartition(".")
        known = vars(import_module(home)) if home else {}
        value = package[name] = known[last] if last in known else import_module(paths[name])
        return value

    others = {"__version__"} & package.keys()
    names = sorted(name for name, path in paths.items() if path != f"{own}.{name}")
    return load, lambda: sorted({*paths, *others}), names

"""Passive dynamic walkers: their gaits, and the basins of attraction of these.

    import walker_jax as wj

    walker = wj.SimplestWalker(slope=0.004)
    grid = wj.Grid.sheared(theta=(0, 0.4, 200), sum=(-0.04, 0.01, 250))
    wj.basin(walker, grid)

Importing sets no JAX flag. Turn on float64 for numbers to quote:
`jax.config.update("jax_enable_x64", True)`.
"""

import ast
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from typing import Any

STUB = ast.parse(Path(__file__).with_suffix(".pyi").read_text())
MODULES = {
    name.name: statement.module or ""
    for statement in STUB.body
    if isinstance(statement, ast.ImportFrom)
    for name in statement.names
}
"""Where each public name is; type checkers read the same file."""


def __getattr__(name: str) -> Any:
    """Public names are loaded when they are first used."""
    if name not in MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = globals()[name] = getattr(import_module(MODULES[name]), name)
    return value


def __dir__() -> list[str]:
    return sorted({*MODULES, "__version__"})


__version__ = version("walker-jax")
__all__ = sorted(MODULES)  # pyright: ignore[reportUnsupportedDunderAll] (computed from the stub)

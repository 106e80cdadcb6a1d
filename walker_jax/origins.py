"""Where code comes from: the user, an installed package, or one that versions identify."""

import functools
import os
import sys
import types
from importlib.machinery import all_suffixes
from pathlib import Path
from typing import Any

PACKAGE = __name__.partition(".")[0]
USED = "jax", "jaxlib", "equinox", "diffrax", "optimistix", "lineax", "numpy", "llvmlite"
"""Packages whose version a program depends on."""
KNOWN = {PACKAGE, *USED, *sys.builtin_module_names, "collections"}
"""Origins of code that versions identify; classes of `collections` are nodes of trees."""
FOLDER, STANDARD = Path(__file__).parent, Path(os.__file__).parent


def home_of(definition: Any) -> types.ModuleType | None:
    """Return the module of a definition; the package, if a compiled one names modules freely."""
    if isinstance(definition, types.ModuleType):
        return definition
    name = getattr(definition, "__module__", None)
    if isinstance(definition, types.FunctionType):  # if decorated, it names another module
        name = definition.__globals__.get("__name__")
    return sys.modules.get(str(name)) or sys.modules.get(str(name).partition(".")[0])


def top_of(home: types.ModuleType | None) -> str:
    """Return the name of the package that a module is in."""
    return getattr(home, "__name__", "").partition(".")[0]


def file_of(home: types.ModuleType | None) -> Path | None:
    """Return the file of a module's code, if there is one."""
    path = Path(str(getattr(home, "__file__", None)))
    return path if path.name.endswith((*all_suffixes(),)) and path.is_file() else None


def root_of(home: types.ModuleType, path: Path) -> Path:
    """Return the folder that holds a module of this file, or its top package."""
    spec = getattr(home, "__spec__", None)
    name = home.__name__ if spec is None else spec.name  # a program's own name is __main__
    depth = name.count(".") + (path.name == "__init__.py")
    return path.parents[min(depth, len(path.parents) - 1)]


@functools.cache
def is_own(home: types.ModuleType | None) -> bool:
    """Return whether a module is the user's own: neither known nor installed."""
    path = file_of(home)
    return not (is_known_module(home) or (home and path and holds_packages(root_of(home, path))))


def is_known_module(home: types.ModuleType | None) -> bool:
    """Return whether a module is part of this package, of one that it uses, or of Python."""
    path = file_of(home)
    return top_of(home) in KNOWN or (path is not None and is_known_file(path))


def is_known_file(path: Path) -> bool:
    """Return whether a file is part of this package or of the standard library."""
    if path.is_relative_to(STANDARD):
        return path.relative_to(STANDARD).parts[0] not in ("site-packages", "dist-packages")
    return path.is_relative_to(FOLDER)


@functools.cache
def holds_packages(folder: Path) -> bool:
    """Return whether a folder holds installed packages, rather than one project."""
    return folder == STANDARD or any(folder.glob("*.dist-info"))

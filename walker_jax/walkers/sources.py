"""The source files behind a module that is not of the package, as they were when it was loaded.

These are the module's own file and all that its import statements, those within functions too, name
in the same folder or package, and below it.
"""

import ast
import functools
import os
import sys
from collections.abc import Iterator
from importlib.machinery import all_suffixes
from pathlib import Path
from types import ModuleType

import equinox as eqx

STANDARD = Path(os.__file__).parent
"""The folder of the standard library; packages are installed in a folder within."""
KNOWN = Path(__file__).parents[1], Path(eqx.__file__).parent
"""The folders of this package and of Equinox: versions tell their code apart."""
Sources = dict[str, bytes]
"""Contents of files, by their paths from the folder in which their module or package is."""
kept: dict[Path, tuple[object, bytes]] = {}
"""Contents of the files that have been read, and what stood for their module then."""


def sources_of(kind: type) -> Sources:
    """The files of a class and of its bases, and what these import from below their folder."""
    sources: Sources = {}
    for base in kind.__mro__:
        module = home_of(base.__module__)
        path = file_of(module)
        if module is not None and path is not None:
            add_sources(path, root_of(module, path), sources)
    return sources


def home_of(name: str | None) -> ModuleType | None:
    """The module of that name; of a compiled package that names its modules freely, the package."""
    return sys.modules.get(str(name)) or sys.modules.get(str(name).partition(".")[0])


def file_of(module: ModuleType | None) -> Path | None:
    """The file of a module's code, if there is one."""
    name = getattr(module, "__file__", None)
    if not name or not name.endswith((*all_suffixes(),)):
        return None
    return path if (path := Path(name)).is_file() else None


def is_known(path: Path) -> bool:
    """Whether a file is of this package, of Equinox or of the standard library."""
    if path.is_relative_to(STANDARD):
        return path.relative_to(STANDARD).parts[0] not in ("site-packages", "dist-packages")
    return any(path.is_relative_to(folder) for folder in KNOWN)


@functools.cache
def holds_packages(folder: Path) -> bool:
    """Whether packages are installed in a folder: they are not of one project."""
    return folder == STANDARD or any(folder.glob("*.dist-info"))


def root_of(module: ModuleType, path: Path) -> Path:
    """The folder in which a module of this file is, or the package that it is in."""
    spec = getattr(module, "__spec__", None)
    name = module.__name__ if spec is None else spec.name  # that of a program is __main__
    depth = name.count(".") + (path.name == "__init__.py")
    return path.parents[min(depth, len(path.parents) - 1)]


def add_sources(path: Path, root: Path, sources: Sources) -> None:
    """Add a file, and those that it imports from below the root.

    Where packages are installed there, these are the files of the same package alone.
    """
    name = path.relative_to(root).as_posix()
    if name in sources or is_known(path):
        return
    own = [*path.relative_to(root).with_suffix("").parts]
    sources[name] = read_loaded(path, ".".join(own).removesuffix(".__init__"))
    # To import a module is to import the packages that it is in.
    imports = [(0, own), *imports_in(sources[name])] if path.suffix == ".py" else []
    for level, words in imports:
        base = path.parents[level - 1] if level else root
        same = level > 0 or words[0] == own[0]
        if base.is_relative_to(root) and (same or not holds_packages(root)):
            for other in located(base, words):
                add_sources(other, root, sources)


def read_loaded(path: Path, name: str) -> bytes:
    """The content of a module's file when that was loaded, or at the first call after that.

    A file may be edited while the code of before is in use, and its module loaded anew.
    """
    module = sys.modules.get(name)
    if file_of(module) != path:
        main = sys.modules.get("__main__")
        module = main if file_of(main) == path else None
    loaded = getattr(module, "__spec__", None) or module  # to load it anew makes another
    if loaded is None or path not in kept or kept[path][0] is not loaded:
        kept[path] = loaded, path.read_bytes()
    return kept[path][1]


@functools.cache
def imports_in(source: bytes) -> list[tuple[int, list[str]]]:
    """What a program imports, anywhere in it: the dots before a name, and its words."""
    found: list[tuple[int, list[str]]] = []
    try:
        tree = ast.parse(source)
    except (SyntaxError, ValueError):  # it cannot be imported either
        return found
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found += [(0, one.name.split(".")) for one in node.names]
        elif isinstance(node, ast.ImportFrom):
            stem = node.module.split(".") if node.module else []
            found += [(node.level, [*stem, one.name]) for one in node.names]
    return found


def located(folder: Path, words: list[str]) -> Iterator[Path]:
    """The files that are run when a name is imported from a folder: of packages, and of a module.

    The last words may name things within a module.
    """
    for word in words:
        for path in (folder / word / "__init__.py", folder / f"{word}.py"):
            if path.is_file():
                yield path
                break
        folder /= word

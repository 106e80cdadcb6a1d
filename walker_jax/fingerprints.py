"""Fingerprints of code, by which stores know it again: of its files, as loaded, or of its parts.

A definition in a file of the user's counts by that file and all that this imports from the same
folder or package. Without a file, as in a notebook, the rule of `identity` holds.
"""

import ast
import contextlib
import functools
import secrets
import sys
import threading
from collections.abc import Hashable, Iterator, Sequence
from pathlib import Path
from types import FunctionType
from typing import Any

from walker_jax.identity import MOST, Cache, Describer, hash_of_code, names_used, sha256_of
from walker_jax.origins import (
    file_of,
    holds_packages,
    home_of,
    is_known_file,
    is_known_module,
    root_of,
)

token_of_process = functools.cache(secrets.token_hex)
"""Identifies this process, for objects that cannot be described in another one."""


def code_fingerprint(kind: type, parts: tuple = ()) -> str:
    """Hash the code of a system's class, and other parts, such as the function of a map.

    The hash is empty for a class of the package without other parts. It covers the files of the
    class and its bases, and their imports from the same folder or package, as loaded; without a
    file, the functions and what they use. It does not cover data in other files.
    """
    describer = StoreDescriber(kind)
    if not describer.bases and not parts:
        return ""
    described = describer.describe(*describer.bases, *parts)
    return sha256_of([described, sorted(describer.sources.items())])[:16]  # alike once in 2^64


def keep_files_of(kind: type) -> None:
    """Keep the contents of a class's files, which may be edited while the class is in use."""
    StoreDescriber(kind)


class StoreDescriber(Describer):
    """Describes code for other processes: by its files, as loaded, or else by its parts."""

    here = False

    def __init__(self, kind: type = object):
        super().__init__()
        self.bases = [one for one in kind.__mro__ if not is_known_module(home_of(one))]
        self.sources: dict[str, bytes] = {}
        """Contents of files, by their paths from the folder that holds their module or package."""
        for one in self.bases:
            self.add_file_of(one)

    def looks_into(self, definition: Any) -> bool:
        return super().looks_into(definition) or definition in self.bases

    def name_definition(self, definition: Any) -> Hashable:
        self.add_file_of(definition)
        name = getattr(definition, "__qualname__", None)
        return name, getattr(home_of(definition), "__name__", None)

    def describe_code(self, function: FunctionType) -> Hashable:
        if self.add_file_of(function):  # where several functions may have one name
            return self.name_definition(function), hash_of_code(function.__code__)
        for name in names_used(function.__code__, "IMPORT_NAME"):
            for path in located(Path(), name.split(".")):
                self.add_file(path.absolute(), Path.cwd())
        return super().describe_code(function)

    def describe_class(self, kind: type) -> Hashable:
        """Name a class of a file; describe a class that a function makes, which depends on more."""
        in_file = "<locals>" not in kind.__qualname__ and self.add_file_of(kind)
        return self.name_definition(kind) if in_file else super().describe_class(kind)

    def identify(self, value: Any) -> Hashable:
        return token_of_process(), id(value)

    def add_file_of(self, definition: Any) -> bool:
        """Add the file of a definition that is described; return whether there is one."""
        home = home_of(definition)
        path = file_of(home) if self.looks_into(definition) else None
        if home is not None and path is not None:
            self.add_file(path, root_of(home, path))
        return path is not None

    def add_file(self, path: Path, root: Path) -> None:
        """Add a file, and what it imports from below the root; if installed, from its package."""
        name, own = path.relative_to(root).as_posix(), path.relative_to(root).with_suffix("").parts
        if name in self.sources or is_known_file(path):
            return
        self.sources[name] = source = read_loaded(path)
        imports = imports_in(source) if path.suffix == ".py" else []
        for level, words in [(0, own), *imports]:  # importing a module imports its packages
            base = path.parents[level - 1] if level else root
            within = level > 0 or words[0] == own[0] or not holds_packages(root)
            if within and base.is_relative_to(root):
                for other in located(base, words):
                    self.add_file(other, root)


kept: Cache = Cache()
"""Contents of files, and the spec of their modules at that time: a file in use may be edited."""


def read_loaded(path: Path) -> bytes:
    """Return a module's file as it was at its last loading, or at the first call after that."""
    modules = ((str(getattr(one, "__file__", "")), one) for one in [*sys.modules.values()])
    same = (one for file, one in modules if file.endswith(path.name) and Path(file) == path)
    module = next(same, None)
    loaded = getattr(module, "__spec__", None) or module  # reloading makes another spec
    if loaded is None or path not in kept or kept[path][0] is not loaded:
        kept[path] = loaded, path.read_bytes()
    return kept[path][1]


parsing = threading.Lock()
"""Held while Python parses: in 3.11, `ast.parse` in two threads at once may raise `SystemError`."""


@functools.lru_cache(MOST)
def imports_in(source: bytes) -> list[tuple[int, Sequence[str]]]:
    """Return all imports of a program: the dots before a name, and the parts of the name."""
    found: list[tuple[int, Sequence[str]]] = []
    with parsing, contextlib.suppress(SyntaxError, ValueError):  # such a file is never imported
        for node in ast.walk(ast.parse(source)):
            if isinstance(node, ast.Import):
                found += [(0, one.name.split(".")) for one in node.names]
            elif isinstance(node, ast.ImportFrom):
                stem = node.module.split(".") if node.module else []
                found += [(node.level, [*stem, one.name]) for one in node.names]
    return found


def located(folder: Path, words: Sequence[str]) -> Iterator[Path]:
    """Yield the files that an import from a folder runs; the name may end within a module."""
    for word in words:
        for path in (folder / word / "__init__.py", folder / f"{word}.py"):
            if path.is_file():
                yield path
                break
        folder /= word

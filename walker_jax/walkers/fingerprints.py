"""Fingerprints of walkers that are not of the package: has their code changed?

A stored result carries the fingerprint of the code that computed it, so that a result is not
resumed, or taken for its own, by a class whose equations are other ones by now.
"""

import hashlib
import inspect
import sys
from collections.abc import Iterator
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any

KNOWN = {*sys.stdlib_module_names, "equinox", "walker_jax"}
"""Packages of base classes that are not a user's own: versions tell these apart."""
DIGITS = 16
"""Hexadecimal digits of a fingerprint: two of a user's codes agree by chance once in 2^64."""


def code_fingerprint(kind: type) -> str:
    """A hash of the source code of a walker's class; empty for a class of the package.

    It covers the files of the class and of its bases, and the modules that these use from the same
    folder or package. Data that the code reads from other files is not covered.
    """
    own = [base for base in kind.__mro__ if base.__module__.split(".")[0] not in KNOWN]
    if not own:
        return ""
    parts: dict[str, bytes] = {}
    for base in own:
        module = sys.modules.get(base.__module__)
        if module is None or source_file(module) is None:  # of a notebook, or of a console
            parts[base.__qualname__] = b"".join(map(bytecode, functions(base)))
        else:
            add_sources(module, parts)
    content = b"\0".join(name.encode() + b"\0" + parts[name] for name in sorted(parts))
    return hashlib.sha256(content).hexdigest()[:DIGITS]


def source_file(module: Any) -> Path | None:
    """The file that holds the source of a module, if there is one."""
    name = getattr(module, "__file__", None)
    path = Path(name) if name else None
    return path if path is not None and path.suffix == ".py" and path.is_file() else None


def add_sources(module: ModuleType, parts: dict[str, bytes]) -> None:
    """Add the source of a module, and of those that it uses from its folder or package."""
    path = source_file(module)
    if path is None or module.__name__ in parts:
        return
    parts[module.__name__] = path.read_bytes()
    package = module.__name__.split(".")[0]
    for value in list(vars(module).values()):
        name = value.__name__ if inspect.ismodule(value) else getattr(value, "__module__", None)
        other = sys.modules.get(str(name))
        file, top = source_file(other), str(name).split(".")[0]
        near = top == package or (file is not None and file.parent == path.parent)
        if other is not None and near and top not in KNOWN:
            add_sources(other, parts)


def functions(kind: type) -> Iterator[CodeType]:
    """The compiled functions that a class defines, in the order in which it does."""
    for value in vars(kind).values():
        plain = inspect.unwrap(
            getattr(value, "__func__", None) or getattr(value, "fget", None) or value
        )
        code = getattr(plain, "__code__", None)
        if code is not None and code.co_filename != "<string>":  # which dataclasses write
            yield code


def bytecode(code: CodeType) -> bytes:
    """What a compiled function does, without the names and lines of its source."""
    constants = [
        bytecode(one) if isinstance(one, CodeType) else repr(one).encode() for one in code.co_consts
    ]
    names = " ".join((*code.co_names, *code.co_varnames, *code.co_freevars))
    return b"\0".join([code.co_code, names.encode(), *constants])

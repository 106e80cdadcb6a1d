"""Fingerprints of user code, by which stores know it again in other processes.

Code is the same while all that it reaches is the same, by the rule of `identity`: functions,
classes and values, as they are in this process, in whatever file they stand. A function also
reaches what it reads in modules that it imports when it runs.
"""

import contextlib
import dis
import functools
import secrets
from collections.abc import Hashable, Iterator, Sequence
from importlib import import_module
from importlib.util import find_spec, module_from_spec, resolve_name
from types import CodeType, FunctionType, ModuleType
from typing import Any

from walker_jax.identity import READING, Cache, Describer, globals_named, names_used, sha256_of
from walker_jax.origins import home_of, is_known_module, is_own, top_of

token_of_process = functools.cache(secrets.token_hex)
"""Identifies this process, for objects that cannot be described in another one."""


def code_fingerprint(kind: type, parts: tuple = ()) -> str:
    """Hash the code of a system's class, and other parts, such as the function of a map.

    The hash is empty for a class of the package without other parts. It does not cover data in
    files that are read when the code runs.
    """
    own = [one for one in kind.__mro__ if not is_known_module(home_of(one))]
    if not own and not parts:
        return ""
    return sha256_of(StoreDescriber(own).describe(*own, *parts))[:16]  # alike once in 2^64


class StoreDescriber(Describer):
    """Describes code for other processes.

    Installed code in the package of one of the `bases` counts as the user's own does.
    """

    here = False

    def __init__(self, bases: list[type] | tuple = ()):
        super().__init__()
        self.packages = {top_of(home_of(one)) for one in bases}

    def looks_into(self, definition: Any) -> bool:
        return super().looks_into(definition) or top_of(home_of(definition)) in self.packages

    def globals_of(self, function: FunctionType) -> dict[str, Any]:
        read = names_used(function.__code__, *READING)
        return globals_named(function, read, Cache, imported_by(function))

    def name_definition(self, definition: Any) -> Hashable:
        name = getattr(definition, "__qualname__", None)
        return name, getattr(home_of(definition), "__name__", None)

    def identify(self, value: Any) -> Hashable:
        return token_of_process(), id(value)


def imported_by(function: FunctionType) -> Iterator[ModuleType]:
    """Yield the user's own modules that a function imports when it runs."""
    for level, name, names in imports_in(function.__code__):
        package = function.__globals__.get("__package__")
        for end in ("", *(f".{one}" for one in names)):  # a name may be that of a module
            with contextlib.suppress(Exception):  # as of an optional package
                path = resolve_name("." * level + name, package) + end
                spec = find_spec(path.partition(".")[0])
                if spec is not None and is_own(module_from_spec(spec)):
                    yield import_module(path)


def imports_in(code: CodeType) -> Iterator[tuple[int, str, Sequence[str]]]:
    """Yield the imports of a code object: the dots before a name, the name, and those from it."""
    steps = [one for one in dis.get_instructions(code) if one.opname != "EXTENDED_ARG"]
    for level, names, step in zip(steps, steps[1:], steps[2:], strict=False):
        if step.opname == "IMPORT_NAME":
            yield level.argval, step.argval, names.argval or ()
    for inner in code.co_consts:
        if isinstance(inner, CodeType):
            yield from imports_in(inner)

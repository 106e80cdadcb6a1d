"""Code that has no file: of a notebook or a console.

Its description holds what its functions do and use: constants, defaults, closures and globals.
"""

import contextlib
import dis
import secrets
import sys
import types
from pathlib import Path
from typing import Any

from walker_jax.kernels.outside_code import codes_of, globals_of
from walker_jax.kernels.program_cache import NOT_CODE, PARTS
from walker_jax.walkers.sources import (
    Sources,
    add_sources,
    file_of,
    holds_packages,
    home_of,
    is_known,
    located,
    root_of,
)

PLAIN = str, bytes, bool, int, float, complex, range, slice, type(None), type(...)
"""Types of values that their words tell from all others."""
GENERATED = NOT_CODE | {
    *("__annotate_func__", "__annotations_cache__", "__static_attributes__", "__firstlineno__"),
    *("__dataclass_params__", "__parameters__", "__orig_bases__"),
}
"""Attributes of classes that Python derives from the others, or takes from the lines of a file."""
token_of_process = secrets.token_hex()
"""Of this process: it stands for what cannot be told from something else."""


def attributes(kind: type) -> dict[str, Any]:
    """What a class defines, without what Python adds."""
    return {name: vars(kind)[name] for name in sorted(vars(kind).keys() - GENERATED)}


class Description:
    """Describes values one after the other, each thing once."""

    def __init__(self, sources: Sources):
        self.sources = sources
        """Files of the code that is used, to which others are added."""
        self.seen: dict[int, Any] = {}
        """What has been described, by its id, which stays its own as long as it is kept here."""

    def describe(self, value: Any) -> Any:
        """Nested lists of words, the same in another process for the same code."""
        if isinstance(value, PLAIN):
            return repr(value)
        if isinstance(value, types.CodeType):
            names = value.co_names, value.co_varnames, value.co_freevars
            return [value.co_code.hex(), names, self.describe(value.co_consts)]
        if isinstance(value, types.CellType):
            with contextlib.suppress(ValueError):  # it may be empty
                return self.describe(value.cell_contents)
            return []
        if type(value) in (tuple, list):
            return [*map(self.describe, value)]
        if type(value) in (dict, types.MappingProxyType):
            return [[self.describe(key), self.describe(item)] for key, item in value.items()]
        if type(value) in (set, frozenset):
            return sorted(map(repr, map(self.describe, value)))
        if id(value) in self.seen:
            return [*self.seen].index(id(value))
        self.seen[id(value)] = value
        if isinstance(value, types.ModuleType) or hasattr(value, "__qualname__"):
            return self.describe_definition(value)
        return self.describe_object(value)

    def describe_definition(self, value: Any) -> Any:
        """A module, class or function: its name, and its code where no file or version has it."""
        if isinstance(value, types.ModuleType):
            words, home = [value.__name__], value
        elif isinstance(value, types.FunctionType):  # a decorator's has the names of another one
            words, home = [value.__qualname__], home_of(value.__globals__.get("__name__"))
        else:
            words, home = [value.__qualname__], home_of(getattr(value, "__module__", None))
        path = file_of(home)
        if home is not None and path is not None:
            root = root_of(home, path)
            if not is_known(path) and not holds_packages(root):
                add_sources(path, root, self.sources)
            return [*words, home.__name__, self.describe(getattr(value, "__closure__", None))]
        if home is not None and home.__name__ in sys.builtin_module_names:
            return [*words, home.__name__]
        if isinstance(value, type):
            return [*words, self.describe(value.__bases__), self.describe(attributes(value))]
        if isinstance(value, types.FunctionType):
            parts = value.__code__, value.__defaults__, value.__kwdefaults__, value.__closure__
            return [*words, self.describe(parts), self.describe(self.globals_of(value))]
        return [*words, self.describe_object(value)]

    def globals_of(self, function: types.FunctionType) -> dict[str, Any]:
        """What a function reads of the names around it; files that it imports are added."""
        for code in codes_of(function):
            for step in dis.get_instructions(code):
                if step.opname == "IMPORT_NAME":
                    for path in located(Path.cwd(), step.argval.split(".")):
                        add_sources(path, Path.cwd(), self.sources)
        return globals_of(function)

    def describe_object(self, value: Any) -> Any:
        """What something is made of: by its parts if it wraps functions, otherwise as pickle does.

        What cannot be pickled is equal to nothing in another process.
        """
        if hasattr(value, "__wrapped__") or hasattr(value, "fget"):
            parts = {name: getattr(value, name) for name in PARTS if hasattr(value, name)}
            return [self.describe(type(value)), self.describe(parts)]
        try:
            state = value.__reduce_ex__(2)
        except Exception:  # whatever its class raises
            return [token_of_process, id(value)]
        return self.describe(state)

"""Code is the same while its parts are the same; installed code counts by its name.

The parts are

- of a function, its code, defaults and closure, and the globals it reads, in modules too;
- of a class, its bases and attributes;
- of containers, arrays and plain values, their contents;
- of any other object, its type and all its state, as pickle takes it; without state, itself.

Another text that documents a function or a class makes no difference. Installed code is that of
Python, of this package and of other packages. What it makes at run time, such as a lambda, has no
name of its own, and counts by its code, defaults and closure.

A compiled program depends on its functions as they were when JAX traced them, and is used again
while they are the same (`FunctionByCode`). Stores and traces on disk are so while the code of
another process is the same: `fingerprints` and `kernels.program_cache` describe it for them.
"""

import contextlib
import dis
import functools
import hashlib
import re
import sys
import types
from collections import OrderedDict
from collections.abc import Hashable
from dataclasses import Field
from typing import Any

import jax
import numpy as np

from walker_jax.origins import PACKAGE, home_of, is_own, top_of
from walker_jax.state_of_objects import DERIVED, has_no_state, state_of

PLAIN = {str, bytes, bool, int, float, complex, range, slice, type(None), type(...)}
"""Types whose values are identified by their `repr`."""
LARGEST = 2**16
"""Bytes of the largest array that is compared by its values; a larger one equals only itself."""
MOST = 4096
"""Size of each cache of descriptions: of codes, trees, modules and files."""
ALONE = np.ndarray | jax.Array | Field
"""Types that count as themselves in a process: large arrays, and what a class is made with."""
DEFINED = types.FunctionType | type
READING = "LOAD_GLOBAL", "LOAD_NAME", "LOAD_FROM_DICT_OR_GLOBALS"
FIRST_CONSTANT = [bytes((code, 0)) for code in dis.hasconst if code < 256]
"""Instructions that use the first constant of a code object."""
ADDRESS = re.compile(r" at 0x[0-9a-f]+")


class Cache(OrderedDict):
    """A dictionary of this package that saves time alone: no result depends on it."""


class ComparedBy:
    """A value that equals another one whose state is equal."""

    def __init__(self, value: Any, state: Hashable):
        self.value, self.state = value, state

    def __eq__(self, other: object) -> bool:
        return isinstance(other, ComparedBy) and self.state == other.state

    def __hash__(self) -> int:
        return hash(self.state)


class FunctionByCode(ComparedBy):
    """A user's function, equal to another one of the same code that reads the same values.

    As a static argument of `jax.jit` it is traced again when the values that it reads have changed.
    """

    def __init__(self, function: Any, state: Hashable = None):
        super().__init__(function, Describer().describe(function) if state is None else state)

    def __call__(self, *args):
        return self.value(*args)


class Description(tuple):
    """A description, which computes its hash once: JAX asks for it at each operation of a trace."""

    @functools.cached_property
    def known_hash(self) -> int:
        return super().__hash__()

    def __hash__(self) -> int:
        return self.known_hash

    def __reduce__(self):
        return Description, (tuple(self),)  # without the hash, which is of this process


class Describer:
    """Describes code so that, within a process, equal descriptions mean the same code."""

    here = True
    """Whether descriptions serve this process alone, where an object may stand for itself."""

    def __init__(self):
        self.found: list[Any] = []
        """Objects with their own description; keeping them keeps their ids from being reused."""
        self.numbers: dict[int, int] = {}

    def describe(self, *values: Any) -> Description:
        """Describe values, and then every object that these refer to, once each."""
        words = tuple(map(self.refer_to, values))
        # The list grows meanwhile.
        return Description((words, *map(self.describe_found, self.found)))

    def refer_to(self, value: Any) -> Hashable:
        """Return a hashable form of a plain value or array, or the number of a description."""
        if type(value) in PLAIN:
            return type(value).__name__, repr(value)
        if id(value) in self.numbers:
            return self.numbers[id(value)]
        if (values := values_in(value, LARGEST if self.here else sys.maxsize)) is not None:
            return values
        if type(value) is tuple:  # inline, as equal ones may be one object in another process
            return "tuple", *map(self.refer_to, value)
        self.numbers[id(value)] = len(self.found)
        self.found.append(value)
        return self.numbers[id(value)]

    def describe_found(self, value: Any) -> Hashable:
        kind = type(value)
        if kind is list:
            return "list", *map(self.refer_to, value)
        if kind in (set, frozenset):
            in_order = sorted(value, key=lambda one: ADDRESS.sub("", repr(one)))
            return "set", *map(self.refer_to, in_order)
        if kind in (dict, types.MappingProxyType):
            return "dict", *((self.refer_to(key), self.refer_to(value[key])) for key in value)
        if isinstance(value, types.CellType):
            try:
                inside = value.cell_contents
            except ValueError:  # the cell is empty
                return ()
            return self.refer_to(inside)
        if isinstance(value, types.CodeType):
            return hash_of_code(value)
        if isinstance(value, types.FunctionType):
            return self.describe_function(value)
        if isinstance(value, type):
            return self.describe_class(value)
        if isinstance(value, types.ModuleType):
            return self.name_definition(value)
        return self.describe_object(value)

    def describe_object(self, value: Any) -> Hashable:
        """Describe an object by its state; within a process, one without any stands for itself."""
        state = state_of(value)
        if isinstance(state, str):
            return self.name_definition(value), state
        kind = self.refer_to(type(value))
        if state is None or (self.here and (isinstance(value, ALONE) or has_no_state(state))):
            return kind, self.identify(value)
        return kind, *map(self.refer_to, state)

    def describe_function(self, function: types.FunctionType) -> Hashable:
        closure = self.refer_to(function.__closure__)
        more = function.__defaults__, function.__kwdefaults__, vars(function) or None
        if self.looks_into(function):
            return self.describe_code(function), closure, *map(self.refer_to, more)
        code = function.__code__
        names = self.name_definition(function), code.co_qualname  # a wrapper has another's name
        made = "<" in code.co_qualname  # a lambda, or defined within a function
        parts = (hash_of_code(code), *map(self.refer_to, more[:2])) if made else ()
        return names, closure, *parts

    def describe_code(self, function: types.FunctionType) -> Hashable:
        read = ((name, self.refer_to(value)) for name, value in self.globals_of(function).items())
        return hash_of_code(function.__code__), *read

    def globals_of(self, function: types.FunctionType) -> dict[str, Any]:
        """Return the globals that a function reads, by their names, also as parts of modules."""
        return globals_named(function, names_used(function.__code__, *READING), Cache)

    def describe_class(self, kind: type) -> Hashable:
        if not self.looks_into(kind):
            return self.name_definition(kind)
        own = vars(kind)
        named = ((one, self.refer_to(own[one])) for one in sorted(own.keys() - DERIVED))
        return self.name_definition(kind), self.refer_to(kind.__bases__), *named

    def looks_into(self, definition: Any) -> bool:
        """Return whether a definition counts by more than its name."""
        return is_own(home_of(definition))

    def name_definition(self, definition: Any) -> Hashable:
        """Return the name by which a definition counts; within a process, the object itself."""
        return ComparedBy(definition, id(definition))  # kept, so that no other gets its number

    def identify(self, value: Any) -> Hashable:
        """Return the object, or any other that it is equal to, within a process."""
        with contextlib.suppress(Exception):  # a user's `__hash__` may raise
            hash(value)
            return value
        return self.name_definition(value)


def values_in(value: Any, largest: int) -> Hashable:
    """Identify an array by its values; None for anything else, and for a larger array."""
    if isinstance(value, np.ndarray | np.generic | jax.Array):
        with contextlib.suppress(TypeError):  # raised by tracers and keys
            if value.dtype != object and value.nbytes <= largest:
                return str(value.dtype), value.shape, sha256_of(np.asarray(value).tobytes())
    return None


def sha256_of(content: Any) -> str:
    content = content if isinstance(content, bytes) else repr(content).encode()
    return hashlib.sha256(content).hexdigest()


@functools.lru_cache(MOST)
def hash_of_code(code: types.CodeType) -> str:
    """Hash what a code object does, wherever it stands in its file."""
    names = code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars
    counts = code.co_argcount, code.co_posonlyargcount, code.co_kwonlyargcount, code.co_flags
    constants = Describer().describe(code.co_consts[has_docstring(code) :])
    return sha256_of((code.co_code, code.co_exceptiontable, names, counts, constants))


def globals_named(function: types.FunctionType, read: list[str], left_out: Any) -> dict[str, Any]:
    """Return the globals of these names, also as attributes of modules, without some types.

    Left out are installed modules too, which do not change.
    """
    found, inside = {}, names_used(function.__code__)
    spaces = [("", function.__globals__, read)]
    for place, space, names in spaces:
        for name, value in ((one, space[one]) for one in names if one in space):
            if isinstance(value, types.ModuleType):
                changes = is_own(value) or top_of(value) == PACKAGE
                if changes and all(vars(value) is not one for _, one, _ in spaces):
                    spaces.append((f"{place}{name}.", vars(value), inside))
            elif not isinstance(value, left_out):
                found[f"{place}{name}"] = value
    return found


def has_docstring(code: types.CodeType) -> bool:
    """Return whether the first constant is a text that no instruction uses: it documents."""
    first = next(iter(code.co_consts), None)
    return isinstance(first, str) and not any(use in code.co_code for use in FIRST_CONSTANT)


@functools.lru_cache(MOST)
def names_used(code: types.CodeType, *how: str) -> list[str]:
    """Return the names in a code object and those within it, by some instructions or by any."""
    names = set(code.co_names)
    if how:
        names = {one.argval for one in dis.get_instructions(code) if one.opname in how}
    inner = (one for one in code.co_consts if isinstance(one, types.CodeType))
    return sorted(names.union(*(names_used(one, *how) for one in inner)))

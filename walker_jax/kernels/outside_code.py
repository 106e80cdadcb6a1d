"""What a user's own code is at this moment, and what it reads around it.

A program is made of functions as they are when they are traced. Those of a user's own may read
globals, or variables of a function around them, that have other values at the next call: then it
takes another program, as it does when a class is defined anew.
"""

import contextlib
import dis
import functools
import sys
import sysconfig
import types
from collections.abc import Callable, Hashable
from pathlib import Path
from typing import Any

import jax
import numpy as np

from walker_jax.kernels.program_cache import KNOWN, NOT_CODE, PARTS

PLAIN = str, bytes, bool, int, float, complex, type(None)
"""Types of values that are told from all others by their words."""
LARGEST = 2**16
"""Bytes of an array that is compared by its values; a larger one is compared by identity."""
MOST_STRUCTURES = 1024
"""Codes, trees and modules of which it is remembered what they are, each."""
INSTALLED = [Path(sysconfig.get_path(name)) for name in ("stdlib", "purelib", "platlib")]
"""Folders of code that is not a user's own."""


class AsItIs:
    """A user's function, equal to another one of the same code that reads the same values.

    As a static argument of `jax.jit` it is traced again where what it reads has changed.
    """

    def __init__(self, function: Callable):
        self.function, self.state = function, state_of(function)

    def __call__(self, *args):
        return self.function(*args)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, AsItIs) and self.state == other.state

    def __hash__(self) -> int:
        return hash(self.state)


class Same:
    """Something that is equal to itself alone."""

    def __init__(self, value: Any):
        self.value = value

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Same) and self.value is other.value

    def __hash__(self) -> int:
        return id(self.value)


def state_of(value: Any, seen: dict[int, int] | None = None) -> Hashable:
    """Equal for the same code that reads the same values.

    Attributes of modules and of objects are not looked at: these are equal to themselves, or to
    what their class says.
    """
    seen = {} if seen is None else seen
    inner = functools.partial(state_of, seen=seen)
    if isinstance(value, PLAIN):
        return type(value), repr(value)
    values = values_in(value)
    if values is not None:
        return values
    if id(value) in seen:
        return seen[id(value)]
    seen[id(value)] = len(seen)
    if isinstance(value, tuple) or type(value) is list:
        return type(value), *map(inner, value)
    if type(value) in (dict, types.MappingProxyType):
        return dict, *((inner(key), inner(item)) for key, item in value.items())
    if type(value) in (set, frozenset):
        return frozenset(map(inner, value))
    if isinstance(value, types.CellType):
        with contextlib.suppress(ValueError):  # it may be empty
            return inner(value.cell_contents)
        return ()
    if isinstance(value, type | types.FunctionType) and not is_outside(value.__module__):
        return Same(value)
    if isinstance(value, types.FunctionType):
        parts = value.__defaults__, value.__kwdefaults__, value.__closure__
        return value.__code__, *map(inner, parts), *map(inner, globals_of(value).values())
    if isinstance(value, type):
        named = ((name, vars(value)[name]) for name in sorted(vars(value).keys() - NOT_CODE))
        bases = map(inner, value.__bases__)
        return Same(value), *((name, inner(one)) for name, one in named), *bases
    parts = [getattr(value, name) for name in PARTS if hasattr(value, name)]
    if parts:
        return type(value), *map(inner, parts)
    return inner(type(value)), value if is_compared_by_value(value) else Same(value)


def is_compared_by_value(value: Any) -> bool:
    """Whether a thing is equal to others that it says are the same."""
    with contextlib.suppress(Exception):  # whatever its class raises
        hash(value)
        return type(value).__eq__ is not object.__eq__
    return False


def values_in(value: Any) -> Hashable:
    """The values of an array; None for anything else, and for a large one."""
    if isinstance(value, np.ndarray | np.generic | jax.Array) and value.nbytes <= LARGEST:
        with contextlib.suppress(TypeError):  # of a tracer, or of a key
            return value.dtype.name, value.shape, np.asarray(value).tobytes()
    return None


def globals_of(function: types.FunctionType) -> dict[str, Any]:
    """What a function reads of the names around it."""
    names = (name for code in codes_of(function) for name in names_read(code))
    around = function.__globals__
    return {name: around[name] for name in names if name in around}


def codes_of(function: types.FunctionType) -> list[types.CodeType]:
    """The code of a function, and of those within it."""
    codes = [function.__code__]
    for code in codes:
        codes += [one for one in code.co_consts if isinstance(one, types.CodeType)]
    return codes


@functools.lru_cache(MOST_STRUCTURES)
def names_read(code: types.CodeType) -> tuple[str, ...]:
    """The global names that a code reads."""
    reading = ("LOAD_GLOBAL", "LOAD_NAME", "LOAD_FROM_DICT_OR_GLOBALS")
    return tuple(one.argval for one in dis.get_instructions(code) if one.opname in reading)


@functools.lru_cache(MOST_STRUCTURES)
def outside_classes(structure: Any) -> tuple[type, ...]:
    """Classes of a tree's nodes that are a user's own."""
    data = structure.node_data()
    if data is None:
        return ()
    inner = [one for child in structure.children() for one in outside_classes(child)]
    return (data[0], *inner) if is_outside(data[0].__module__) else tuple(inner)


def states_of(function: Callable, structure: Any) -> tuple[Hashable, ...]:
    """The states of a user's own code that a function of arguments in this tree runs."""
    own = (function,) if is_outside(getattr(function, "__module__", None)) else ()
    return tuple(map(state_of, (*own, *outside_classes(structure))))


@functools.lru_cache(MOST_STRUCTURES)
def is_outside(module: str | None) -> bool:
    """Whether a module is of a user's own: not known, of Python, or installed."""
    if str(module).partition(".")[0] in KNOWN:
        return False
    file = getattr(sys.modules.get(str(module)), "__file__", None)
    if file is None:
        return str(module) not in sys.builtin_module_names
    return not any(Path(file).is_relative_to(folder) for folder in INSTALLED)

"""An on-disk cache of tracing results, so that processes share what one of them has traced.

Once the machine code of a function is on disk, most of the time until a first answer goes into
tracing it and writing its program. So the shapes of its results are kept on disk too, with the name
of the code. They are found by a hash of all that a trace depends on:

- the function, the shapes and types of its arguments, and the static parts of these;
- the settings of JAX under which it is traced;
- the code of this package that it reaches, and all that this reads but caches and values for a call
  alone (`ContextVar`), as it is in this process: what is replaced at run time is traced anew;
- the package's source files, as they were when loaded, and the versions of the packages it uses.

Functions and classes of other packages, including a user's own walkers, are traced in each process.
"""

import functools
import hashlib
import importlib
import json
import platform
import sys
import types
from collections.abc import Callable, Hashable, Sequence
from contextvars import ContextVar
from importlib.metadata import version
from typing import Any, NamedTuple

import jax
import numpy as np
from jax.core import ShapedArray

from walker_jax.identity import (
    ADDRESS,
    DEFINED,
    MOST,
    Cache,
    Describer,
    Description,
    FunctionByCode,
    globals_named,
    names_used,
    sha256_of,
)
from walker_jax.kernels.machine import register_bits
from walker_jax.kernels.object_cache import recall, store
from walker_jax.origins import (
    FOLDER,
    KNOWN,
    PACKAGE,
    USED,
    home_of,
    is_known_module,
    top_of,
)

OPTIONS = (
    *("jax_default_matmul_precision", "jax_default_prng_impl", "jax_disable_jit"),
    *("jax_enable_custom_prng", "jax_numpy_rank_promotion", "jax_softmax_custom_jvp"),
    *("jax_threefry_partitionable", "jax_use_direct_linearize", "jax_debug_nans"),
)
"""Settings of JAX on which a trace may depend, besides those of `program.MODES`."""
MOST_SHARED = 256
"""Descriptions of user code that are kept to be shared."""
code_of_program = jax.make_user_context(None)
"""State of the user code in the program that is being traced (`user_code_states`)."""


class Traced(NamedTuple):
    """Facts about a function that are known without tracing it."""

    operands: list[ShapedArray]
    results: list[ShapedArray]
    tree: Any
    """The tree of the results; None of a derivative."""
    size: int
    """The number of operations of one cell."""
    digest: str
    """The hash of its program, which names its machine code."""


class Unknown(Exception):
    """A trace depends on something that has no unique description."""


def trace_name(function: Any, structure: Any, avals: Sequence, settings: tuple) -> str | None:
    """Return the hash that names a function's trace; None if the trace cannot be identified."""
    statics = statics_of(structure)
    leaves, nodes = jax.tree.flatten(statics)
    classes = *classes_of(structure), *classes_of(nodes), *map(type, leaves)
    try:
        places = [*map(definition_place, (function, *classes))]
        words = str(structure), [value for _, value in settings], [*map(describe_aval, avals)]
        if ADDRESS.search(repr(words)):
            raise Unknown
        code = environment(), ReachedCode().describe(function, classes, statics)
    except Unknown:
        return None
    options = [str(getattr(jax.config, option, None)) for option in OPTIONS]
    # Machines with different registers may share a folder.
    return sha256_of((places, words, options, code, register_bits()))


class ReachedCode(Describer):
    """Describes the code of this package that a function reaches, as it is in this process.

    A user may have replaced some of it. Everything else is identified by its text, or is part of
    the source files.
    """

    here = False

    def looks_into(self, definition: Any) -> bool:
        return super().looks_into(definition) or top_of(home_of(definition)) == PACKAGE

    def globals_of(self, function: types.FunctionType) -> dict[str, Any]:
        """Leave out of the code of this package what is for a call alone."""
        if super().looks_into(function):
            return super().globals_of(function)
        return globals_named(function, names_used(function.__code__), Cache | ContextVar)

    def name_definition(self, definition: Any) -> Hashable:
        return tuple(getattr(definition, f"__{name}__", None) for name in ("module", "qualname"))

    def describe_object(self, value: Any) -> Hashable:
        if top_of(home_of(type(value))) in ("llvmlite", "pathlib"):
            return None  # they keep their texts once asked, and paths are of one machine
        return super().describe_object(value)

    def identify(self, value: Any) -> Hashable:
        if not is_known_module(home_of(type(value))):
            raise Unknown


def statics_of(structure: Any) -> list[Any]:
    """Return the static values in the nodes of a tree."""
    data = structure.node_data()
    inner = [one for child in structure.children() for one in statics_of(child)]
    return inner if data is None else [data[1], *inner]


def user_code_states(function: Callable, structure: Any) -> tuple[Hashable, ...]:
    """Describe the user code that a function of arguments in this tree runs; () if none."""
    describer = Describer()
    describer.describe(function)
    definitions = (one for one in describer.found if isinstance(one, DEFINED))
    functions = (function,) if any(map(describer.looks_into, definitions)) else ()
    held = *classes_of(structure), *static_functions(structure)
    own = *functions, *filter(describer.looks_into, held)
    return shared(Describer().describe(*own)) if own else ()


@functools.lru_cache(MOST_SHARED)
def shared(states: Description) -> Description:
    """Return one object for all equal descriptions, which then need no comparison."""
    return states


@functools.lru_cache(MOST)
def user_system_in(structure: Any) -> str | None:
    """Return the name of the first system in a tree that has code of a user's own, if any.

    It is that of the system's class, or of a function that the system holds, such as a map's.
    """
    looks_into = Describer().looks_into
    systems = [one for one in classes_of(structure) if hasattr(one, "advance")]
    held = static_functions(structure) if systems else ()
    own = (one for one in (*systems, *held) if looks_into(one))
    return next((getattr(one, "__qualname__", type(one).__qualname__) for one in own), None)


@functools.lru_cache(MOST)
def classes_of(structure: Any) -> tuple[type, ...]:
    """Return the classes of a tree's nodes."""
    data = structure.node_data()
    inner = (one for child in structure.children() for one in classes_of(child))
    return () if data is None else (data[0], *inner)


@functools.lru_cache(MOST)
def static_functions(structure: Any) -> tuple[Callable, ...]:
    """Return the functions and other callable objects that are static in a tree's nodes."""
    return tuple(one for one in jax.tree.leaves(statics_of(structure)) if callable(one))


def identify_by_code(function: Callable) -> FunctionByCode | None:
    """Wrap a function so that it equals any other with the same code and globals.

    None if it has more than these, such as a closure or defaults.
    """
    plain = isinstance(function, types.FunctionType) and not function.__closure__
    if not plain or function.__defaults__ or function.__kwdefaults__:
        return None
    return FunctionByCode(function, (function.__code__, id(function.__globals__)))


def definition_place(thing: Any) -> str:
    """Return where a function or class is defined; `Unknown` if it is not found there.

    A class made at run time is not found there, and another may have its name.
    """
    module, name = (str(getattr(thing, one, None)) for one in ("__module__", "__qualname__"))
    homes = {PACKAGE} if isinstance(thing, types.FunctionType) else KNOWN
    found = sys.modules.get(module)
    if module.partition(".")[0] not in homes:
        raise Unknown
    for part in name.split("."):
        found = getattr(found, part, None)
    while found is not thing and hasattr(found, "__wrapped__"):
        found = vars(found)["__wrapped__"]
    if found is not thing and thing is not types.NoneType:
        raise Unknown
    return f"{module}:{name}"


@functools.cache
def environment() -> tuple:
    """Return the versions that a trace depends on, and a hash of the package's source files."""
    found = hashlib.sha256()
    for path in sorted(FOLDER.rglob("*.py")):
        found.update(path.relative_to(FOLDER).as_posix().encode() + b"\0" + path.read_bytes())
    return platform.python_version(), [version(name) for name in USED], found.hexdigest()


environment()  # now, as a file may be edited later, while the loaded code is still the former


def recall_trace(name: str | None) -> Traced | None:
    """Read the trace under a name from disk."""
    content = recall(name) if name else None
    if content is None:
        return None
    try:
        found = json.loads(content)
        arrays = lambda avals: [
            ShapedArray(tuple(s), np.dtype(t), weak_type=w) for s, t, w in avals
        ]
        like = found["tree"]
        tree = None if like is None else jax.tree.structure(decode_tree(like))
        return Traced(
            *(arrays(found["operands"]), arrays(found["results"]), tree),
            *(found["size"], found["digest"]),
        )
    except (ValueError, KeyError, TypeError, AttributeError, ImportError):
        return None


def keep_trace(name: str | None, traced: Traced) -> None:
    """Write the facts about a function to disk, if its trace has a name."""
    if name is None:
        return
    try:
        like = None if traced.tree is None else encode_tree(traced.tree)
    except Unknown:
        return
    found = {
        "operands": list(map(describe_aval, traced.operands)),
        "results": list(map(describe_aval, traced.results)),
        **{"tree": like, "size": traced.size, "digest": traced.digest},
    }
    store(name, json.dumps(found).encode())


def describe_aval(aval: Any) -> tuple:
    return tuple(aval.shape), np.dtype(aval.dtype).name, bool(aval.weak_type)


def encode_tree(tree: Any) -> Any:
    """Encode a tree of results for a file, by classes of nodes and keys of dictionaries."""
    if tree.node_data() is None:
        return 0
    kind, keys = tree.node_data()
    place = definition_place(kind)
    if place not in MAKERS and not hasattr(kind, "_fields"):
        raise Unknown
    keys = keys if kind is dict else []
    if not all(isinstance(key, str) for key in keys):
        raise Unknown
    return [place, keys, *map(encode_tree, tree.children())]


def decode_tree(like: Any) -> Any:
    """Decode a tree of results, with zeros for its leaves."""
    if like == 0:
        return 0
    place, keys, *children = like
    children = list(map(decode_tree, children))
    if place in MAKERS:
        return MAKERS[place](keys, children)
    module, name = place.split(":")
    if module.partition(".")[0] != PACKAGE:
        raise ImportError(place)
    return getattr(importlib.import_module(module), name)(*children)


MAKERS: dict[str, Callable] = {
    "builtins:dict": lambda keys, children: dict(zip(keys, children, strict=True)),
    "builtins:list": lambda keys, children: children,
    "builtins:tuple": lambda keys, children: tuple(children),
    "builtins:NoneType": lambda keys, children: None,
}
"""By the place of a class of Python's own: how a node of it is made from keys and children."""

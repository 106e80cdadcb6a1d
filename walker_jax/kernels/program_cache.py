"""What tracing led to, on disk, so that a process need not trace what another one has traced.

To trace a function and to write its program takes most of the time until a first answer, once its
machine code is on disk. So the shapes of its results are kept there too, beside the name of the
code. They are found by a hash of all that a trace depends on:

- the function, the shapes and types of its arguments, and the static parts of these;
- the settings of JAX under which it is traced;
- the code of this package as it is in this process, function by function: whoever replaces one at
  run time gets a trace of what is there now; its source files, as they were when it was loaded; and
  the versions of the packages that it uses.

Functions and classes of other packages, a user's own walkers among them, are traced in each
process.
"""

import contextlib
import functools
import hashlib
import importlib
import inspect
import json
import platform
import re
import sys
import types
from collections.abc import Iterator, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from jax.core import ShapedArray

from walker_jax.kernels.machine import register_bits
from walker_jax.kernels.object_cache import recall, store

PACKAGE = __name__.partition(".")[0]
FOLDER = Path(sys.modules[PACKAGE].__path__[0])
USED = "jax", "jaxlib", "equinox", "diffrax", "optimistix", "lineax", "numpy", "llvmlite"
"""Packages on whose version a trace depends, or what is compiled of it."""
KNOWN = {PACKAGE, *USED, "builtins", "collections"}
"""Where classes may come from that a trace depends on: versions tell these apart."""
OPTIONS = (
    *("jax_default_matmul_precision", "jax_default_prng_impl", "jax_disable_jit"),
    *("jax_enable_custom_prng", "jax_numpy_rank_promotion", "jax_softmax_custom_jvp"),
    *("jax_threefry_partitionable", "jax_use_direct_linearize", "jax_debug_nans"),
)
"""Settings of JAX on which a trace may depend, besides those of `program.MODES`."""
ADDRESS = re.compile(r" at 0x[0-9a-f]+")


class Traced(NamedTuple):
    """What is known of a function without tracing it."""

    operands: list[ShapedArray]
    results: list[ShapedArray]
    tree: Any
    """The tree of the results; None of a derivative."""
    size: int
    """The number of operations of one cell."""
    digest: str
    """Of its program, by which its machine code is found."""


class Unknown(Exception):
    """A trace depends on something that cannot be told from something else."""


def name_of(function: Any, structure: Any, avals: Sequence, settings: tuple) -> str | None:
    """The hash by which a function's trace is known; None if it depends on what cannot be told."""
    try:
        parts = (
            *(place_of(function), describe_tree(structure), [describe_aval(x) for x in avals]),
            *([describe_value(value) for _, value in settings], environment()),
            *([str(getattr(jax.config, option, None)) for option in OPTIONS],),
            code_of({function.__module__, *modules_of(structure)}),
            register_bits(),  # machines of several kinds may share a folder
        )
    except Unknown:
        return None
    return digest_of(parts)


def digest_of(parts: Any) -> str:
    return hashlib.sha256(repr(parts).encode()).hexdigest()


def recall_trace(name: str | None) -> Traced | None:
    """What is on disk under a name."""
    content = recall(name) if name else None
    if content is None:
        return None
    try:
        found = json.loads(content)
        arrays = lambda avals: [
            ShapedArray(tuple(s), np.dtype(t), weak_type=w) for s, t, w in avals
        ]
        like = found["tree"]
        tree = None if like is None else jax.tree.structure(build_like(like))
        return Traced(
            *(arrays(found["operands"]), arrays(found["results"]), tree),
            *(found["size"], found["digest"]),
        )
    except (ValueError, KeyError, TypeError, AttributeError, ImportError):
        return None


def keep_trace(name: str | None, traced: Traced) -> None:
    """Write what is known of a function to disk, if its trace has a name."""
    if name is None:
        return
    try:
        like = None if traced.tree is None else like_of(traced.tree)
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


def place_of(thing: Any) -> str:
    """Where a function or a class is defined; `Unknown` if it is not what a known module has there.

    A class that is made at run time is not, and another may have its name.
    """
    module, name = (str(getattr(thing, one, None)) for one in ("__module__", "__qualname__"))
    home = PACKAGE if isinstance(thing, types.FunctionType) else module.partition(".")[0]
    found = sys.modules.get(module)
    if home not in KNOWN or module.partition(".")[0] != home:
        raise Unknown
    for part in name.split("."):
        found = getattr(found, part, None)
    while found is not thing and hasattr(found, "__wrapped__"):
        found = vars(found)["__wrapped__"]
    if found is not thing:
        raise Unknown
    return f"{module}:{name}"


def describe_tree(tree: Any) -> Any:
    """Node types, and what is static in them."""
    data = tree.node_data()
    if data is None:
        return "*"
    kind, static = data
    if kind is types.NoneType:
        return "None"
    return place_of(kind), describe_value(static), list(map(describe_tree, tree.children()))


def modules_of(tree: Any) -> Iterator[str]:
    """Modules of the classes of a tree's nodes."""
    data = tree.node_data()
    if data is not None:
        yield data[0].__module__
        for child in tree.children():
            yield from modules_of(child)


def describe_value(value: Any) -> Any:
    """A static value in words that another process would use for the same value, and no other."""
    if value is None or isinstance(value, str | bytes | bool | int | float | complex):
        return type(value).__name__, repr(value)
    if isinstance(value, tuple | list):
        return [place_of(type(value)), *map(describe_value, value)]
    if isinstance(value, Mapping):
        return [
            place_of(type(value)),
            *((describe_value(k), describe_value(value[k])) for k in value),
        ]
    if isinstance(value, type | types.FunctionType):
        return place_of(value)
    leaves, tree = jax.tree.flatten(value)
    if leaves == [value]:  # no tree: by its words, if these do not hold its address
        text = repr(value)
        if ADDRESS.search(text):
            raise Unknown
        return place_of(type(value)), text
    return describe_tree(tree), list(map(describe_value, leaves))


def like_of(tree: Any) -> Any:
    """A tree of results for a file: tuples, and named ones by their classes."""
    data = tree.node_data()
    if data is None:
        return 0
    kind, _ = data
    if kind is not tuple and not hasattr(kind, "_fields"):
        raise Unknown
    return [place_of(kind), *map(like_of, tree.children())]


def build_like(like: Any) -> Any:
    """The same tree with zeros for leaves."""
    if like == 0:
        return 0
    place, *children = like
    children = list(map(build_like, children))
    if place == "builtins:tuple":
        return tuple(children)
    module, name = place.split(":")
    if module.partition(".")[0] != PACKAGE:
        raise ImportError(place)
    return getattr(importlib.import_module(module), name)(*children)


# ------------------------------------------------------------------------------ code and versions


@functools.cache
def environment() -> tuple:
    """Versions of what a trace depends on, and a hash of the package's source files."""
    found = hashlib.sha256()
    for path in sorted(FOLDER.rglob("*.py")):
        found.update(path.relative_to(FOLDER).as_posix().encode() + b"\0" + path.read_bytes())
    return platform.python_version(), [version(name) for name in USED], found.hexdigest()


environment()  # now: a file may be edited later, when the code that is loaded is still the former
digests: dict[str, tuple[tuple, str]] = {}
"""By module: the objects that were seen in it, and the hash of its code."""


def code_of(names: set[str]) -> list[str]:
    """Hashes of the functions, classes and constants of modules as they are in this process.

    And of those of all modules of this package that they use.
    """
    modules: dict[str, types.ModuleType] = {}
    for name in names:
        add_modules(name, modules)
    for name, module in modules.items():
        classes = [
            one for one in vars(module).values() if is_of(one, name) and inspect.isclass(one)
        ]
        seen = tuple(id(value) for one in (module, *classes) for value in vars(one).values())
        if name not in digests or digests[name][0] != seen:
            digests[name] = seen, digest_of(list(words_of(module, module, set())))
    return [digests[name][1] for name in sorted(modules)]


def is_of(value: Any, module: str) -> bool:
    """Whether a function or class is of this module, or of none whose code is looked at as well."""
    home = str(getattr(value, "__module__", None))
    return home == module or home.partition(".")[0] not in KNOWN


def add_modules(name: str, modules: dict[str, types.ModuleType]) -> None:
    """Add a module of this package, and those from which it has a name."""
    if name in modules or name.partition(".")[0] != PACKAGE or name not in sys.modules:
        return
    modules[name] = sys.modules[name]
    for value in list(vars(modules[name]).values()):
        home = value.__name__ if inspect.ismodule(value) else getattr(value, "__module__", None)
        add_modules(str(home), modules)


def words_of(value: Any, module: types.ModuleType, known: set[int]) -> Iterator[str]:
    """What tells the code of a module from another; of what is defined elsewhere its name alone.

    Of a module its classes, functions and what is named as a constant is: other names hold what
    changes while a program runs.
    """
    words = functools.partial(words_of, module=module, known=known)
    if id(value) in known:
        return
    if value is module:
        for name, inner in sorted(vars(module).items(), key=lambda item: item[0]):
            if name.isupper() or inspect.isroutine(inner) or inspect.isclass(inner) or wraps(inner):
                yield name
                yield from words(inner)
    elif isinstance(value, types.CodeType):
        yield f"{value.co_code.hex()} {value.co_names} {value.co_varnames} {value.co_freevars}"
        for one in value.co_consts:
            yield from words(one)
    elif isinstance(value, CONSTANTS):
        yield repr(value.tolist() if isinstance(value, np.ndarray) else value)
    elif isinstance(value, types.CellType):
        with contextlib.suppress(ValueError):  # it may be empty
            yield from words(value.cell_contents)
    elif isinstance(value, tuple | list | set | frozenset):
        parts = [list(words(one)) for one in value]
        yield repr(sorted(parts) if isinstance(value, set | frozenset) else parts)
    elif isinstance(value, Mapping):
        for text, key in sorted((ADDRESS.sub("", repr(key)), key) for key in value):
            yield text
            yield from words(value[key])
    else:
        known.add(id(value))
        yield f"{type(value).__qualname__} {getattr(value, '__module__', '')}"
        yield str(getattr(value, "__qualname__", ""))
        if isinstance(value, types.ModuleType) or not is_of(value, module.__name__):
            return
        if inspect.isclass(value):
            for name in sorted(vars(value).keys() - NOT_CODE):
                yield name
                yield from words(vars(value)[name])
        elif isinstance(value, types.FunctionType):
            yield from words(value.__code__)
            yield from words(value.__defaults__)
            yield from words(value.__kwdefaults__)
            yield from words(value.__closure__)
            yield from words(vars(value).get("__wrapped__"))
        else:
            for name in PARTS:
                yield from words(getattr(value, name, None))


def wraps(value: Any) -> bool:
    """Whether a value is a function that something has been made of, by a decorator."""
    return callable(value) and hasattr(value, "__wrapped__")


NOT_CODE = {"__dict__", "__weakref__", "__doc__", "_abc_impl", "__annotations__", "__module__"}
PARTS = "__wrapped__", "__func__", "fget", "func", "args", "keywords", "fun", "jvp", "fwd", "bwd"
"""Attributes that hold the functions of which something is made."""
CONSTANTS = str, bytes, bool, int, float, complex, type(None), np.ndarray

"""Parameters of any shape: arrays, and trees of them such as networks, as leaves with names.

A leaf of a tree has the name of its path, `policy.layers[0].weight` or `table["torques"]`.
Functions in a tree, such as the activation of a network, are part of its structure, so that JAX
sees arrays alone. Integers in arrays stay integers: they are places in a table, not parameters.
"""

import dataclasses
import functools
import importlib
import math
import sys
import types
import typing
from collections.abc import Iterator
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from walker_jax.checks import WrongUse, short
from walker_jax.systems.parameter import Parameter, description

LARGEST = 4096
"""Numbers of the largest array that is written down; a larger one is known by its hash."""
HASHED = "sha256 "
"""Beginning of the words for a larger array."""
CONTAINERS = tuple, list, dict, type(None)
PARAMETERS = "parameters"
"""Field of a `Map` whose entries have names of their own."""


@jax.tree_util.register_static
class Code:
    """A function in a tree, as part of the tree's structure."""

    def __init__(self, func: Any):
        self.func = func

    def __call__(self, *args, **kwargs):
        return self.func(*args, **kwargs)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Code) and self.func == other.func

    def __hash__(self) -> int:
        return hash(self.func)

    def __reduce__(self):
        """Pickle the function by its name in a module, which a lambda of a module has too."""
        name = name_of(self.func)
        return (named_code, (self.func.__module__, name)) if name else (Code, (self.func,))

    def __repr__(self) -> str:
        plain = getattr(self.func, "__name__", type(self.func).__name__)
        return name_of(self.func) or plain


def name_of(function: Any) -> str | None:
    """Return the name of a function in its module; None if it has none there."""
    names = vars(sys.modules.get(getattr(function, "__module__", ""), object))
    return next((name for name, one in names.items() if one is function), None)


def named_code(module: str, name: str) -> Code:
    """Restore a function of a tree by its name."""
    return Code(getattr(importlib.import_module(module), name))


def is_tree(value: Any) -> bool:
    """Return whether a value is a tree of parameters, rather than one array or number."""
    return not jax.tree_util.all_leaves([value])


def make_static(value: Any, name: str, owner: str = "") -> Any:
    """Return a parameter with its functions as `Code`; raise `WrongUse` for other things in it."""

    def checked(path, leaf):
        if callable(leaf) and not eqx.is_array_like(leaf):
            return Code(leaf)
        real = eqx.is_array_like(leaf) or hasattr(leaf, "dtype")
        real = real and not (path and isinstance(leaf, bool | complex))
        if not real or jnp.issubdtype(jnp.result_type(leaf), jnp.complexfloating):
            raise WrongUse(
                f"{name}{path_name(path)}{owner} must be real numbers or a function, not "
                f"{short(leaf)}: a static field may hold words"
            )
        return float(leaf) if path and isinstance(leaf, int) else leaf

    return jax.tree_util.tree_map_with_path(checked, value)


def settle(system: Any) -> None:
    """Make functions in the trees of a new system static, and note the ranks of its arrays."""
    for name in (one.name for one in dynamic_fields(system)):
        value = getattr(system, name)
        if value is not (settled := make_static(value, name, f" of {type(system).__name__}")):
            object.__setattr__(system, name, settled)
    if ranks := positive_ranks(system):
        object.__setattr__(system, "array_ranks", ranks)


def with_static_functions(system: Any) -> Any:
    """Return the system with functions as `Code`, where a tree was put in after it was made."""
    if not any(callable(leaf) for leaf in jax.tree.leaves(system)):
        return system
    return make_static(system, "")


def path_name(path: Any) -> str:
    """Return the name of a leaf after that of its field: `.layers[0].weight` or `["torques"]`.

    Its quotes are those that NetCDF allows in names.
    """
    key = lambda one: f'["{one.key}"]' if isinstance(getattr(one, "key", 0), str) else str(one)
    return "".join(map(key, path))


def leaves_in(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    """Yield the leaves of a field with their names."""
    for path, leaf in jax.tree_util.tree_leaves_with_path(value):
        if name == PARAMETERS and isinstance(value, dict):
            yield f"{path[0].key}{path_name(path[1:])}", leaf
        else:
            yield f"{name}{path_name(path)}", leaf


def dynamic_fields(kind: Any) -> list[dataclasses.Field]:
    """Return the fields of a class of systems, or of one, that hold parameters."""
    return [one for one in dataclasses.fields(kind) if not one.metadata.get("static")]


def leaves_of(system: Any) -> dict[str, Any]:
    """Return the leaves of all parameters of a system by name, in the order of its fields."""
    known = {one.name for one in dynamic_fields(system)}
    fields = ((name, value) for name, value in vars(system).items() if name in known)
    return {leaf: value for field in fields for leaf, value in leaves_in(*field)}


def names_in_tree(system: Any) -> list[str]:
    """Return the names of the leaves of a system, in JAX's order."""
    return [
        leaf
        for one in dynamic_fields(system)
        for leaf, _ in leaves_in(one.name, getattr(system, one.name))
    ]


def default_of(field: dataclasses.Field) -> Any:
    """Return the default of a field; `dataclasses.MISSING` for none."""
    if field.default_factory is not dataclasses.MISSING:
        return field.default_factory()
    return field.default


def like_of(field: dataclasses.Field, annotation: Any) -> Any:
    """Return what the class tells of a field's shape: its rank, or a tree of that structure.

    None if the class tells nothing.
    """
    if (one := description(field, Parameter)) is not None:
        return len(one.shape)
    default = default_of(field)
    if default is not dataclasses.MISSING and default is not None:
        return default if is_tree(default) else np.ndim(default)
    return rank_in(annotation)


def rank_in(annotation: Any) -> int | Any | None:
    """Return the rank that an annotation states: 0 for a number, or that of jaxtyping's arrays.

    It is an empty tree for a class of modules, such as a network, and None for any other one.
    """
    union = typing.get_origin(annotation) in (typing.Union, types.UnionType)
    for one in typing.get_args(annotation) if union else (annotation,):
        one = typing.get_origin(one) or one
        if one in (float, int):
            return 0
        dims = getattr(one, "dims", None)
        if isinstance(dims, tuple) and getattr(one, "index_variadic", None) is None:
            return len(dims)
        if isinstance(one, type) and issubclass(one, eqx.Module | dict | list | tuple):
            return {}
    return None


@functools.cache
def told_by(kind: type) -> dict[str, Any]:
    """Return what a class tells of the shapes of its fields (`like_of`).

    A parameter that it gives a span of values, over which gaits are followed, is one number.
    """
    try:
        annotations = typing.get_type_hints(kind)
    except Exception:  # a name that only a type checker knows
        annotations = {}
    found = {
        one.name: like_of(one, annotations.get(one.name, one.type)) for one in dynamic_fields(kind)
    }
    numbers = [name for name in getattr(kind, "spans", ()) if found.get(name, 0) is None]
    return found | dict.fromkeys(numbers, 0)


def ranks_told(kind: type) -> dict[str, int]:
    """Return the ranks that a class tells, by the names of leaves."""
    found: dict[str, int] = {}
    for name, like in told_by(kind).items():
        if isinstance(like, int):
            found[name] = like
        elif like is not None:
            found |= {leaf: np.ndim(value) for leaf, value in leaves_in(name, like)}
    return found


def positive_ranks(system: Any) -> tuple[tuple[str, int], ...]:
    """Return the ranks of a new system's leaves, of those that are no single numbers.

    A leaf has the rank that its class tells, and otherwise its own: the system is one, unless it is
    made under `jax.vmap`.
    """
    told = ranks_told(type(system))
    ranks = {name: told.get(name, np.ndim(leaf)) for name, leaf in leaves_of(system).items()}
    return tuple((name, rank) for name, rank in ranks.items() if rank)


def ranks_of(system: Any) -> list[int]:
    """Return the ranks of a system's leaves in one walker, in JAX's order."""
    known = dict(system.array_ranks)
    return [known.get(name, 0) for name in names_in_tree(system)] if known else []


def map_leaves(function: Any, system: Any) -> Any:
    """Return the system with function(leaf, rank) for each leaf."""
    leaves, structure = jax.tree.flatten(system)
    ranks = ranks_of(system) or [0] * len(leaves)
    return structure.unflatten(map(function, leaves, ranks))


def own_shape(leaf: Any, rank: int) -> tuple[int, ...]:
    """Return the shape of a leaf in one system."""
    return np.shape(leaf)[np.ndim(leaf) - rank :]


def zeros_like(system: Any, rows: int, dtype: Any) -> Any:
    """Return rows of zeros for each number of one system."""
    return map_leaves(lambda leaf, rank: np.zeros((rows, *own_shape(leaf, rank)), dtype), system)


def in_dtype(system: Any, dtype: Any, array: Any = np.asarray) -> Any:
    """Return the system with all its reals in one dtype, as arrays that `array` makes."""
    return map_leaves(lambda leaf, rank: array(leaf, own_dtype(leaf, rank, dtype)), system)


def own_dtype(leaf: Any, rank: int, dtype: Any) -> Any:
    """Return the dtype in which to compute with a leaf: integers in an array stay integers."""
    exact = rank and not jnp.issubdtype(jnp.result_type(leaf), jnp.floating)
    return jnp.result_type(leaf) if exact else dtype


def is_many(system: Any) -> bool:
    """Return whether a system is many, with further axes before those of its leaves."""
    return bool(sizes_of_many(system))


def sizes_of_many(system: Any) -> set[int]:
    """Return the numbers of systems that the leaves describe; none for a single system."""
    leaves = jax.tree.leaves(system)
    ranks = ranks_of(system) or [0] * len(leaves)
    shapes = ((np.shape(leaf), rank) for leaf, rank in zip(leaves, ranks, strict=True))
    return {math.prod(shape[: len(shape) - r]) for shape, r in shapes if len(shape) > r}


def select(system: Any, which: Any) -> Any:
    """Return some of many systems, by an index, a slice or an array; a single system as it is."""
    return map_leaves(lambda leaf, rank: leaf[which] if np.ndim(leaf) > rank else leaf, system)


def statics_in(structure: Any) -> list[Any]:
    """Return the classes and static values of the nodes of a tree, without those of containers."""
    data = structure.node_data()
    inner = [one for child in structure.children() for one in statics_in(child)]
    return inner if data is None or data[0] in CONTAINERS else [*data, *inner]


def structure_of(value: Any) -> tuple[Any, ...]:
    """Return all that makes a tree what it is but its numbers: classes, options and functions."""
    return tuple(statics_in(jax.tree.structure(value))) if is_tree(value) else ()


def functions_in(name: str, value: Any) -> dict[str, Code]:
    """Return the functions in a tree by the names of their paths."""
    paths = jax.tree_util.tree_leaves_with_path(value, is_leaf=lambda one: isinstance(one, Code))
    keys = {f"{name}{path_name(path)}": one for path, one in paths}
    return {key: one for key, one in keys.items() if isinstance(one, Code)}

"""Parameters of walkers and other systems: their names, units, defaults and bounds."""

import dataclasses
import inspect
from collections.abc import Container, Iterable, Mapping, Sequence
from importlib.metadata import version
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from walker_jax.checks import WrongUse, check_kind, short
from walker_jax.fingerprints import code_fingerprint
from walker_jax.identity import sha256_of
from walker_jax.systems.outcomes import join_names
from walker_jax.systems.parameter import Described, description
from walker_jax.systems.parameter import Option as Option
from walker_jax.systems.parameter import Parameter as Parameter
from walker_jax.systems.system import (
    AnySystem,
    System,
    arrays_of,
    code_of,
    fields_of,
    numbers_of,
    statics_of,
)
from walker_jax.systems.trees import (
    HASHED,
    LARGEST,
    PARAMETERS,
    default_of,
    dynamic_fields,
    functions_in,
    leaves_of,
    names_in_tree,
    own_shape,
    told_by,
    zeros_like,
)
from walker_jax.walkers.parameter_table import SLOPE as SLOPE


def parameters(walker: type[System] | System) -> tuple[Parameter, ...]:
    """Return the parameters of a walker, in the order of its constructor's arguments.

    A user's own class need not describe its fields: they accept any real number then.
    """
    found, told = [], told_by(walker if isinstance(walker, type) else type(walker))
    for field in dynamic_fields(walker):
        if field.name == PARAMETERS or told[field.name] not in (0, None):
            continue
        one = description(field, Parameter)
        one = one or (SLOPE if field.name == "slope" else UNDESCRIBED)
        known = field.default is not dataclasses.MISSING and field.default is not None
        default = float(cast("Any", field.default)) if known else one.default
        found.append(one._replace(name=field.name, default=default))
    return tuple(found)


class Tree(NamedTuple):
    """A field of a system that is no number: an array, or a tree of arrays such as a network."""

    name: str
    default: Any
    """Its default; `dataclasses.MISSING` for none."""


def trees(walker: type[System]) -> tuple[Tree, ...]:
    """Return the fields of a class of systems whose parameters are no single numbers."""
    told = told_by(walker)
    return tuple(
        Tree(one.name, default_of(one))
        for one in dynamic_fields(walker)
        if one.name != PARAMETERS and told[one.name] not in (0, None)
    )


def parameters_of(kind: type[System] | System) -> tuple[Parameter, ...]:
    """Return the parameters of a class; for a system, its own values are the defaults."""
    if isinstance(kind, type):
        return parameters(kind)
    described = {one.name: one for one in parameters(type(kind))}
    return tuple(
        described.get(name, UNDESCRIBED)._replace(name=name, default=float(value))
        for name, value in numbers_of(kind).items()
    )


def described_by(walker: type[System] | System, kind: type[Described]) -> tuple[Described, ...]:
    """Return the descriptions of one kind among a walker's fields."""
    described = (description(field, kind) for field in dataclasses.fields(walker))
    return tuple(one for one in described if one is not None)


def options(walker: type[System] | System) -> tuple[Option, ...]:
    """Return the options of a walker, in the order of its constructor's arguments."""
    return described_by(walker, Option)


def chosen_options(walker: System) -> tuple[str, ...]:
    """Return the names of a walker's options that are on."""
    return tuple(one.name for one in options(walker) if getattr(walker, one.name))


def other_statics(walker: System) -> dict[str, Any]:
    """Return the values of static fields that are no options, as numbers or words."""
    known = {one.name for one in options(walker)}

    def plain(value):
        if isinstance(value, bool):
            return int(value)
        return value if isinstance(value, int | float | str) else str(value)

    return {name: plain(value) for name, value in statics_of(walker).items() if name not in known}


def describe_walker(walker: System) -> dict[str, Any]:
    """Return the name, parameters and active options of a walker, for a request."""
    values = {name: float(value) for name, value in numbers_of(walker).items()}
    values |= {name: write_array(value) for name, value in arrays_of(walker).items()}
    chosen = dict.fromkeys(chosen_options(walker), True)
    others = other_statics(walker) | names_of_functions(walker)
    return {"name": walker.label(), **values, **chosen, **others}


def write_array(value: Any) -> list[Any] | str:
    """Return an array as lists of numbers; a large one as its hash."""
    numbers = np.asarray(value)
    if numbers.size <= LARGEST:
        return numbers.tolist()
    return f"{HASHED}{sha256_of(numbers.tobytes())}, {numbers.dtype} of shape {numbers.shape}"


def names_of_functions(walker: System) -> dict[str, str]:
    """Return the names of the functions in the trees of a walker, by their paths."""
    fields = ((one.name, getattr(walker, one.name)) for one in dynamic_fields(walker))
    return {path: repr(one) for field in fields for path, one in functions_in(*field).items()}


def attributes_of(walker: System, *, without: Container[str] = ()) -> dict[str, Any]:
    """Return the parameters and active options of a walker, as attributes of a data set.

    Parameters that are variables of the data set are left out by `without`. Arrays are lists in
    their C order, beside their shapes, and large ones their hashes (`LARGEST`). The attributes
    include the names of its own failures, and a fingerprint of the code of a class outside the
    package.
    """
    numbers = numbers_of(walker).items()
    values: dict[str, Any] = {name: float(value) for name, value in numbers if name not in without}
    for name, value in arrays_of(walker).items():
        large, shape = np.size(value) > LARGEST, np.shape(value)
        values[name] = write_array(value) if large else np.ravel(value).tolist()
        values |= {f"{name}_shape": list(shape)} if len(shape) > 1 and not large else {}
    values |= dict.fromkeys(chosen_options(walker), 1) | other_statics(walker)
    values |= names_of_functions(walker)
    code = code_fingerprint(type(walker), code_of(walker))
    about: dict[str, Any] = {f"walker_{name}": value for name, value in values.items()}
    about |= {"failures": join_names(walker.failures)} if walker.failures else {}
    return about | ({"code": code} if code else {})


def describe_source(walker: System, *, without: Container[str] = ()) -> dict[str, Any]:
    """Return the attributes of a data set that tell where it is from: a walker, and this version.

    `without` is as in `attributes_of`.
    """
    return {
        "walker": walker.label(),
        **attributes_of(walker, without=without),
        "section": join_names(walker.section),
        "version": f"walker-jax {version('walker-jax')}",
    }


def describe_in_words(walker: System) -> str:
    """Describe a walker on one line: its name, then each parameter with its value."""
    return write_description(describe_walker(walker))


def write_description(about: dict[str, Any], form: str = "g") -> str:
    """Write the result of `describe_walker` on one line."""
    name, *values = about.items()

    def words(value: Any) -> str:
        if isinstance(value, list):
            return f"of {np.size(value)} numbers"
        return value if isinstance(value, str) else f"{value:{form}}"

    return ", ".join([name[1], *(f"{key} {words(value)}" for key, value in values)])


BRIEF = 48
"""Characters of a walker's description in an error, which is one line of less than 200."""


def describe_briefly(walker: System) -> str:
    """Describe a walker on one line, with as many of its parameters as there is room for."""
    told, *others = describe_in_words(walker).split(", ")
    for i, one in enumerate(others):
        if i and len(f"{told}, {one}") > BRIEF:
            return f"{told}, ..."
        told = f"{told}, {one}"
    return told


DIGITS = 12
"""Significant digits of values spaced over an interval: all that a user has typed, and no rounding
errors, which begin at the 16th digit."""


def space_decimals(low: float, high: float, count: int) -> list[float]:
    """Return equally spaced values of a parameter, from low to high, rounded to `DIGITS`.

    So 0.3 is 0.3, and not 0.30000000000000004.
    """
    zero = 10.0**-DIGITS * (high - low)
    return [
        float(f"{value:.{DIGITS}g}") if abs(value) > zero else 0.0
        for value in np.linspace(low, high, count).tolist()
    ]


UNDESCRIBED = Parameter("", "", "", low=-np.inf)


def span_of(kind: type[System], name: str) -> tuple[float, float] | None:
    """Return the ends between which gaits are followed over a parameter, if they are known."""
    own = next((one.span for one in parameters(kind) if one.name == name), (np.nan, np.nan))
    return kind.spans.get(name) if np.isnan(own[0]) else own


def check_parameter(walker: System, parameter: str, *values: float) -> None:
    """Raise `WrongUse` for a parameter the walker lacks, or values that it refuses."""
    check_kind("walker", walker, System)
    if not is_number_of(walker, parameter):
        names = ", ".join([*numbers_of(walker), *example_of_entry(walker)])
        raise WrongUse(
            f"parameter must be one of the walker's, {names}, not {short(parameter)}",
            of="parameter",
        )
    if set(fields_of(walker)) <= set(inspect.signature(type(walker)).parameters):
        for value in values:
            try:
                type(walker)(**fields_of(with_parameter(walker, parameter, value)))
            except WrongUse as error:
                error.arguments = []  # the value is that of another argument
                raise


def parameter_directions(
    walker: AnySystem, parameters: Sequence[str], dtype, rows: int = 1
) -> AnySystem:
    """Return a walker with a row of numbers for each parameter: directions of some of them.

    In the row of one of these its own number is 1, and all others are 0. The rows of other
    parameters are 0.
    """
    zeros = zeros_like(walker, rows, dtype)
    units = (np.eye(1, rows, i, dtype)[0] for i in range(len(parameters)))
    return with_values(zeros, zip(parameters, units, strict=True))


def with_parameter(walker: AnySystem, parameter: str, value) -> AnySystem:
    """Return the walker with another value of one parameter; an array makes many walkers.

    The parameter may be one number of an array, `weights[0, 1]`.
    """
    return with_values(walker, {parameter: value})


def with_values(
    walker: AnySystem, values: Mapping[str, Any] | Iterable[tuple[str, Any]]
) -> AnySystem:
    """Return the walker with other values of some parameters, by name, unchecked."""
    leaves, structure = jax.tree.flatten(walker)
    places, entries = {name: i for i, name in enumerate(names_in_tree(walker))}, {}
    for parameter, value in dict(values).items():
        if parameter in places:
            leaves[places[parameter]] = value
        else:
            name, entry = parse_entry(parameter)
            entries.setdefault(places[name], {})[entry] = value
    for i, changed in entries.items():
        leaves[i] = with_entries(leaves[i], changed)
    return structure.unflatten(leaves)


def with_entries(leaf: Any, entries: Mapping[tuple[int, ...], Any]) -> Any:
    """Return an array with other numbers at some places; arrays of values make many arrays."""
    shape = max(map(np.shape, entries.values()), key=len)
    own = all(np.ndim(leaf) == len(entry) for entry in entries)
    traced = any(isinstance(one, Tracer) for one in (leaf, *entries.values()))
    made: Any = jnp if traced else np
    changed = made.array(leaf)
    if shape and own:
        changed = made.array(made.broadcast_to(changed, (*shape, *changed.shape)))
    for entry, value in entries.items():
        if traced:
            changed = changed.at[..., *entry].set(value)
        else:
            changed[..., *entry] = value
    return jnp.asarray(changed) if isinstance(leaf, jax.Array) else changed


def parse_entry(parameter: str) -> tuple[str, tuple[int, ...]]:
    """Return the array, and the place in it, of a number such as `weights[0, 1]`."""
    name, _, place = parameter.removesuffix("]").rpartition("[")
    whole = place.replace(",", " ").split() if parameter.endswith("]") else []
    entry = tuple(int(one) for one in whole if one.isdecimal())
    return (name, entry) if entry and len(entry) == len(whole) else (parameter, ())


def is_number_of(walker: System, parameter: Any) -> bool:
    """Return whether a walker has a parameter, or a number in an array, of this name."""
    if not isinstance(parameter, str) or parameter in numbers_of(walker):
        return isinstance(parameter, str)
    (name, entry), arrays = parse_entry(parameter), arrays_of(walker)
    if name not in arrays or not jnp.issubdtype(jnp.result_type(arrays[name]), jnp.floating):
        return False
    rank = dict(walker.array_ranks)[name]
    shape = own_shape(arrays[name], rank)
    return len(entry) == rank and all(i < n for i, n in zip(entry, shape, strict=True))


def example_of_entry(walker: System) -> list[str]:
    """Return the name of the first number in the arrays of a walker, after an ellipsis."""
    ranks = dict(walker.array_ranks).items()
    return [f"{name}[{', '.join('0' * rank)}], ..." for name, rank in [*ranks][:1]]


def value_of(walker: System, parameter: str) -> Any:
    """Return the value of a parameter, or of one number in an array, by name."""
    leaves = leaves_of(walker)
    if parameter in leaves:
        return leaves[parameter]
    name, entry = parse_entry(parameter)
    return leaves[name][..., *entry]


def as_tangent(walker: AnySystem, direction: AnySystem) -> AnySystem:
    """Return a direction of a walker as JAX takes it, which has no numbers for integers."""

    def tangent(leaf, change):
        real = jnp.issubdtype(jnp.result_type(leaf), jnp.floating)
        return change if real else np.zeros(np.shape(leaf), jax.dtypes.float0)

    return jax.tree.map(tangent, walker, direction)

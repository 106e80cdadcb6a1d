"""Parameters of walkers and other systems: their names, units, defaults and bounds."""

import dataclasses
import inspect
from collections.abc import Container, Iterable, Mapping, Sequence
from importlib.metadata import version
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from walker_jax.checks import WrongUse, check_kind, short
from walker_jax.identity import code_fingerprint
from walker_jax.systems.outcomes import join_names
from walker_jax.systems.parameter import Described, description
from walker_jax.systems.parameter import Parameter as Parameter
from walker_jax.systems.system import AnySystem, System, code_of, numbers_of, statics_of


def parameters(walker: type[System] | System) -> tuple[Parameter, ...]:
    """Return the parameters of a walker, in the order of its constructor's arguments.

    A user's own class need not describe its fields: they accept any real number then.
    """
    found = []
    for field in dataclasses.fields(walker):
        if field.metadata.get("static") or field.name == "parameters":
            continue
        one = description(field, Parameter)
        one = one or (SLOPE if field.name == "slope" else UNDESCRIBED)
        default = one.default if field.default is dataclasses.MISSING else float(field.default)
        found.append(one._replace(name=field.name, default=default))
    return tuple(found)


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


class Option(NamedTuple):
    """A static field: a check of a walker's strides that is on or off."""

    name: str
    meaning: str

    def convert(self, value: object) -> bool:
        """Return the value; raise `WrongUse` for one that is not true or false."""
        check_kind(self.name, value, bool)
        return bool(value)


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
    chosen = dict.fromkeys(chosen_options(walker), True)
    return {"name": walker.label(), **values, **chosen, **other_statics(walker)}


def attributes_of(walker: System, *, without: Container[str] = ()) -> dict[str, Any]:
    """Return the parameters and active options of a walker, as attributes of a data set.

    Parameters that are variables of the data set are left out by `without`. The attributes include
    the names of its own failures, and a fingerprint of the code of a class outside the package.
    """
    values = {name: float(value) for name, value in numbers_of(walker).items()}
    values = {name: value for name, value in values.items() if name not in without}
    values |= dict.fromkeys(chosen_options(walker), 1) | other_statics(walker)
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
    words = lambda value: value if isinstance(value, str) else f"{value:{form}}"
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


SLOPE = Parameter("slope", "of the ground", "rad", 0.004, high=np.pi / 2, span=(0.001, 0.022))
UNDESCRIBED = Parameter("", "", "", low=-np.inf)


def span_of(kind: type[System], name: str) -> tuple[float, float] | None:
    """Return the ends between which gaits are followed over a parameter, if they are known."""
    own = next((one.span for one in parameters(kind) if one.name == name), (np.nan, np.nan))
    return kind.spans.get(name) if np.isnan(own[0]) else own


def check_parameter(walker: System, parameter: str, *values: float) -> None:
    """Raise `WrongUse` for a parameter the walker lacks, or values that it refuses."""
    check_kind("walker", walker, System)
    if not isinstance(parameter, str) or parameter not in numbers_of(walker):
        names = ", ".join(numbers_of(walker))
        raise WrongUse(
            f"parameter must be one of the walker's, {names}, not {short(parameter)}",
            of="parameter",
        )
    if set(vars(walker)) <= set(inspect.signature(type(walker)).parameters):
        for value in values:
            try:
                type(walker)(**{**vars(walker), parameter: value})
            except WrongUse as error:
                error.arguments = []  # the value is that of another argument
                raise


def check_parameters(walker: System, parameters: Sequence[str]) -> None:
    """Raise `WrongUse` for anything but a sequence of names of the walker's parameters."""
    check_kind("parameters", parameters, Sequence)
    for name in parameters:
        check_parameter(walker, name)


def parameter_directions(
    walker: AnySystem, parameters: Sequence[str], dtype, rows: int = 1
) -> AnySystem:
    """Return a walker with a row of numbers for each parameter: directions of some of them.

    In the row of one of these its own number is 1, and all others are 0. The rows of other
    parameters are 0.
    """
    zeros = jax.tree.map(lambda leaf: np.zeros(rows, dtype), walker)
    units = (np.eye(1, rows, i, dtype)[0] for i in range(len(parameters)))
    return with_values(zeros, zip(parameters, units, strict=True))


def with_parameter(walker: AnySystem, parameter: str, value) -> AnySystem:
    """Return the walker with another value of one parameter; an array makes many walkers."""
    return eqx.tree_at(lambda walker: getattr(walker, parameter), walker, value)


def with_values(
    walker: AnySystem, values: Mapping[str, Any] | Iterable[tuple[str, Any]]
) -> AnySystem:
    """Return the walker with other values of some parameters, by name, unchecked."""
    for parameter, value in dict(values).items():
        walker = with_parameter(walker, parameter, value)
    return walker


def along_parameter(walker: AnySystem, parameter: str) -> AnySystem:
    """Return the direction of one parameter: the walker with 1 for it and 0 for all others."""
    one = jnp.ones_like(getattr(walker, parameter))
    return with_parameter(jax.tree.map(jnp.zeros_like, walker), parameter, one)

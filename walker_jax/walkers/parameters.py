"""Parameters of walkers: their names, units, defaults and bounds."""

import dataclasses
import inspect
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.typing import ArrayLike

from walker_jax.checks import WrongUse, check_kind, short
from walker_jax.walkers.fingerprints import code_fingerprint
from walker_jax.walkers.model import Scalar, Walker


class Parameter(NamedTuple):
    """A parameter of a walker: its meaning and its bounds."""

    name: str
    meaning: str
    unit: str
    default: float = np.nan
    """Of the command line; and of the constructor, but for the slope. NaN where it has none."""
    low: float = 0.0
    high: float = np.inf
    closed: bool = False
    """Whether it may be equal to `low`."""

    def convert(self, value: ArrayLike) -> Scalar:
        """The number as an array. Raises `ValueError` for one that is not within the bounds."""
        refusal = f"{self.name} must be one real number, not {short(value)}"
        try:
            value = jnp.asarray(value)
        except (TypeError, ValueError, OverflowError):
            raise WrongUse(refusal) from None
        real = jnp.issubdtype(value.dtype, jnp.number) and jnp.isrealobj(value)
        if value.shape != () or not real:
            raise WrongUse(refusal)
        if not jnp.issubdtype(value.dtype, jnp.floating):
            value = value.astype(float)
        if isinstance(value, Tracer):
            return value
        number = np.asarray(value)
        above = number >= self.low if self.closed else number > self.low
        if not (above & (number < self.high)):
            raise WrongUse(f"{self.name} must be {self.bounds()}, not {value}")
        return value

    def bounds(self) -> str:
        """The bounds in words."""
        if self.low > -np.inf and self.high < np.inf:
            limit = "at least" if self.closed else "above"
            return f"{limit} {self.low:g} and below {self.high:g}"
        if self.low > -np.inf:
            return f"finite and {'not negative' if self.closed else f'above {self.low:g}'}"
        return "finite"


def parameters(walker: type[Walker] | Walker) -> tuple[Parameter, ...]:
    """The parameters of a walker, in the order of its constructor's arguments.

    A class of a user's own need not describe its fields: any real number is accepted then.
    """
    found = []
    for field in dataclasses.fields(walker):
        one = description(field) or (SLOPE if field.name == "slope" else UNDESCRIBED)
        default = one.default if field.default is dataclasses.MISSING else float(field.default)
        found.append(one._replace(name=field.name, default=default))
    return tuple(found)


def described_parameters(walker: Walker) -> tuple[Parameter, ...]:
    """Those parameters of a walker whose bounds are known."""
    return tuple(one for field in dataclasses.fields(walker) if (one := description(field)))


def description(field: dataclasses.Field) -> Parameter | None:
    """The `Parameter` whose `convert` is the converter of a field, if one is."""
    one = getattr(field.metadata.get("converter"), "__self__", None)
    return one if isinstance(one, Parameter) else None


def describe_walker(walker: Walker) -> dict[str, Any]:
    """The name and the parameters of a walker, for a request or an answer."""
    values = {one.name: float(getattr(walker, one.name)) for one in parameters(walker)}
    return {"name": type(walker).__name__, **values}


def walker_attributes(walker: Walker, *without: str) -> dict[str, Any]:
    """A walker as attributes of a data set, `without` parameters that are dimensions of it."""
    values = {name: float(value) for name, value in vars(walker).items() if name not in without}
    about = {"walker": type(walker).__name__}
    about |= {f"walker_{name}": value for name, value in values.items()}
    code = code_fingerprint(type(walker))
    return about | ({"code": code} if code else {})


def describe_in_words(walker: Walker) -> str:
    """The same on one line: its name, then each parameter with its value."""
    name, *values = describe_walker(walker).items()
    return ", ".join([name[1], *(f"{key} {value:g}" for key, value in values)])


DIGITS = 12
"""Significant digits of values spaced over an interval: all that a user has typed, and none of the
rounding errors, which begin at the 16th digit."""


def space_decimals(low: float, high: float, count: int) -> list[float]:
    """Equally spaced values of a parameter, from low to high, rounded to `DIGITS`.

    So 0.1, 0.2 and 0.3 are these, and not 0.30000000000000004.
    """
    zero = 10.0**-DIGITS * (high - low)
    return [
        float(f"{value:.{DIGITS}g}") if abs(value) > zero else 0.0
        for value in np.linspace(low, high, count).tolist()
    ]


SLOPE = Parameter("slope", "of the ground", "rad", 0.004, high=np.pi / 2)
UNDESCRIBED = Parameter("", "", "", low=-np.inf)


def check_parameter(walker: Walker, parameter: str, *values: float) -> None:
    """Refuse a parameter that the walker does not have, and values that its constructor refuses."""
    check_kind("walker", walker, Walker)
    if not isinstance(parameter, str) or parameter not in vars(walker):
        names = ", ".join(vars(walker))
        raise WrongUse(f"parameter must be one of the walker's, {names}, not {short(parameter)}")
    if set(vars(walker)) <= set(inspect.signature(type(walker)).parameters):
        for value in values:
            type(walker)(**{**vars(walker), parameter: value})


def parameter_direction(walker: Walker, parameter: str | None, dtype) -> Walker:
    """A walker with 1 for the parameter and 0 for all others: the direction of the parameter."""
    zeros = jax.tree.map(lambda leaf: np.zeros((), dtype), walker)
    return zeros if parameter is None else with_parameter(zeros, parameter, np.ones((), dtype))


def with_parameter(walker: Walker, parameter: str, value) -> Walker:
    """The walker with another value of one parameter, unchecked; an array makes many walkers."""
    return eqx.tree_at(lambda walker: getattr(walker, parameter), walker, value)

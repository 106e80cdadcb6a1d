"""A parameter of a system: its name, unit, default and bounds. This module loads without JAX."""

from __future__ import annotations

import dataclasses
from functools import partial
from math import inf, isnan, nan
from typing import Any, NamedTuple, TypeVar

from walker_jax.refusals import WrongUse

Described = TypeVar("Described")


class Parameter(NamedTuple):
    """A parameter of a system: its meaning and its bounds."""

    name: str
    meaning: str
    unit: str
    default: float = nan
    """Default of the command line, and, except for the slope, of the constructor; NaN for none."""
    low: float = 0.0
    high: float = inf
    closed: bool = False
    """Whether the value may equal `low`."""
    span: tuple[float, float] = (nan, nan)
    """Default range of slopes over which the command line follows gaits."""
    shape: tuple[int, ...] = ()
    """Shape of an array of such numbers; by default one number."""

    def convert(self, value: Any) -> Any:
        """Return the number, or the array, as an array; `ValueError` for one outside the bounds."""
        import jax.numpy as jnp
        import numpy as np
        from jax.core import Tracer

        from walker_jax.checks import short

        kind = f"real numbers of shape {self.shape}" if self.shape else "one real number"
        refusal = f"{self.name} must be {kind}, not {short(value)}"
        try:
            value = jnp.asarray(value)
        except (TypeError, ValueError, OverflowError):
            raise WrongUse(refusal, of=self.name) from None
        real = jnp.issubdtype(value.dtype, jnp.number) and jnp.isrealobj(value)
        if value.shape != self.shape or not real:
            raise WrongUse(refusal, of=self.name)
        if not jnp.issubdtype(value.dtype, jnp.floating):
            value = value.astype(float)
        if isinstance(value, Tracer):
            return value
        numbers = np.asarray(value)
        if not (within := np.asarray(self.holds(numbers))).all():
            wrong = value[np.nonzero(~within)][0] if self.shape else value
            raise WrongUse(f"{self.name} must be {self.bounds()}, not {wrong}", of=self.name)
        return value

    def holds(self, value: Any) -> Any:
        """Return whether a number lies within the bounds; for an array, each of its numbers."""
        return (value >= self.low if self.closed else value > self.low) & (value < self.high)

    def bounds(self) -> str:
        """Describe the bounds in words."""
        if self.low > -inf and self.high < inf:
            limit = "at least" if self.closed else "above"
            return f"{limit} {self.low:g} and below {self.high:g}"
        if self.low > -inf:
            return f"finite and {'not negative' if self.closed else f'above {self.low:g}'}"
        return f"finite and below {self.high:g}" if self.high < inf else "finite"

    def field(self) -> Any:
        """Return a field of a system for this parameter, with checked values."""
        import equinox as eqx
        import numpy as np

        if isnan(self.default):
            return eqx.field(converter=self.convert)
        if self.shape:
            full = partial(np.full, self.shape, self.default)
            return eqx.field(converter=self.convert, default_factory=full)
        return eqx.field(converter=self.convert, default=self.default)


class Option(NamedTuple):
    """A static field: a check of a walker's strides that is on or off."""

    name: str
    meaning: str

    def convert(self, value: object) -> bool:
        """Return the value; raise `WrongUse` for one that is not true or false."""
        from walker_jax.checks import check_kind

        check_kind(self.name, value, bool)
        return bool(value)


def description(field: dataclasses.Field, kind: type[Described]) -> Described | None:
    """Return the description of a field, if it is of the kind: the owner of its converter."""
    one = getattr(field.metadata.get("converter"), "__self__", None)
    return one if isinstance(one, kind) else None

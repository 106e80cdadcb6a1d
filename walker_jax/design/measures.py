"""Measures of gaits, and their derivatives by the walker's parameters.

Speed, step length, largest multiplier and cost of transport follow from the gait, and their
derivatives from the implicit function theorem.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Inexact

from walker_jax.checks import WrongUse, short
from walker_jax.gaits.cycles import Gait
from walker_jax.gaits.derivatives import GaitPull
from walker_jax.systems.system import System
from walker_jax.walkers.choices import values_of
from walker_jax.walkers.model import Scalar
from walker_jax.walking.integrals import integrals, named_functions
from walker_jax.walking.stride import stride
from walker_jax.walking.trajectories import trajectory

GaitFunction = Callable[[Any, Gait], Any]
"""A JAX function of a walker and its gait that returns one number."""


class Measure(NamedTuple):
    """A quantity of a walker, and its derivatives by parameters."""

    value: Any
    """A number; an array for states, multipliers and step times of a gait. Of a basin, the area of
    the basins of all attractors within the grid or slice (rad^2 per unit of time), or over three
    dimensions the volume (rad^3 per unit of time squared)."""
    gradient: Inexact[np.ndarray, "*value parameters"]
    """Its derivatives, over the numbers of the parameters last."""
    value_error: float = 0.0
    """Standard error of the value; 0 but for areas, volumes and basin stability."""
    gradient_error: Float[np.ndarray, " parameters"] = np.zeros(0)
    """Standard errors of the derivatives of areas, volumes and basin stability; otherwise empty.
    They combine the scatter between lines of the grid, an estimate for parts thinner than a cell,
    and the crossings of unknown velocity. They are infinite where the boundary is `fractal` and the
    derivative is not averaged: the integral along such a boundary may even have the wrong sign.
    Give `bands` there."""
    averaged: Bool[np.ndarray, " parameters"] = np.zeros(0, bool)
    """Whether each derivative is an average over a band; empty where none ever is."""
    crossings: int = 0
    """Number of points where lines cross the boundary of a basin."""
    lost: int = 0
    """Crossings of unknown velocity: they border on another attractor, on infeasible starts, on a
    failure without a margin, or on one whose margin jumps there, as where a strike is missed that
    would have led to another stride. Those at infeasible starts count as fixed, since the
    parameters of most walkers do not move that border. Each of the others enters the error with the
    root-mean-square velocity of the known ones."""
    strides: int = 0
    """Total number of strides for a basin; those with derivatives count once for each direction."""
    fractal: Bool[np.ndarray, " parameters"] = np.zeros(0, bool)
    """Whether a basin's boundary is fractal at the scale of the cells: neighbouring lines cross
    parts of it that move independently. It is not told in three dimensions."""


def measures_known(walker: System) -> tuple[str, ...]:
    """Return the names of the measures of a walker's gaits, its integrals last."""
    named = named_functions(walker)
    if taken := sorted({*named} & {*GAIT_MEASURES}):
        raise WrongUse(
            f"integrals of {walker.label()} must not be named {taken[0]!r}: gaits have it"
        )
    return (*GAIT_MEASURES, *named)


def differentiate_measures(
    walker: System,
    names: Sequence[str],
    gait: Gait,
    wanted: Sequence[str],
    functions: Mapping[str, GaitFunction],
    tolerance: float | None,
) -> dict[str, Measure]:
    """Return the measures that are `wanted`, with derivatives by the numbers of these names.

    Measures by name are known ones, or `functions`.
    """
    none = np.full(len(names), np.nan)
    if not gait.found:
        return dict.fromkeys(wanted, Measure(np.nan, none))
    by_gait = GaitPull(walker, gait, names, tolerance)
    real, exact = eqx.partition(walker, eqx.is_inexact_array_like)
    arrays = [jnp.asarray(one) for one in (gait.states, gait.step_times, gait.multipliers)]
    known = {name: partial(one, tolerance) for name, one in KNOWN.items()}
    known |= {name: partial(number_from, name, one) for name, one in functions.items()}
    known["cost-of-transport"] = partial(
        cost_of_transport, tolerance, cost_is_known(walker), walker.driven_by_gravity()
    )
    summed = [name for name in wanted if name not in known]

    def measure(function) -> list[Measure]:
        def of(real, states, times, multipliers):
            there = gait._replace(states=states, step_times=times, multipliers=multipliers)
            return jnp.atleast_1d(jnp.asarray(function(eqx.combine(real, exact), there)))

        values, pull = jax.vjp(of, real, *arrays)
        gradients = [none] * len(values)
        if names:
            for i, unit in enumerate(np.eye(len(values), dtype=values.dtype)):
                by_real, *by_others = pull(jnp.asarray(unit))
                by_walker = values_of(eqx.combine(by_real, exact), names)
                gradients[i] = by_walker + by_gait.pull(*map(np.asarray, by_others))
        return [Measure(*one) for one in zip(values.tolist(), gradients, strict=True)]

    found = {name: measure(known[name])[0] for name in wanted if name in known}
    if summed:
        means = partial(mean_integrals, summed, tolerance)
        found |= zip(summed, measure(means), strict=True)
    return {name: found[name] for name in wanted}


def number_from(name: str, function: GaitFunction, walker: Any, gait: Gait) -> Scalar:
    """Return the number of a function of a gait; refuse a function that returns another thing."""
    value = function(walker, gait)
    try:
        number = jnp.asarray(value)
        number = number.astype(float) if number.dtype.kind in "iu" else number
        single = number.shape == () and jnp.issubdtype(number.dtype, jnp.floating)
    except (TypeError, ValueError):
        number, single = jnp.zeros(()), False
    if not single:
        array = f"an array of shape {np.shape(value)}" if hasattr(value, "dtype") else short(value)
        raise WrongUse(f"{name} must return one real number, not {array}")
    return number


def mean_step_length(tolerance: float | None, walker: Any, gait: Gait) -> Scalar | float:
    """Average the lengths of the steps, each measured at the heel strike that ends it."""
    lengths: list[Any] = [step_length(walker, x) for x in gait.states]
    return np.nan if lengths[0] is None else jnp.mean(jnp.stack(lengths))


def speed(tolerance: float | None, walker: Any, gait: Gait) -> Scalar | float:
    """Return the mean step length over the mean step time."""
    return mean_step_length(tolerance, walker, gait) / jnp.mean(gait.step_times)


def spectral_radius(tolerance: float | None, walker: Any, gait: Gait) -> Scalar:
    """Return the modulus of the largest multiplier, per stride."""
    return jnp.abs(gait.multipliers[0]) ** (1 / len(gait.states))


def cost_of_transport(
    tolerance: float | None, is_known: bool, by_gravity: bool, walker: Any, gait: Gait
) -> Scalar | float:
    """Return the energy lost per unit of weight and of distance; NaN if unknown.

    Whether gravity alone does work depends on the numbers of the walker, which are traced here.
    """
    if not is_known or step_length(walker, gait.states[0]) is None:
        return np.nan
    slope = jnp.sin(vars(walker)["slope"])
    if by_gravity:
        return slope
    works = [
        walker.during_stride(x).motor_work(walker.lift(x), end_of_stride(walker, x))
        for x in gait.states
    ]
    known = jnp.stack([work for work in works if work is not None])
    return slope + jnp.mean(known) / mean_step_length(tolerance, walker, gait)


KNOWN: dict[str, Callable[..., Any]] = {
    "step-length": mean_step_length,
    "speed": speed,
    "spectral-radius": spectral_radius,
}
"""Measures of any walker's gaits, as functions of a tolerance, a walker and a gait."""
GAIT_MEASURES = (*KNOWN, "cost-of-transport")


def mean_integrals(
    names: Sequence[str], tolerance: float | None, walker: Any, gait: Gait
) -> Float[Array, " names"]:
    """Average integrals and largest values over the strides of a gait."""
    found = [integrals(walker, x, tolerance=tolerance) for x in gait.states]
    return jnp.stack([jnp.mean(jnp.stack([one[name] for one in found])) for name in names])


def step_length(walker: System, x: Float[Array, " section"]) -> Scalar | None:
    """Return the length of a step of a gait: in the plane the step before x, in space the next.

    None for a system that makes no steps.
    """
    return walker.step_length(x, lambda: end_of_stride(walker, x))


def end_of_stride(walker: Any, x: Float[Array, " section"]) -> Any:
    """Return the full state just before the heel strike that ends a stride."""
    motion = trajectory(walker, x, stride(walker, x).time[None])
    return jax.tree.map(lambda values: values[0], motion)


def cost_is_known(walker: Any) -> bool:
    """Return whether the energy that a step loses is known."""
    if walker.driven_by_gravity():
        return True
    if type(walker).motor_work is System.motor_work:
        return False
    anywhere = walker.lift(jnp.zeros(len(walker.section)))
    return walker.motor_work(anywhere, anywhere) is not None

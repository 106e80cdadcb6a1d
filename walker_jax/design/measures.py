"""Measures of gaits, and their derivatives by the walker's parameters.

Speed, step length, largest multiplier and cost of transport follow from the gait, and their
derivatives from the implicit function theorem.
"""

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from walker_jax.checks import WrongUse, check_kind, refuses_tracers
from walker_jax.gaits.cycles import Gait
from walker_jax.gaits.derivatives import gait_derivatives
from walker_jax.gaits.search import search_gait
from walker_jax.systems.system import System
from walker_jax.walkers.model import Scalar
from walker_jax.walkers.parameters import along_parameter, check_parameters
from walker_jax.walking.integrals import integrals, named_functions
from walker_jax.walking.stride import stride
from walker_jax.walking.trajectories import trajectory

GAIT_MEASURES = ("step-length", "speed", "spectral-radius", "cost-of-transport")


class Measure(NamedTuple):
    """A measure of a walker's gait, and its derivatives by parameters."""

    value: float
    gradient: Float[np.ndarray, " parameters"]


@refuses_tracers("it gives derivatives itself, by the parameters named")
def gait_measures(
    walker: System,
    parameters: Sequence[str] = ("slope",),
    gait: Gait | None = None,
    *,
    tolerance: float | None = None,
) -> dict[str, Measure]:
    """Measure a gait's speed, step length, stability and cost, with derivatives by parameters.

    ```python
    walker = wj.SimplestWalker(slope=0.004)
    speed = wj.gait_measures(walker, ["slope"])["speed"]
    speed.value, speed.gradient
    ```

    - "step-length": the mean length of a step along the slope, in the unit of length;
    - "speed": the step length over the mean step time;
    - "spectral-radius": the modulus of the gait's largest multiplier, per stride: its root of the
      order of the period;
    - "cost-of-transport": the energy lost per unit of weight and of distance along the slope. It is
      sin(slope) plus the work of all motors in a step over the step's length
      (`Walker.motor_work`), hip and push-off together; NaN if that work is not known. So on level
      ground it is the motors' work alone, and uphill that work less what gravity takes.

    The mean of each integral and largest value that the modes name (`integrals`) is there too, by
    its name.

    Arguments are those of `gait_derivatives`; the gait is that of `find_gait` by default. All
    measures are NaN if there is no gait. A system that makes no steps has only the
    spectral radius; its other measures are NaN.

    Raises `ValueError` for parameters that the walker does not have, and, if any are given, for a
    gait that is not one of this walker.
    """
    check_parameters(walker, parameters)
    gait = search_gait(walker, tolerance=tolerance) if gait is None else gait
    check_kind("gait", gait, Gait)
    named = named_functions(walker)
    if taken := sorted({*named} & {*GAIT_MEASURES}):
        raise WrongUse(
            f"integrals of {walker.label()} must not be named {taken[0]!r}: gaits have it"
        )
    if not gait.found:
        unknown = Measure(np.nan, np.full(len(parameters), np.nan))
        return dict.fromkeys((*GAIT_MEASURES, *named), unknown)
    changes = [gait_derivatives(walker, gait, name, tolerance=tolerance) for name in parameters]
    states, period = np.asarray(gait.states), len(gait.states)

    def along(measure, name: str, dx: Float[np.ndarray, "period section"]) -> float:
        way = along_parameter(walker, name), jnp.asarray(dx)
        return float(jax.jvp(measure, (walker, jnp.asarray(states)), way)[1])

    steps = jax.eval_shape(step_length, walker, jnp.asarray(states[0])) is not None
    length = float(mean_step_length(walker, jnp.asarray(states))) if steps else np.nan
    time = float(np.mean(gait.step_times))

    def changes_of(measure) -> Float[np.ndarray, " parameters"]:
        pairs = zip(parameters, changes, strict=True)
        return np.array([along(measure, name, change.states) for name, change in pairs])

    longer = changes_of(mean_step_length) if steps else np.full(len(parameters), np.nan)
    slower = np.array([np.mean(change.step_times) for change in changes])
    largest = complex(gait.multipliers[0])
    radius = abs(largest) ** (1 / period)
    growth = np.array([(np.conj(largest) * change.multipliers[0]).real for change in changes])
    growing = growth / abs(largest) ** 2 if largest else np.full(len(parameters), np.nan)
    cost = Measure(np.nan, np.full(len(parameters), np.nan))
    if steps and cost_is_known(walker):
        slope, steeper = float(vars(walker)["slope"]), [float(n == "slope") for n in parameters]
        work, by = 0.0, np.cos(slope) * np.array(steeper)
        if not walker.driven_by_gravity():
            work = float(work_per_length(walker, jnp.asarray(states)))
            by = by + changes_of(work_per_length)
        cost = Measure(float(np.sin(slope)) + work, by)
    means = {name: partial(mean_integral, name, tolerance) for name in named}
    return {
        "step-length": Measure(length, longer),
        "speed": Measure(length / time, (longer - slower * length / time) / time),
        "spectral-radius": Measure(radius, radius * growing / period),
        "cost-of-transport": cost,
        **{
            name: Measure(float(mean(walker, jnp.asarray(states))), changes_of(mean))
            for name, mean in means.items()
        },
    }


def mean_step_length(walker: Any, states: Float[Array, "period section"]) -> Scalar:
    """Average the lengths of the steps, each measured at the heel strike that ends it."""
    lengths: list[Any] = [step_length(walker, x) for x in states]
    return jnp.mean(jnp.stack(lengths))


def work_per_length(walker: Any, states: Float[Array, "period section"]) -> Scalar:
    """Return the motors' work per unit of weight and of distance."""
    works = [
        walker.during_stride(x).motor_work(walker.lift(x), end_of_stride(walker, x)) for x in states
    ]
    known = jnp.stack([work for work in works if work is not None])
    return jnp.mean(known) / mean_step_length(walker, states)


def mean_integral(
    name: str, tolerance: float | None, walker: Any, states: Float[Array, "period section"]
) -> Scalar:
    """Average an integral, or a largest value, over the strides of a gait."""
    return jnp.mean(jnp.stack([integrals(walker, x, tolerance=tolerance)[name] for x in states]))


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

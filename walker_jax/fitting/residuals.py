"""Residuals of a fit: recorded less predicted, over the standard deviation of the noise.

A step contributes those of its samples and that of the heel strike that ends it, and the first of a
run also that of the heel strike that begins it. Heel strikes are consecutive: a step begins when
the one before it ends, as predicted. Its start on the section is free (multiple shooting), or where
the step before it leads (single shooting).
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float

from walker_jax.fitting.bounds import Bounds, from_free
from walker_jax.fitting.predictions import (
    Predicted,
    linearised,
    predict_samples,
    predict_step,
    sample_state,
)
from walker_jax.fitting.steps import Steps
from walker_jax.integrators.integrator import Integrator
from walker_jax.systems.hybrid_system import HybridSystem
from walker_jax.walkers.parameters import with_values

LOST = 1e4
"""Residual, in standard deviations, of anything that a failed step does not predict: large enough
for the search to turn back."""


class Layout(NamedTuple):
    """Static facts of a fit, for which its program is compiled."""

    names: tuple[str, ...]
    """Parameters."""
    places: tuple[int, ...]
    """Places of the recorded columns in a state."""
    single: bool
    """Whether starts are linked by the impact."""
    loss: str


class Unknowns(NamedTuple):
    """All that a fit searches for."""

    free: Float[Any, " parameters"]
    """Parameters, without bounds (`bounds.from_free`)."""
    begins: Float[Any, " runs"]
    """Time at which each run begins."""
    starts: Float[Any, "starts section"]
    """Starts of all steps on the section; of the runs alone in single shooting."""


class Data(NamedTuple):
    """Recorded numbers and their noise: constants of the search."""

    systems: Any
    """The system of each step: leaves have steps along their first axis."""
    steps: Steps
    noise: Float[Any, " columns"]
    strike_noise: Float[Any, ""]
    prior: Float[Any, "2 parameters"]
    """Mean and standard deviation, infinite for none."""
    bounds: Bounds
    weights: Float[Any, " steps"]
    """How often each step counts; 1 but for a bootstrap."""
    integrator: Integrator
    apart: Bool[Any, ""]
    """Whether each step begins at its recorded heel strike, so that steps are fitted one by one."""


class Problem(NamedTuple):
    """A fit before its search."""

    systems: tuple[HybridSystem, ...]
    layout: Layout
    columns: tuple[str, ...]
    data: Data
    given: Float[Any, " columns"]
    """Noise of columns, NaN where it is to be found."""
    begun: Unknowns
    """First guesses, with a start for each step."""


class Motion(NamedTuple):
    """Predicted steps."""

    values: Float[Array, " parameters"]
    starts: Float[Array, "steps section"]
    begins: Float[Array, " steps"]
    """Time of the heel strike before each step."""
    ends: Float[Array, " steps"]
    walks: Bool[Array, " steps"]


def follow_steps(layout: Layout, unknowns: Unknowns, data: Data) -> Motion:
    """Follow all steps: from their own starts at once, or one after another.

    A step begins when the one before it ends, or, while steps are `apart`, when it was recorded to.
    """
    values = from_free(unknowns.free, data.bounds)
    size, steps = unknowns.starts.shape[1], data.steps
    join = lambda x: jnp.concatenate([x, values])
    make = partial(predict_step, layout.names, size)
    if layout.single:

        def advance(x, step):
            system, is_first, run = step
            x = jnp.where(is_first, unknowns.starts[run], x)
            end = linearised(make, join(x), system, data.integrator)
            return jnp.where(jnp.isfinite(end[:size]), end[:size], x), (x, end[size])

        each = data.systems, steps.is_first, steps.run
        _, (starts, durations) = lax.scan(advance, unknowns.starts[0], each)
    else:
        starts = unknowns.starts
        joined = jax.vmap(join)(starts)
        ends = linearised(jax.vmap(make, (0, 0, None)), joined, data.systems, data.integrator)
        durations = ends[:, size]
    walks = jnp.isfinite(durations)
    durations = jnp.where(walks, durations, steps.ends - steps.begins)
    total = jnp.cumsum(durations)
    before = jnp.where(steps.is_first, total - durations, 0)
    offset = unknowns.begins - jax.ops.segment_sum(before, steps.run, len(unknowns.begins))
    begins = jnp.where(data.apart, steps.begins, total - durations + offset[steps.run])
    return Motion(values, starts, begins, begins + durations, walks)


def standardise(loss: str, residuals: Float[Array, "..."]) -> Float[Array, "..."]:
    """Return residuals whose squares are the loss of the given ones."""
    if loss == "linear":
        return residuals
    squares = residuals**2
    if loss == "soft_l1":  # 2 (sqrt(1 + r^2) - 1)
        return residuals * jnp.sqrt(2 / (1 + jnp.sqrt(1 + squares)))
    small = squares < 1e-12
    ratio = jnp.log1p(squares) / jnp.where(small, 1.0, squares)  # cauchy: log(1 + r^2)
    return residuals * jnp.sqrt(jnp.where(small, 1.0, ratio))


LOSSES = "linear", "soft_l1", "cauchy"


def step_residuals(
    layout: Layout, size: int, variables: Array, step: Any, shared: Any
) -> Predicted:
    """Return the residuals of a step's samples, from its start, its time and the parameters."""
    system, times, recorded, known, weight = step
    noise, integrator = shared
    names, places = layout.names, layout.places
    found = predict_samples(names, places, size, variables, times, system, integrator)
    finite = jnp.isfinite(found.values) & jnp.isfinite(found.jacobian).all(axis=-1)
    off = jnp.where(known, (found.values - recorded) / noise[None], 0)
    lost = jnp.where(known, LOST, 0.0)
    rate = jax.vmap(jax.vmap(jax.grad(partial(standardise, layout.loss))))(
        jnp.where(finite, off, 0)
    )
    used = (known & finite)[..., None]
    slopes = jnp.where(used, rate[..., None] * found.jacobian / noise[None, :, None], 0)
    root = jnp.sqrt(weight)
    residuals = root * jnp.where(finite, standardise(layout.loss, off), lost)
    return Predicted(residuals.reshape(-1), root * slopes.reshape(-1, len(variables)))


def compress(found: Predicted) -> Predicted:
    """Turn residuals by a rotation after which only the first few, and their slopes, are not zero.

    Sums of squares, and their derivatives, are the same: a step counts for no more rows than it has
    variables, and one more, which has no slopes.
    """
    both = jnp.concatenate([found.jacobian, found.values[:, None]], axis=1)
    triangle = jnp.linalg.qr(both, mode="r")
    return Predicted(triangle[:, -1], triangle[:, :-1])


def residuals(
    layout: Layout, unknowns: Unknowns, data: Data
) -> tuple[Float[Array, " residuals"], Motion]:
    """Return residuals whose sum of squares is to be least, and the steps that they are of.

    Those of samples are compressed; the parts that no variable changes at first order are one.
    """
    motion = follow_steps(layout, unknowns, data)
    size = unknowns.starts.shape[1]
    variables = jax.vmap(lambda x, begin: jnp.concatenate([x, begin[None], motion.values]))(
        motion.starts, motion.begins
    )

    def of_samples(variables, steps, shared):
        of_one = lambda one, step: compress(step_residuals(layout, size, one, step, shared))
        return jax.vmap(of_one)(variables, steps)

    steps = data.systems, *data.steps[:3], data.weights  # times, values, known
    samples = linearised(of_samples, variables, steps, (data.noise, data.integrator))
    samples, rest = jnp.split(samples, (variables.shape[1],), axis=1)
    rest = jnp.linalg.norm(lax.stop_gradient(rest))
    others = strike_residuals(layout, motion, data, len(unknowns.begins)), prior(motion, data)
    return jnp.concatenate([samples.reshape(-1), rest[None], *others]), motion


def strike_residuals(
    layout: Layout, motion: Motion, data: Data, runs: int
) -> Float[Array, " strikes"]:
    """Return the residuals of heel strikes: of ends, and of beginnings of runs."""
    steps, root = data.steps, jnp.sqrt(data.weights)
    ends = standardise(layout.loss, (motion.ends - steps.ends) / data.strike_noise)
    begins = standardise(layout.loss, (motion.begins - steps.begins) / data.strike_noise)
    ends = root * jnp.where(motion.walks, ends, LOST)
    (first,) = jnp.nonzero(steps.is_first, size=runs)
    return jnp.concatenate([ends, (root * begins)[first]])


def prior(motion: Motion, data: Data) -> Float[Array, " parameters"]:
    """Return the distances of the parameters from their prior means, over standard deviations."""
    mean, deviation = data.prior
    return (motion.values - mean) / deviation


@partial(jax.jit, static_argnums=0)
def predicted(
    layout: Layout, unknowns: Unknowns, data: Data
) -> tuple[Motion, Float[Array, "steps samples columns"]]:
    """Return the predicted steps, and their coordinates at the times of the samples."""
    motion = follow_steps(layout, unknowns, data)

    def of_step(x, begin, system, times):
        now = with_values(system, zip(layout.names, motion.values, strict=True))
        state = lambda time: sample_state(now, x, time - begin, data.integrator)
        return jax.vmap(state)(times)[:, jnp.asarray(layout.places)]

    return motion, jax.vmap(of_step)(motion.starts, motion.begins, data.systems, data.steps.times)


def all_residuals(layout: Layout, unknowns: Unknowns, data: Data) -> Float[Array, " numbers"]:
    """Return a residual for each number, as other programs search with; none is compressed."""
    motion, values = predicted(layout, unknowns, data)
    off = jnp.where(data.steps.known, (values - data.steps.values) / data.noise[None, None], 0)
    others = strike_residuals(layout, motion, data, len(unknowns.begins)), prior(motion, data)
    return jnp.concatenate([standardise(layout.loss, off).reshape(-1), *others])

"""Motion of a step as its recording sees it: chosen coordinates at times, and the next step.

All is written for one step of one system, and mapped over steps and samples by `jax.vmap`, so that
one call of a kernel computes all samples, with their derivatives in forward mode.
"""

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from walker_jax.integrators.integrator import Integrator
from walker_jax.integrators.roots import Scalar
from walker_jax.systems.hybrid_system import HybridSystem
from walker_jax.systems.outcomes import Outcome
from walker_jax.walkers.parameters import with_values
from walker_jax.walking.stride import follow_stride, modes_from
from walker_jax.walking.trajectories import state_after


class Predicted(NamedTuple):
    """Values of a function of one step or sample, and their derivatives by its variables."""

    values: Float[Array, "*batch values"]
    jacobian: Float[Array, "*batch values variables"]


def sample_state(
    system: HybridSystem, x: Float[Array, " section"], time: Scalar, integrator: Integrator
) -> Float[Array, " state"]:
    """Return the numbers of the state at a time after the start x of a step.

    Before the start they follow the rates at the start: the recorded heel strike may be too early.
    """
    state = state_after(system, x, jnp.maximum(time, 0), integrator)
    rates = next(iter(modes_from(system, x).values())).rates(system.launch(x))
    before = jnp.minimum(time, 0)
    return jnp.stack(jax.tree.leaves(state)) + before * jnp.stack(jax.tree.leaves(rates))


def predict_samples(
    names: Sequence[str],
    places: Sequence[int],
    size: int,
    variables: Float[Array, " variables"],
    times: Float[Array, " samples"],
    system: HybridSystem,
    integrator: Integrator,
) -> Predicted:
    """Predict the coordinates at `places` of a state, at times on the clock of the recording.

    Variables are the `size` coordinates of the start, its time, and the parameters `names`.
    """

    def predict(variables, time):
        now = with_values(system, zip(names, variables[size + 1 :], strict=True))
        state = sample_state(now, variables[:size], time - variables[size], integrator)
        return state[jnp.asarray(places)]

    return jax.vmap(lambda time: with_jacobian(partial(predict, time=time), variables))(times)


def predict_step(
    names: Sequence[str],
    size: int,
    variables: Float[Array, " variables"],
    system: HybridSystem,
    integrator: Integrator,
) -> Predicted:
    """Predict the start of the next step, and the duration of this one; NaN after a failure.

    Variables are the `size` coordinates of the start, and the parameters `names`.
    """

    def predict(variables):
        now = with_values(system, zip(names, variables[size:], strict=True))
        made = follow_stride(now, variables[:size], integrator)
        walks = made.outcome == Outcome.STRIDE
        return jnp.append(made.state, jnp.where(walks, made.time, jnp.nan))

    return with_jacobian(predict, variables)


def with_jacobian(function: Any, variables: Float[Array, " variables"]) -> Predicted:
    """Return a function's values and its Jacobian, from one evaluation in forward mode."""
    twice = lambda at: (function(at),) * 2
    jacobian, values = jax.jacfwd(twice, has_aux=True)(variables)
    return Predicted(values, jacobian)


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def linearised(function: Any, variables: Any, *arrays: Any) -> Float[Array, "*batch values"]:
    """Return the values of function(variables, *arrays) -> `Predicted`, with its own Jacobian.

    Derivatives by `variables` multiply by that Jacobian, however many directions there are. The
    other arrays are constants.
    """
    return function(variables, *arrays).values


@linearised.defjvp
def push(function: Any, primals: Any, tangents: Any) -> Any:
    """Multiply a direction by the Jacobian."""
    found = function(*primals)
    return found.values, jnp.einsum("...ij,...j->...i", found.jacobian, tangents[0])

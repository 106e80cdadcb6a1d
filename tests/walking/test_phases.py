"""Strides whose swing is preceded by a phase, of a walker that moves as the simplest one does."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from by_differences import differences
from part_of_swing import PartOfSwing

import walker_jax as wj
from walker_jax import Outcome, SimplestWalker
from walker_jax.gaits.cycles import linearise
from walker_jax.integrators.integrator import Integrator
from walker_jax.walkers.parameters import with_parameter

SLOPE, LEAN = 0.004, 0.15


class UntilItLeans(PartOfSwing):
    """Until the stance leg leans so far; before that, the swing foot must not come down."""

    def event(self, state):
        return -LEAN - state.theta

    def end(self, state):
        walker: Any = self.walker
        return state._replace(phidot=walker.kept * state.phidot)

    def clearance(self, state):
        return jnp.cos(state.theta) - jnp.cos(state.theta - state.phi)

    def reach(self, state):
        return -0.1 - state.phi  # not just where the legs pass each other


class SlowedWalker(SimplestWalker):
    """The simplest walker, whose swing leg keeps a part of its rate as the stance leg leans."""

    kept: jax.Array

    def phases(self):
        return (UntilItLeans(self),)


def slowed(kept: float) -> SlowedWalker:
    return SlowedWalker(*np.array([SLOPE, kept]))


STARTS = np.array([[0.1878, -0.1888], [0.1586, -0.1599], [0.1459, -0.1488], [0.1492, -0.1526]])
"""Of the walk in the paper's Table 1; the next steps are of 0.1586, 0.1459, 0.1492 and 0.1539."""


def onto(walker: Any, steps: np.ndarray) -> Any:
    """Strides from every start, each onto ground of every height."""
    one = lambda x, step: wj.stride(walker, x, step=step)
    every = jax.vmap(jax.vmap(one, (None, 0)), (0, None))
    return jax.tree.map(np.asarray, every(jnp.asarray(STARTS), jnp.asarray(steps)))


@pytest.mark.slow
def test_a_foot_that_lands_in_a_phase_makes_the_same_stride():
    """Onto higher and lower ground, also where it is below the level as the phase ends."""
    steps = np.concatenate([-np.geomspace(1e-5, 2e-2, 15), [0.0], np.geomspace(1e-5, 2e-3, 15)])
    plain, found = onto(SimplestWalker(SLOPE), steps), onto(slowed(1.0), steps)
    walks = plain.outcome == Outcome.STRIDE
    strikes = plain.state[..., 0] - plain.state[..., 1]  # theta there: legs have been exchanged
    early, later = walks & (strikes > -LEAN), walks & (strikes <= -LEAN)
    for one in (early, later):
        assert min((one & (steps < 0)).sum(), (one & (steps > 0)).sum()) > 10
    level = strikes[:, steps == 0]
    assert (later & (steps < 0) & (level > -LEAN)).sum() > 5  # below the level as the phase ends
    np.testing.assert_array_equal(found.outcome[walks], np.where(early, 8, 0)[walks])
    np.testing.assert_allclose(found.state[later], plain.state[later], rtol=0, atol=1e-11)
    np.testing.assert_allclose(found.time[later], plain.time[later], rtol=0, atol=1e-10)


@pytest.mark.parametrize(
    ("name", "number"), [pytest.param("slope", 2, marks=pytest.mark.slow), ("kept", 3)]
)
@pytest.mark.slow
def test_derivatives_through_the_end_of_a_phase_are_differences(name, number):
    """Of states, by the start and by a parameter."""
    walker, x = slowed(0.9), STARTS[0]
    found = linearise(walker, x[None, None], Integrator(1e-13), name)

    def ends(zs: np.ndarray) -> np.ndarray:
        many = with_parameter(with_parameter(walker, "slope", zs[:, 2]), "kept", zs[:, 3])
        made = wj.strides(many, zs[:, :2])
        assert (made.outcome == Outcome.STRIDE).all()
        return np.asarray(made.state)

    expected = differences(ends, np.array([*x, SLOPE, 0.9]), np.array([3e-4, 3e-4, 1e-4, 1e-2]))
    np.testing.assert_allclose(found.jacobian[0, 0], expected[:, :2], rtol=1e-7, atol=1e-9)
    by_parameter = found.by_parameter[0, 0]
    np.testing.assert_allclose(by_parameter, expected[:, number], rtol=1e-7, atol=1e-9)
    assert np.abs(expected[:, 3]).max() > 1e-3


def test_times_of_phases_are_where_they_end():
    """The stance leg leans by the angle, and the foot strikes; none without a stride."""
    x = STARTS[0]
    (first, last), whole = np.asarray(wj.phase_times(slowed(1.0), x)), wj.stride(slowed(1.0), x)
    theta, phi, *_ = np.stack(wj.trajectory(SimplestWalker(SLOPE), x, np.array([first, last])))
    assert theta[0] == pytest.approx(-LEAN, abs=1e-12)
    assert phi[1] == pytest.approx(2 * theta[1], abs=1e-11)
    assert last == pytest.approx(float(whole.time), rel=1e-13)
    assert np.isnan(wj.phase_times(slowed(1.0), np.array([0.2, -0.05]))).all()


def test_tension_as_a_phase_ends_is_no_start_in_tension():
    """The leg is in tension where 3 cos(theta - slope) < 2 E, so from just before the phase ends.

    It falls forward without a heel strike; only a start in tension is running at once.
    """
    energy = 3 * np.cos(LEAN - 0.01 + SLOPE) / 2
    rate = lambda theta: -np.sqrt(2 * (energy - np.cos(theta - SLOPE)))
    begun = np.array([[0.1, rate(0.1)], [0.16, rate(0.16)]])
    for walker in (SimplestWalker(SLOPE), slowed(1.0)):
        outcomes = jax.vmap(lambda x, walker=walker: wj.stride(walker, x).outcome)(begun)
        assert outcomes.tolist() == [Outcome.FORWARD, Outcome.RUNNING]

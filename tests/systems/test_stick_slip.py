"""The block that sticks and slips, whose modes are entered again, against closed forms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import walker_jax as wj


def period(speed, static, kinetic):
    """Stick for 2 d / speed, then slip on a circle about x = kinetic; d = static - kinetic."""
    d = static - kinetic
    return jnp.pi + 2 * jnp.arctan2(speed, d) + 2 * d / speed


@pytest.mark.parametrize("values", [(0.5, 1.0, 0.5), (0.1, 1.0, 0.9), (2.0, 1.5, 0.2)])
def test_the_cycle_has_its_period(values):
    speed, static, kinetic = values
    gait = wj.find_gait(wj.systems.StickSlip(*values))
    assert gait.step_times[0] == pytest.approx(float(period(*values)), abs=1e-12)
    top = kinetic + np.hypot(static - kinetic, speed)
    assert gait.states[0, 0] == pytest.approx(top, abs=1e-12)
    assert abs(gait.multipliers[0]) < 1e-12


VALUES = jnp.array([0.5, 1.0, 0.5])


def time_of_cycle(values):
    """The time of a stride from the top of the cycle."""
    speed, static, kinetic = values
    top = kinetic + jnp.sqrt((static - kinetic) ** 2 + speed**2)
    return wj.stride(wj.systems.StickSlip(*values), top[None]).time


@pytest.mark.parametrize("jacobian", [pytest.param(jax.jacfwd, marks=pytest.mark.slow), jax.jacrev])
def test_derivatives_pass_modes_that_are_entered_again(jacobian):
    expected = jax.jacfwd(lambda p: period(*p))(VALUES)
    np.testing.assert_allclose(jacobian(time_of_cycle)(VALUES), expected, rtol=1e-12)


@pytest.mark.slow
def test_second_derivatives_pass_them_too():
    curvature = jax.jacfwd(jax.jacfwd(time_of_cycle))(VALUES)
    np.testing.assert_allclose(curvature, jax.hessian(lambda p: period(*p))(VALUES), rtol=1e-9)


def test_fast_motions_lose_energy_on_half_circles():
    """Below the belt's speed the motion is a circle about kinetic, above it about -kinetic."""
    system, x, v = wj.systems.StickSlip(), 6.0, 0.5
    k = float(system.kinetic)
    below = np.hypot(x - k, 0)
    at = k - np.sqrt(below**2 - v**2)  # the block reaches the belt's speed here, past sticking
    above = np.hypot(at + k, v)
    back = -k + np.sqrt(above**2 - v**2)
    expected = k + np.hypot(back - k, v)
    assert at < -1 and back > 1
    assert wj.stride(system, [x]).state[0] == pytest.approx(expected, abs=1e-12)


def test_starts_end_in_one_call_each_on_its_way():
    system = wj.systems.StickSlip()
    starts = np.array([0.4, 0.9, 1.2, 2.0, 6.0, 9.0])[:, None]
    made = wj.strides(system, starts)
    alone = [wj.stride(system, x) for x in starts]
    assert made.outcome.tolist() == [wj.Outcome.OUTSIDE, 0, 0, 0, 0, 0]
    np.testing.assert_array_equal(made.state, [one.state for one in alone])
    assert made.state[1] == pytest.approx(0.9, abs=1e-12)  # never as fast as the belt


class Chatters(wj.HybridSystem):
    """Two modes that hand a state to each other for ever, after no time."""

    rate: float = 1.0
    section = ("x",)

    def lift(self, x):
        return {"x": x[0]}

    def project(self, state):
        return state["x"][None]

    def modes(self):
        field = lambda y: {"x": self.rate + 0 * y["x"]}
        here = lambda y: y["x"]
        ends = wj.Guard(lambda y: y["x"] - 5, wj.SECTION)
        return {
            "one": wj.Mode(field, (wj.Guard(here, "other"), ends)),
            "other": wj.Mode(field, (wj.Guard(here, "one"), ends)),
        }


def test_chatter_is_undecided_and_explained():
    system = Chatters()
    made = wj.strides(system, np.array([[1.0], [-1.0]]))
    assert made.outcome.tolist() == [wj.Outcome.UNDECIDED] * 2
    found = wj.explain(system, [1.0])
    assert "the stride chatters: it has passed 100 modes" in found.complaints

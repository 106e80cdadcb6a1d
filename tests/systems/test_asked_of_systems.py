"""Systems that are no walkers have pictures, steps, regions and usual ranges if they say so."""

from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np
import pytest

import walker_jax as wj
from walker_jax.basins.windows import default_region
from walker_jax.checks import WrongUse
from walker_jax.design.measures import cost_is_known
from walker_jax.walkers.parameters import span_of
from walker_jax.walking.consistency import check_landing

ALPHA = np.pi / 8


class Hub:
    """A picture of a wheel: its hub, and the foot on which it stands."""

    axes = 2

    def longest(self):
        return 4.0

    def sizes(self):
        return {"spoke": 1.0}

    def move(self, states, foot, number=0, height=None, failed=False):
        angle = np.asarray(states.theta)
        hub = foot + np.stack([-np.sin(angle), np.cos(angle)], axis=1)
        step = np.array([2 * np.sin(ALPHA), 0.0])
        return {"theta": angle}, {"hub": hub}, foot + step


class DrawnWheel(wj.systems.TorsoWheel):
    """A torso wheel that says what a walker says."""

    spans: ClassVar = {"lean": (0.2, 0.6)}

    def picture(self) -> Any:
        return Hub()

    def step_length(self, x, end):
        return 2 * jnp.sin(self.alpha)

    def motor_work(self, start, end):
        return jnp.full_like(start.theta, 0.02)

    def basin_region(self, gait):
        state: Any = gait()
        return wj.Grid.through(
            dict(zip(self.section, map(float, state), strict=True)), psi=(0.0, 1.0, 20)
        )


@pytest.fixture(scope="module")
def gait():
    """That of `find_gait`, whose derivatives take long to compile."""
    state = np.array([-0.444569120151, 0.608648375889, 0.336953860588])
    made = wj.stride(DrawnWheel(), state)
    np.testing.assert_allclose(made.state, state, rtol=0, atol=1e-11)
    multipliers = np.array([0.643845112371, -0.392150400913, -0.271893040444], complex)
    yes = np.array(True)
    return wj.Gait(state[None], multipliers, np.array([made.time]), yes, np.array(0.0), yes)


def test_a_wheel_has_a_motion(gait):
    """The hub goes on from stride to stride, and a step is a chord of the wheel."""
    shown = wj.motion(DrawnWheel(), gait.states[0], 3, step=0.1)
    hub, stride = shown["hub"].values, shown["stride"].values
    for k in (1, 2):
        before, after = hub[stride == k - 1][-1], hub[stride == k][0]
        np.testing.assert_allclose(before, after, rtol=0, atol=1e-9)
    along = hub[stride == 2][0] - hub[stride == 1][0]
    np.testing.assert_allclose(along, [2 * np.sin(ALPHA), 0], rtol=0, atol=1e-9)
    assert shown.attrs["spoke"] == 1.0
    with pytest.raises(WrongUse, match="walker must be a system with a picture, unlike TorsoWheel"):
        wj.motion(wj.systems.TorsoWheel(), gait.states[0], 3)


def test_a_wheel_has_a_speed(gait):
    drawn, plain = DrawnWheel(), wj.systems.TorsoWheel()
    value = lambda wheel, name: wj.measure(wheel, name, (), gait).value
    length = value(drawn, "step-length")
    assert length == pytest.approx(2 * np.sin(ALPHA), rel=1e-15)
    speed = length / float(gait.step_times[0])
    assert value(drawn, "speed") == pytest.approx(speed, rel=1e-14)
    cost = value(drawn, "cost-of-transport")  # on level ground it is the motors' alone
    assert cost == pytest.approx(0.02 / length, rel=1e-14)
    assert np.isnan(value(plain, "step-length")) and not cost_is_known(plain)
    assert value(plain, "spectral-radius") == value(drawn, "spectral-radius")


@pytest.mark.slow
def test_the_step_of_a_wheel_has_a_derivative():
    length = wj.measure(DrawnWheel(), "step-length", ["alpha"])
    assert length.gradient[0] == pytest.approx(2 * np.cos(ALPHA), rel=1e-13)


def test_a_wheel_has_a_region_and_a_usual_range(gait):
    region = default_region(DrawnWheel(), gait)
    assert region is not None and region.names == ("psi",)
    plain = default_region(wj.systems.TorsoWheel(), gait)
    assert plain is not None and plain.names == wj.systems.TorsoWheel.section
    assert span_of(DrawnWheel, "lean") == (0.2, 0.6)
    assert span_of(wj.systems.TorsoWheel, "lean") is None
    assert span_of(wj.KneedWalker, "slope") == (0.03, 0.12)
    assert span_of(wj.SimplestWalker, "slope") == (0.001, 0.022)


def test_a_landing_off_the_section_is_told_of_any_system():
    """A state may count turns from anywhere, as the place of a runner does, but not move on so."""
    wheel = wj.systems.TorsoWheel()
    landed = wheel.lift(jnp.array([-0.5, 0.2, 0.1]))
    assert check_landing(wheel, landed) == []
    complaint = "the last reset leads off the section: rates differ by"
    off = landed._replace(theta=landed.theta + 1e-3)
    assert check_landing(wheel, off)[0].startswith(complaint)
    walker = wj.SimplestWalker(0.004)
    landed = walker.lift(jnp.array([0.2, -0.2]))
    assert check_landing(walker, landed) == []
    off = landed._replace(phidot=landed.phidot + 1e-4)
    assert check_landing(walker, off)[0].startswith(complaint)

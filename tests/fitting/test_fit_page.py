"""The programs of the page on fits, and of the robot with unlike legs, run as they stand."""

import re
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from made_up_recordings import Ball, record_ball
from reference import ROOT

import walker_jax as wj


def run_program(page, title, *, until="```", **known):
    """Run the program of a page that follows a comment, until a text in it, or whole.

    Returns its names, the known ones too.
    """
    text = (ROOT / "docs" / page).read_text()
    (source,) = re.findall(rf"<!-- {title} -->\n```python\n(.*?){until}", text, re.S)
    names: dict[str, Any] = {"__name__": page} | known
    with jax.numpy_dtype_promotion("standard"):
        exec(compile(source, page, "exec"), names)
    return names


@pytest.mark.slow
def test_the_page_fits_a_slope_and_carries_its_error_on():
    """The command fits the same walker by default; test_propagation has errors of gaits."""
    names = run_program("fit.md", "from a recording to an error of a gait")
    assert names["gait"].error.max() < 0.02


@pytest.mark.slow
def test_the_page_tells_the_one_recording_unlike_the_others():
    """A ball whose heights are a tenth larger has a tenth more gravity, and the same times."""
    balls = [record_ball(noise=1e-3, seed=seed)[0] for seed in range(3)]
    other = balls[1]._replace(values={"height": 1.1 * balls[1].values["height"]})
    names = run_program("fit.md", "leave one recording out", wj=wj)
    recordings, noise = [balls[0], other, balls[2]], {"height": 1e-3, "time": 1e-3}
    off = [
        float(np.sqrt((heights**2).mean()))
        for heights, _ in names["left_out"](Ball(9.5, 0.0, 0.9), recordings, ["gravity"], noise)
    ]
    # the others agree on gravity; a fit to both kinds is off by half of their difference
    assert off[1] > 1.5 * max(off[0], off[2]) > 15e-3


def rates_after(walker, x, phi, psidot):
    """The strike of the robot in closed form, by two balances of angular momentum.

    Momenta of both legs in the coordinates of the next step, with its stance foot at rest, are
    those just before the strike: the ground's impulse at that foot does no work on them.
    """
    one, two = walker.outer, walker.inner  # stands before, stands after
    length, hip, c = walker.length, walker.hip_mass, np.cos(phi)
    own = [leg.inertia - leg.mass * leg.com**2 for leg in (one, two)]
    w = x
    first = hip * length**2 * w * c + own[1] * psidot
    first += two.mass * (length - two.com) * (length * w * c - two.com * psidot)
    first += one.mass * length * (length - one.com) * w * c
    second = own[0] * w - one.com * one.mass * (length - one.com) * w
    a = hip * length**2 + two.mass * (length - two.com) ** 2 + own[1] + one.mass * length**2
    k = one.mass * length * one.com * c
    return np.linalg.solve(np.array([[a, -k], [-k, one.inertia]]), np.array([first, second]))


@pytest.mark.slow
def test_the_robot_with_unlike_legs_walks():
    run_program("write-your-own.md", "a robot with unlike legs")


def test_the_robot_strikes_as_momentum_demands():
    names = run_program("write-your-own.md", "a robot with unlike legs", until="\n\nx = ")
    walker = names["robot"](1.0)
    before = names["Clocked"](*jnp.array([-0.2, -0.4, 0.5, -1.4, 0.3, 1.0]))
    with jax.numpy_dtype_promotion("standard"):
        after = walker.exchange_legs(walker.impact(before)[1])
    stance, swing = rates_after(walker, -1.4, -0.4, -1.4 - 0.3)
    np.testing.assert_allclose(after.thetadot, stance, rtol=1e-10)
    np.testing.assert_allclose(after.phidot, stance - swing, rtol=1e-10)
    assert float(after.clock) == 0 and float(after.clockdot) == 1
    times = np.array([0.0, 0.2, 0.4, 0.5])
    table = names["robot"](1.0, torque=(0.1, 0.3))
    with jax.numpy_dtype_promotion("standard"):
        torques = [float(table.motor(time)) for time in times]
    np.testing.assert_allclose(torques, np.interp(times, [0, 0.4], [0.1, 0.3]), rtol=1e-12)

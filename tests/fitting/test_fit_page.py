"""The programs of the page on fits, and of the robot with unlike legs, run as they stand."""

import re
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from reference import ROOT


def run_program(page, title):
    """Run the program of a page that follows a comment; return its names."""
    text = (ROOT / "docs" / page).read_text()
    (source,) = re.findall(rf"<!-- {title} -->\n```python\n(.*?)```", text, re.S)
    names: dict[str, Any] = {"__name__": page}
    with jax.numpy_dtype_promotion("standard"):
        exec(compile(source, page, "exec"), names)
    return names


def test_the_page_fits_a_slope_and_carries_its_error_on():
    names = run_program("fit.md", "from a recording to an error of a gait")
    assert names["gait"].error.max() < 0.02


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


def test_the_robot_strikes_as_momentum_demands():
    names = run_program("write-your-own.md", "a robot with unlike legs")
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

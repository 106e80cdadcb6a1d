"""Loops of fixed length and tables in equations, against SciPy.

The stiffness of an oscillator's spring changes at two knots, where its force has a kink; SciPy
starts anew at each of them. Its speed solves Kepler's equation, by four turns of its iteration.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax
from scipy.integrate import solve_ivp

import walker_jax as wj
from walker_jax.integrators.taylor_steps import Taylor

TURNS, TIME = 4, 3.0
STIFFNESS = np.array([4.0, 1.0, 2.5])


def offsets(knots):
    """The force of each part of the spring at q = 0: at the knots the parts meet."""
    return jnp.append(0.0, jnp.cumsum(-jnp.diff(STIFFNESS) * knots))


class Oscillator(wj.HybridSystem):
    """q' = E(v) and v' = -f(q) - v / 5, with E = v + e sin(E) and f' by where q is among knots."""

    eccentricity: float
    knots: jax.Array
    section = ("q", "v")

    def lift(self, x):
        return {"x": x, "time": 0 * x[0]}

    def project(self, state):
        return state["x"]

    def modes(self):
        def field(state):
            q, v = state["x"]
            speed = lax.fori_loop(0, TURNS, lambda _, E: v + self.eccentricity * jnp.sin(E), v)
            place = jnp.searchsorted(self.knots, q)
            force = offsets(self.knots)[place] + jnp.asarray(STIFFNESS)[place] * q
            rate = jnp.stack([speed, -force - v / 5])
            return {"x": rate, "time": jnp.ones_like(q)}

        return {"flow": wj.Mode(field, (wj.Guard(lambda state: state["time"] - TIME, wj.SECTION),))}


def rate(e, force, stiffness, _, x):
    speed = x[1]
    for _ in range(TURNS):
        speed = x[1] + e * np.sin(speed)
    return [speed, -force - stiffness * x[0] - x[1] / 5]


def by_scipy(values):
    """The state after `TIME`, from q, v, the eccentricity and both knots."""
    x, e, knots = values[:2], values[2], values[3:]
    place, time, kinks = int(np.searchsorted(knots, x[0])), 0.0, 0
    forces = np.asarray(offsets(knots))
    while time < TIME:
        field = partial(rate, e, forces[place], STIFFNESS[place])
        events = []
        for knot, direction in ((place - 1, -1), (place, 1)):
            if 0 <= knot < len(knots):
                event = lambda _, x, knot=knot: x[0] - knots[knot]
                event.terminal, event.direction = True, direction
                events.append(event)
        how = {"method": "DOP853", "rtol": 1e-13, "atol": 1e-15, "events": events}
        found = solve_ivp(field, (time, TIME), x, **how)
        time, x = found.t[-1], found.y[:, -1]
        for event, at in zip(events, found.t_events, strict=True):
            place, kinks = place + event.direction * len(at), kinks + len(at)
    return x, kinks


def derivatives_by_scipy(values, kinks, step=2e-3):
    """By differences of sixth order, among motions that pass as many knots."""
    columns = []
    for unit in np.eye(len(values)):

        def at(k, unit=unit):
            state, passed = by_scipy(values + k * step * unit)
            assert passed == kinks
            return state

        pairs = [at(k) - at(-k) for k in (1, 2, 3)]
        columns.append((45 * pairs[0] - 9 * pairs[1] + pairs[2]) / (60 * step))
    return np.stack(columns, axis=1)


@pytest.fixture(scope="module")
def end():
    def state(values):
        few = Taylor(8)  # of fewer terms, so quicker to compile
        return wj.stride(Oscillator(values[2], values[3:]), values[:2], solver=few).state

    return jax.jit(jax.jacfwd(lambda values: [state(values)] * 2, has_aux=True))


@pytest.mark.parametrize("start", [[1.6, 0.3], [-0.2, 1.4], [0.1, -1.1]])
def test_a_motion_by_a_loop_and_a_table_is_that_of_scipy(end, start):
    values = np.array([*start, 0.4, -0.35, 0.45])
    jacobian, state = end(values)
    expected, kinks = by_scipy(values)
    assert kinks >= 2
    np.testing.assert_allclose(state, expected, rtol=0, atol=1e-9)
    np.testing.assert_allclose(jacobian, derivatives_by_scipy(values, kinks), rtol=0, atol=1e-9)

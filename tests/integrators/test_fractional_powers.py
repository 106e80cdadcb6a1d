"""Forces that are fractional powers of a depth or an angle, through the zeros of their bases."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp
from scipy.special import gamma
from switching import switching_series

import walker_jax as wj
from walker_jax.integrators.series import short_logs
from walker_jax.integrators.taylor import function_series, power_bases
from walker_jax.integrators.taylor_steps import Taylor

CONTACTS = {
    "power of a maximum": lambda d: jnp.maximum(d, 0) ** 1.5,
    "where": lambda d: jnp.where(d > 0, d**1.5, 0),
    "where twice": lambda d: jnp.where(d > 0, jnp.where(d > 0, d, 1.0) ** 1.5, 0),
    "square root": lambda d: jnp.sqrt(jnp.maximum(d, 0)) * jnp.maximum(d, 0),
    "cube roots": lambda d: jnp.sqrt(jnp.cbrt(jax.nn.relu(d)) ** 9),
    "exponent of an array": lambda d: jnp.power(jax.nn.relu(d), jnp.asarray(1.5)),
}
"""Ways to write depth^1.5 of a contact."""
FEW = Taylor(8)
"""Steps by fewer terms than usual, which are quicker to compile."""
TWO = "power of a maximum", "square root"
ALL = pytest.param(tuple(CONTACTS), marks=pytest.mark.slow)


class Hertz(wj.HybridSystem):
    """Contacts of spheres without damping, all alike but for how their force is written."""

    stiffness: Any = 1000.0
    depth: Any = 0.0
    contacts: tuple[str, ...] = eqx.field(static=True, default=tuple(CONTACTS))

    section = ("speed",)

    def lift(self, x):
        speeds = jnp.repeat(x, len(self.contacts))
        return self.depth + 0 * speeds, speeds

    def project(self, state):
        return -state[1].mean()[None]

    def modes(self):
        def field(state):
            depth, rate = state
            forces = [CONTACTS[name](d) for name, d in zip(self.contacts, depth, strict=True)]
            return rate, -self.stiffness * jnp.stack(forces)

        return {"contact": wj.Mode(field, (wj.Guard(lambda state: -state[0][0], wj.SECTION),))}


def contact_time(speed, stiffness=1000.0):
    """The time of a Hertzian contact of mass 1, 3.218 (m^2 / (k^2 v))^(1/5)."""
    deepest = (1.25 * speed**2 / stiffness) ** 0.4
    return 2 * deepest / speed * np.sqrt(np.pi) * gamma(1.4) / gamma(0.9)


@pytest.mark.parametrize("contacts", [TWO, ALL])
def test_a_hertzian_contact_that_begins_at_depth_zero(contacts):
    """It keeps the energy, and its time is the closed form; so are their derivatives."""
    speed = jnp.array([0.7])
    assert contact_time(0.7) == pytest.approx(3.2180 * (1e-6 / 0.7) ** 0.2, rel=1e-4)

    def both(stiffness, x):
        made = wj.stride(Hertz(stiffness, contacts=contacts), x, solver=FEW)
        return (made.state[0], made.time), (made.state[0], made.time)

    changes, (state, time) = jax.jacfwd(both, (0, 1), has_aux=True)(jnp.array(1000.0), speed)
    assert float(state) == pytest.approx(0.7, rel=1e-11)
    assert float(time) == pytest.approx(contact_time(0.7), rel=1e-11)
    of_state, of_time = changes
    np.testing.assert_allclose(of_state[1], 1, rtol=1e-9)
    np.testing.assert_allclose(of_time[1], -contact_time(0.7) / 5 / 0.7, rtol=1e-9)
    np.testing.assert_allclose(of_state[0], 0, atol=1e-12)
    np.testing.assert_allclose(of_time[0], -0.4 * contact_time(0.7) / 1000, rtol=1e-9)


BESIDE = np.array([0, 1e-300, -1e-300, 1e-40, -1e-30, 1e-20, -1e-18, 1e-16, -1e-14])


@pytest.mark.parametrize(
    ("dtype", "error", "contacts"),
    [("float64", 1e-11, tuple(CONTACTS)), ("float32", 2e-5, TWO)],
)
def test_a_contact_that_begins_beside_depth_zero(dtype, error, contacts):
    depths = BESIDE.astype(dtype)
    systems = Hertz(jnp.full(len(depths), 1000.0, dtype), jnp.asarray(depths), contacts)
    made = wj.strides(systems, np.full((len(depths), 1), 0.7, dtype))
    np.testing.assert_allclose(made.state[:, 0], 0.7, rtol=error)
    np.testing.assert_allclose(made.time, contact_time(0.7), rtol=error)


class Bouncer(wj.HybridSystem):
    """A ball that falls onto an elastic ground and returns, in one mode."""

    stiffness: Any = 1000.0

    section = ("apex",)

    def lift(self, x):
        return jnp.stack([x[0], 0 * x[0]])

    def project(self, state):
        return state[:1]

    def modes(self):
        force = lambda y: self.stiffness * jnp.maximum(1 - y, 0) ** 1.5
        field = lambda s: jnp.stack([s[1], force(s[0]) - 1])
        return {"flow": wj.Mode(field, (wj.Guard(lambda s: -s[1], wj.SECTION),))}


@pytest.mark.slow
def test_a_ball_through_a_contact_within_a_mode():
    """The base is zero for a while. The ground is at 1, so that depths have rounding errors."""
    x = jnp.array([1.3])
    made = wj.stride(Bouncer(), x)
    assert float(made.state[0]) == pytest.approx(1.3, abs=1e-11)
    speed = np.sqrt(0.6)
    deepest = max(np.roots([400**2, 0, 0, -1, -0.6, -0.09]).real)  # 400 d^2.5 = d + 0.3
    energy = lambda d: speed**2 + 2 * d - 800 * d**2.5
    # d = deepest (1 - u^2), as the speed vanishes like a square root at the deepest point
    inner = lambda u: 2 * u * deepest / np.sqrt(energy(deepest * (1 - u * u)))
    expected = 2 * speed + 2 * quad(inner, 0, 1, epsabs=1e-13)[0]
    assert float(made.time) == pytest.approx(expected, rel=1e-8)
    slope = jax.jacfwd(lambda x: wj.stride(Bouncer(), x).state)(x)
    np.testing.assert_allclose(slope, 1, rtol=1e-9)


SPRINGS = {
    "square root of the modulus": lambda q: q * jnp.sqrt(jnp.abs(q)),
    "power of the modulus": lambda q: jnp.sign(q) * jnp.abs(q) ** 1.5,
    "cube root": lambda q: jnp.cbrt(q) ** 3 * jnp.abs(q) ** 0.5,
    "two sides": lambda q: jnp.maximum(q, 0) ** 1.5 - jnp.maximum(-q, 0) ** 1.5,
}


class Oscillator(wj.HybridSystem):
    """q'' = -q - 2 q |q|^(1/2), from one turning point to the other."""

    springs: tuple[str, ...] = eqx.field(static=True)

    section = ("q",)

    def lift(self, x):
        start = jnp.repeat(x, len(self.springs))
        return start, 0 * start

    def project(self, state):
        return -state[0].mean()[None]

    def modes(self):
        def field(state):
            q, rate = state
            springs = [SPRINGS[name](one) for name, one in zip(self.springs, q, strict=True)]
            return rate, -q - 2 * jnp.stack(springs)

        return {"flow": wj.Mode(field, (wj.Guard(lambda state: state[1][0], wj.SECTION),))}


def half_period(amplitude):
    """Twice the integral of dq / rate from 0 to the amplitude, with q = amplitude sin(a)."""
    potential = lambda q: q * q / 2 + 0.8 * q**2.5

    def integrand(a):
        q = amplitude * np.sin(a)
        fallen = 2 * (potential(amplitude) - potential(q))
        return amplitude * np.cos(a) / np.sqrt(fallen)

    return 2 * quad(integrand, 0, np.pi / 2 - 1e-9, epsabs=1e-13, epsrel=1e-13)[0]


@pytest.mark.parametrize(
    "springs",
    [
        ("two sides",),
        pytest.param(tuple(SPRINGS), marks=pytest.mark.slow),
    ],
)
def test_an_oscillator_through_the_zero_of_a_power(springs):
    end = lambda x: wj.stride(Oscillator(springs), x, solver=FEW)[::2]
    change, (state, time) = jax.jacfwd(lambda x: [end(x)] * 2, has_aux=True)(jnp.array([0.4]))
    assert float(state[0]) == pytest.approx(0.4, rel=1e-11)
    assert float(time) == pytest.approx(half_period(0.4), rel=1e-8)
    np.testing.assert_allclose(change[0], 1, rtol=1e-9)
    h = 1e-3
    difference = (half_period(0.4 + h) - half_period(0.4 - h)) / (2 * h)
    np.testing.assert_allclose(change[1], difference, rtol=1e-5)


class PowerSpringWalker(wj.SimplestWalker):
    """A spring between the legs whose torque is once continuously differentiable."""

    def vector_field(self, state):
        free = super().vector_field(state)
        torque = 0.02 * state.phi * jnp.sqrt(jnp.abs(state.phi))
        return free._replace(phidot=free.phidot - torque)


@pytest.mark.slow
def test_a_stride_with_a_power_of_an_angle():
    """Compared with an independent integration, split where the angle is zero."""
    start = np.array([0.2073, -0.2061])
    made = wj.stride(PowerSpringWalker(0.01), start)
    assert made.outcome == wj.Outcome.STRIDE

    def field(_, y):
        theta, phi, thetadot, phidot = y
        angle = theta - 0.01
        swing = np.sin(phi) * (thetadot**2 - np.cos(angle)) + np.sin(angle)
        return [thetadot, phidot, np.sin(angle), swing - 0.02 * phi * np.sqrt(abs(phi))]

    theta, thetadot = start
    y: Any = [theta, 2 * theta, thetadot, (1 - np.cos(2 * theta)) * thetadot]
    t, end = 0.0, float(made.time)
    crosses: Any = lambda t, y: y[1]
    crosses.terminal = True
    while t < end:
        found = solve_ivp(
            field, (t, end), y, events=crosses, method="DOP853", rtol=1e-13, atol=1e-15
        )
        t, y = found.t[-1], found.y[:, -1]
        if t < end:
            y[1] = np.copysign(1e-18, y[3])
    np.testing.assert_allclose(y[1], 2 * y[0], rtol=0, atol=1e-10)
    np.testing.assert_allclose(made.state, [-y[0], np.cos(y[1]) * y[2]], rtol=0, atol=1e-10)


def test_a_power_of_what_stays_zero_is_zero():
    """Its series has no infinite terms, and neither do their derivatives."""
    line = [jnp.array(-0.3), jnp.array(1.0), *[jnp.array(0.0)] * 4]

    def series(shift):
        moved = [line[0] + shift, *line[1:]]
        force = lambda x: jnp.stack([contact(x) for contact in CONTACTS.values()])
        return jnp.stack(function_series(force, moved))

    for found in jax.jit(lambda shift: (series(shift), jax.jacfwd(series)(shift)))(0.0):
        np.testing.assert_array_equal(found, 0)


def test_bases_of_powers_are_switching_functions():
    line = [jnp.array(0.3), jnp.array(-1.0), *[jnp.array(0.0)] * 4]
    for power in (jnp.sqrt, jnp.cbrt, lambda x: x**0.7, lambda x: x ** jnp.asarray(2.5)):
        (base,), (switch,) = power_bases(power, line), switching_series(power, line)
        np.testing.assert_array_equal(base, line)
        np.testing.assert_array_equal(switch, line)
    for power in (lambda x: x**2, lambda x: x**-1, lambda x: x**-1.5, jnp.exp):
        assert power_bases(power, line) == switching_series(power, line) == []


def test_short_logarithms_of_numbers_too_large_for_float32():
    numbers = np.array([1e-30, 1.0, 1e29, 1e31, 1e100, 1e307, np.inf])
    pairs = jnp.asarray(numbers), jnp.asarray(numbers[::-1].copy())
    for found, expected in zip(jax.vmap(short_logs)(*pairs), pairs, strict=True):
        assert found.dtype == jnp.float32
        np.testing.assert_allclose(found, np.log(expected), rtol=1e-6)
    assert short_logs(jnp.array(0.0)) == [-jnp.inf]


def test_fast_motions_have_steps():
    """Coefficients of the last terms exceed the range of float32, in which steps are chosen."""

    class Decay(wj.HybridSystem):
        section = ("y",)
        lift = lambda self, x: jnp.stack([x[0], 0 * x[0]])
        project = lambda self, state: state[:1]

        def modes(self):
            field = lambda s: jnp.stack([-1e6 * (s[0] - 2), 1e6 * s[1] ** 0])
            return {"decay": wj.Mode(field, (wj.Guard(lambda s: s[1] - 1, wj.SECTION),))}

    made = wj.stride(Decay(), jnp.array([3.0]))
    assert float(made.state[0]) == pytest.approx(2 + np.exp(-1), abs=1e-12 * 1e6)  # of the rate


class KinkAtTheStart(wj.HybridSystem):
    """A ramp that begins as the motion does, beside a root that is never zero."""

    section = ("sum",)

    def lift(self, x):
        return jnp.stack([0 * x[0], x[0]])

    def project(self, state):
        return state[1:]

    def modes(self):
        rate = lambda t: jnp.where(t > 0, t, 0) + jnp.sqrt(1 + t)
        field = lambda s: jnp.stack([1 + 0 * s[0], rate(s[0])])
        return {"ramp": wj.Mode(field, (wj.Guard(lambda s: s[0] - 1, wj.SECTION),))}


def test_a_kink_at_the_start_beside_a_root_far_from_zero():
    made = wj.stride(KinkAtTheStart(), jnp.array([0.0]))
    assert float(made.state[0]) == pytest.approx(0.5 + 2 / 3 * (2**1.5 - 1), rel=1e-11)

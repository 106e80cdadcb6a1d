"""Derivatives of strides, and strides to lower ground."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from by_differences import differences
from independent_strides import GAIT, VALUES, dead_point_rate, following, strides
from scipy.integrate import solve_ivp

import walker_jax as wj
from walker_jax import Outcome, SimplestWalker, State
from walker_jax.execution.tiles import map_cells
from walker_jax.integrators.integrator import Integrator
from walker_jax.walking.stride import follow_step

# Precision, wrong use, transformations


@pytest.mark.slow
def test_single_strides_equal_those_in_tiles_and_mapped(tangents):
    """Called as it is, in tiles, and jitted and mapped over slopes."""
    starts = np.array([[0.2, -0.2], [0.2, -0.25], [0.2, -0.1], [0.9, -0.1], GAIT["state"]])
    walker = SimplestWalker(0.009)
    tiled = strides(0.009, starts)
    mapped, _ = tangents(np.insert(starts, 0, 0.009, axis=1), np.zeros((5, 3)))
    np.testing.assert_allclose(mapped[:, :2], tiled.state, rtol=0, atol=1e-12)
    np.testing.assert_allclose(mapped[:, 2], tiled.time, rtol=0, atol=1e-12)
    assert set(tiled.outcome) == {0, 1, 2, 5}
    for i, start in enumerate(starts):
        single = wj.stride(walker, start)
        assert single.state.shape == (2,) and single.outcome.shape == single.time.shape == ()
        assert single.outcome == tiled.outcome[i] and single.outcome.dtype == jnp.int8
        np.testing.assert_allclose(single.state, tiled.state[i], rtol=0, atol=1e-12)
        np.testing.assert_allclose(single.time, tiled.time[i], rtol=0, atol=1e-12)


# Derivatives with respect to z = (slope, theta, thetadot)


def jacobian(tangents, z):
    """d following / d z, (3, 3)."""
    return tangents(np.tile(z, (3, 1)), np.eye(3))[1].T


def test_jacobian_of_the_gait_is_the_reference(tangents):
    z = np.array([GAIT["slope"], *GAIT["state"]])
    found = jacobian(tangents, z)[:2, 1:]
    np.testing.assert_allclose(found, GAIT["jacobian"], rtol=0, atol=1e-8)


def test_multipliers_of_the_gaits_are_the_reference(tangents):
    for gait in VALUES["gaits"]:
        found = jacobian(tangents, np.array([gait["slope"], *gait["state"]]))[:2, 1:]
        multipliers = np.sort_complex(np.linalg.eigvals(found))
        expected = np.sort_complex(np.array(gait["multipliers"]) @ [1, 1j])
        np.testing.assert_allclose(multipliers, expected, rtol=0, atol=2e-9)


def test_gait_follows_the_slope_as_in_the_reference(tangents):
    """x = S(x, slope): dx/dslope = (1 - dS/dx)^-1 dS/dslope."""
    known = VALUES["gait_slope_derivative"]
    derivatives = jacobian(tangents, np.array([GAIT["slope"], *GAIT["state"]]))[:2]
    found = np.linalg.solve(np.eye(2) - derivatives[:, 1:], derivatives[:, 0])
    np.testing.assert_allclose(found, known["d_state_d_slope"], rtol=0, atol=6e-6)


# z, and the length over which its stride changes: its distance to the nearest boundary
POINTS = {
    "gait": ((GAIT["slope"], *GAIT["state"]), 4e-4),
    "table": ((0.004, 0.2, -0.21645), 4e-4),
    "tiny": ((0.004, 0.011, -0.0071), 1e-5),
    "nearly backward": ((0.004, 0.2, dead_point_rate(0.004, 0.2) - 2e-6), 1e-7),
    "backward": ((0.0165, 0.5, dead_point_rate(0.0165, 0.5) - 1e-5), 5e-7),
    "only just clear": ((0.004, 0.2, -0.21818277212359), 5e-8),
    "steep": ((0.0165, 0.7, -0.70), 2e-4),
}


@pytest.mark.parametrize("name", POINTS)
def test_derivatives_equal_extrapolated_differences(name, tangents):
    """Of next state and time, by slope and start, relative to the largest of a row."""
    z, scale = POINTS[name]
    found = jacobian(tangents, np.array(z))
    expected = differences(lambda zs: tangents(zs, zs)[0], np.array(z), np.full(3, scale))
    assert np.isfinite(found).all()
    errors = np.abs(found - expected) / np.max(np.abs(expected), axis=1, keepdims=True)
    assert np.max(errors) < 1e-7, (found, expected)


def test_derivatives_grow_as_the_boundaries_are_neared(tangents):
    """The points above are near enough to matter."""
    sizes = {
        name: np.max(np.abs(jacobian(tangents, np.array(POINTS[name][0]))[:2]))
        for name in ("gait", "nearly backward", "only just clear")
    }
    assert sizes["gait"] < 10
    assert sizes["nearly backward"] > 1e3 and sizes["only just clear"] > 100


@pytest.mark.slow
def test_jacfwd_is_the_same_derivative(tangents):
    z = jnp.array([GAIT["slope"], *GAIT["state"]])
    found = jax.jit(jax.jacfwd(following))(z)
    np.testing.assert_allclose(found, jacobian(tangents, np.asarray(z)), rtol=1e-10)
    np.testing.assert_allclose(found[:2, 1:], GAIT["jacobian"], rtol=0, atol=1e-8)


@pytest.mark.slow
def test_second_derivatives_equal_differences_of_the_first(tangents):
    z = np.array([GAIT["slope"], *GAIT["state"]])

    @jax.jit
    def second(z, v, w):
        along = lambda z: jax.jvp(following, (z,), (v,))[1]
        return jax.jvp(along, (z,), (w,))[1]

    for v in np.eye(3):
        first = lambda zs, v=v: tangents(zs, np.tile(v, (len(zs), 1)))[1]
        expected = differences(first, z, np.full(3, 4e-4))
        found = np.stack([second(z, v, w) for w in np.eye(3)], axis=1)
        np.testing.assert_allclose(found, expected, rtol=1e-6)


# A heel strike on lower ground


def test_a_step_down_is_what_the_motion_of_the_feet_gives():
    """By Runge-Kutta, and from velocities of hip and feet in the plane."""
    slope, x = 0.009, np.array([0.2, -0.2])
    walker = SimplestWalker(slope)
    full = np.array([0.2, 0.4, -0.2, (1 - np.cos(0.4)) * -0.2])

    def field(t, y):
        theta, phi, thetadot, phidot = y
        swing = np.sin(phi) * (thetadot**2 - np.cos(theta - slope)) + np.sin(theta - slope)
        return [thetadot, phidot, np.sin(theta - slope), swing]

    for drop in (0.0, 1e-4, 2e-3, 0.02):
        found = wj.stride(walker, x, step=-drop)
        assert found.outcome == Outcome.STRIDE
        time = float(found.time)
        before = solve_ivp(field, (0, time), full, rtol=1e-13, atol=1e-13, method="DOP853").y[:, -1]
        theta, phi, thetadot, _ = before
        foot = np.cos(theta) - np.cos(theta - phi)
        assert foot == pytest.approx(-drop, abs=1e-11)
        across = lambda angle: np.array([-np.cos(angle), -np.sin(angle)])
        stance = theta - phi
        rate = thetadot * across(theta) @ across(stance)  # the hip's velocity across the new leg
        trailing = rate * across(stance) @ across(theta)  # the old foot's across its leg is zero
        expected = stance, -phi, rate, rate - trailing
        np.testing.assert_allclose(found.state, expected, rtol=0, atol=1e-10)
    level = wj.stride(walker, x)
    flat = wj.stride(walker, x, step=0.0)
    np.testing.assert_allclose(flat.state[jnp.array([0, 2])], level.state, rtol=0, atol=1e-13)
    assert float(flat.state[1] - 2 * flat.state[0]) == pytest.approx(0, abs=1e-13)
    assert float(flat.time) == pytest.approx(float(level.time), abs=1e-12)


def test_a_step_down_by_nothing_is_a_stride_from_anywhere():
    """Legs that pass each other, and feet that never clear the slope, strike no lower ground."""
    walker = jax.tree.map(np.asarray, SimplestWalker(0.004))
    starts = np.random.default_rng(1).uniform([0.01, -0.8], [np.pi / 4, -0.01], (4000, 2))
    level = wj.strides(walker, starts)
    for drop in (0.0, 1e-9):
        drops = np.full(len(starts), drop)
        down = map_cells(
            follow_step,
            (walker, starts, -drops, Integrator(np.float64(1e-12))),
            (False, True, True, False),
        )
        np.testing.assert_array_equal(down.outcome, level.outcome)
        np.testing.assert_allclose(down.time, level.time, rtol=0, atol=1e-6)
        np.testing.assert_allclose(down.state[:, 0], level.state[:, 0], rtol=0, atol=1e-6)
    assert {0, 1, 2} <= set(level.outcome.tolist())


def test_an_impulse_changes_the_momentum_also_on_lower_ground():
    walker = SimplestWalker(0.009)
    state = State(*map(jnp.asarray, (-0.21, -0.4, -0.2, 0.1)))
    (_, _), after = walker.impact(state)
    across = lambda angle: np.array([-np.cos(angle), -np.sin(angle)])
    before = float(state.thetadot) * across(float(state.theta))
    swing = float(state.theta - state.phi)
    change = float(after.thetadot - after.phidot) * across(swing) - before
    np.testing.assert_allclose(np.array(walker.impulse(state)), change, rtol=0, atol=1e-15)


def test_a_step_down_may_fail():
    walker = SimplestWalker(0.009)
    assert wj.stride(walker, np.array([0.2, -0.2]), step=-0.9).outcome == Outcome.FORWARD
    assert wj.stride(walker, np.array([0.2, -0.1]), step=-1e-3).outcome == Outcome.BACKWARD
    assert np.isnan(wj.stride(walker, np.array([0.2, -0.1]), step=-1e-3).state).all()


@pytest.mark.slow
def test_a_step_down_has_derivatives():
    walker = SimplestWalker(0.009)
    state = lambda z: wj.stride(walker, z[:2], step=-z[2]).state
    z, width = jnp.array([0.2, -0.2, 1e-3]), 1e-4
    jacobian = jax.jit(jax.jacfwd(state))(z)
    step = lambda i, h: (state(z.at[i].add(h)) - state(z.at[i].add(-h))) / (2 * h)
    for i in range(3):
        central = (4 * step(i, width / 2) - step(i, width)) / 3
        np.testing.assert_allclose(jacobian[:, i], central, rtol=0, atol=1e-7)

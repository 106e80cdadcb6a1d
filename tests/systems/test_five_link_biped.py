"""The five-link biped against equations of motion and of impact by hand, integrated by SciPy."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import walker_jax as wj
from walker_jax import multibody
from walker_jax.multibody.single_support import SingleSupport
from walker_jax.systems.five_links import LinkState

BIPED = wj.systems.FiveLinkBiped()
GUESS = -0.1, -0.41, 0.14, 0.16, 0.5, 1.5, 0.5, 0.9, 1.4
OTHER = np.array([-0.13, -0.38, 0.2, 0.17, 0.6, 1.6, 0.3, 0.7, 1.5])
"""A point of the section, some way from the gait."""

L, G = 0.4, 9.81
MASSES = np.array([3.2, 6.8, 20.0, 6.8, 3.2])
INERTIAS = np.array([0.93, 1.08, 2.22, 1.08, 0.93])
ARMS = np.array(
    [
        [0.272, 0, 0, 0, 0],
        [L, 0.237, 0, 0, 0],
        [L, L, 0.2, 0, 0],
        [L, L, 0, -0.163, 0],
        [L, L, 0, -L, -0.128],
    ]
)
"""From the stance foot to each centre of mass, along the links."""
KNEE, HIP, SWING_KNEE = np.array([[L, 0, 0, 0, 0], [L, L, 0, 0, 0], [L, L, 0, -L, 0]])
FOOT = np.array([L, L, 0, -L, -L])


def joint_torques(q, w):
    """At the stance knee, the stance hip, the swing hip and the swing knee: on what is further from
    the stance foot."""
    theta, rate = (q[0] + q[1]) / 2, (w[0] + w[1]) / 2
    swing = 0.6 * (1 - theta**2 / 0.3**2)
    swinging = -1.2 * theta * rate / 0.3**2
    knee = 400 * (q[0] - q[1] - 0.2) + 40 * (w[0] - w[1])
    torso = -400 * (q[2] - 0.15) - 40 * w[2]
    leg = -400 * ((q[3] + q[4]) / 2 + theta) - 40 * ((w[3] + w[4]) / 2 + rate)
    shank = -400 * (q[4] - q[3] - 0.2 - swing) - 40 * (w[4] - w[3] - swinging)
    return np.array([knee, torso + leg, leg, shank])


def power(q, w):
    """Of the motors: each torque times the rate of the link beyond less that of the one before."""
    turned = np.array([w[1] - w[0], w[2] - w[1], w[3] - w[2], w[4] - w[3]])
    return joint_torques(q, w) @ turned


def accelerations(q, w):
    """By Lagrange's equations, of the absolute angles."""
    matrix = ARMS.T @ (MASSES[:, None] * ARMS)
    apart = q[:, None] - q
    knee, hip, swing_hip, shank = joint_torques(q, w)
    torques = np.array([-knee, knee - hip, hip - swing_hip, swing_hip - shank, shank])
    forces = G * (MASSES @ ARMS) * np.sin(q) - (matrix * np.sin(apart)) @ w**2 + torques
    return np.linalg.solve(matrix * np.cos(apart) + np.diag(INERTIAS), forces)


def energy(q, w):
    vx, vy = ARMS @ (np.cos(q) * w), -ARMS @ (np.sin(q) * w)
    kinetic = MASSES @ (vx**2 + vy**2) / 2 + INERTIAS @ w**2 / 2
    return kinetic + G * MASSES @ ARMS @ np.cos(q)


def upward_force(q, w):
    rise = -ARMS @ (np.sin(q) * accelerations(q, w) + np.cos(q) * w**2)
    return MASSES @ (rise + G)


def strike(q, w):
    """Angles and rates after heel strike, with unknown rates of foot and links, and impulses."""
    x = np.hstack([ARMS * np.cos(q), np.ones((5, 1)), np.zeros((5, 1))])
    y = np.hstack([-ARMS * np.sin(q), np.zeros((5, 1)), np.ones((5, 1))])
    matrix = (x.T * MASSES) @ x + (y.T * MASSES) @ y + np.diag([*INERTIAS, 0, 0])
    foot = np.array([[*(FOOT * np.cos(q)), 1, 0], [*(-FOOT * np.sin(q)), 0, 1]])
    every = np.block([[matrix, -foot.T], [foot, np.zeros((2, 2))]])
    after = np.linalg.solve(every, [*(matrix @ [*w, 0, 0]), 0, 0])
    return q[::-1], after[4::-1]


def begin(x):
    """Angles and rates, with both feet on the ground."""
    return np.array([*x[:4], np.arccos(np.cos(x[0]) + np.cos(x[1]) - np.cos(x[3]))]), x[4:]


def derivative(t, y):
    q, w = y[:5], y[5:10]
    return np.concatenate([w, accelerations(q, w), [power(q, w)]])


def swing(x):
    """Angles, rates and the motors' work as the swing foot comes down, and when."""

    def height(t, y):
        return FOOT @ np.cos(y[:5]) if FOOT @ np.sin(y[:5]) > 0 else 1.0

    height.terminal = True
    how: Any = {"method": "DOP853", "rtol": 3e-14, "atol": 1e-14}
    found = solve_ivp(derivative, (0, 5), [*np.concatenate(begin(x)), 0], events=height, **how)
    before, since, time = found.y[:, -2], found.t[-2], found.t[-1]
    for _ in range(3):  # the event was found on an interpolation
        y = solve_ivp(derivative, (since, time), before, **how).y[:, -1]
        time += FOOT @ np.cos(y[:5]) / (FOOT @ (np.sin(y[:5]) * y[5:10]))
    return y[:5], y[5:10], y[10], time


def stride(x):
    q, w, _, time = swing(x)
    q, w = strike(q, w)
    return np.array([*q[:4], *w]), time


def split(q, w) -> LinkState:
    return LinkState(tuple(map(jnp.asarray, q)), tuple(map(jnp.asarray, w)))


def some_states():
    draw = np.random.default_rng(3)
    return [(draw.uniform(-0.6, 0.6, 5), draw.uniform(-3, 3, 5)) for _ in range(4)]


@pytest.fixture(scope="module")
def gait():
    return wj.find_gait(BIPED, GUESS)


@pytest.mark.slow
def test_stride_is_that_of_lagrange_and_scipy():
    found = wj.stride(BIPED, OTHER)
    state, time = stride(OTHER)
    assert found.outcome == wj.Outcome.STRIDE
    np.testing.assert_allclose(found.state, state, rtol=0, atol=1e-11)
    np.testing.assert_allclose(found.time, time, rtol=1e-12)


@pytest.mark.slow
def test_gait_has_the_multipliers_of_differences(gait):
    (x,), h = gait.states, 1e-3
    np.testing.assert_allclose(stride(x)[0], x, rtol=0, atol=1e-11)
    np.testing.assert_allclose(gait.step_times, stride(x)[1], rtol=1e-12)
    assert gait.stable
    change = lambda one, h: (stride(x + h * one)[0] - stride(x - h * one)[0]) / (2 * h)
    columns = [(4 * change(one, h) - change(one, 2 * h)) / 3 for one in np.eye(9)]
    order = lambda values: sorted(values, key=lambda value: (-abs(value), value.imag))
    multipliers = order(np.linalg.eigvals(np.transpose(columns)))
    np.testing.assert_allclose(order(gait.multipliers), multipliers, rtol=0, atol=1e-9)


def test_motors_alone_change_the_energy():
    system = BIPED.system()

    def whole(q, w):
        q, w = (jnp.concatenate([jnp.zeros(2), jnp.asarray(one)]) for one in (q, w))
        kinetic = multibody.kinetic_energy(system, q, w)
        return kinetic + multibody.potential_energy(system, q)

    swinging = jax.jit(lambda state: SingleSupport(BIPED)(state))
    along = jax.jit(lambda *at: jax.jvp(whole, *at))
    for q, w in some_states():
        rates = swinging(split(q, w))
        np.testing.assert_allclose(rates.rates, accelerations(q, w), rtol=1e-11)
        now, change = along((q, w), (jnp.stack(rates.angles), jnp.stack(rates.rates)))
        np.testing.assert_allclose(now, energy(q, w), rtol=1e-13)
        np.testing.assert_allclose(change, power(q, w), rtol=1e-11)


def test_work_of_a_stride_is_its_gain_of_energy():
    q, w, work, _ = swing(OTHER)
    np.testing.assert_allclose(energy(q, w) - energy(*begin(OTHER)), work, rtol=0, atol=1e-10)


@pytest.mark.slow
def test_walks_into_a_gait_whose_impact_takes_the_work():
    states = [OTHER]
    for _ in range(40):
        states.append(np.asarray(wj.stride(BIPED, states[-1]).state))
    x = states[-1]
    np.testing.assert_allclose(stride(x)[0], x, rtol=0, atol=1e-11)
    np.testing.assert_allclose(x[4:6], [0.542530414621, 1.544549631456], rtol=1e-11)
    q, w, work, _ = swing(x)
    lost = energy(q, w) - energy(*begin(np.asarray(wj.stride(BIPED, x).state)))
    np.testing.assert_allclose(lost, work, rtol=0, atol=1e-9)
    assert work > 5


def test_momentum_at_heel_strike():
    """Of the whole about the foot that strikes, and of what is beyond each joint about that."""
    impact = jax.jit(lambda state: BIPED.strike(state).rates)
    for q, w in some_states():
        rates = np.asarray(impact(split(q, w)))[::-1]
        np.testing.assert_allclose(rates, strike(q, w)[1][::-1], rtol=1e-11)
        # The foot that stood moves such that the other one is at rest.
        moves = -FOOT @ (np.cos(q) * rates), FOOT @ (np.sin(q) * rates)

        def momentum(links, point, w, moves=(0.0, 0.0), q=q):
            x, y = (ARMS - point) @ np.sin(q), (ARMS - point) @ np.cos(q)
            vx, vy = ARMS @ (np.cos(q) * w) + moves[0], -ARMS @ (np.sin(q) * w) + moves[1]
            return (MASSES * (y * vx - x * vy) + INERTIAS * w)[links].sum()

        beyond = [[0, 1, 2, 3, 4], [0, 1, 2, 3], [0, 1], [2], [0]]
        for links, point in zip(beyond, [FOOT, SWING_KNEE, HIP, HIP, KNEE], strict=True):
            before, after = momentum(links, point, w), momentum(links, point, rates, moves)
            np.testing.assert_allclose(after, before, rtol=0, atol=1e-11)


def test_failures():
    starts = {
        wj.Outcome.BACKWARD: (-0.1, -0.41, 0.14, 0.16, -2.0, 1.5, 0.5, 0.9, 1.4),
        wj.Outcome.FORWARD: (-0.1, -0.41, 0.74, 0.16, 0.5, 1.5, 0.5, 0.9, 1.4),
        wj.Outcome.SCUFFED: (0.1, -0.45, 0.18, 0.03, 0.28, 0.08, 2.46, 1.13, -0.25),
        wj.Outcome.RUNNING: (-0.1, -0.41, 0.14, 0.16, 0.5, 4.5, 0.5, 0.9, 1.4),
        wj.Outcome.OUTSIDE: (-0.1, -0.41, 0.14, 1.2, 0.5, 1.5, 0.5, 0.9, 1.4),
    }
    outcomes = wj.strides(BIPED, np.array([*starts.values()])).outcome
    assert outcomes.tolist() == [*starts]
    at = {outcome: begin(np.array(x)) for outcome, x in starts.items() if outcome != 5}
    assert at[wj.Outcome.BACKWARD][1][:2].sum() < 0
    forces = {outcome: upward_force(*one) for outcome, one in at.items()}
    assert forces.pop(wj.Outcome.RUNNING) < 0 < min(forces.values())
    q, w = at[wj.Outcome.SCUFFED]
    assert FOOT @ (np.sin(q) * w) > 0  # the foot sinks


def test_strike_with_a_shank_that_leans_back_is_outside():
    x = np.array([-0.17, 0.16, 0.61, -0.04, 1.56, 4.4, -1.06, 0.82, 1.63])
    assert wj.stride(BIPED, x).outcome == wj.Outcome.OUTSIDE
    q, w, _, _ = swing(x)
    assert q[0] < 0 and BIPED.feasible(jnp.asarray(x))
    # The section's point would have the shank lean forward instead.
    again = jax.jit(lambda state: BIPED.lift(BIPED.project(BIPED.strike(state))))
    np.testing.assert_allclose(again(split(q, w)).angles[4], -q[0], rtol=1e-9)


@pytest.mark.slow
def test_gaits_of_its_region(gait):
    """The other one, of short and fast steps, is between walking on and falling."""
    slow, fast = wj.find_gaits(BIPED)
    np.testing.assert_allclose(slow.states, gait.states, rtol=0, atol=1e-10)
    assert slow.stable and sum(abs(fast.multipliers) > 1) == 1
    (x,), (start,) = fast.states, gait.states
    np.testing.assert_allclose(stride(x)[0], x, rtol=0, atol=1e-10)
    edge = wj.edge_state(BIPED, start, x + 0.3 * (x - start), strides=60)
    assert edge.fates == (wj.Outcome.STRIDE, wj.Outcome.FORWARD) and edge.saddle is not None
    np.testing.assert_allclose(edge.saddle.states, fast.states, rtol=0, atol=1e-9)


@pytest.mark.slow
def test_derivatives_through_ten_strides():
    def last(lean, x):
        walk = wj.walk(wj.systems.FiveLinkBiped(lean=lean), x, 10)
        return walk.times.sum() + walk.states[-1] @ jnp.arange(1.0, 10.0)

    lean, x, h = jnp.asarray(0.15), jnp.asarray(OTHER), 1e-3
    by_lean, by_start = jax.grad(last, argnums=(0, 1))(lean, x)
    along = np.linspace(0.5, 1.0, 9)
    for slope, at in (
        (by_lean, lambda s: last(lean + s, x)),
        (by_start @ along, lambda s: last(lean, x + s * along)),
    ):
        one, two, three = (at(n * h) - at(-n * h) for n in (1, 2, 3))
        np.testing.assert_allclose(slope, (45 * one - 9 * two + three) / (60 * h), rtol=1e-8)


@pytest.mark.slow
def test_least_disturbance(gait):
    """Just within it strides succeed, and just beyond it the one in its direction does not."""
    (x,), scale = gait.states, np.array([0.1] * 4 + [1.0] * 5)
    least = wj.least_disturbance(BIPED, gait, scale=scale, directions=256, strides=40)
    away = least.state - x
    np.testing.assert_allclose(np.linalg.norm(away / scale), least.size, rtol=1e-6)
    near, far = (wj.walk(BIPED, x + part * away, 40).outcomes for part in (0.999, 1.001))
    assert near.max() == 0 and far[-1] == least.failure
    draw = np.random.default_rng(0).standard_normal((400, 9))
    within = 0.99 * least.size * scale * draw / np.linalg.norm(draw, axis=1, keepdims=True)
    assert (wj.strides(BIPED, x + within).outcome == 0).all()


@pytest.mark.slow
def test_basin_in_a_plane(gait):
    point = dict(zip(BIPED.section, gait.states[0], strict=True))
    axes = {"stance_thigh_rate": (0.0, 4.0, 12), "torso": (-0.6, 0.9, 12)}
    coarse = wj.basin(BIPED, wj.Grid.through(point, **axes), method="direct")
    fine = wj.refine(BIPED, wj.Grid.through(point, **axes), 1, check=100)
    assert fine.mistaken == 0
    np.testing.assert_allclose(coarse.states[0, 0], gait.states[0], rtol=0, atol=1e-9)
    for i, rate in enumerate(coarse.stance_thigh_rate.values):
        for j, torso in enumerate(coarse.torso.values):
            x = np.array([*(point | {"stance_thigh_rate": rate, "torso": torso}).values()])
            last = wj.walk(BIPED, x, 60)
            assert last.outcomes[-1] == coarse.fate[i, j]
            if last.outcomes[-1] == wj.Outcome.STRIDE:
                np.testing.assert_allclose(last.states[-1], gait.states[0], rtol=0, atol=1e-6)


@pytest.mark.slow
def test_branch(gait):
    branch = wj.continue_gait(BIPED, "lean", (0.1, 0.2), gait)
    assert not branch.folds and not branch.doublings
    end = wj.find_gait(wj.systems.FiveLinkBiped(lean=jnp.asarray(0.2)), gait.states[0])
    np.testing.assert_allclose(branch.states[-1], end.states, rtol=0, atol=1e-9)
    assert (np.diff(branch.step_times[:, 0]) < 0).all()  # the further it leans, the faster

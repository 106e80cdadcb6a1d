"""Walkers against legs and bodies that forces hold together, and when they run."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from by_differences import stacked, strides
from free_bodies import Bodies, a_family
from planar_walkers import GAITS, SLOW, name
from scipy.integrate import solve_ivp

import walker_jax as wj
from walker_jax import Outcome, RoundFootWalker, State, UpperBodyWalker

# An independent solution: each leg and the upper body a free body, held by forces at its joints

INDEPENDENT = [RoundFootWalker, pytest.param(UpperBodyWalker, marks=SLOW)]


@pytest.mark.parametrize("cls", [RoundFootWalker, UpperBodyWalker], ids=name)
def test_equations_are_those_of_free_bodies_held_at_joints(cls):
    """Accelerations, force of the ground, and what heel strike leads to."""
    look = jax.jit(lambda walker, state: (walker.vector_field(state), walker.contact_force(state)))
    hit = jax.jit(lambda walker, state: walker.impact(state))
    rng = np.random.default_rng(3)
    for walker in a_family(cls, 12, 4):
        bodies = Bodies(walker)
        state = rng.uniform(-1, 1, 4)
        rates, force = look(walker, State(*map(jnp.asarray, state)))
        accelerations, forces = bodies.motion(state)
        np.testing.assert_allclose(rates[2:], accelerations, rtol=1e-10, atol=1e-11)
        np.testing.assert_allclose(force, forces, rtol=1e-10, atol=1e-11)
        state[0] = -abs(state[0])
        state[1] = 2 * state[0]
        foot, after = hit(walker, State(*map(jnp.asarray, state)))
        following, lifted = bodies.impact(state)
        np.testing.assert_allclose(after, following, rtol=1e-10, atol=1e-11)
        np.testing.assert_allclose(foot, lifted, rtol=1e-10, atol=1e-11)


@pytest.mark.slow
@pytest.mark.parametrize("cls", INDEPENDENT, ids=name)
def test_strides_are_those_of_free_bodies_held_at_their_joints(cls):
    walkers = a_family(cls, 12, 5)
    _, x, _ = GAITS[cls]
    xs = np.array(x) * (1 + 0.1 * np.random.default_rng(6).uniform(-1, 1, (len(walkers), 3)))
    found = strides(walkers, xs)
    walks = 0
    for walker, x, state, time, outcome in zip(
        walkers, xs, found.state, found.time, found.outcome, strict=True
    ):
        following, expected, _ = Bodies(walker).stride(x)
        assert (following is not None) == (outcome == Outcome.STRIDE)
        if following is not None:
            walks += 1
            np.testing.assert_allclose(state, following, rtol=0, atol=1e-9)
            assert time == pytest.approx(expected, abs=1e-9)
    assert walks >= 4


# Ways to fail


@pytest.mark.slow
def test_a_heel_strike_may_turn_a_walker_back():
    """With heavy legs the impact may leave the new stance leg turning back, the foot lifting."""
    walker = RoundFootWalker(0.2113, 0.2293, 0.5035, 0.287, 1.0, 0.3853, -0.1476, 0.3712)
    x = np.array([0.4695, -0.3179, 0.0358])
    result = wj.stride(walker, x)
    assert result.outcome == Outcome.BACKWARD and np.isnan(result.state).all()
    # an independent solution comes to the heel strike, after which the walker goes back
    field = jax.jit(lambda y: jnp.stack(walker.vector_field(State(*y))))
    times = np.linspace(0, 5, 5001)
    motion = solve_ivp(
        lambda t, y: field(y),
        (0, 5),
        walker.lift(jnp.asarray(x)),
        t_eval=times,
        rtol=1e-9,
        atol=1e-9,
    ).y
    h = motion[1] - 2 * motion[0]
    (strike, *_) = np.flatnonzero((h[:-1] < 0) & (h[1:] >= 0) & (motion[0, 1:] < 0))
    assert np.all(motion[2, : strike + 1] < 0)
    arrival = State(*jnp.asarray(motion[:, strike]))
    (_, lift), after = walker.impact(arrival)
    assert lift > 0 and walker.exchange_legs(after).thetadot > 0.1


# Running


def fast_starts(seed, count):
    """Walkers and starts so fast that many of them fly."""
    rng = np.random.default_rng(seed)
    walkers = a_family(RoundFootWalker, count, seed)
    theta, speed = rng.uniform(0.05, 0.6, count), rng.uniform(0.4, 1.4, count)
    return walkers, np.stack([theta, -speed, rng.uniform(-2, 2, count) * speed], axis=1)


def test_running_is_a_force_that_pulls_before_heel_strike():
    """By the free bodies' force of the ground, along the stride."""
    walkers, xs = fast_starts(7, 1000)
    found = strides(walkers, xs)

    def at_start(i):
        theta, thetadot, phidot = xs[i]
        _, force = Bodies(walkers[i]).motion(np.array([theta, 2 * theta, thetadot, phidot]))
        return force[1]

    runs = np.flatnonzero(found.outcome == Outcome.RUNNING)
    later = [i for i in runs if at_start(i) > 0][:5]
    assert len(later) >= 4 and len(runs) > 100
    for i in later[:2]:
        following, _, forces = Bodies(walkers[i]).stride(xs[i])
        assert following is not None and forces.min() < 0
    for i in np.flatnonzero(found.outcome == Outcome.STRIDE)[:2]:
        following, _, forces = Bodies(walkers[i]).stride(xs[i])
        assert following is not None and forces.min() > 0
    for i in np.flatnonzero(found.outcome != Outcome.OUTSIDE)[:100]:
        assert found.outcome[i] == Outcome.RUNNING or at_start(i) > 0


DIPS = (
    ((0.088, 0.866, 1.049, 0.351, 1, 0.859, -0.128, 0.013), (0.481, -0.815, -1.42)),
    ((0.105, 0.539, 1.053, 0.368, 1, 0.821, -0.13, 0.044), (0.514, -0.904, -1.572)),
    ((0.245, 0.52, 0.376, 0.352, 1, 0.372, -0.12, 0.179), (0.635, -0.383, -0.342)),
    ((0.101, 0.885, 1.093, 0.341, 1, 0.827, -0.137, 0.019), (0.482, -0.817, -1.409)),
    ((0.049, 0.753, 0.826, 0.375, 1, 0.855, -0.055, 0.047), (0.479, -0.857, -1.654)),
    ((0.087, 0.455, 1.031, 0.368, 1, 0.778, -0.121, 0.041), (0.476, -0.823, -1.44)),
    ((0.088, 0.882, 1.1, 0.355, 1, 0.871, -0.119, 0.0), (0.489, -0.821, -1.438)),
)
"""Walkers and starts from which the ground would have to pull in mid-stride alone."""


def test_running_is_found_where_mid_stride_alone_pulls():
    walkers = [RoundFootWalker(*values) for values, _ in DIPS]
    xs = np.array([x for _, x in DIPS])
    assert (strides(walkers, xs).outcome == Outcome.RUNNING).all()
    for walker, x in zip(walkers, xs, strict=True):
        _, _, forces = Bodies(walker).stride(x)
        assert min(forces[0], forces[-1]) > 0 > forces.min() and forces.argmin() > 100


class Weightless(RoundFootWalker):
    """One that the ground may pull at as well, and that no heel strike turns back."""

    def contact_force(self, state):
        return jnp.zeros_like(state.theta), jnp.ones_like(state.theta)

    def exchange_legs(self, state):
        following = super().exchange_legs(state)
        return following._replace(thetadot=-jnp.abs(following.thetadot))


@pytest.mark.slow
def test_running_is_found_by_brute_force_too():
    """From where it only starts or ends in tension, and where the force dips in between."""
    walkers, xs = fast_starts(8, 2000)
    rng = np.random.default_rng(10)
    for values, x in DIPS:
        for _ in range(60):
            changed = np.array(values) * rng.normal(1, 0.02, len(values))
            walkers.append(RoundFootWalker(*changed))
            xs = np.append(xs, (np.array(x) * rng.normal(1, 0.02, 3))[None], axis=0)
    found = strides(walkers, xs)
    glued = [Weightless(**vars(walker)) for walker in walkers]
    arrives = strides(glued, xs)
    lands = np.flatnonzero(arrives.outcome == Outcome.STRIDE)
    share = np.linspace(0, 1, 200)

    @jax.jit
    @jax.vmap
    def force(walker, x, time):
        path = wj.trajectory(walker, x, share * time)
        return jax.vmap(walker.contact_force)(path)[1]

    chosen = jax.tree.map(lambda leaf: leaf[lands], stacked(walkers))
    normal = np.asarray(force(chosen, xs[lands], arrives.time[lands]))
    least, ends = normal.min(axis=1), np.minimum(normal[:, 0], normal[:, -1])
    clear = np.abs(least) > 1e-3 * np.ptp(normal, axis=1)
    runs = found.outcome[lands] == Outcome.RUNNING
    np.testing.assert_array_equal(runs[clear], least[clear] < 0)
    kinds = Outcome.STRIDE, Outcome.RUNNING, Outcome.BACKWARD  # the last by the impact
    assert set(found.outcome[lands].tolist()) == set(kinds)
    walks = found.outcome[lands] == Outcome.STRIDE
    np.testing.assert_allclose(
        found.state[lands][walks], arrives.state[lands][walks], rtol=0, atol=1e-10
    )
    assert np.mean(clear) > 0.9
    dips = clear & (least < 0) & (ends > 0)
    assert dips.sum() >= 50


class PatientWalker(RoundFootWalker):
    """One watched to the end of every fall."""

    def past_contact(self, state):
        return state.theta > jnp.inf


@pytest.mark.slow
def test_no_outcome_depends_on_when_a_fall_is_given_up():
    count = 3000
    rng = np.random.default_rng(9)
    walkers = a_family(RoundFootWalker, count, 9)
    theta = rng.uniform(0.02, 0.7, count)
    sums, phidot = rng.uniform(-0.4, 0.1, count), rng.uniform(-0.6, 0.3, count)
    xs = np.stack([theta, sums - theta, phidot], axis=1)
    given_up = strides(walkers, xs)
    watched = strides([PatientWalker(**vars(walker)) for walker in walkers], xs)
    np.testing.assert_array_equal(given_up.outcome, watched.outcome)
    assert {Outcome.STRIDE, Outcome.FORWARD, Outcome.BACKWARD} <= set(given_up.outcome.tolist())
    np.testing.assert_allclose(given_up.state, watched.state, rtol=0, atol=1e-10)


ROCKING = {
    "slope": (0.02264938489109991, 0.005503582399388848, 0.04014859533270511),
    "hip_mass": (0.12831044801419733, 0.35514931261608473, 0.12496587102840406),
    "leg_mass": (0.5, 0.5, 0.5),
    "leg_inertia": (0.07426454266306473, 0.009078804468579471, 0.08752646038024421),
    "leg_length": (1.0, 1.0, 1.0),
    "com_from_hip": (0.594164672303009, 0.6971453413428059, 0.6679215046324196),
    "com_offset": (0.0, 0.0, 0.0),
    "foot_radius": (0.7857080063371362, 0.7650850908503968, 0.7909646877874522),
}
"""Walkers whose centre of mass is below the centre of their feet's arcs."""
SINKING = [
    [0.03580699069757498, -0.05420269374154335, 0.01746781533596363],
    [0.10666128746573629, -0.2096187743091732, -0.1440136112713943],
    [0.028859710781021057, -0.02278819883324394, -0.027294763442872634],
]


def test_a_leg_that_rocks_may_stop_after_the_other_foot_sank():
    walkers = [RoundFootWalker(*values) for values in zip(*ROCKING.values(), strict=True)]
    # By steps of 0.0004 that share no code with the package's events (benchmarks/small_steps.py).
    assert strides(walkers, SINKING).outcome.tolist() == [Outcome.BACKWARD] * 3


# Parameters


def test_a_launch_is_followed_to_the_end_of_its_fall():
    """The swing leg swings so fast, its foot below the ground, that it stops the stance leg."""
    walker = wj.PointFootWalker(0.028741, 0.789282)
    launch = np.array([-0.2532712826255108, -0.4475475949, -0.5318088083, 2.7522266076])
    legs = dict(leg_mass=walker.foot_mass, leg_length=1.0, com_from_hip=1.0, hip_mass=1.0)
    bodies = Bodies(SimpleNamespace(slope=walker.slope, **legs))
    rates = lambda t, y: np.concatenate([y[2:], bodies.motion(y)[0]])
    motion = solve_ivp(rates, (0, 0.6), launch, rtol=1e-9, atol=1e-9, max_step=0.005).y
    stopped = np.argmax(motion[2] >= 0)
    assert stopped > 0 and motion[0, stopped] > -1
    assert wj.stride(walker, launch).outcome == wj.Outcome.BACKWARD

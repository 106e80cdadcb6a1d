"""All walkers: limits of vanishing feet, and the laws of mechanics."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from by_differences import newton, strides
from hypothesis import given, settings
from planar_walkers import (
    CLASSES,
    GAIT,
    GAITS,
    GENERAL,
    MASSLESS,
    SLOW,
    cases,
    drawn,
    name,
    states,
    strikes,
)

import walker_jax as wj
from walker_jax import (
    KneedWalker,
    Outcome,
    PointFootWalker,
    RoundFootWalker,
    SimplestWalker,
    SpringWalker,
    State,
    UpperBodyWalker,
    multibody,
)
from walker_jax.multibody import System
from walker_jax.multibody.single_support import stance_coordinates
from walker_jax.walkers.masses import MultibodyWalker
from walker_jax.walkers.parameters import parameters

# Limits of vanishing foot mass

BETAS = 10.0 ** -np.arange(1, 7)


def assert_in_proportion(errors, tolerance=0.05):
    """Errors fall by ten from each beta to the next, but the largest two of BETAS."""
    assert (errors[-1] > 0).all() and (errors[-1] < errors[0]).all()
    ratios = errors[:-1] / errors[1:]
    np.testing.assert_allclose(ratios[1:], 10, rtol=0.15)
    np.testing.assert_allclose(ratios[2:], 10, rtol=tolerance)


def errors_of(general, simplest, at):
    """Largest differences over many states, for each beta and each quantity."""
    found = jax.jit(jax.vmap(jax.vmap(general, (None, 0)), (0, None)))(jnp.asarray(BETAS), at)
    expected = jax.vmap(simplest)(at)
    return np.max(np.abs(np.asarray(found) - np.asarray(expected)), axis=1)


def motion_and_contact_force(walker, state):
    """(7) and (8) are the limit of (4)."""
    rates = walker.vector_field(state)
    return jnp.stack([rates.thetadot, rates.phidot, *walker.contact_force(state)])


def impact_and_impulse(walker, state):
    """(18) and (19) are the limit of (17)."""
    foot, after = walker.impact(state)
    return jnp.stack([*foot, after.thetadot, after.phidot, *walker.impulse(state)])


@pytest.mark.parametrize(
    ("look", "at"), [(motion_and_contact_force, states), (impact_and_impulse, strikes)]
)
def test_motion_and_impact_have_the_limit_of_the_paper(look, at):
    general = lambda beta, state: look(PointFootWalker(0.03, beta), state)
    simplest = lambda state: look(SimplestWalker(0.03), state)
    assert_in_proportion(errors_of(general, simplest, at()))


@pytest.mark.slow
def test_gaits_and_multipliers_have_the_simplest_ones_as_limit():
    betas = BETAS[1:]
    gaits = [wj.find_gait(PointFootWalker(GAIT["slope"], beta), GAIT["state"]) for beta in betas]
    assert all(gait.found and gait.stable for gait in gaits)
    pairs = [[[m.real, m.imag] for m in np.asarray(gait.multipliers)] for gait in gaits]
    quantities = lambda state, time, pairs: [*state, time, *np.ravel(pairs)]
    found = [
        quantities(gait.states[0], gait.step_times[0], pair)
        for gait, pair in zip(gaits, pairs, strict=True)
    ]
    expected = quantities(GAIT["state"], GAIT["step_time"], GAIT["multipliers"])
    errors = np.abs(np.array(found) - expected)
    np.testing.assert_allclose(errors[:-1] / errors[1:], 10, rtol=0.2)
    np.testing.assert_allclose(errors[1:-1] / errors[2:], 10, rtol=0.02)
    assert np.all(errors[-1] < 2e-5)


def test_a_spring_is_the_limit_of_one_that_weakens_with_feet():
    """K = beta hip_stiffness, in (4); the ground and the impact do not feel it in the limit."""
    stiffness = 3.0

    def general(beta, state):
        plain = PointFootWalker(0.03, beta).system()
        torque = lambda q, qdot: -beta * stiffness * q * jnp.array([0.0, 0.0, 0.0, 1.0])
        system = System(plain.transfer, plain.masses, plain.forces, torque)
        q, qdot = stance_coordinates(list(state[:2])), stance_coordinates(list(state[2:]))
        motion = multibody.solve_motion(system, q, qdot, held=(0, 1))
        return jnp.concatenate([motion.accelerations[2:], motion.forces[:2]])

    def limit(state):
        walker = SpringWalker(0.03, stiffness)
        rates = walker.vector_field(state)
        return jnp.stack([rates.thetadot, rates.phidot, *walker.contact_force(state)])

    assert_in_proportion(errors_of(general, limit, states()))
    stiff, plain = SpringWalker(0.03, stiffness), SimplestWalker(0.03)
    for method in ("contact_force", "impact", "impulse"):
        found, expected = (jax.vmap(getattr(w, method))(strikes()) for w in (stiff, plain))
        np.testing.assert_array_equal(jax.tree.leaves(found), jax.tree.leaves(expected))
    faster = jax.vmap(stiff.vector_field)(states())
    slower = jax.vmap(plain.vector_field)(states())
    np.testing.assert_allclose(faster.phidot - slower.phidot, -3 * states().phi, atol=1e-14)
    np.testing.assert_array_equal(faster.thetadot, slower.thetadot)


def test_without_stiffness_the_spring_is_not_there():
    slack, plain = SpringWalker(0.03, 0.0), SimplestWalker(0.03)
    for method in ("vector_field", "contact_force", "past_contact"):
        found, expected = (jax.vmap(getattr(w, method))(states()) for w in (slack, plain))
        np.testing.assert_array_equal(jax.tree.leaves(found), jax.tree.leaves(expected))


@pytest.mark.slow
def test_without_stiffness_strides_are_the_simplest_walkers():
    rng = np.random.default_rng(0)
    theta = rng.uniform(0.01, 0.75, 500)
    xs = np.stack([theta, rng.uniform(-0.2, 0.05, 500) - theta], axis=1)
    slack = strides([SpringWalker(0.0165, 0.0)] * len(xs), xs)
    simplest = strides([SimplestWalker(0.0165)] * len(xs), xs)
    np.testing.assert_array_equal(slack.outcome, simplest.outcome)
    assert {Outcome.STRIDE, Outcome.FORWARD, Outcome.BACKWARD} <= set(slack.outcome.tolist())
    np.testing.assert_allclose(slack.state, simplest.state, rtol=0, atol=1e-13)
    np.testing.assert_allclose(slack.time, simplest.time, rtol=0, atol=1e-12)


@pytest.mark.slow
def test_a_spring_makes_steps_shorter_and_faster():
    """Kuo (2002)."""
    stiffness = np.array([0.0, 0.5, 1.0, 2.0])
    walkers = [SpringWalker(GAIT["slope"], k) for k in stiffness]
    x, times = np.array([GAIT["state"]]), []
    for walker in walkers:
        x, _ = newton(walker, x[0])
        times.append(strides([walker], x).time[0])
        assert np.abs(strides([walker], x).state - x).max() < 1e-11
    assert (np.diff(times) < -0.1).all()


# Laws of mechanics, for random walkers and states

FREE = [(-1.3, 1.3), (-1.3, 1.3), (-2, 2), (-2, 2)]
STRIKE = [(-1.3, -1e-3), (-2, 2), (-2, 2)]


def paper_transfer(q):
    """(1)."""
    u, v, theta, phi = q
    x = [u, v, u - jnp.sin(theta), v + jnp.cos(theta)]
    x += [u - jnp.sin(theta) + jnp.sin(theta - phi), v + jnp.cos(theta) - jnp.cos(theta - phi)]
    return jnp.stack(x)


def system_of(walker):
    if isinstance(walker, MultibodyWalker):
        return walker.system()
    masses = jnp.array([0.0, 0.0, 1.0, 1.0, 0.0, 0.0])
    down = jnp.stack([jnp.sin(walker.slope), -jnp.cos(walker.slope)])
    return System(paper_transfer, masses, masses * jnp.tile(down, 3))


def contact_point(walker, q):
    """Where the swing foot meets the ground: below the centre of its arc."""
    if not isinstance(walker, MultibodyWalker):
        return paper_transfer(q)[4:]
    radius = getattr(walker, "foot_radius", jnp.zeros(()))
    return walker.swing_foot(q) - jnp.stack([radius * (q[2] - q[3]), jnp.zeros(())])


def momenta(system, q, qdot, about):
    """Angular momentum about a point, of each point mass and each body that turns."""
    x, xdot = jax.jvp(system.transfer, (q,), (qdot,))
    points = 10 if len(x) == 14 else 6  # five of a walker with knees, three of the others
    arm, velocity = x[:points].reshape(-1, 2) - about, xdot[:points].reshape(-1, 2)
    cross = arm[:, 0] * velocity[:, 1] - arm[:, 1] * velocity[:, 0]
    return system.masses[:points:2] * cross, system.masses[points:] * xdot[points:]


@cache
def power(cls):
    """Of one kind of walker: rate of energy, and the sum of the sizes of its terms."""

    @jax.jit
    def look(values, state):
        walker, state = cls(*values), State(*state)
        system, rates = system_of(walker), walker.vector_field(state)
        q, qdot = stance_coordinates(list(state[:2])), stance_coordinates(list(state[2:]))
        qddot = stance_coordinates([rates.thetadot, rates.phidot])
        velocity = lambda q, qdot: multibody.velocity(system.transfer, q, qdot)
        xdot, xddot = jax.jvp(velocity, (q, qdot), (qdot, qddot))
        gain, work = system.masses * xdot * xddot, system.forces * xdot
        return jnp.sum(gain) - jnp.sum(work), jnp.sum(jnp.abs(gain) + jnp.abs(work))

    return lambda values, state: map(float, look(values, state))


@cache
def collision(cls):
    """Of one kind of walker: what heel strike changes, by name, before and after."""

    @jax.jit
    def look(values, strike):
        walker = cls(*values)
        theta, thetadot, phidot = strike
        state = State(theta, 2 * theta, thetadot, phidot)
        foot, after = walker.impact(state)
        system, q = system_of(walker), stance_coordinates(list(state[:2]))
        about = contact_point(walker, q)
        rates = (
            stance_coordinates(list(state[2:])),
            jnp.stack([*foot, after.thetadot, after.phidot]),
        )
        x = system.transfer(q)
        found = {"kinetic": [multibody.kinetic_energy(system, q, qdot) for qdot in rates]}
        whole = [momenta(system, q, qdot, about) for qdot in rates]
        found["whole"] = [jnp.sum(points) + jnp.sum(turns) for points, turns in whole]
        if cls is PointFootWalker:  # its trailing leg is the foot
            about_hip = [momenta(system, q, qdot, x[2:4]) for qdot in rates]
            found["trailing"] = [points[0] for points, _ in about_hip]
        elif cls is RoundFootWalker:
            about_hip = [momenta(system, q, qdot, x[:2]) for qdot in rates]
            found["trailing"] = [points[1] + turns[0] for points, turns in about_hip]
        elif cls is UpperBodyWalker:  # where it is not kept
            radius = walker.foot_radius
            straight = jnp.stack([-jnp.sin(theta), jnp.cos(theta)])
            hip = jnp.stack([-radius * theta, radius]) + (walker.leg_length - radius) * straight
            about_hip = [momenta(system, q, qdot, hip) for qdot in rates]
            found["of trailing leg"] = [points[1] + turns[0] for points, turns in about_hip]
        point = lambda q: contact_point(walker, q)
        slip = jax.jvp(point, (q,), (rates[1],))[1]
        # The material point of the foot there turns with the leg about the centre of its arc.
        radius = getattr(walker, "foot_radius", jnp.zeros(()))
        slip = slip + radius * (after.thetadot - after.phidot) * jnp.array([1.0, 0.0])
        found["slip"] = [slip[0], slip[1]]
        following = walker.exchange_legs(after)
        found["theta"] = [following.theta, -theta]
        again = walker.lift(walker.project(following))
        found["phi lifted"] = [following.phi, again.phi]
        found["phidot lifted"] = [following.phidot, again.phidot]
        expected = (1 - jnp.cos(2 * theta)) * following.thetadot
        found["phidot expected"] = [following.phidot, expected]
        speeds = jnp.abs(jnp.stack(rates)).max() * (1 + jnp.abs(system.masses).max())
        return found, speeds

    return lambda values, strike: jax.device_get(look(values, strike))


OTHERWISE = RoundFootWalker, UpperBodyWalker, KneedWalker
"""Compared with other equations in test_free_bodies.py and test_knee_mechanics.py: by default laws
are left to these."""
OF_LAWS = [pytest.param(cls, marks=[SLOW] * (cls in OTHERWISE)) for cls in CLASSES]


@pytest.mark.parametrize("cls", OF_LAWS, ids=name)
def test_no_power_is_gained_or_lost_during_a_stride(cls):
    """The motion conserves energy, as the ground does no work; a spring only on massless feet."""

    @settings(max_examples=30, deadline=None)
    @given(cases(cls), drawn(FREE))
    def check(values, state):
        gain, scale = power(cls)(values, state)
        assert abs(gain) <= 1e-11 * scale + 1e-14

    check()


@pytest.mark.parametrize("cls", OF_LAWS, ids=name)
def test_what_heel_strike_keeps_and_what_it_loses(cls):
    """Kinetic energy does not grow; angular momentum about the new contact point is kept.

    That of the trailing leg about the hip is kept too, where the hip is free to turn. Where a
    mechanism makes the upper body bisect the angle of the legs it is not, but for the whole. The
    new stance foot does not slip.
    """

    @settings(max_examples=30, deadline=None)
    @given(cases(cls), drawn(STRIKE))
    def check(values, strike):
        found, scale = collision(cls)(values, strike)
        before, after = found["kinetic"]
        assert after <= before * (1 + 1e-10) + 1e-20
        kept = ["whole", "theta", "phi lifted"] + ["trailing"] * ("trailing" in found)
        if "phidot" not in cls.section:
            kept += ["phidot lifted", "phidot expected"]
        for key in kept:
            before, after = found[key]
            assert abs(after - before) <= 1e-9 * scale + 1e-15, key
        assert np.abs(found["slip"]).max() <= 1e-9 * scale + 1e-15

    check()


@pytest.mark.slow
def test_an_upper_body_takes_momentum_from_the_trailing_leg():
    """The bisecting hip is a mechanism between body and legs: only the whole is conserved."""
    values = [parameter.default for parameter in parameters(UpperBodyWalker)[1:]]
    found, _ = collision(UpperBodyWalker)((0.01, *values), (-0.2, -0.3, 0.1))
    before, after = found["of trailing leg"]
    assert abs(after - before) > 0.01 * abs(before)
    before, after = found["whole"]
    assert after == pytest.approx(before, rel=1e-13)


@pytest.mark.slow
@pytest.mark.parametrize("cls", [*MASSLESS, *GENERAL], ids=name)
def test_energy_is_conserved_along_a_stride(cls):
    walker, x, time = GAITS[cls]
    path = wj.trajectory(walker, np.array(x), np.linspace(0, time, 30))
    if cls is KneedWalker:  # a State has no knee: the straight leg's energy, after knee strike
        path = State(*(getattr(path, one)[path.knee == 0][1:] for one in State._fields))
    if issubclass(cls, MultibodyWalker):
        energy = jax.jit(jax.vmap(walker.energy))(path)
    else:
        energy = path.thetadot**2 / 2 + np.cos(path.theta - walker.slope)
    assert np.ptp(energy) < 2e-11 * np.mean(energy)
    assert path.theta[-1] < 0 and np.ptp(path.phi) > 0.5

"""All walkers: limits, laws of mechanics, an independent solution, and gaits that others found."""

from functools import cache
from types import SimpleNamespace
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from by_differences import composite, differences, newton, stacked, strides
from hypothesis import given, settings
from hypothesis import strategies as st
from reference import read_values
from scipy.integrate import solve_ivp

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
from walker_jax.gaits.derivatives import linearise
from walker_jax.integrators.integrator import Integrator
from walker_jax.kernels.program import programs
from walker_jax.kernels.scalars import unroll
from walker_jax.multibody import System
from walker_jax.multibody.single_support import stance_coordinates
from walker_jax.walkers.family import PLANAR_WALKERS
from walker_jax.walkers.masses import MultibodyWalker
from walker_jax.walkers.parameters import parameters

VALUES = read_values("values")
GAIT = VALUES["gaits"][0]  # of the simplest walker: long, slope 0.009
FINITE = {gait["name"]: gait for gait in VALUES["finite_mass"]}
PUBLISHED = read_values("published_gaits")

CLASSES = tuple(cls for cls in PLANAR_WALKERS.values() if not cls.__name__.startswith("Powered"))
"""Walkers without motors; those with motors have tests of their own (test_powered.py)."""
MASSLESS = SimplestWalker, SpringWalker
GENERAL = PointFootWalker, RoundFootWalker, UpperBodyWalker
SLOW = pytest.mark.slow
name = lambda cls: cls.__name__

GAITS = {
    SimplestWalker: (SimplestWalker(0.009), GAIT["state"], GAIT["step_time"]),
    SpringWalker: (SpringWalker(0.009, 2.0), [0.15, -0.16], 2.2),
    PointFootWalker: (PointFootWalker(0.009, 1e-3), [0.200161, -0.199906], 3.88),
    RoundFootWalker: (RoundFootWalker(0.01, leg_length=1.2), [0.18944, -0.23901, -0.0514], 2.428),
    UpperBodyWalker: (UpperBodyWalker(0.01), [0.196, -0.2434, -0.033], 2.36),
    KneedWalker: (KneedWalker(0.05), [0.23793, -0.35396, -0.33328], 1.77),
}
"""A walker of each kind, a start close to a gait of it, and about how long a stride then takes."""


def states(count=40):
    """States of all kinds, also fast and steep ones."""
    rng = np.random.default_rng(1)
    many = [*rng.uniform(-1.3, 1.3, (2, count)), *rng.uniform(-1.5, 1.5, (2, count))]
    return State(*map(jnp.asarray, many))


def strikes(count=40):
    """States at heel strike: phi = 2 theta, theta and thetadot negative."""
    rng = np.random.default_rng(2)
    theta, thetadot = rng.uniform(-1.2, -0.01, count), rng.uniform(-1.5, -0.01, count)
    phidot = rng.uniform(-2, 2, count)
    return State(*map(jnp.asarray, (theta, 2 * theta, thetadot, phidot)))


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


def test_motion_and_contact_force_have_the_limit_of_the_paper():
    """(7) and (8) from (4)."""

    def look(walker, state):
        rates = walker.vector_field(state)
        return jnp.stack([rates.thetadot, rates.phidot, *walker.contact_force(state)])

    general = lambda beta, state: look(PointFootWalker(0.03, beta), state)
    simplest = lambda state: look(SimplestWalker(0.03), state)
    assert_in_proportion(errors_of(general, simplest, states()))


def test_impact_and_impulse_have_the_limit_of_the_paper():
    """(18) and (19) from (17)."""

    def look(walker, state):
        foot, after = walker.impact(state)
        return jnp.stack([*foot, after.thetadot, after.phidot, *walker.impulse(state)])

    general = lambda beta, state: look(PointFootWalker(0.03, beta), state)
    simplest = lambda state: look(SimplestWalker(0.03), state)
    assert_in_proportion(errors_of(general, simplest, strikes()))


@pytest.mark.slow
def test_gaits_and_multipliers_have_those_of_the_simplest_walker_as_limit():
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


def test_a_spring_is_the_limit_of_one_that_weakens_with_the_feet():
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
def test_without_stiffness_strides_are_those_of_the_simplest_walker():
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

RANGES = {
    "slope": (1e-3, 0.3),
    "hip_stiffness": (0, 20),
    "foot_mass": (1e-4, 10),
    "hip_mass": (0, 10),
    "leg_mass": (0.05, 10),
    "leg_inertia": (1e-3, 2),
    "leg_length": (0.5, 2),
    "com_from_hip": (-0.5, 1.5),
    "com_offset": (-0.3, 0.3),
    "foot_radius": (0, 0.45),
    "body_mass": (0.01, 10),
    "body_inertia": (0, 2),
    "body_com": (-0.5, 1),
    "thigh_mass": (0.05, 10),
    "shank_mass": (0.05, 10),
    "thigh_length": (0.3, 1),
    "shank_length": (0.3, 1),
    "thigh_com": (-0.2, 0.8),
    "shank_com": (-0.2, 0.8),
    "thigh_inertia": (1e-3, 1),
    "shank_inertia": (1e-3, 1),
}
FREE = [(-1.3, 1.3), (-1.3, 1.3), (-2, 2), (-2, 2)]
STRIKE = [(-1.3, -1e-3), (-2, 2), (-2, 2)]


def drawn(ranges):
    return st.tuples(*(st.floats(*ends, allow_subnormal=False) for ends in ranges))


def cases(cls):
    return drawn(RANGES[parameter.name] for parameter in parameters(cls))


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
"""Compared with other equations below and in test_knees.py: by default laws are left to these."""
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


# An independent solution: each leg and the upper body a free body, held by forces at its joints


class Bodies:
    """A walker with round feet, and an upper body or a mass at the hip, as three bodies.

    Their coordinates are (x, y, angle), each. Joints and the ground are constraints, whose forces
    are unknowns besides the accelerations.
    """

    def __init__(self, walker):
        self.walker = walker
        get = lambda name, otherwise=0.0: float(getattr(walker, name, otherwise))
        self.slope, self.radius, self.length = (
            get("slope"),
            get("foot_radius"),
            get("leg_length"),
        )
        self.down, self.offset, self.body_com = (
            get("com_from_hip"),
            get("com_offset"),
            get("body_com"),
        )
        self.upper = isinstance(walker, UpperBodyWalker)
        leg = [get("leg_mass"), get("leg_mass"), get("leg_inertia")]
        body = get("body_mass") if self.upper else get("hip_mass")
        inertia = get("body_inertia") if self.upper else 1.0  # of what does not turn otherwise
        self.masses = np.array([*leg, *leg, body, body, inertia])
        pull = np.array([np.sin(self.slope), -np.cos(self.slope), 0.0])
        self.gravity = self.masses * np.tile(pull, 3)

    def place(self, angles, body, up, forward):
        """Rows of the derivative of a point of a body, and its acceleration at constant rates.

        The point is `up` from the centre of mass along the leg or trunk, and `forward` across.
        """
        s, c = np.sin(angles[body]), np.cos(angles[body])
        along, across = np.array([-s, c]), np.array([c, s])
        rows = np.zeros((2, 9))
        rows[0, 3 * body], rows[1, 3 * body + 1] = 1, 1
        rows[:, 3 * body + 2] = -up * across + forward * along
        return rows, -up * along - forward * across

    def constraints(self, state, foot):
        """Rows that take the bodies' rates to zero, and what velocities add to accelerations."""
        theta, phi, thetadot, phidot = state
        angles = [theta, theta - phi, theta - phi / 2]
        rates = np.array([thetadot, thetadot - phidot, thetadot - phidot / 2])
        rows, extra = [], []
        hip, bend = self.place(angles, 0, self.down, -self.offset)
        for body, up, forward in ((1, self.down, -self.offset), (2, -self.body_com, 0.0)):
            other, turn = self.place(angles, body, up, forward)
            rows.append(hip - other)
            extra.append(bend * rates[0] ** 2 - turn * rates[body] ** 2)
        if self.upper:
            bisects = np.zeros((1, 9))
            bisects[0, [2, 5, 8]] = 0.5, 0.5, -1
            rows.append(bisects)
            extra.append(np.zeros(1))
        # The arc's centre moves with the foot's rolling, and the sole below it is at rest.
        to_centre = self.down - (self.length - self.radius)
        sole, bend = self.place(angles, foot, to_centre, -self.offset)
        sole[0, 3 * foot + 2] += self.radius
        rows.append(sole)
        extra.append(bend * rates[foot] ** 2)
        return np.concatenate(rows), np.concatenate(extra)

    def solve(self, rows, right, zero):
        """M a - rows^T forces = right, rows a = zero."""
        n = len(rows)
        matrix = np.block([[np.diag(self.masses), -rows.T], [rows, np.zeros((n, n))]])
        solution = np.linalg.solve(matrix, np.concatenate([right, zero]))
        return solution[:9], solution[9:]

    def motion(self, state):
        """Accelerations of theta and phi, and the force of the ground."""
        rows, extra = self.constraints(state, 0)
        accelerations, forces = self.solve(rows, self.gravity, -extra)
        first, second = accelerations[2], accelerations[5]
        return np.array([first, first - second]), forces[-2:]

    def velocities(self, state):
        """Of all bodies, with the stance foot on the ground: the only ones that the joints let."""
        _, _, thetadot, phidot = state
        rows, _ = self.constraints(state, 0)
        turns = np.zeros((2, 9))
        turns[0, 2], turns[1, 5] = 1, 1
        if not self.upper:
            turns = np.concatenate([turns, np.eye(9)[8:]])
        right = np.zeros(9)
        right[len(rows) :][:2] = thetadot, thetadot - phidot
        return np.linalg.solve(np.concatenate([rows, turns]), right)

    def impact(self, state):
        """The state after heel strike, legs not yet exchanged, and the trailing sole's velocity."""
        rows, _ = self.constraints(state, 1)
        before = self.velocities(state)
        after, _ = self.solve(rows, self.masses * before, np.zeros(len(rows)))
        old, _ = self.constraints(state, 0)
        rates = after[2], after[2] - after[5]
        return np.array([state[0], state[1], *rates]), (old @ after)[-2:]

    def stride(self, x):
        """Next state on the section, time, and normal forces until heel strike."""
        theta, thetadot, phidot = x
        start = np.array([theta, 2 * theta, thetadot, phidot])

        def rates(t, y):
            return np.concatenate([y[2:], self.motion(y)[0]])

        def strike(t, y):
            return y[1] - 2 * y[0]

        def stands(t, y):
            return y[2]

        def down(t, y):
            return y[0] + np.pi / 2

        strike.direction = 1
        stands.terminal = down.terminal = True
        solution = solve_ivp(
            rates,
            (0, 12),
            start,
            method="DOP853",
            rtol=1e-12,
            atol=1e-14,
            dense_output=True,
            max_step=0.05,
            events=[strike, stands, down],
        )
        ahead = [t for t in solution.t_events[0] if t > 1e-3 and solution.sol(t)[0] < 0]
        if not ahead:
            return None, np.nan, np.array([])
        time = ahead[0]
        times = np.linspace(0, time, 200)
        forces = np.array([self.motion(solution.sol(t))[1][1] for t in times])
        (angle, _, stance, relative), _ = self.impact(solution.sol(time))
        return np.array([-angle, stance - relative, -relative]), time, forces


def a_family(cls, count, seed):
    """Walkers of random parameters, with none far from those that walk."""
    rng = np.random.default_rng(seed)
    near = dict(leg_length=1.2, slope=0.02)
    walkers = []
    for _ in range(count):
        values = {}
        for parameter in parameters(cls):
            value = near.get(parameter.name, parameter.default)
            spread = 0.05 if value == 0 else 0.3 * value
            low = 0.0 if parameter.low == 0 else -np.inf
            values[parameter.name] = max(low, value + spread * rng.uniform(-1, 1))
        walkers.append(cls(**values))
    return walkers


INDEPENDENT = [RoundFootWalker, pytest.param(UpperBodyWalker, marks=SLOW)]


@pytest.mark.parametrize("cls", [RoundFootWalker, UpperBodyWalker], ids=name)
def test_equations_are_those_of_free_bodies_held_at_their_joints(cls):
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


class Uneven(wj.HeavyLegWalker):
    """A walker whose swing leg is longer than its stance leg."""

    slope: jax.Array
    longer: jax.Array

    def system(self):
        return RoundFootWalker(self.slope).system()

    def swing_foot(self, q):
        hip = q[:2] + jnp.stack([-jnp.sin(q[2]), jnp.cos(q[2])])
        swing = q[2] - q[3]
        return hip - (1 + self.longer) * jnp.stack([-jnp.sin(swing), jnp.cos(swing)])


def test_legs_that_are_not_alike_are_refused():
    assert Uneven(jnp.asarray(0.01), jnp.asarray(0.0)).longer == 0
    with pytest.raises(ValueError, match="swing_foot of Uneven must be on the slope"):
        Uneven(jnp.asarray(0.01), jnp.asarray(0.01))
    slope, longer = jnp.asarray(0.01), jnp.asarray(0.0)
    assert jax.jit(lambda a: a * Uneven(slope, longer).slope)(2.0) == 0.02
    assert jax.jit(lambda a: a * RoundFootWalker(slope).slope)(2.0) == 0.02


@pytest.mark.parametrize(
    ("walker", "named"),
    [
        (RoundFootWalker(0.01), None),
        (jax.vmap(RoundFootWalker)(jnp.array([0.01, 0.02, 0.03])), None),
        (jax.vmap(RoundFootWalker)(jnp.array([0.01, 0.02])), r"slope .*3, not of shape \(2,\)"),
        (jax.vmap(RoundFootWalker)(jnp.array([0.01, -0.02, 0.03])), r"slope .*-0.02"),
        (jax.vmap(RoundFootWalker)(jnp.array([0.01, jnp.nan, 0.03])), r"slope .*nan"),
    ],
)
def test_parameters_that_are_arrays_are_checked(walker, named):
    xs = np.tile(GAITS[RoundFootWalker][1], (3, 1))
    if named is None:
        assert wj.strides(walker, xs).outcome.shape == (3,)
        return
    with pytest.raises(ValueError, match=named):
        wj.strides(walker, xs)


# Gaits that others found


def test_the_reference_gait_on_round_feet():
    """There the leg's length is that to the arc's centre."""
    value = FINITE["round feet"]
    names = [parameter.name for parameter in parameters(RoundFootWalker)]
    settings = {name: value[name] for name in names}
    settings["leg_length"] += settings["foot_radius"]
    state = value["state"]
    expected = [state["theta"], state["thetadot"], state["phidot"]]
    walker = RoundFootWalker(**settings)
    (x,), multipliers = newton(walker, expected)
    np.testing.assert_allclose(x, expected, rtol=0, atol=1e-9)
    assert state["phi"] == pytest.approx(float(walker.lift(jnp.array(x)).phi), abs=1e-9)
    known = np.array(value["multipliers"]) @ [1, 1j]
    np.testing.assert_allclose(multipliers, known, rtol=0, atol=1e-5)
    time = strides([walker], [expected]).time[0]
    assert time == pytest.approx(value["step_time"], abs=1e-9)


@pytest.mark.slow
def test_the_reference_gait_on_point_feet():
    """With a hip of 1000 times the mass of a foot."""
    value = FINITE["point feet"]
    walker = PointFootWalker(value["slope"], value["leg_mass"] / value["hip_mass"])
    state = value["state"]
    gait = wj.find_gait(walker, [state["theta"], state["thetadot"]])
    assert gait.found and gait.stable
    full = walker.lift(jnp.asarray(gait.states[0]))
    np.testing.assert_allclose(full, [state[key] for key in State._fields], rtol=0, atol=1e-9)


def published_walker(entry, slope=None):
    if slope is None:
        slope = entry["slope"] if "slope" in entry else np.deg2rad(entry["slope_degrees"])
    return RoundFootWalker(slope=slope, **PUBLISHED["walkers"][entry["walker"]])


def on_section(entry, slope):
    """Of the published state; the leg is of length 1, so times are in 1 / sqrt(gravity)."""
    state, unit = entry["state"], np.sqrt(entry["gravity"])
    tilt = slope if entry["convention"] == "vertical" else 0.0
    theta, thetadot = state["stance"] + tilt, state["stance_rate"]
    if entry["convention"] == "relative":
        return np.array([theta, thetadot / unit, -state["relative_rate"] / unit])
    assert state["swing"] + tilt == pytest.approx(-theta, abs=entry["accuracy"])
    return np.array([theta, thetadot / unit, (thetadot - state["swing_rate"]) / unit])


@pytest.mark.parametrize("entry", PUBLISHED["gaits"], ids=lambda entry: entry["name"])
def test_published_gaits(entry):
    """States to what is printed of them, or where that is more, to what they repeat themselves."""
    walker = published_walker(entry)
    printed = on_section(entry, float(walker.slope))
    period, unit = entry["period"], np.sqrt(entry["gravity"])
    (x,), multipliers = newton(walker, printed, period, step=1e-5 if period > 1 else 1e-4)
    np.testing.assert_allclose(x, printed, rtol=0, atol=entry["accuracy"])
    assert np.abs(multipliers[0]) < 1
    for fewer in range(1, period):
        after, _ = composite([walker], x[None], fewer)
        assert np.abs(after - x).max() > 1e-4
    ends, time = composite([walker], x[None], period)
    np.testing.assert_allclose(ends[0], x, rtol=0, atol=1e-11)
    if "multipliers" in entry:
        known = np.array(entry["multipliers"]) @ [1, 1j]
        np.testing.assert_allclose(multipliers, known, rtol=0, atol=2e-4)
        assert time[0] / unit == pytest.approx(entry["step_time"], abs=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("slope, radius, size", [(0.07, 0.25, 0.547), (0.09, 0.4, 0.534)])
def test_gaits_on_large_feet_and_steep_slopes_are_found_without_a_guess(slope, radius, size):
    """Legs like those of the default walker with knees: its largest multiplier follows from a
    branch over the radius (docs/results.md)."""
    legs = {"leg_mass": 1.1, "leg_inertia": 0.09 / 11, "com_from_hip": 0.3875 / 1.1}
    walker = RoundFootWalker(slope, **legs, foot_radius=radius)
    gait = wj.find_gait(walker)
    assert gait.found and gait.stable
    first = walker.gait_region()  # where it is looked for at first
    assert not first.contains(np.asarray(gait.states)).any()
    assert np.abs(gait.multipliers).max() == pytest.approx(size, abs=5e-4)


@pytest.mark.parametrize(
    ("slope", "radius", "state"),
    [
        (0.02, 0.75, [0.8713, -0.74, -0.3896]),
        (0.09, 0.6, [0.9934, -0.8114, -0.8536]),
        (0.15, 0.6, [1.3768, -0.9814, -1.2519]),
    ],
)
def test_the_further_region_holds_the_long_steps_of_large_feet(slope, radius, state):
    """States of attractors that direct iteration finds over the whole section."""
    walker = RoundFootWalker(slope, foot_radius=radius)
    states, multipliers = newton(walker, state)
    assert np.abs(multipliers).max() < 1 and np.abs(states - np.array(state)).max() < 1e-3
    assert walker.further_gait_region().contains(states).all()


def test_mcgeers_totter_mode_is_unstable_on_point_feet_alone():
    """For steps of the same length."""
    read, leg = PUBLISHED["totter_mode"], PUBLISHED["walkers"]["McGeer"]
    cases = {0.3: (0.02785469, -0.11384), 0.12: (0.0528190, -0.16691), 0.0: (0.0778149, -0.20775)}
    sizes = []
    for radius, (slope, phidot) in cases.items():
        walker = RoundFootWalker(slope=slope, **(leg | {"foot_radius": radius}))
        (x,), multipliers = newton(walker, [0.3, -0.39 + 0.05 * (0.3 - radius), phidot])
        assert x[0] == pytest.approx(read["theta"], abs=1e-5)
        sizes.append(np.abs(multipliers))
        if radius == read["foot_radius"]:
            _, time = composite([walker], x[None], 1)
            assert (slope, time[0]) == pytest.approx((read["slope"], read["step_time"]), rel=0.1)
    assert sizes[0][0] < 0.5 < sizes[1][0] < 1 < 2.5 < sizes[2][0]  # the totter mode
    assert np.max(sizes, axis=0)[1] < 0.4  # the others


def compass_multipliers(degrees, state, period):
    entry = PUBLISHED["gaits"][1]
    walker = published_walker(entry, np.deg2rad(degrees))
    return newton(walker, state, period, step=2e-5)


def doubling(around, state, period):
    """The slope (degrees) at which a gait's multiplier passes -1, by secants."""
    low, high = around
    values = []
    for slope in (low, high):
        (state,), multipliers = compass_multipliers(slope, state, period)
        values.append(multipliers[0].real + 1)
    assert values[0] > 0 > values[1]
    for _ in range(4):
        slope = low + (high - low) * values[0] / (values[0] - values[1])
        (state,), multipliers = compass_multipliers(slope, state, period)
        value = multipliers[0].real + 1
        low, high, values = (
            (slope, high, [value, values[1]]) if value > 0 else (low, slope, [values[0], value])
        )
    return slope


def test_period_doublings_of_the_compass_gait():
    """4.391 degrees, of which Goswami, Thuilot and Espiau (1996) print 4.37; and 4.9."""
    by_name = {entry["name"]: entry for entry in PUBLISHED["gaits"]}
    known = PUBLISHED["compass_gait"]
    entry = by_name["compass gait, 4 deg"]
    first = doubling((4.3, 4.45), on_section(entry, np.deg2rad(4.0)), 1)
    assert first == pytest.approx(known["first_doubling_degrees"], abs=0.03)
    assert first == pytest.approx(4.3909, abs=1e-4)
    entry = by_name["compass gait of period two, 4.75 deg"]
    second = doubling((4.8, 4.95), on_section(entry, np.deg2rad(4.75)), 2)
    assert second == pytest.approx(known["second_doubling_degrees"], abs=0.05)


def test_multipliers_of_the_compass_gait():
    """Printed for two steps, from differences."""
    known, entry = PUBLISHED["compass_gait"], PUBLISHED["gaits"][1]
    slope = known["multipliers_slope_degrees"]
    _, multipliers = compass_multipliers(slope, on_section(entry, np.deg2rad(slope)), 2)
    sizes = known["multiplier_sizes_of_two_steps"]
    np.testing.assert_allclose(np.abs(multipliers), sizes, rtol=0, atol=5e-3)


# Derivatives

TOLERANCE = jnp.asarray(np.float64(1e-12))  # of a type as in gaits, which compiles it once


def derivative_cases():
    points = {
        SpringWalker: (SpringWalker(0.009, 0.5), [0.19, -0.19]),
        PointFootWalker: (PointFootWalker(0.009, 0.01), [0.2, -0.2]),
        RoundFootWalker: (RoundFootWalker(0.01, leg_length=1.2), [0.189, -0.239, -0.0514]),
        UpperBodyWalker: (
            UpperBodyWalker(0.01, body_inertia=0.01),
            [0.196, -0.2434, -0.033],
        ),
    }
    fast = {PointFootWalker}
    return [
        pytest.param(*point, marks=() if cls in fast else SLOW, id=cls.__name__)
        for cls, point in points.items()
    ]


@pytest.mark.parametrize(("walker", "x"), derivative_cases())
def test_derivatives_equal_extrapolated_differences(walker, x):
    """Of the next state, by the start and by every parameter, to the largest of a row."""
    names = [parameter.name for parameter in parameters(walker)]
    values = np.array([float(getattr(walker, name)) for name in names])
    cycle = np.array([[x]])
    found = [linearise(walker, cycle, Integrator(TOLERANCE), name) for name in names]
    jacobian = np.concatenate(
        [found[0].jacobian[0, 0], np.stack([each.by_parameter[0, 0] for each in found], axis=1)],
        axis=1,
    )

    def following(zs):
        many = [type(walker)(*z[len(x) :]) for z in zs]
        return linearise(stacked(many), zs[:, None, : len(x)], Integrator(TOLERANCE)).state[:, 0]

    steps = 4e-4 * np.concatenate([np.ones(len(x)), np.maximum(values, 0.25)])
    steps[len(x) + np.flatnonzero(np.isin(names, ["slope", "foot_mass"]))] = 1e-4
    expected = differences(following, np.concatenate([x, values]), steps)
    assert np.isfinite(jacobian).all()
    errors = np.abs(jacobian - expected) / np.max(np.abs(expected), axis=1, keepdims=True)
    assert np.max(errors) < 1e-7, (jacobian, expected)


# A walker of one's own: the rimless wheel


class RimlessWheel(wj.Walker):
    """Spokes of a wheel of mass 1, alpha on either side of the upright: phi stays -2 alpha."""

    slope: jax.Array
    alpha: jax.Array
    inertia: jax.Array
    section: ClassVar = ("thetadot",)

    def system(self):
        """The hub and the wheel's angle, of (u, v, theta, ...)."""

        def transfer(q):
            return jnp.stack([q[0] - jnp.sin(q[2]), q[1] + jnp.cos(q[2]), q[2]])

        mass = jnp.ones_like(self.inertia)
        weight = [jnp.sin(self.slope), -jnp.cos(self.slope), jnp.zeros_like(mass)]
        return System(transfer, jnp.stack([mass, mass, self.inertia]), jnp.stack(weight))

    def motion(self, state):
        """Accelerations and forces with u, v and the spokes held."""

        def solve(wheel, q, qdot):
            return multibody.solve_motion(
                wheel.system(), stance_coordinates(q), stance_coordinates(qdot), held=(0, 1, 3)
            )

        return unroll(solve)(self, list(state[:2]), list(state[2:]))

    def lift(self, x):
        return State(self.alpha, -2 * self.alpha, x[0], jnp.zeros_like(x[0]))

    def project(self, state):
        return jnp.stack([state.thetadot])

    def feasible(self, x):
        return x[0] < 0

    def gait_region(self):
        return wj.Grid.plain(thetadot=(-1, 0, 50))

    def vector_field(self, state):
        acceleration = self.motion(state).accelerations[2]
        return State(state.thetadot, state.phidot, acceleration, jnp.zeros_like(state.phi))

    def contact_force(self, state):
        forces = self.motion(state).forces
        return forces[0], forces[1]

    def past_contact(self, state):
        return state.phi > 2 * state.theta

    def clearance(self, state):
        return jnp.cos(state.theta) - jnp.cos(state.theta - state.phi)

    def reach(self, state):
        return jnp.sin(state.theta - state.phi) - jnp.sin(state.theta)

    def impact(self, state):
        def spoke(q):
            feet = [jnp.sin(q[2] - state.phi) - jnp.sin(q[2])]
            return q[:2] + jnp.stack([*feet, jnp.cos(q[2]) - jnp.cos(q[2] - state.phi)])

        q, qdot = (stance_coordinates([a, a])[:3] for a in (state.theta, state.thetadot))
        u, v, thetadot = multibody.impact(self.system(), spoke, q, qdot).velocities
        return (u, v), State(state.theta, state.phi, thetadot, jnp.zeros_like(thetadot))


def wheel(slope, alpha, inertia):
    return RimlessWheel(*(jnp.asarray(value, float) for value in (slope, alpha, inertia)))


def test_the_rimless_wheel_has_its_closed_return_map():
    """thetadot -> -eta sqrt(thetadot^2 + 4 sin(alpha) sin(slope) / (1 + I)), from energy and (17).

    eta = (I + cos 2 alpha) / (I + 1); with eta^2 as multiplier everywhere on thetadot^2. Slower
    than the dead point it rolls back, and faster than 1 g holds it flies.
    """
    known = PUBLISHED["rimless_wheel"]
    wheels = {
        "hub": (0.2, np.pi / 8, 0.01),  # of a point alone, nothing keeps the spokes from turning
        "published": (known["slope"], np.pi / known["spokes"], known["inertia"]),
        "rim": (0.1, 0.3, 1.0),
    }
    rates = -np.linspace(0.02, 1.1, 40)
    walkers = [wheel(*values) for values in wheels.values() for _ in rates]
    found = strides(walkers, np.tile(rates, len(wheels))[:, None])
    outcomes = found.outcome.reshape(len(wheels), -1)
    states = found.state.reshape(len(wheels), -1)
    for (slope, alpha, inertia), outcome, state in zip(
        wheels.values(), outcomes, states, strict=True
    ):
        eta, gain = (inertia + np.cos(2 * alpha)) / (inertia + 1), 4 * np.sin(alpha)
        gain *= np.sin(slope) / (1 + inertia)
        expected = -eta * np.sqrt(rates**2 + gain)
        needed = 2 * (1 - np.cos(alpha - slope)) / (1 + inertia)
        np.testing.assert_array_equal(outcome == Outcome.BACKWARD, rates**2 < needed)
        walks = outcome == Outcome.STRIDE
        assert walks.sum() > 8 and set(outcome) == {0, 2, 3}
        np.testing.assert_allclose(state[walks], expected[walks], rtol=1e-11)
        start = np.array([-eta * np.sqrt(gain / (1 - eta**2))])
        (x,), multipliers = newton(wheel(slope, alpha, inertia), start * 1.02)
        np.testing.assert_allclose(x, start, rtol=0, atol=1e-11)
        np.testing.assert_allclose(multipliers, [eta**2], rtol=0, atol=1e-8)
    assert known["multiplier"] == pytest.approx(((0.5 + 0.5) / 1.5) ** 2, abs=1e-15)
    published = strides([wheel(*wheels["published"])], [[known["thetadot"]]])
    assert published.state[0, 0] == pytest.approx(known["thetadot"], abs=1e-12)


# Running


def fast_starts(seed, count):
    """Walkers and starts so fast that many of them fly."""
    rng = np.random.default_rng(seed)
    walkers = a_family(RoundFootWalker, count, seed)
    theta, speed = rng.uniform(0.05, 0.6, count), rng.uniform(0.4, 1.4, count)
    return walkers, np.stack([theta, -speed, rng.uniform(-2, 2, count) * speed], axis=1)


def test_running_is_a_force_that_pulls_at_any_time_before_heel_strike():
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
    for i in np.flatnonzero(found.outcome != Outcome.OUTSIDE):
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


def test_running_is_found_where_the_ground_pulls_in_mid_stride_alone():
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


class WatchedWalker(SimplestWalker):
    """The simplest walker, with its force looked at all along."""

    force_least_at_ends: ClassVar = False


class PatientWalker(RoundFootWalker):
    """One watched to the end of every fall."""

    def past_contact(self, state):
        return state.theta > jnp.inf


@pytest.mark.slow
def test_a_force_least_at_its_ends_is_as_well_looked_at_all_along():
    theta, thetadot = np.meshgrid(np.linspace(0.005, 0.78, 40), np.linspace(-1.19, -0.01, 50))
    xs = np.stack([theta.ravel(), thetadot.ravel()], axis=1)
    plain, watched = (wj.strides(cls(0.0165), xs) for cls in (SimplestWalker, WatchedWalker))
    np.testing.assert_array_equal(plain.outcome, watched.outcome)
    assert {0, 1, 2, 3} <= set(plain.outcome.tolist())
    np.testing.assert_allclose(plain.state, watched.state, rtol=0, atol=1e-12)
    np.testing.assert_allclose(plain.time, watched.time, rtol=0, atol=1e-12)


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


def test_a_leg_that_rocks_on_its_foot_may_stop_after_the_other_foot_has_sunk():
    walkers = [RoundFootWalker(*values) for values in zip(*ROCKING.values(), strict=True)]
    # By steps of 0.0004 that share no code with the package's events (benchmarks/small_steps.py).
    assert strides(walkers, SINKING).outcome.tolist() == [Outcome.BACKWARD] * 3


# One by one, many, and many walkers


@pytest.mark.slow
@pytest.mark.parametrize("cls", [SpringWalker, RoundFootWalker, UpperBodyWalker], ids=name)
def test_a_stride_is_the_same_alone_and_among_other_walkers(cls):
    """Parameters are numbers, or arrays with one for each start."""
    walker, x, _ = GAITS[cls]
    scales = np.array([1.0, 1.02, 0.6, 1.6, -1.0])
    xs = np.array(x) * np.stack([np.ones(5), *[scales] * (len(x) - 1)], axis=1)
    walkers = [walker, cls(0.02), walker, cls(0.015), walker]
    among = strides(walkers, xs)
    assert {Outcome.STRIDE, Outcome.OUTSIDE} < set(among.outcome.tolist())
    for i, (walker, x) in enumerate(zip(walkers, xs, strict=True)):
        alone = wj.stride(walker, x)
        assert alone.outcome == among.outcome[i]
        np.testing.assert_allclose(alone.state, among.state[i], rtol=0, atol=1e-12)
        np.testing.assert_allclose(alone.time, among.time[i], rtol=0, atol=1e-12)


@pytest.mark.slow
def test_one_walker_is_as_many_that_are_equal():
    walker, x, _ = GAITS[SpringWalker]
    xs = np.array(x) * np.stack([np.ones(50), np.linspace(0.3, 2, 50)], axis=1)
    one, many = wj.strides(walker, xs), strides([walker] * len(xs), xs)
    np.testing.assert_array_equal(one.outcome, many.outcome)
    assert len(set(one.outcome.tolist())) > 1
    np.testing.assert_allclose(one.state, many.state, rtol=0, atol=1e-13)
    np.testing.assert_allclose(one.time, many.time, rtol=0, atol=1e-13)


@pytest.mark.slow
def test_strides_are_compiled_once_for_all_kinds_of_numbers():
    xs = np.array([GAIT["state"]])
    compiled = lambda: len(programs)
    wj.strides(SimplestWalker(0.009), xs)
    count = compiled()
    for slope in (0.008, np.float64(0.008), jnp.asarray(0.007, float), np.float32(0.006)):
        for tolerance in (None, 1e-12, np.float64(1e-12), jnp.asarray(1e-12, float)):
            found = wj.strides(SimplestWalker(slope), xs, tolerance=tolerance)
            assert found.outcome[0] == Outcome.STRIDE
    assert compiled() == count


# Parameters

EVERY = [(cls, parameter) for cls in CLASSES for parameter in parameters(cls)]


def refused(parameter):
    bad = [np.nan, np.inf, -np.inf]
    if parameter.low == 0:
        bad += [-0.1, -1e-300] + [0.0] * (not parameter.closed)
    return bad + ([2.0] if parameter.high < 2 else [])


def call(cls, **values):
    return cls(**{"slope": 0.01, **values})


@pytest.mark.parametrize(
    ("cls", "parameter"), EVERY, ids=lambda value: getattr(value, "name", None) or value.__name__
)
def test_bad_parameters_are_refused_in_one_line(cls, parameter):
    for value in refused(parameter):
        with pytest.raises(ValueError) as error:
            call(cls, **{parameter.name: value})
        message = str(error.value)
        assert message.startswith(f"{parameter.name} must be ") and "\n" not in message
        assert message.endswith(f"not {jnp.asarray(value)}") and len(message) < 100
    if parameter.closed:
        assert getattr(call(cls, **{parameter.name: 0}), parameter.name) == 0


def test_the_bounds_of_masses_and_lengths():
    """What may be zero, and what may be negative."""
    closed = {parameter.name for _, parameter in EVERY if parameter.closed}
    of_knees = {"thigh_mass", "thigh_inertia", "shank_inertia"}
    others = {"hip_stiffness", "hip_mass", "leg_inertia", "foot_radius", "body_inertia"}
    assert closed == others | of_knees
    signed = {parameter.name for _, parameter in EVERY if parameter.low < 0}
    assert signed == {"com_from_hip", "com_offset", "body_com", "thigh_com", "shank_com"}


@pytest.mark.parametrize("cls", [RoundFootWalker, UpperBodyWalker], ids=name)
def test_legs_that_cannot_be_are_refused(cls):
    for radius in (1.0, 1.5):
        with pytest.raises(ValueError, match=f"foot_radius must .*leg_length 1, not {radius:g}$"):
            cls(0.01, foot_radius=radius)
    with pytest.raises(ValueError, match=r"foot_radius must .*leg_length 0.1, not 0.2$"):
        cls(0.01, leg_length=0.1)
    with pytest.raises(ValueError, match=r"leg_inertia must be above 0 .*com_from_hip.*, not 0$"):
        cls(0.01, leg_inertia=0, com_from_hip=0)
    for turns in (dict(com_offset=0.1), dict(leg_inertia=1e-6), dict(com_from_hip=-0.1)):
        cls(0.01, **{"leg_inertia": 0.0, "com_from_hip": 0.0, **turns})


@pytest.mark.parametrize("cls", CLASSES, ids=name)
def test_parameters_are_leaves_and_another_value_compiles_nothing(cls):
    traces = []

    @jax.jit
    def look(walker, state):
        traces.append(walker)
        return walker.vector_field(state)

    names = [parameter.name for parameter in parameters(cls)]
    plain = call(cls)
    assert jax.tree.leaves(plain) == [getattr(plain, name) for name in names]
    state = State(*map(jnp.asarray, (0.2, 0.3, -0.2, 0.1)))
    fields = [look(plain, state)]
    for parameter in parameters(cls):
        value = 1.1 * parameter.default + (0.01 if parameter.default == 0 else 0)
        fields.append(look(call(cls, **{parameter.name: value}), state))
    assert len(traces) == 1
    assert all(np.isfinite(field).all() for field in fields)
    assert len({float(field.phidot) for field in fields}) > 1


@pytest.mark.parametrize("cls", CLASSES, ids=name)
def test_float32_is_kept(cls):
    values = {p.name: np.float32(p.default) for p in parameters(cls)}
    walker = cls(**values)
    state = State(*map(jnp.float32, (-0.2, -0.4, -0.2, 0.1)))
    assert {leaf.dtype for leaf in jax.tree.leaves(walker)} == {jnp.dtype("float32")}
    section = jnp.array(GAITS[cls][1], jnp.float32)
    results = [walker.lift(section), walker.project(state), walker.contact(state)]
    for method in ("vector_field", "contact_force", "impact", "impulse", "energy"):
        if hasattr(walker, method):
            results.append(jax.eval_shape(getattr(walker, method), state))
    assert {leaf.dtype for leaf in jax.tree.leaves(results)} == {jnp.dtype("float32")}


@pytest.mark.slow
def test_float32_strides_are_those_of_float64():
    walker, x, _ = GAITS[RoundFootWalker]
    xs = np.array(x) * np.linspace(0.98, 1.02, 9)[:, None]
    double = strides([walker] * len(xs), xs)
    single = wj.strides(stacked([walker] * len(xs)), xs.astype(np.float32))
    assert single.state.dtype == single.time.dtype == np.float32
    np.testing.assert_array_equal(single.outcome, double.outcome)
    assert (double.outcome == Outcome.STRIDE).sum() >= 5
    np.testing.assert_allclose(single.state, double.state, rtol=0, atol=5e-5)


@pytest.mark.slow
def test_a_step_down_has_the_limit_of_the_simplest_walker():
    x, drop = np.array([0.2, -0.2]), 2e-3
    limit = np.asarray(wj.step_down(wj.SimplestWalker(0.009), x, drop).state)
    errors = [
        np.abs(wj.step_down(wj.PointFootWalker(0.009, mass), x, drop).state - limit).max()
        for mass in (1e-3, 1e-4)
    ]
    assert 9.5 < errors[0] / errors[1] < 10.5
    spring = wj.step_down(wj.SpringWalker(0.009, 0.0), x, drop)
    np.testing.assert_allclose(spring.state, limit, rtol=0, atol=1e-12)


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

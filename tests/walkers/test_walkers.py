"""The simplest walker's equations against Newton's laws and the paper's general method."""

import inspect
import re

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import walker_jax as wj
from walker_jax import State
from walker_jax.checks import WrongUse
from walker_jax.multibody import System
from walker_jax.walkers.family import WALKERS
from walker_jax.walkers.masses import gravity
from walker_jax.walkers.model import Scalar
from walker_jax.walkers.parameters import SLOPE as SLOPE_PARAMETER
from walker_jax.walkers.parameters import parameters

SLOPE = 0.03
WALKER = wj.SimplestWalker(SLOPE)
COUNT = 40


def test_the_representation_shows_values():
    assert repr(wj.SimplestWalker(slope=0.004)) == "SimplestWalker(slope=0.004)"
    single = wj.SpringWalker(jnp.float32(0.1), 0.5)
    assert repr(single) == "SpringWalker(slope=0.1, hip_stiffness=0.5)"
    many = jax.vmap(wj.SimplestWalker)(jnp.array([0.004, 0.005]))
    assert repr(many) == "SimplestWalker(slope=f64[2])"
    seen = []
    jax.eval_shape(lambda slope: seen.append(repr(wj.SimplestWalker(slope))), jnp.ones(()))
    assert seen == ["SimplestWalker(slope=f64[])"]


def states():
    """States of all kinds, also fast and steep ones: arrays of shape (COUNT,)."""
    rng = np.random.default_rng(1)
    angles = rng.uniform(-1.4, 1.4, (2, COUNT))
    rates = rng.uniform(-1.5, 1.5, (2, COUNT))
    return State(*map(jnp.asarray, [*angles, *rates]))


def strikes():
    """States at heel strike: phi = 2 theta, theta and thetadot negative."""
    rng = np.random.default_rng(2)
    theta, thetadot = rng.uniform(-1.2, 0, COUNT), rng.uniform(-1.5, 0, COUNT)
    phidot = rng.uniform(-2, 2, COUNT)
    return State(*map(jnp.asarray, [theta, 2 * theta, thetadot, phidot]))


def each(function, *args):
    return jax.jit(jax.vmap(function))(*args)


def close(actual, expected, tolerance=1e-13):
    np.testing.assert_allclose(actual, expected, rtol=tolerance, atol=tolerance)


# Geometry, in axes along and normal to the slope, the stance foot at the origin


def hip(theta):
    return jnp.stack([-jnp.sin(theta), jnp.cos(theta)])


def swing_foot(theta, phi):
    return hip(theta) - hip(theta - phi)


def hip_velocity(theta, thetadot):
    return jax.jvp(hip, (theta,), (thetadot,))[1]


def cross(a, b):
    return a[0] * b[1] - a[1] * b[0]


GRAVITY = np.array([np.sin(SLOPE), -np.cos(SLOPE)])


# The motion between heel strikes


def test_energy_of_the_stance_leg_does_not_change():
    """(7): E = thetadot^2 / 2 + cos(theta - slope)."""

    def power(state):
        energy = lambda s: s.thetadot**2 / 2 + jnp.cos(s.theta - SLOPE)
        return jax.jvp(energy, (state,), (WALKER.vector_field(state),))[1]

    close(each(power, states()), 0)


def test_rates_are_the_derivatives_of_the_angles():
    rates = each(WALKER.vector_field, states())
    np.testing.assert_array_equal(rates.theta, states().thetadot)
    np.testing.assert_array_equal(rates.phi, states().phidot)


def test_contact_force_is_what_newton_demands_of_the_hip():
    """(8): Q = acceleration of the hip - gravity, for it has all the mass."""

    def force(state):
        rates = WALKER.vector_field(state)
        velocity = lambda theta, thetadot: hip_velocity(theta, thetadot)
        primals, tangents = (state.theta, state.thetadot), (rates.theta, rates.thetadot)
        return jax.jvp(velocity, primals, tangents)[1] - GRAVITY

    close(jnp.stack(each(WALKER.contact_force, states()), axis=1), each(force, states()))


def test_swing_foot_moves_as_a_pendulum_hung_from_the_hip():
    """Massless, it feels no force across its leg: (acceleration - gravity) x leg = 0, (7)."""

    def moment(state):
        rates = WALKER.vector_field(state)

        def velocity(theta, phi, thetadot, phidot):
            return jax.jvp(swing_foot, (theta, phi), (thetadot, phidot))[1]

        acceleration = jax.jvp(velocity, tuple(state), tuple(rates))[1]
        return cross(acceleration - GRAVITY, hip(state.theta - state.phi))

    close(each(moment, states()), 0)


def test_contact_coordinate_is_zero_with_both_feet_on_the_slope():
    """And below zero where the swing foot is ahead and above it."""
    on_slope = each(WALKER.contact, strikes())
    close(on_slope, 0)
    ahead = State(*map(jnp.asarray, (-0.2, -0.5, -0.3, 0.0)))
    assert swing_foot(ahead.theta, ahead.phi)[0] > 0 and swing_foot(ahead.theta, ahead.phi)[1] > 0
    assert WALKER.contact(ahead) < 0


def test_contact_coordinate_can_only_grow_once_past():
    """h'' > 0 wherever h > 0 rises, the swing leg ahead and the stance leg in compression."""
    many = np.random.default_rng(3).uniform(-1.5, 1.5, (4, 4000))
    many = State(*map(jnp.asarray, many))

    def look(state):
        def rate(state):
            return jax.jvp(WALKER.contact, (state,), (WALKER.vector_field(state),))[1]

        curvature = jax.jvp(rate, (state,), (WALKER.vector_field(state),))[1]
        return WALKER.past_contact(state), WALKER.contact(state), rate(state), curvature

    past, h, rate, curvature = each(look, many)
    forward = np.asarray(past & (many.theta < 0) & (many.theta > -np.pi / 2))
    assert np.sum(forward) > 100
    assert np.all(h[forward] > 0) and np.all(rate[forward] > 0) and np.all(curvature[forward] > 0)


# Heel strike


def test_impact_keeps_the_angular_momentum_about_the_contact():
    """Of the hip, before and after, (18)."""

    def momenta(state):
        (u, v), after = WALKER.impact(state)
        arm = hip(state.theta) - swing_foot(state.theta, state.phi)
        before = hip_velocity(state.theta, state.thetadot)
        velocity = jnp.stack([u, v]) + hip_velocity(state.theta, after.thetadot)
        return cross(arm, before), cross(arm, velocity)

    before, after = each(momenta, strikes())
    close(after, before)
    assert np.ptp(before) > 0.5


def test_after_impact_the_hip_turns_about_the_new_stance_foot():
    def look(state):
        (u, v), after = WALKER.impact(state)
        trailing = jnp.stack([u, v])
        angles, rates = (state.theta, state.phi), (after.thetadot, after.phidot)
        foot = trailing + jax.jvp(swing_foot, angles, rates)[1]
        velocity = trailing + hip_velocity(state.theta, after.thetadot)
        leg = hip(state.theta) - swing_foot(*angles)
        return foot, velocity @ leg, (after.theta, after.phi)

    foot, along, angles = each(look, strikes())
    close(foot, 0)
    close(along, 0)
    np.testing.assert_array_equal(angles, (strikes().theta, strikes().phi))


def test_impulse_is_the_change_of_the_hips_momentum():
    """(19), along the swing leg, upwards. The paper prints its x component with the other sign."""

    def change(state):
        (u, v), after = WALKER.impact(state)
        velocity = jnp.stack([u, v]) + hip_velocity(state.theta, after.thetadot)
        return velocity - hip_velocity(state.theta, state.thetadot)

    changes = each(change, strikes())
    close(jnp.stack(each(WALKER.impulse, strikes()), axis=1), changes)
    gentle = np.asarray(strikes().theta > -np.pi / 4)
    assert np.all(changes[gentle, 1] > 0)
    close(each(cross, changes, each(lambda s: hip(s.theta - s.phi), strikes())), 0)


def test_trailing_foot_lifts_up_to_a_right_angle_of_the_legs():
    (_, lift), _ = each(WALKER.impact, strikes())
    np.testing.assert_array_equal(lift > 0, strikes().theta > -np.pi / 4)


def test_impact_and_exchange_lead_to_the_next_start():
    """(22): (-theta, -2 theta, cos 2theta thetadot, cos 2theta (1 - cos 2theta) thetadot)."""
    theta, _, thetadot, _ = strikes()
    c = np.cos(2 * theta)
    following = each(lambda state: WALKER.exchange_legs(WALKER.impact(state)[1]), strikes())
    close(following, (-theta, -2 * theta, c * thetadot, c * (1 - c) * thetadot))


def test_exchange_of_legs_twice_changes_nothing():
    twice = each(lambda state: WALKER.exchange_legs(WALKER.exchange_legs(state)), states())
    close(twice, states(), 1e-14)


def test_exchange_of_legs_leaves_the_hip_where_it_is():
    """Seen from the other foot."""
    other = each(WALKER.exchange_legs, states())
    feet = each(swing_foot, states().theta, states().phi)
    close(feet + each(hip, other.theta), each(hip, states().theta))


# The Poincaré section


def test_lift_and_project_are_inverse_and_agree_with_impact():
    x = jnp.stack([-strikes().theta, strikes().thetadot], axis=1)
    full = each(WALKER.lift, x)
    np.testing.assert_array_equal(each(WALKER.project, full), x)
    following = each(lambda state: WALKER.exchange_legs(WALKER.impact(state)[1]), strikes())
    close(each(lambda state: WALKER.lift(WALKER.project(state)), following), following)
    close(each(WALKER.contact, full), 0)


def test_swing_foot_leaves_the_floor_after_heel_strike():
    """On the section h = 0 and rises: the foot is behind, on the floor, and lifts from it."""
    x = jnp.stack(jnp.meshgrid(jnp.linspace(0.01, 0.78, 8), jnp.linspace(-2, -0.01, 5)), -1)

    def velocity(x):
        state = WALKER.lift(x)
        rates = State(state.thetadot, state.phidot, state.theta, state.phi)
        return (
            jax.jvp(swing_foot, (state.theta, state.phi), (state.thetadot, state.phidot))[1][1],
            jax.jvp(WALKER.contact, (state,), (rates,))[1],
        )

    lift, rate = each(velocity, x.reshape(-1, 2))
    assert np.all(lift > 0) and np.all(rate > 0)


def test_feasible_starts_go_forward_below_a_quarter_of_pi():
    edge = np.pi / 4
    points = {
        (0.2, -0.2): True,
        (np.nextafter(edge, 0), -5.0): True,
        (1e-300, -1e-300): True,
        (edge, -0.2): False,
        (0.0, -0.2): False,
        (-0.1, -0.2): False,
        (0.2, 0.0): False,
        (0.2, 0.1): False,
        (np.nan, -0.2): False,
        (0.2, np.nan): False,
        (0.2, -np.inf): False,
        (np.inf, -0.2): False,
    }
    feasible = each(WALKER.feasible, jnp.array(list(points)))
    assert feasible.tolist() == list(points.values())


# The general method of the paper, for feet of mass beta


def transfer(q):
    """(1): positions of stance foot, hip and swing foot, q = (u, v, theta, phi)."""
    foot, theta, phi = q[:2], q[2], q[3]
    return jnp.concatenate([foot, foot + hip(theta), foot + swing_foot(theta, phi)])


def masses(beta):
    """(5)."""
    return jnp.stack([beta, beta, 1.0, 1.0, beta, beta])


def general_motion(state, beta):
    """(4): accelerations of theta and phi, and the contact force, with the stance foot held."""
    q = jnp.array([0.0, 0.0, state.theta, state.phi])
    qdot = jnp.array([0.0, 0.0, state.thetadot, state.phidot])
    M = masses(beta)
    jacobian = jax.jacfwd(transfer)(q)
    velocity = lambda q: jax.jvp(transfer, (q,), (qdot,))[1]
    convective = jax.jvp(velocity, (q,), (qdot,))[1]
    mass_matrix = jacobian.T @ (M[:, None] * jacobian)
    force = jacobian.T @ (M * (jnp.tile(GRAVITY, 3) - convective))
    accelerations = jnp.linalg.solve(mass_matrix[2:, 2:], force[2:])
    contact_force = mass_matrix[:2, 2:] @ accelerations - force[:2]
    return jnp.concatenate([accelerations, contact_force])


def general_impact(state, beta):
    """(17) with e = 0: velocities after impact, and the impulses."""
    q = jnp.stack([0 * state.theta, 0 * state.theta, state.theta, state.phi])
    qdot = jnp.stack([0 * state.theta, 0 * state.theta, state.thetadot, state.phidot])
    jacobian = jax.jacfwd(transfer)(q)
    mass_matrix = jacobian.T @ (masses(beta)[:, None] * jacobian)
    contact = jacobian[4:]
    system = jnp.block([[mass_matrix, contact.T], [contact, jnp.zeros((2, 2))]])
    right = jnp.concatenate([mass_matrix @ qdot, jnp.zeros(2)])
    return jnp.linalg.solve(system, right)


def assert_limit(general, simplest, at):
    """The simplest walker is the limit: its error is proportional to beta."""
    expected = np.asarray(simplest)
    betas = np.array([1e-3, 1e-4, 1e-5])
    found = jax.jit(jax.vmap(jax.vmap(general, (0, None)), (None, 0)))(at, betas)
    errors = np.array([np.max(np.abs(f - expected), axis=0) for f in found])
    assert np.all(errors[-1] < 2e-4)
    varies = errors[0] > 1e-8
    np.testing.assert_allclose(errors[0][varies] / errors[1][varies], 10, rtol=0.1)
    np.testing.assert_allclose(errors[1][varies] / errors[2][varies], 10, rtol=0.1)
    return varies


@pytest.mark.slow
def test_motion_and_contact_force_are_the_limit_of_small_feet():
    """(7) and (8) from (4)."""
    rates = each(WALKER.vector_field, states())
    forces = each(WALKER.contact_force, states())
    simplest = jnp.stack([rates.thetadot, rates.phidot, *forces], axis=1)
    assert assert_limit(general_motion, simplest, states()).all()


@pytest.mark.slow
def test_impact_is_the_limit_of_small_feet():
    """(18) and (19) from (17), whose multipliers are minus the impulse of the ground."""
    (u, v), after = each(WALKER.impact, strikes())
    rho_x, rho_y = each(WALKER.impulse, strikes())
    simplest = jnp.stack([u, v, after.thetadot, after.phidot, -rho_x, -rho_y], axis=1)
    assert assert_limit(general_impact, simplest, strikes()).all()


# Parameters

BAD = [np.nan, np.inf, -np.inf, 0, 0.0, -0.004, np.pi / 2, 3, 1e9, [0.1, 0.2], np.full(1, 0.25)]


@pytest.mark.parametrize("slope", BAD, ids=str)
def test_a_slope_that_is_none_is_refused_in_one_line(slope):
    slope = np.asarray(slope) if isinstance(slope, list) else slope
    with pytest.raises(ValueError, match="slope") as error:
        wj.SimplestWalker(slope)
    message = str(error.value)
    assert "\n" not in message and str(float(np.ravel(slope)[0]))[:4] in message


@pytest.mark.parametrize("slope", ["0.004", "steep", None, 0.1 + 0.2j, np.ones((30, 30))])
def test_what_is_no_real_number_is_refused_in_one_line(slope):
    unchecked = inspect.unwrap(type(SLOPE_PARAMETER).convert)  # by the tests' own checks of types
    with pytest.raises(ValueError, match="slope") as error:
        unchecked(SLOPE_PARAMETER, slope)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("slope", [1e-9, 0.004, 1, np.float32(0.5), np.array(1.5), jnp.array(0.1)])
def test_slopes_of_all_kinds_of_numbers_are_taken(slope):
    walker = wj.SimplestWalker(slope)
    assert walker.slope == slope and walker.slope.shape == ()
    assert jnp.issubdtype(walker.slope.dtype, jnp.floating)


def test_the_name_of_a_parameter_means_the_same_in_all_walkers():
    """Commands offer one option for all walkers that have it."""
    known: dict = {}
    for kind in WALKERS.values():
        for one in parameters(kind):
            first = known.setdefault(one.name, one)
            assert (one.meaning, one.unit) == (first.meaning, first.unit), (kind, one.name)


def test_a_walker_is_a_pytree_of_its_parameters():
    assert jax.tree.leaves(WALKER) == [WALKER.slope]
    assert wj.SimplestWalker.section == ("theta", "thetadot")

    def acceleration(slope):
        state = State(*jnp.array([0.2, 0.4, -0.1, 0.0]))
        return wj.SimplestWalker(slope).vector_field(state).thetadot

    slopes = jnp.array([0.01, 0.3])
    expected = np.sin(0.2 - slopes)
    close(jax.jit(jax.vmap(acceleration))(slopes), expected)
    close(jax.vmap(jax.jacfwd(acceleration))(slopes), -np.cos(0.2 - slopes))


# An impact of a user's own


class SlidingWalker(wj.SimplestWalker):
    """Its swing leg keeps a part of its rate at heel strike, which the section does not know of."""

    kept: Scalar = eqx.field(converter=jnp.asarray)

    def impact(self, state):
        foot, after = super().impact(state)
        return foot, after._replace(phidot=after.phidot + self.kept * state.phidot)


class MassiveLegWalker(wj.PointFootWalker):
    """Masses on the legs, not at their ends alone."""

    def system(self):
        system = super().system()

        def transfer(q):
            x = system.transfer(q)
            return jnp.concatenate([x, (x[:4] + x[2:]) / 2])

        masses = jnp.concatenate([system.masses, jnp.full(4, 0.1)])
        return System(transfer, masses, gravity(self.slope, masses))


def test_an_impact_off_the_section_is_refused_by_coordinate():
    kept = 0.25 * -0.5 * (1 - np.cos(0.6))  # goes to both rates when the legs are exchanged
    error = (1 - np.cos(0.6)) * kept - kept
    said = f"impact of SlidingWalker must lead to its section: phidot is {error:.3g} off it"
    with pytest.raises(WrongUse, match=re.escape(said)):
        SlidingWalker(SLOPE, 0.25)
    with pytest.raises(WrongUse, match=r"impact of MassiveLegWalker .* phidot is"):
        MassiveLegWalker(SLOPE)
    assert SlidingWalker(SLOPE, 0.0).kept == 0
    shape = jax.eval_shape(lambda kept: SlidingWalker(SLOPE, kept), jnp.ones(()))
    assert shape.kept.shape == ()  # nothing is looked at while JAX traces

"""Constraints on rates, and rigid bodies in space: what rolls, against SymPy's Kane's method."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from kane import Rolling
from solving import solve

from walker_jax import multibody
from walker_jax.integrators.integrator import Method
from walker_jax.integrators.taylor_steps import Taylor
from walker_jax.kernels import kernel
from walker_jax.multibody import ConstrainedMotion, System, space

DISC = dict(slope=0.1, mass=1.3, length=1.0, width=0.3, radius=0.4, forward=0.0, outward=0.0)
DISC |= dict(height=0.4, xx=0.06, yy=0.11, zz=0.06, xy=0.0, xz=0.0, yz=0.0)
BODY = DISC | dict(forward=0.05, outward=0.1, height=0.55, xx=0.09, yy=0.08, zz=0.07)
BODY |= dict(xy=0.01, xz=-0.02, yz=0.015)
COUNT = 20


class Rolled(NamedTuple):
    """A state of a body that rolls."""

    x: jax.Array
    y: jax.Array
    yaw: jax.Array
    lean: jax.Array
    pitch: jax.Array
    yawdot: jax.Array
    leandot: jax.Array
    pitchdot: jax.Array


class RollingBody(ConstrainedMotion):
    """A rigid body on the edge of a disc: x, y of the contact, yaw, lean, pitch."""

    sizes: dict

    @property
    def independent(self):
        return 2, 3, 4

    def axle(self, q):
        return space.rotation_about(2, q[2]) @ space.rotation_about(0, q[3])

    def rotation(self, q):
        return self.axle(q) @ space.rotation_about(1, q[4])

    def contact(self, q):
        return jnp.append(q[:2], 0.0)

    def centre(self, q):
        return self.contact(q) + self.sizes["radius"] * self.axle(q)[:, 2]

    def system(self):
        s = self.sizes

        def transfer(q):
            arm = jnp.stack([s["forward"], s["outward"], s["height"] - s["radius"]])
            rotation = self.rotation(q)
            return space.body_coordinates(self.centre(q) + rotation @ arm, rotation)

        rows = [[s["xx"], s["xy"], s["xz"]], [s["xy"], s["yy"], s["yz"]]]
        rows += [[s["xz"], s["yz"], s["zz"]]]
        inertia = jnp.stack([jnp.stack(row) for row in rows])
        down = jnp.stack([jnp.sin(s["slope"]), jnp.zeros(()), -jnp.cos(s["slope"])])
        masses = [s["mass"]]
        return System(
            transfer, space.body_masses(masses, [inertia]), space.body_weights(masses, down)
        )

    def constraints(self, q, qdot):
        at = self.centre, self.rotation, self.contact
        return space.material_velocity(*at, q, qdot)[:2]


def rolling(sizes):
    return RollingBody({name: jnp.asarray(value, float) for name, value in sizes.items()})


@partial(jax.vmap, in_axes=(None, 0))
@kernel
def rates_of(motion, start):
    return jnp.stack(motion(list(start)))


def states(seed, count=COUNT):
    """x, y, yaw, lean, pitch and the rates of the last three."""
    rng = np.random.default_rng(seed)
    low, high = np.array([[-1, -1, -3, -1, -3, -2, -2, -6], [1, 1, 3, 1, 3, 2, 2, 6]], float)
    return rng.uniform(low, high, (count, 8))


def in_kanes_order(reference, start):
    return reference.state(start[2:5], start[5:], start[:2])


@pytest.mark.parametrize(
    "sizes", [pytest.param(DISC, id="disc", marks=pytest.mark.slow), pytest.param(BODY, id="body")]
)
def test_what_rolls_accelerates_as_kanes_method_says(sizes):
    starts, reference = states(1), Rolling(sizes, 1)
    found = np.asarray(rates_of(rolling(sizes), starts))
    for start, rates in zip(starts, found, strict=True):
        expected = reference.rates_of(in_kanes_order(reference, start))
        expected = np.concatenate([expected[3:5], expected[:3], expected[5:8]])
        np.testing.assert_allclose(rates, expected, rtol=1e-10, atol=1e-10)


def constrained(motion, start):
    q, u = list(start[:5]), list(start[5:])
    qdot = jnp.stack(motion.rates(q, u))
    return jnp.stack(q), qdot


def test_multipliers_give_the_same_motion_and_friction():
    motion, starts = rolling(BODY), states(2)
    whole = motion.system()

    @jax.vmap
    @kernel
    def look(start):
        q, qdot = constrained(motion, start)
        found = multibody.solve_constrained(whole, motion.constraints, q, qdot)
        along = lambda q: multibody.velocity(whole.transfer, q, qdot)[:3]
        _, accelerate = jax.jvp(along, (q,), (qdot,))
        accelerate += multibody.velocity(whole.transfer, q, found.accelerations)[:3]
        weight = whole.forces[:3]
        return found, BODY["mass"] * accelerate - weight

    found, newton = look(starts)
    own = rates_of(motion, starts)[:, 5:]
    np.testing.assert_allclose(found.accelerations[:, 2:], own, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(found.multipliers, newton[:, :2], rtol=1e-9, atol=1e-9)
    assert not np.any(found.forces)


@pytest.mark.slow
def test_energy_is_kept_and_the_disc_does_not_slip():
    """Over some turns of a disc that wobbles: to rounding, by the series of the motion."""
    motion = rolling(BODY)
    start = jnp.array([0.0, 0.0, 0.3, 0.1, 0.2, 0.5, -0.3, 4.0])
    reference = Rolling(BODY, 1)

    @kernel
    def walk(start):
        method = Method(motion, Taylor(8), jnp.asarray(1e-14))
        return jnp.stack(solve(method, Rolled(*start), jnp.asarray(2.0)))

    end = walk(start)
    for state in (start, end):
        q, qdot = constrained(motion, state)
        assert np.abs(motion.constraints(q, qdot)).max() < 1e-14
        z = in_kanes_order(reference, np.asarray(state))
        slides = reference.look("slides", z)
        assert np.abs(slides).max() < 1e-14  # nor does it leave the ground
    energies = [
        reference.look("energy", in_kanes_order(reference, np.asarray(s))) for s in (start, end)
    ]
    assert np.abs(np.asarray(end) - np.asarray(start)).max() > 1
    assert abs(energies[1] - energies[0]) < 1e-12 * abs(energies[0])
    system = motion.system()
    for state, energy in zip((start, end), energies, strict=True):
        q, qdot = constrained(motion, state)
        own = multibody.kinetic_energy(system, q, qdot) + multibody.potential_energy(system, q)
        assert abs(own - energy) < 1e-12


class Slid(NamedTuple):
    """A state of a sleigh."""

    x: jax.Array
    y: jax.Array
    angle: jax.Array
    xdot: jax.Array
    angledot: jax.Array


class Sleigh(ConstrainedMotion):
    """Chaplygin's: a body on a knife's edge, which does not slide sideways."""

    mass: jax.Array
    inertia: jax.Array
    ahead: jax.Array  # of the centre of mass

    @property
    def independent(self):
        return 0, 2

    def system(self):
        def transfer(q):
            direction = jnp.stack([jnp.cos(q[2]), jnp.sin(q[2])])
            return jnp.concatenate([q[:2] + self.ahead * direction, q[2:]])

        masses = jnp.stack([self.mass, self.mass, self.inertia])
        return System(transfer, masses, jnp.zeros_like(masses))

    def constraints(self, q, qdot):
        return (qdot[1] * jnp.cos(q[2]) - qdot[0] * jnp.sin(q[2]))[None]


@pytest.mark.slow
def test_chaplygins_sleigh_moves_by_its_closed_form():
    """With v along the edge and the turn w: vdot = a w^2, wdot = -m a v w / (I + m a^2)."""
    m, inertia, a = 2.0, 0.3, 0.4
    sleigh = Sleigh(*jnp.array([m, inertia, a]))
    method = Method(sleigh, Taylor(8), jnp.asarray(1e-14))
    v, w = 0.2, 0.9
    ellipse = lambda v, w: v**2 + w**2 * (inertia + m * a**2) / m

    @kernel
    def look(start, time):
        accelerations = sleigh(list(start))
        return jnp.stack(accelerations), jnp.stack(solve(method, Slid(*start), time))

    angle = 0.3
    start = jnp.array([0.0, 0.0, angle, v * np.cos(angle), w])
    rates, end = look(start, jnp.asarray(0.8))
    assert abs(rates[1] - v * np.sin(angle)) < 1e-15
    assert abs(rates[4] + m * a * v * w / (inertia + m * a**2)) < 1e-14
    speed_rate = a * w**2 * np.cos(angle) - v * w * np.sin(angle)  # of v cos(angle)
    assert abs(rates[3] - speed_rate) < 1e-14
    later = float(end[3] / np.cos(end[2])), float(end[4])
    assert abs(ellipse(*later) - ellipse(v, w)) < 1e-14
    # the known solution: v = c tanh(k c (t - t0)), w = ... with k = m a / (I + m a^2)
    k, c = m * a / (inertia + m * a**2), np.sqrt(ellipse(v, w))
    assert abs(later[0] - c * np.tanh(k * c * 0.8 + np.arctanh(v / c))) < 1e-13


def test_a_dropped_disc_rolls_and_keeps_its_momentum():
    sizes = {name: jnp.asarray(value, float) for name, value in BODY.items()}
    rng = np.random.default_rng(3)

    class Free(RollingBody):
        """The same with the height of its lowest point: x, y, z, yaw, lean, pitch."""

        def contact(self, q):
            return q[:3]

        def axle(self, q):
            return super().axle(q[1:])

        def rotation(self, q):
            return self.axle(q) @ space.rotation_about(1, q[5])

    body = Free(sizes)
    made = lambda q, qdot: space.material_velocity(
        body.centre, body.rotation, body.contact, q, qdot
    )

    @kernel
    def drop(q, qdot):
        system = body.system()
        after = multibody.impact(system, None, q, qdot, constraints=made)
        about = lambda rates: space.angular_momentum(system, q, rates, q[:3])
        kinetic = lambda rates: multibody.kinetic_energy(system, q, rates)
        gained = space.momentum(system, q, after.velocities) - space.momentum(system, q, qdot)
        at = made(q, after.velocities), about(qdot), about(after.velocities)
        return after, *at, kinetic(qdot) - kinetic(after.velocities), gained

    for _ in range(10):
        q, qdot = rng.uniform(-1, 1, (2, 6))
        after, slides, before, later, lost, gained = drop(jnp.asarray(q), jnp.asarray(qdot))
        np.testing.assert_allclose(slides, 0, atol=1e-13)
        np.testing.assert_allclose(later, before, rtol=1e-11, atol=1e-12)
        np.testing.assert_allclose(gained, after.impulses, rtol=1e-11, atol=1e-12)
        assert lost > 0


def test_angular_velocity_and_momentum_are_of_the_rotation():
    body, q = rolling(BODY), jnp.array([0.1, 0.2, 0.3, 0.4, 0.5])
    qdot = jnp.array([0.0, 0.0, 0.7, -0.2, 1.1])

    @jax.jit
    def look(q, qdot):
        system = body.system()
        momentum = space.angular_momentum(system, q, qdot, system.transfer(q)[:3])
        return (
            space.angular_velocity(body.rotation, q, qdot),
            momentum,
            body.axle(q),
            body.rotation(q),
        )

    omega, momentum, axle, R = look(q, qdot)
    expected = 0.7 * np.array([0, 0, 1]) - 0.2 * axle[:, 0] + 1.1 * axle[:, 1]
    np.testing.assert_allclose(omega, expected, atol=1e-14)
    inertia = np.array([[0.09, 0.01, -0.02], [0.01, 0.08, 0.015], [-0.02, 0.015, 0.07]])
    np.testing.assert_allclose(momentum, R @ inertia @ R.T @ expected, atol=1e-14)


def test_wrong_constraints_are_refused():
    system, q = System(lambda q: q, jnp.ones(3), jnp.zeros(3)), jnp.array([0.1, 0.2, 0.3])
    twice = lambda q, qdot: jnp.stack([qdot[0], qdot[1], qdot[0] + qdot[1]])
    with pytest.raises(ValueError, match=r"constraints is (singular|ill-conditioned).*a\[2\]"):
        multibody.solve_constrained(system, twice, q, q)
    with pytest.raises(ValueError, match=r"constraints must return .* \(a,\), not \(\)"):
        multibody.solve_constrained(system, lambda q, qdot: qdot[0], q, q)
    with pytest.raises(ValueError, match="contact must be given"):
        multibody.impact(system, None, q, q)
    with pytest.raises(ValueError, match="symmetric"):
        System(lambda q: q, jnp.array([[1.0, 2.0], [0.0, 1.0]]), jnp.zeros(2))

"""Impacts: balls, rods, and what no impact may do."""

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from mechanisms import COUNT, GRAVITY, close, each, uniform

from walker_jax import multibody
from walker_jax.kernels import kernel
from walker_jax.multibody import System, impact, kinetic_energy

RESTITUTIONS = [0.0, 0.3, 1.0]


@pytest.mark.parametrize("e", RESTITUTIONS)
def test_a_ball_bounces(e):
    """Only its velocity normal to the ground changes."""
    m = 0.3
    ball = System(lambda q: q, jnp.full(2, m), jnp.array([0.0, -m * GRAVITY]))
    after = impact(ball, lambda q: q[1:], jnp.zeros(2), jnp.array([2.0, -3.0]), restitution=e)
    close(after.velocities, [2.0, 3.0 * e])
    close(after.impulses, [m * (1 + e) * 3.0])


def rod(m, inertia):
    """q = (x, y, angle) of its centre; heavy."""
    return System(lambda q: q, jnp.array([m, m, inertia]), jnp.array([0.0, -m * GRAVITY, 0.0]))


HALF = 0.8
M_ROD = 0.5
I_ROD = M_ROD * HALF**2 / 3


def end(q, side=1):
    return q[:2] + side * HALF * jnp.stack([jnp.cos(q[2]), jnp.sin(q[2])])


@pytest.mark.parametrize("e", RESTITUTIONS)
def test_a_rod_dropped_on_one_end_of_a_smooth_ground(e):
    """The impulse (1 + e) m v / (1 + 3 cos^2), and its moment about the centre."""
    v, angle = 2.5, uniform(29, COUNT, low=-3.0, high=3.0)

    def drop(angle):
        q = jnp.stack([jnp.zeros(()), jnp.zeros(()), angle])
        return impact(
            rod(M_ROD, I_ROD), lambda q: end(q)[1:], q, jnp.array([0.7, -v, 0.0]), restitution=e
        )

    velocities, impulses = each(drop, angle)
    rho = (1 + e) * M_ROD * v / (1 + 3 * np.cos(angle) ** 2)
    close(impulses[:, 0], rho)
    close(velocities[:, 0], 0.7)
    close(velocities[:, 1], rho / M_ROD - v)
    close(velocities[:, 2], rho * HALF * np.cos(angle) / I_ROD)


def test_a_rod_that_sticks_keeps_its_momentum_about_its_end():
    """It turns about that end: rate = (moment of the momentum) / (I + m l^2)."""
    angle, rates = uniform(30, COUNT, low=-3.0, high=3.0), uniform(31, COUNT, 3)

    def drop(angle, qdot):
        q = jnp.stack([jnp.zeros(()), jnp.zeros(()), angle])
        return impact(rod(M_ROD, I_ROD), end, q, qdot), multibody.velocity(end, q, qdot)

    (velocities, impulses), closing = each(drop, angle, rates)
    sine, cosine = np.sin(angle), np.cos(angle)
    u, v, w = rates.T
    moment = I_ROD * w + M_ROD * HALF * (sine * u - cosine * v)
    rate = moment / (I_ROD + M_ROD * HALF**2)
    close(velocities, np.stack([HALF * sine * rate, -HALF * cosine * rate, rate], 1))
    close(impulses, M_ROD * (velocities[:, :2] - rates[:, :2]))
    assert np.min(np.linalg.norm(closing, axis=1)) > 0.01


@pytest.mark.parametrize("e", RESTITUTIONS)
def test_a_rod_dropped_flat_on_both_ends(e):
    """Two contacts at once: each takes half, and it does not turn."""

    def ends(q):
        return jnp.stack([end(q)[1], end(q, -1)[1]])

    after = impact(
        rod(M_ROD, I_ROD), ends, jnp.zeros(3), jnp.array([0.2, -1.5, 0.0]), restitution=e
    )
    close(after.velocities, [0.2, 1.5 * e, 0.0])
    close(after.impulses, [(1 + e) * M_ROD * 1.5 / 2] * 2)


N, POINTS, CONTACTS = 4, 6, 2


def some_system(masses, shape):
    """q, and POINTS - N functions of all of q: no coordinate without its own mass."""

    def transfer(q):
        return jnp.concatenate([q, jnp.sin(shape @ q)])

    return System(transfer, masses, jnp.zeros(POINTS))


def some_contacts(shape):
    """Independent of each other where |shape| <= 1."""
    return lambda q: q[:CONTACTS] + jnp.cos(shape @ q) / 5


@kernel
def collide(masses, shape, contacts, q, qdot, e):
    system, contact = some_system(masses, shape), some_contacts(contacts)
    after = impact(system, contact, q, qdot, restitution=e)
    matrix, slopes = multibody.mass_matrix(system, q), multibody.jacobian(contact, q)
    energies = [kinetic_energy(system, q, v) for v in (qdot, after.velocities)]
    return after, matrix, slopes, jnp.stack(energies)


def test_velocities_and_impulses_solve_the_whole_linear_system():
    """(17), with the sign of (19), of random systems."""
    for seed in range(20):
        rng = np.random.default_rng(seed)
        masses, e = rng.uniform(0.1, 3, POINTS), rng.uniform(0, 1)
        shape = rng.normal(size=(POINTS - N, N))
        contacts = rng.uniform(-1, 1, (CONTACTS, N))
        q, qdot = rng.normal(size=(2, N))
        after, matrix, slopes, _ = collide(masses, shape, contacts, q, qdot, e)
        # Derivatives of the transfer function and the contacts by hand.
        F_q = np.concatenate([np.eye(N), np.cos(shape @ q)[:, None] * shape])
        g_q = np.eye(N)[:CONTACTS] - np.sin(contacts @ q)[:, None] * contacts / 5
        close(slopes, g_q)
        close(matrix, F_q.T @ np.diag(masses) @ F_q)
        zero = np.zeros((CONTACTS, CONTACTS))
        whole = np.block([[F_q.T @ np.diag(masses) @ F_q, -g_q.T], [g_q, zero]])
        right = np.concatenate([matrix @ qdot, -e * g_q @ qdot])
        close(np.concatenate(after), np.linalg.solve(whole, right), 1e-11)


def box(shape, low=-1.0, high=1.0):
    return arrays(float, shape, elements=st.floats(low, high, allow_subnormal=False))


@settings(max_examples=100, deadline=None)
@given(
    box(POINTS, 0.05, 20.0),
    box((POINTS - N, N), -2, 2),
    box((CONTACTS, N)),
    box(N, -3, 3),
    box(N, -5, 5),
    st.sampled_from([0.0, 0.3, 1.0]) | st.floats(0, 1),
)
def test_no_impact_adds_energy(masses, shape, contacts, q, qdot, e):
    """It takes (1 - e^2) / 2 of that of the closing velocities; none where e = 1."""
    after, matrix, slopes, (before, left) = collide(masses, shape, contacts, q, qdot, e)
    closing = slopes @ qdot
    share = np.linalg.inv(slopes @ np.linalg.solve(matrix, slopes.T))
    lost = (1 - e**2) / 2 * closing @ share @ closing
    assert lost >= 0
    tolerance = 1e-12 * (1 + before) * np.linalg.cond(matrix)
    assert left <= before + tolerance
    assert before - left == pytest.approx(float(lost), rel=0, abs=float(tolerance))
    assert np.allclose(slopes @ after.velocities, -e * closing, rtol=0, atol=tolerance)

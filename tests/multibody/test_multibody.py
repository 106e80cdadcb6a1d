"""Equations of motion and of impact against SymPy's mechanics, Newton's laws and closed forms."""

import functools
import inspect

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import sympy
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from sympy.physics import mechanics

from walker_jax import multibody
from walker_jax.kernels import kernel
from walker_jax.multibody import System, impact, kinetic_energy, potential_energy, solve_motion

GRAVITY = 9.81
COUNT = 30


def close(actual, expected, tolerance=1e-12):
    np.testing.assert_allclose(actual, expected, rtol=tolerance, atol=tolerance)


def uniform(seed, *shape, low=-1.0, high=1.0):
    return jnp.asarray(np.random.default_rng(seed).uniform(low, high, shape))


def states(seed, n, rates=4.0):
    """Any angles, and rates on both sides of that at which a pendulum swings."""
    return uniform(seed, COUNT, n, low=-3.1, high=3.1), rates * uniform(seed + 1, COUNT, n)


def each(function, *args):
    """By kernels, which take less to compile."""
    return jax.vmap(kernel(function))(*args)


def hanging(angle):
    return jnp.stack([jnp.sin(angle), -jnp.cos(angle)])


def weights(masses, points=None):
    """Gravity on points in the plane, of which each has two masses; none on what comes after."""
    down = jnp.array([0.0, -GRAVITY])
    points = len(masses) // 2 if points is None else points
    rest = jnp.zeros(len(masses) - 2 * points, masses.dtype)
    return masses * jnp.concatenate([*[down.astype(masses.dtype)] * points, rest])


# Against SymPy


def double_pendulum(m1=1.3, m2=0.7, l1=0.9, l2=1.4):
    """Two point masses on rods; both angles from the vertical."""

    def transfer(q):
        first = l1 * hanging(q[0])
        return jnp.concatenate([first, first + l2 * hanging(q[1])])

    one, two = jnp.asarray(m1), jnp.asarray(m2)
    masses = jnp.stack([one, one, two, two])
    return System(transfer, masses, weights(masses))


BARS = dict(m1=1.3, m2=0.7, I1=0.2, I2=0.05, c1=0.4, c2=0.6, l1=0.9)


def two_bars(m1, m2, I1, I2, c1, c2, l1, springs=None):
    """Two rigid bodies on hinges; the angle of the second is from the first."""

    def transfer(q):
        angle = q[0] + q[1]
        second = l1 * hanging(q[0]) + c2 * hanging(angle)
        return jnp.concatenate([c1 * hanging(q[0]), second, jnp.stack([q[0], angle])])

    masses = jnp.array([m1, m1, m2, m2, I1, I2])
    return System(transfer, masses, weights(masses, points=2), springs)


T = mechanics.dynamicsymbols._t


def accelerations_by(method, coordinates):
    """A function of (q, qdot), of NumPy, from a method of SymPy's mechanics."""
    if isinstance(method, mechanics.LagrangesMethod):
        method.form_lagranges_equations()
    names = sympy.symbols(f"q:{len(coordinates)} w:{len(coordinates)}")
    rates = dict(zip([c.diff(T) for c in coordinates], names[len(coordinates) :], strict=True))
    angles = dict(zip(coordinates, names, strict=False))
    matrix, force = (part.subs(rates).subs(angles) for part in (method.mass_matrix, method.forcing))
    numbers = sympy.lambdify(names, (matrix, force), "numpy", cse=True)

    def accelerations(q, qdot):
        matrix, force = numbers(*q, *qdot)
        return np.linalg.solve(np.array(matrix, float), np.array(force, float))[:, 0]

    return accelerations


def frames(*angles):
    """The fixed frame, its origin at rest, and frames turned from it about z."""
    fixed, origin = mechanics.ReferenceFrame("N"), mechanics.Point("O")
    origin.set_vel(fixed, 0)
    turned = [fixed.orientnew(f"A{i}", "Axis", [a, fixed.z]) for i, a in enumerate(angles)]
    return fixed, origin, turned


def assert_accelerations(system, expected, q, qdot):
    found = each(lambda q, qdot: solve_motion(system, q, qdot).accelerations, q, qdot)
    exact = np.array([expected(*pair) for pair in zip(np.array(q), np.array(qdot), strict=True)])
    assert np.ptp(exact) > 1
    close(found, exact)


def test_two_points_on_rods_accelerate_as_sympy_says():
    a, b = coordinates = mechanics.dynamicsymbols("a b")
    fixed, origin, (first, second) = frames(a, b)
    masses, points = [1.3, 0.7], []
    for arm, length in ((first, 0.9), (second, 1.4)):
        place = -length * arm.y
        points.append((points or [origin])[-1].locatenew(f"P{len(points)}", place))
        points[-1].v2pt_theory((points or [origin])[-2] if points[1:] else origin, fixed, arm)
    bodies = [mechanics.Particle(f"B{m}", p, m) for p, m in zip(points, masses, strict=True)]
    for body in bodies:
        height = body.point.pos_from(origin).dot(fixed.y)
        body.potential_energy = body.mass * GRAVITY * height
    method = mechanics.LagrangesMethod(mechanics.Lagrangian(fixed, *bodies), coordinates)
    assert_accelerations(double_pendulum(), accelerations_by(method, coordinates), *states(1, 2))


def test_two_bodies_on_hinges_accelerate_as_sympy_says():
    """By Kane's method, with a spring and a damper in the second hinge."""
    a, b = coordinates = mechanics.dynamicsymbols("a b")
    rates = mechanics.dynamicsymbols("w v")
    fixed, origin, (first, second) = frames(a, a + b)
    first.set_ang_vel(fixed, rates[0] * fixed.z)
    second.set_ang_vel(fixed, (rates[0] + rates[1]) * fixed.z)
    hinge = origin.locatenew("H", -BARS["l1"] * first.y)
    hinge.v2pt_theory(origin, fixed, first)
    bodies, loads = [], []
    for i, (frame, base) in enumerate([(first, origin), (second, hinge)], 1):
        centre = base.locatenew(f"C{i}", -BARS[f"c{i}"] * frame.y)
        centre.v2pt_theory(base, fixed, frame)
        inertia = mechanics.inertia(frame, 0, 0, BARS[f"I{i}"]), centre
        bodies.append(mechanics.RigidBody(f"B{i}", centre, frame, BARS[f"m{i}"], inertia))
        loads.append((centre, -BARS[f"m{i}"] * GRAVITY * fixed.y))
    torque = -(2.0 * b + 0.3 * rates[1]) * fixed.z
    loads += [(second, torque), (first, -torque)]
    kinematic = [rate - c.diff(T) for rate, c in zip(rates, coordinates, strict=True)]
    method = mechanics.KanesMethod(fixed, coordinates, rates, kinematic)
    method.kanes_equations(bodies, loads)

    names = sympy.symbols("q:2 w:2")
    values = dict(zip([*coordinates, *rates], names, strict=True))
    parts = [part.subs(values) for part in (method.mass_matrix, method.forcing)]
    numbers = sympy.lambdify(names, parts, "numpy", cse=True)

    def accelerations(q, qdot):
        matrix, force = numbers(*q, *qdot)
        return np.linalg.solve(matrix, force)[:, 0]

    def springs(q, qdot):
        return jnp.stack([jnp.zeros_like(q[0]), -2.0 * q[1] - 0.3 * qdot[1]])

    assert_accelerations(two_bars(**BARS, springs=springs), accelerations, *states(3, 2))


LENGTH = 1.7


def spatial_pendulum():
    """One point mass in space: q = (polar angle from straight down, azimuth)."""

    def transfer(q):
        polar, azimuth = q[0], q[1]
        out = jnp.sin(polar)
        return LENGTH * jnp.stack([out * jnp.cos(azimuth), out * jnp.sin(azimuth), -jnp.cos(polar)])

    masses = jnp.full(3, 0.6)
    return System(transfer, masses, masses * jnp.array([0.0, 0.0, -GRAVITY]))


def test_spatial_pendulum_accelerates_by_its_closed_form():
    def closed_form(q, qdot):
        s, c = np.sin(q[0]), np.cos(q[0])
        polar = s * c * qdot[1] ** 2 - GRAVITY / LENGTH * s
        return np.array([polar, -2 * qdot[0] * qdot[1] * c / s])

    _, qdot = states(5, 2)
    q = uniform(6, COUNT, 2, low=0.2, high=2.9)
    assert_accelerations(spatial_pendulum(), closed_form, q, qdot)


@pytest.mark.slow
def test_spatial_pendulum_keeps_its_energy_and_angular_momentum():
    """The latter about the vertical, over many swings."""
    system = spatial_pendulum()

    def rates(t, state, args):
        return state[1], solve_motion(system, *state).accelerations

    @jax.jit
    def conserved_along(start):
        solution = diffrax.diffeqsolve(
            diffrax.ODETerm(rates),
            diffrax.Dopri8(),
            0.0,
            20.0,
            None,
            start,
            saveat=diffrax.SaveAt(ts=jnp.linspace(0, 20, 60)),
            stepsize_controller=diffrax.PIDController(rtol=1e-11, atol=1e-11),
        )
        assert solution.ys is not None
        q, qdot = solution.ys

        def conserved(q, qdot):
            energy = kinetic_energy(system, q, qdot) + potential_energy(system, q)
            place = system.transfer(q)
            momentum = system.masses * multibody.velocity(system.transfer, q, qdot)
            return energy, place[0] * momentum[1] - place[1] * momentum[0]

        return jax.vmap(conserved)(q, qdot), q

    (energy, momentum), q = conserved_along((jnp.array([0.8, 0.0]), jnp.array([1.0, 1.5])))
    assert np.ptp(q[:, 0]) > 0.5 and np.ptp(q[:, 1]) > 10
    np.testing.assert_allclose(energy, energy[0], rtol=1e-8)
    np.testing.assert_allclose(momentum, momentum[0], rtol=1e-8)
    assert momentum[0] == pytest.approx(0.6 * (LENGTH * np.sin(0.8)) ** 2 * 1.5, rel=1e-12)


# Wheels that roll down a slope, and the forces that hold them there


def wheel(mass, inertia, radius, slope, offset=0.0):
    """q = (slip, height, turned angle); axes down the slope and normal to it.

    A wheel whose slip and height are held rolls. Its centre of mass is `offset` from its centre,
    straight above it at angle zero.
    """

    def transfer(q):
        centre = jnp.stack([q[0] + radius * q[2], q[1] + radius])
        arm = jnp.stack([jnp.sin(q[2]), jnp.cos(q[2])])
        return jnp.concatenate([centre + offset * arm, q[2:]])

    down = GRAVITY * mass * jnp.stack([jnp.sin(slope), -jnp.cos(slope)])
    masses = jnp.stack([mass, mass, inertia])
    return System(transfer, masses, jnp.concatenate([down, jnp.zeros(1)]))


def rolling(mass, inertia, radius, slope, angle, rate, offset=0.0):
    q, qdot = (jnp.stack([jnp.zeros(()), jnp.zeros(()), x]) for x in (angle, rate))
    return solve_motion(wheel(mass, inertia, radius, slope, offset), q, qdot, held=(0, 1))


def wheels(seed):
    """Masses, moments of inertia, radii, slopes, angles, rates."""
    positive = uniform(seed, 3, COUNT, low=0.1, high=3.0)
    slopes = uniform(seed + 1, COUNT, low=0.05, high=1.4)
    return *positive, slopes, *states(seed + 2, 2)[0].T


def test_wheel_rolls_down_a_slope_by_its_closed_form_and_friction_holds_it():
    m, inertia, r, slope, angle, rate = wheels(7)
    accelerations, forces = each(rolling, m, inertia, r, slope, angle, rate)
    along = GRAVITY * np.sin(slope) / (1 + inertia / (m * r**2))
    close(r * accelerations[:, 2], along)
    friction = -m * GRAVITY * np.sin(slope) * inertia / (inertia + m * r**2)
    close(forces[:, 0], friction)
    close(forces[:, 1], m * GRAVITY * np.cos(slope))
    np.testing.assert_array_equal(forces[:, 2], 0)
    np.testing.assert_array_equal(accelerations[:, :2], 0)


def test_eccentric_wheel_obeys_newton_and_euler():
    """Forces move its centre of mass, and their moment about that turns it."""
    m, inertia, r, slope, angle, rate = wheels(11)
    c = 0.4
    accelerations, forces = each(functools.partial(rolling, offset=c), *wheels(11))
    alpha = np.asarray(accelerations[:, 2])
    sine, cosine = np.sin(angle), np.cos(angle)
    x_acceleration = r * alpha + c * (cosine * alpha - sine * rate**2)
    y_acceleration = -c * (sine * alpha + cosine * rate**2)
    friction, normal = forces[:, 0], forces[:, 1]
    close(friction + m * GRAVITY * np.sin(slope), m * x_acceleration, 1e-11)
    close(normal - m * GRAVITY * np.cos(slope), m * y_acceleration, 1e-11)
    # The contact is at (-c sin, -r - c cos) from the centre of mass; clockwise is positive.
    close((-r - c * cosine) * friction + c * sine * normal, inertia * alpha, 1e-11)


def test_eccentric_wheel_rolls_by_its_lagrangian():
    m, inertia, r, slope, angle, rate = wheels(13)
    c = 0.4
    accelerations, _ = each(functools.partial(rolling, offset=c), *wheels(13))
    sine, cosine = np.sin(angle), np.cos(angle)
    inertia = inertia + m * (r**2 + c**2 + 2 * r * c * cosine)
    gravity = m * GRAVITY * (np.sin(slope) * (r + c * cosine) + np.cos(slope) * c * sine)
    close(accelerations[:, 2], (gravity + m * r * c * sine * rate**2) / inertia)


def on_a_pivot(bars):
    """The same system on a pivot that can move: q = (pivot, q of the system)."""
    points = 2 * ((len(bars.masses) - 2) // 2)

    def transfer(q):
        x = bars.transfer(q[2:])
        return x + jnp.concatenate([jnp.tile(q[:2], points // 2), jnp.zeros_like(x[points:])])

    return System(transfer, bars.masses, bars.forces)


def test_forces_that_hold_a_pivot_are_what_newton_demands():
    """Their sum with gravity changes the momentum of all masses; the motion is as without them."""
    bars, (q, qdot) = two_bars(**BARS), states(15, 2)
    still = jnp.zeros_like(q)

    def look(q, qdot, q_all, qdot_all):
        alone = solve_motion(bars, q, qdot).accelerations
        accelerations, forces = solve_motion(on_a_pivot(bars), q_all, qdot_all, held=(0, 1))
        acceleration = multibody.velocity(bars.transfer, q, alone)
        acceleration += multibody.convective_acceleration(bars.transfer, q, qdot)
        demanded = bars.masses * acceleration - bars.forces
        return accelerations[2:], alone, forces, demanded[0:2] + demanded[2:4]

    all_q, all_qdot = jnp.concatenate([still, q], 1), jnp.concatenate([still, qdot], 1)
    held, alone, forces, demanded = each(look, q, qdot, all_q, all_qdot)
    close(held, alone)
    close(forces[:, :2], demanded, 1e-11)
    np.testing.assert_array_equal(forces[:, 2:], 0)


def test_tension_of_a_pendulum_on_its_pivot():
    """m (g cos + l rate^2), along the rod."""

    def transfer(q):
        return q[:2] + LENGTH * hanging(q[2])

    masses = jnp.full(2, 0.6)
    system = System(transfer, masses, weights(masses))
    (angle, *_), (rate, *_) = (s.T for s in states(17, 2))
    q, qdot = (jnp.stack([0 * x, 0 * x, x], 1) for x in (angle, rate))
    _, forces = each(lambda q, qdot: solve_motion(system, q, qdot, held=(0, 1)), q, qdot)
    tension = 0.6 * (GRAVITY * np.cos(angle) + LENGTH * rate**2)
    close(forces[:, 0], -tension * np.sin(angle))
    close(forces[:, 1], tension * np.cos(angle))


def test_a_locked_hinge_makes_one_body_of_two_and_takes_a_torque():
    """Bars in line: a compound pendulum, whose hinge carries what the second bar lacks."""
    bars = BARS
    q = jnp.stack([uniform(19, COUNT, low=-3, high=3), jnp.zeros(COUNT)], 1)
    qdot = jnp.stack([uniform(20, COUNT), jnp.zeros(COUNT)], 1)
    accelerations, forces = each(
        lambda q, qdot: solve_motion(two_bars(**bars), q, qdot, held=(1,)), q, qdot
    )
    reach = bars["l1"] + bars["c2"]
    first = bars["m1"] * bars["c1"] ** 2 + bars["I1"]
    second = bars["m2"] * reach**2 + bars["I2"]
    sine = np.sin(q[:, 0])
    moment = bars["m1"] * bars["c1"] + bars["m2"] * reach
    alpha = -GRAVITY * moment * sine / (first + second)
    close(accelerations[:, 0], alpha)
    torque = (bars["I2"] + bars["m2"] * bars["c2"] * reach) * alpha
    torque += bars["m2"] * GRAVITY * bars["c2"] * sine
    close(forces[:, 1], torque)


def test_held_coordinates_are_counted_from_either_end_in_any_order_and_once():
    bars = two_bars(**BARS)

    @kernel
    def results(q, qdot):
        some = solve_motion(bars, q, qdot, held=(1,)), solve_motion(bars, q, qdot, held=[-1, 1, 1])
        return (
            some,
            solve_motion(bars, q, qdot, held=[1, -2]),
            multibody.reduced_force(bars, q, qdot),
        )

    q, qdot = states(21, 2)
    (first, second), everything, force = results(q[0], qdot[0])
    close(first, second, 0)
    np.testing.assert_array_equal(everything.accelerations, 0)
    close(everything.forces, -force)


# Generalised forces


def test_spring_and_damper_on_a_mass():
    """m xddot = -k x - c xdot + m g, and what holds it is the opposite of that force."""
    m, k, c = 0.8, 3.0, 0.5

    def damped(q, qdot):
        return -k * q - c * qdot

    system = System(lambda q: q, jnp.array([m]), jnp.array([m * GRAVITY]), damped)
    x, v = states(23, 1)
    accelerations, forces = each(lambda q, qdot: solve_motion(system, q, qdot), x, v)
    close(accelerations, GRAVITY - (k * x + c * v) / m)
    np.testing.assert_array_equal(forces, 0)
    accelerations, forces = each(lambda q, qdot: solve_motion(system, q, qdot, held=(0,)), x, v)
    np.testing.assert_array_equal(accelerations, 0)
    close(forces, k * x + c * v - m * GRAVITY)


def test_power_of_a_damper_is_what_the_energy_loses():
    """d(T + V)/dt = Q qdot, of two bars."""

    def damped(q, qdot):
        return jnp.stack([-0.3 * qdot[0], -0.7 * qdot[1] * q[0] ** 2])

    system = two_bars(**BARS, springs=damped)

    def power(q, qdot):
        energy = lambda q, qdot: kinetic_energy(system, q, qdot) + potential_energy(system, q)
        accelerations, _ = solve_motion(system, q, qdot)
        change = jax.jvp(energy, (q, qdot), (qdot, accelerations))[1]
        return change, damped(q, qdot) @ qdot

    change, expected = each(power, *states(25, 2))
    assert np.all(expected < 0)
    close(change, expected, 1e-11)


def test_virtual_power_of_the_motion_is_zero_but_for_what_is_held():
    """(2): where it is held, the force that holds it makes up for it."""
    springs = lambda q, qdot: -0.4 * qdot + jnp.sin(q)
    system = two_bars(**BARS, springs=springs)
    choices = [(), (0,), (1,)]

    def look(q, qdot):
        for held in choices:
            accelerations, forces = solve_motion(system, q, qdot, held=held)
            acceleration = multibody.velocity(system.transfer, q, accelerations)
            acceleration += multibody.convective_acceleration(system.transfer, q, qdot)
            yield multibody.virtual_power(system, q, qdot, acceleration), forces

    results = each(lambda q, qdot: list(look(q, qdot)), *states(27, 2))
    for held, (power, forces) in zip(choices, results, strict=True):
        free = [i for i in range(2) if i not in held]
        close(power[:, free], 0, 1e-11)
        close(power, -forces, 1e-11)
        assert all(np.ptp(forces[:, i]) > 1 for i in held)


# Impact

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
            rod(M_ROD, I_ROD),
            lambda q: end(q)[1:],
            q,
            jnp.array([0.7, -v, 0.0]),
            restitution=e,
        )

    velocities, impulses = each(drop, angle)
    rho = (1 + e) * M_ROD * v / (1 + 3 * np.cos(angle) ** 2)
    close(impulses[:, 0], rho)
    close(velocities[:, 0], 0.7)
    close(velocities[:, 1], rho / M_ROD - v)
    close(velocities[:, 2], rho * HALF * np.cos(angle) / I_ROD)


def test_a_rod_whose_end_sticks_to_the_ground_keeps_its_angular_momentum_about_it():
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


# Energies


def test_kinetic_energy_is_the_quadratic_form_of_the_mass_matrix():
    system = two_bars(**BARS)

    def look(q, qdot):
        form = qdot @ multibody.mass_matrix(system, q) @ qdot / 2
        return kinetic_energy(system, q, qdot), form

    close(*each(look, *states(33, 2)))


def test_force_of_gravity_is_minus_the_slope_of_the_potential_energy():
    system = two_bars(**BARS)

    def look(q, _):
        slope = jax.grad(lambda q: potential_energy(system, q))(q)
        return multibody.reduced_force(system, q, jnp.zeros_like(q)), -slope

    close(*each(look, *states(35, 2)))


# Refusals


def plain(q):
    return q


def assert_one_line(error, *words):
    message = str(error.value)
    assert "\n" not in message and all(word in message for word in words), message


@pytest.mark.parametrize("mass", [-1.0, -1e-300, np.nan, np.inf, -np.inf])
def test_masses_that_are_none_are_refused(mass):
    with pytest.raises(ValueError) as error:
        System(plain, jnp.array([1.0, mass]), jnp.zeros(2))
    assert_one_line(error, "masses", str(mass))


@pytest.mark.parametrize("mass", [-1.0, np.nan])
def test_masses_that_are_none_give_nan_where_jax_traces(mass):
    @jax.jit
    def results(mass):
        system = System(plain, jnp.stack([jnp.ones(()), mass]), jnp.zeros(2))
        q = jnp.ones(2)
        return solve_motion(system, q, q).accelerations, impact(
            system, lambda q: q[1:], q, q
        ).velocities

    acceleration, velocity = results(mass)
    assert np.isnan(acceleration[1]) and np.isnan(velocity).all()
    assert np.isfinite(np.concatenate(results(2.0))).all()


@pytest.mark.parametrize("count", [1, 3])
def test_masses_and_forces_not_of_the_shape_of_the_transfer_function_are_refused(count):
    system = System(plain, jnp.ones(count), jnp.zeros(count))
    for use in (solve_motion, functools.partial(impact, contact=plain)):
        with pytest.raises(ValueError) as error:
            use(system, q=jnp.ones(2), qdot=jnp.ones(2))
        assert_one_line(error, "masses", "(2,)", f"({count},)")


def test_rates_not_of_the_shape_of_the_coordinates_are_refused():
    unchecked = inspect.unwrap(multibody.check_state)  # by the tests' own checks of types
    system = System(plain, jnp.ones(2), jnp.zeros(2))
    for q, qdot in [(jnp.ones(2), jnp.ones(3)), (jnp.ones((2, 1)), jnp.ones((2, 1)))]:
        with pytest.raises(ValueError) as error:
            unchecked(system, q, qdot)
        assert_one_line(error, "q and qdot", str(q.shape), str(qdot.shape))


@pytest.mark.parametrize("shape", [(), (1,), (3,), (2, 1)])
def test_generalised_forces_not_of_the_shape_of_the_coordinates_are_refused(shape):
    forces = lambda q, qdot: jnp.zeros(shape)
    system = System(plain, jnp.ones(2), jnp.zeros(2), forces)
    with pytest.raises(ValueError) as error:
        solve_motion(system, jnp.ones(2), jnp.ones(2))
    assert_one_line(error, "generalised_forces", "(2,)", str(shape))


@pytest.mark.parametrize("held", [(2,), (-3,), (0, 5)])
def test_coordinates_that_there_are_not_cannot_be_held(held):
    system = System(plain, jnp.ones(2), jnp.zeros(2))
    with pytest.raises(ValueError) as error:
        solve_motion(system, jnp.ones(2), jnp.ones(2), held=held)
    assert_one_line(error, "held", "2 coordinates", str(sorted(held)))


def test_a_contact_that_is_no_vector_is_refused():
    system = System(plain, jnp.ones(2), jnp.zeros(2))
    with pytest.raises(ValueError) as error:
        impact(system, lambda q: q[0], jnp.ones(2), jnp.ones(2))
    assert_one_line(error, "contact", "(g,)", "()")


@pytest.mark.parametrize("e", [-0.1, 1.0000001, np.nan, np.inf, -np.inf])
def test_restitution_beyond_its_bounds_is_refused_and_nan_where_jax_traces(e):
    system, q = System(plain, jnp.ones(2), jnp.zeros(2)), jnp.ones(2)
    with pytest.raises(ValueError) as error:
        impact(system, lambda q: q[1:], q, q, restitution=e)
    assert_one_line(error, "restitution", "between 0 and 1", str(e))
    results = bounce(e)
    assert np.isnan(results.velocities[1]) and np.isnan(results.impulses).all()


@jax.jit
def bounce(e):
    system, q = System(plain, jnp.ones(2), jnp.zeros(2)), jnp.ones(2)
    return impact(system, lambda q: q[1:], q, q, restitution=e)


def test_restitution_up_to_its_bounds_is_taken():
    for e in (0, 0.0, 1, 1.0, jnp.array(0.5)):
        expected = [1.0, -float(e)]
        close(bounce(jnp.asarray(e, float)).velocities, expected)
        system, q = System(plain, jnp.ones(2), jnp.zeros(2)), jnp.ones(2)
        unchecked = inspect.unwrap(impact)  # whole numbers are no floats to the checks of types
        after = unchecked(system, lambda q: q[1:], q, q, restitution=e)
        close(after.velocities, expected)


def tilted(small):
    """The second coordinate does almost what the first does."""
    return lambda q: jnp.stack([q[0] + q[1], small * q[1]])


@pytest.mark.parametrize(
    ("transfer", "masses", "words"),
    [
        (plain, [0.0, 1.0], ["singular", "q[0]"]),
        (plain, [1.0, 0.0], ["singular", "q[1]"]),
        (tilted(0.0), [1.0, 1.0], ["singular", "q[1]"]),
        (tilted(1e-6), [1.0, 1.0], ["ill-conditioned", "q[1]"]),
        (lambda q: tilted(1e-6)(q[::-1]), [1.0, 1.0], ["ill-conditioned", "q[1]"]),
    ],
)
def test_singular_and_ill_conditioned_mass_matrices_are_refused_by_coordinate(
    transfer, masses, words
):
    system, q = System(transfer, jnp.array(masses), jnp.ones(2)), jnp.array([0.5, 0.25])
    for use in (solve_motion, functools.partial(impact, contact=lambda q: q[:1])):
        with pytest.raises(ValueError) as error:
            use(system, q=q, qdot=q)
        assert_one_line(error, "mass matrix", "[0.5, 0.25]", *words)
        results = jax.jit(lambda q, use=use: use(system, q=q, qdot=q))(q)
        assert np.isnan(results[0]).any()
    worst = words[-1][2]
    with_it_held = solve_motion(system, q, q, held=(int(worst),))
    assert np.isfinite(np.concatenate(with_it_held)).all()


def test_what_is_scaled_badly_but_conditioned_well_is_taken():
    """Units do not matter."""
    scales = jnp.array([1e-9, 1.0, 1e9])
    q, qdot = states(37, 3)

    @jax.jit
    def accelerations(scales):
        shape = jnp.array([[1.0, 0.5, 0.2], [0.3, -1.0, 0.4], [0.1, 0.6, 1.0]])
        system = System(lambda q: jnp.sin(shape @ (q * scales)), jnp.ones(3), jnp.ones(3))
        q_scaled, qdot_scaled = (x[0] / scales for x in (q, qdot))
        return scales * solve_motion(system, q_scaled, qdot_scaled).accelerations

    expected = accelerations(jnp.ones(3))
    assert np.isfinite(expected).all()
    np.testing.assert_allclose(accelerations(scales), expected, rtol=1e-9)


def test_contacts_that_depend_on_each_other_are_refused():
    system, q = System(plain, jnp.ones(3), jnp.zeros(3)), jnp.ones(3)
    dependent = {
        "singular": (lambda q: jnp.stack([q[0], q[1], q[0] + q[1]]), "g[2]"),
        "ill-conditioned": (lambda q: jnp.stack([q[0], q[0] + 1e-7 * q[1]]), "g[1]"),
    }
    for kind, (contact, place) in dependent.items():
        with pytest.raises(ValueError) as error:
            impact(system, contact, q, q)
        assert_one_line(error, "contacts", kind, place)
        result = jax.jit(lambda q, contact=contact: impact(system, contact, q, q))(q)
        assert np.isnan(result.impulses).any() and np.isnan(result.velocities).any()


# Transformations


def test_results_are_the_same_compiled_and_mapped():
    system, (q, qdot) = double_pendulum(), states(39, 2)

    def both(q, qdot):
        tip = lambda q: system.transfer(q)[3:]
        return *solve_motion(system, q, qdot, held=(0,)), *impact(system, tip, q, qdot)

    for one, many in zip(both(q[0], qdot[0]), each(both, q, qdot), strict=True):
        close(one, many[0])


def test_derivatives_by_a_mass_and_a_state_agree_with_central_differences():
    q, qdot = states(41, 2)

    def results(mass, angle):
        system, start = double_pendulum(m2=mass), jnp.stack([angle, q[0, 1]])
        tip = lambda q: system.transfer(q)[2:3]
        after = impact(system, tip, start, qdot[0], restitution=0.4)
        return jnp.concatenate([*solve_motion(system, start, qdot[0]), *after])

    @kernel
    def look(*at):
        total = lambda *at: jnp.sum(results(*at))
        return results(*at), jax.jacfwd(results, (0, 1))(*at), jax.grad(total, (0, 1))(*at)

    mass, angle, h = jnp.asarray(0.7), q[0, 0], 1e-5
    _, forward, backward = look(mass, angle)
    by_mass = (look(mass + h, angle)[0] - look(mass - h, angle)[0]) / (2 * h)
    by_angle = (look(mass, angle + h)[0] - look(mass, angle - h)[0]) / (2 * h)
    assert np.max(np.abs(by_mass)) > 0.1 and np.max(np.abs(by_angle)) > 0.1
    np.testing.assert_allclose(forward, (by_mass, by_angle), rtol=1e-7, atol=1e-7)
    close(backward, np.sum(forward, axis=1), 1e-11)


def test_float32_gives_float32():
    q, qdot = states(43, 2)

    @kernel
    def both(masses, q, qdot):
        transfer, forces = two_bars(**BARS).transfer, weights(masses, points=2)
        system = System(transfer, masses, forces, lambda q, qdot: -0.5 * qdot)
        contact = lambda q: q[1:]
        after = impact(system, contact, q, qdot, restitution=0.5)
        energies = kinetic_energy(system, q, qdot), potential_energy(system, q)
        return solve_motion(system, q, qdot, held=(0,)), after, energies

    masses = two_bars(**BARS).masses
    double = both(masses, q[0], qdot[0])
    single = both(*(x.astype(jnp.float32) for x in (masses, q[0], qdot[0])))
    assert {leaf.dtype for leaf in jax.tree.leaves(single)} == {jnp.dtype("float32")}
    for a, b in zip(jax.tree.leaves(single), jax.tree.leaves(double), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-4, atol=1e-4)


def test_float32_refuses_sooner():
    """What has five digits left of sixteen has none of seven."""
    q = jnp.ones(2, jnp.float32)
    system = System(tilted(1e-3), jnp.ones(2, jnp.float32), jnp.ones(2, jnp.float32))
    with pytest.raises(ValueError, match=r"ill-conditioned.*q\[1\]"):
        solve_motion(system, q, q)
    double = System(tilted(1e-3), jnp.ones(2), jnp.ones(2))
    assert np.isfinite(solve_motion(double, jnp.ones(2), jnp.ones(2)).accelerations).all()

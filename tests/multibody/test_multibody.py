"""Equations of motion and of impact against SymPy's mechanics, Newton's laws and closed forms."""

import functools

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import sympy
from mechanisms import (
    BARS,
    COUNT,
    GRAVITY,
    close,
    each,
    hanging,
    states,
    two_bars,
    uniform,
    weights,
)
from sympy.physics import mechanics

from walker_jax import multibody
from walker_jax.kernels import kernel
from walker_jax.multibody import System, impact, kinetic_energy, potential_energy, solve_motion

# Against SymPy


def double_pendulum(m1=1.3, m2=0.7, l1=0.9, l2=1.4):
    """Two point masses on rods; both angles from the vertical."""

    def transfer(q):
        first = l1 * hanging(q[0])
        return jnp.concatenate([first, first + l2 * hanging(q[1])])

    one, two = jnp.asarray(m1), jnp.asarray(m2)
    masses = jnp.stack([one, one, two, two])
    return System(transfer, masses, weights(masses))


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


def test_wheel_rolls_by_its_closed_form_and_friction_holds_it():
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


def test_a_locked_hinge_makes_one_body_and_takes_a_torque():
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


def test_held_coordinates_count_from_either_end_in_any_order():
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


def test_virtual_power_is_zero_but_for_what_is_held():
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


# Energies


def test_kinetic_energy_is_the_form_of_the_mass_matrix():
    system = two_bars(**BARS)

    def look(q, qdot):
        form = qdot @ multibody.mass_matrix(system, q) @ qdot / 2
        return kinetic_energy(system, q, qdot), form

    close(*each(look, *states(33, 2)))


def test_gravity_is_minus_the_slope_of_the_potential_energy():
    system = two_bars(**BARS)

    def look(q, _):
        slope = jax.grad(lambda q: potential_energy(system, q))(q)
        return multibody.reduced_force(system, q, jnp.zeros_like(q)), -slope

    close(*each(look, *states(35, 2)))


# Transformations


def test_results_are_the_same_compiled_and_mapped():
    system, (q, qdot) = double_pendulum(), states(39, 2)

    def both(q, qdot):
        tip = lambda q: system.transfer(q)[3:]
        return *solve_motion(system, q, qdot, held=(0,)), *impact(system, tip, q, qdot)

    for one, many in zip(both(q[0], qdot[0]), each(both, q, qdot), strict=True):
        close(one, many[0])


def test_derivatives_by_a_mass_and_a_state_are_differences():
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

"""Mechanics that cannot be are refused in one line."""

import functools
import inspect

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from mechanisms import close, states

from walker_jax import multibody
from walker_jax.multibody import System, impact, solve_motion


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
def test_masses_and_forces_of_other_shapes_are_refused(count):
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
def test_generalised_forces_of_other_shapes_are_refused(shape):
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
def test_restitution_beyond_its_bounds_is_refused_or_nan(e):
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
def test_singular_mass_matrices_are_refused_by_coordinate(transfer, masses, words):
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


def test_float32_refuses_sooner():
    """What has five digits left of sixteen has none of seven."""
    q = jnp.ones(2, jnp.float32)
    system = System(tilted(1e-3), jnp.ones(2, jnp.float32), jnp.ones(2, jnp.float32))
    with pytest.raises(ValueError, match=r"ill-conditioned.*q\[1\]"):
        solve_motion(system, q, q)
    double = System(tilted(1e-3), jnp.ones(2), jnp.ones(2))
    assert np.isfinite(solve_motion(double, jnp.ones(2), jnp.ones(2)).accelerations).all()

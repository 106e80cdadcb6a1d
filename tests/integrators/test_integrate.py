"""The Taylor solver, integration up to a condition, roots of polynomials, refinement of events."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jax import lax
from polynomials import ascending
from scipy.integrate import solve_ivp
from solving import solve

from walker_jax.hybrid.crossings import Crossing, begins_below, rise_of
from walker_jax.integrators.integrator import Method, default_tolerance
from walker_jax.integrators.roots import bracketed_newton, derivative_of, polynomial_jet
from walker_jax.integrators.series import evaluate_polynomial
from walker_jax.integrators.step_lengths import step_size
from walker_jax.integrators.taylor import evaluate_series, is_list, solution_series
from walker_jax.integrators.taylor_steps import (
    SERIES_ORDER,
    Taylor,
)
from walker_jax.kernels import kernel

TOLERANCE = 1e-12

# Three equations with known solutions, of one state: an oscillator, y' = 4 t y, a pole at pi/2.


def rates(t, state, args):
    del args
    (q, p), grown, pole = state
    return (4 * p, -4 * q), 4 * t * grown, 1 + pole**2


START = ((jnp.array(1.0), jnp.array(0.0)), jnp.array(1.0), jnp.array(0.0))


def exact(t):
    return (np.cos(4 * t), -np.sin(4 * t)), np.exp(2 * t**2), np.tan(t)


def errors(times, states):
    """Largest error of each of the four variables, relative where it exceeds 1."""
    pairs = zip(jax.tree.leaves(states), jax.tree.leaves(exact(times)), strict=True)
    return np.array([np.max(np.abs(y - e) / np.maximum(np.abs(e), 1)) for y, e in pairs])


# The solver


def along(state):
    """The rates of the time and of the state."""
    time, y = state
    return jnp.ones_like(time), rates(time, y, None)


@pytest.mark.parametrize(("order", "steps"), [(3, 48), (6, 14)])
def test_error_falls_with_the_order_also_between_steps(order, steps):
    @jax.jit
    def step(state, length):
        series = solution_series(along, state, order)
        return [evaluate_series(series, part * length) for part in (1.0, 0.4)]

    def error_of(count):
        state, worst = (jnp.array(0.0), START), 0.0
        for _ in range(count):
            state, between = step(state, 1.0 / count)
            worst = np.maximum(worst, np.maximum(errors(*state), errors(*between)))
        return worst

    coarse, fine, finer = [error_of(steps * twice) for twice in (1, 2, 4)]
    assert np.all(finer > 1e-14)  # rounding has no part in it
    np.testing.assert_allclose(np.log2(coarse / fine), order, atol=0.35)
    np.testing.assert_allclose(np.log2(fine / finer), order, atol=0.25)


def test_steps_keep_the_tolerance_at_all_times():
    """Half way through each step too, where the rate is the right-hand side."""
    method = Method(along, Taylor(10), TOLERANCE)

    @jax.jit
    def step(state):
        series, end, length, _ = method.step(state, method.begin(state))
        slopes = jax.tree.map(derivative_of, series, is_leaf=is_list)
        return end, *(evaluate_series(one, length / 2) for one in (series, slopes))

    state, made = (jnp.array(0.0), START), 0
    while state[0] < 1.4:
        state, between, slope = step(state)
        made += 1
        assert np.all(errors(*state) < 1e-11) and np.all(errors(*between) < 1e-11)
        expected = rates(between[0], exact(between[0]), None)
        for one, right in zip(jax.tree.leaves(slope[1]), jax.tree.leaves(expected), strict=True):
            np.testing.assert_allclose(one, right, rtol=1e-9, atol=1e-9)
    assert 4 <= made < 60


def test_a_solution_follows_parameters_and_differentiates():
    """y' = a y: dy(1)/da = y(1), in float32 too."""

    @jax.jit
    def final(a):
        method = Method(lambda y: a * y, Taylor(8), 1e-12 if a.dtype == jnp.float64 else 1e-6)
        return solve(method, jnp.ones_like(a), jnp.ones_like(a))

    value, derivative = jax.jvp(final, (jnp.array(-0.7),), (jnp.array(1.0),))
    np.testing.assert_allclose((value, derivative), np.exp(-0.7), rtol=1e-10)
    low = final(jnp.array(-0.7, jnp.float32))
    assert low.dtype == jnp.float32
    assert low == pytest.approx(np.exp(-0.7), rel=1e-6)


# Step lengths and tolerances


def test_step_length_puts_the_last_terms_at_the_tolerance():
    """The exponential, c_k = 1/k!: |c_k| h^k <= tolerance, with equality for the worse term."""
    series = [jnp.array(1 / np.prod(np.arange(1.0, k + 1))) for k in range(13)]
    length = float(step_size(series, 1e-10))
    terms = np.array([float(series[k]) * length**k for k in (11, 12)])
    assert np.max(terms) == pytest.approx(1e-10, rel=1e-5)
    several = {"a": series, "b": [0.1 * c for c in series]}
    assert step_size(several, 1e-10) == pytest.approx(length)


@pytest.mark.parametrize("rate", [0.2, 5.0])
def test_step_length_is_relative_to_the_state_or_its_rate(rate):
    """Whichever is larger, of all variables: that takes the terms below its part of 1e-9."""
    series = {
        "a": [jnp.array([0.5, -1.0]), jnp.array([0.1, 0.0]), *[jnp.array([0.0, 3.0])] * 3],
        "b": [jnp.array(0.0), jnp.array(-rate), *map(jnp.array, (1e3, -40.0, 7.0))],
    }
    limit = 1e-9 * max(1.0, rate)
    expected = min((limit / 40) ** (1 / 3), (limit / 7) ** (1 / 4))
    assert step_size(series, 1e-9) == pytest.approx(expected, rel=1e-5)


def test_step_length_does_not_depend_on_units():
    """Of time or of length, where the rate does not exceed the state."""
    series = solution_series(lambda y: jnp.sin(y), jnp.array(1.0), 12)
    scaled = [1e-6 * c for c in series]
    slowed = [c * 2.0**-k for k, c in enumerate(series)]
    length = step_size(series, 1e-9)
    np.testing.assert_allclose(step_size(scaled, 1e-9), length, rtol=1e-6)
    np.testing.assert_allclose(step_size(slowed, 1e-9), 2 * length, rtol=1e-6)


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64, "float32", np.dtype("float64")])
def test_default_tolerances_lie_above_what_the_dtype_holds(dtype):
    tolerance = default_tolerance(dtype)
    assert jnp.finfo(dtype).eps < tolerance < 1e3 * jnp.finfo(dtype).eps * 10
    assert default_tolerance(dtype, 1e-3) == 1e-3


@pytest.mark.parametrize(
    ("dtype", "tolerance"),
    [
        (jnp.float32, 1e-9),
        (jnp.float64, 1e-18),
        (jnp.float64, 0.0),
        (jnp.float64, -1e-9),
        (jnp.float64, 1.0),
        (jnp.float64, np.nan),
        (jnp.float64, np.inf),
    ],
)
def test_tolerances_that_the_dtype_cannot_hold_are_refused(dtype, tolerance):
    with pytest.raises(ValueError, match="tolerance") as error:
        default_tolerance(dtype, tolerance)
    assert f"{tolerance:g}" in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize("dtype", [jnp.float16, jnp.int32, jnp.complex128])
def test_other_dtypes_are_refused(dtype):
    with pytest.raises(ValueError, match=jnp.dtype(dtype).name):
        default_tolerance(dtype)


# Single steps


def oscillator(state):
    q, p = state
    return p, -q


def three_body_like(state):
    """Rigid body: Euler's equations, an odd number of variables."""
    x, y, z = state
    return y * z, -2 * z * x, x * y


@pytest.fixture(scope="module")
def single_steps():
    """One step at a time of Euler's equations: times and states at step ends."""
    method = Method(three_body_like, Taylor(SERIES_ORDER[jnp.dtype("float64")]), TOLERANCE)
    take = kernel(lambda state: method.step(state, method.begin(state))[1:3])
    state = jnp.array(1.0), jnp.array(0.4), jnp.array(0.9)
    times, states = [0.0], [state]
    for _ in range(12):
        state, length = take(state)
        times.append(times[-1] + float(length))
        states.append(state)
    return np.array(times), np.array(states)


def test_steps_equal_a_runge_kutta_solution(single_steps):
    times, states = single_steps
    solution = solve_ivp(
        lambda t, y: three_body_like(y),
        (0, times[-1]),
        states[0],
        method="DOP853",
        rtol=1e-13,
        atol=1e-13,
        t_eval=times,
    )
    np.testing.assert_allclose(states, solution.y.T, atol=2e-11)
    x, y, z = states.T
    for conserved in (x**2 - z**2, 2 * x**2 + y**2):
        np.testing.assert_allclose(conserved, conserved[0], rtol=1e-11)


# Roots of polynomials


@pytest.fixture(scope="module")
def rise():
    """Upcrossings of a batch of polynomials of degree 6, (n, 7), in steps of lengths (n,)."""

    @kernel  # each search ends for itself: some take a hundred thousand hops
    def first(p, length):
        value, always = list(p), jnp.asarray(True)
        ends_below = evaluate_polynomial(value, length) < 0
        return rise_of(Crossing(value, [], begins_below(value), ends_below, always), length)

    def padded(polynomials, lengths):
        count = len(polynomials)
        array, times = np.zeros((1000, 7)), np.ones(1000)
        for i, p in enumerate(polynomials):
            array[i, : len(p)] = p
        times[:count] = lengths
        rises, roots = jax.vmap(first)(array, times)
        return np.asarray(rises)[:count], np.asarray(roots)[:count]

    return padded


RISES = {  # polynomial, length of the step, root
    "line": (ascending(0.3), 1.0, 0.3),
    "cubic": (ascending(0.7, factor=(1.0, 0.0, 1.0)), 1.0, 0.7),
    "dip": (ascending(0.2, 0.6), 1.0, 0.6),
    "dip of 1e-12": (ascending(0.4 - 1e-6, 0.4 + 1e-6), 1.0, 0.4 + 1e-6),
    "dip just after the start": (ascending(0.0, 1e-7), 1.0, 1e-7),
    "dip just before the end": (ascending(0.9, 1 - 1e-12), 1.0, 1 - 1e-12),
    "starts at a falling zero": (ascending(0.0, 0.8), 1.0, 0.8),
    "ends at the root": (ascending(0.5, 1.0), 1.0, 1.0),
    "tiny step": (ascending(3e-9), 1e-8, 3e-9),
    "tiny coefficients": (1e-150 * ascending(0.2, 0.6), 1.0, 0.6),
    "triple root": (ascending(0.5, 0.5, 0.5), 1.0, 0.5),
    "dip, of degree 6": (ascending(0.3, 0.5, factor=(1.0, 0.5, 2.0, -1.0, 3.0)), 1.0, 0.5),
}
STAYS = {
    "positive": (ascending(-1.0), 1.0),
    "turns above zero": (np.array([0.25 + 1e-12, -1.0, 1.0]), 1.0),
    "starts at a rising zero": (ascending(0.0, -1.0), 1.0),
    "falls all the way but stays above": (np.array([2.0, -1.0]), 1.0),
    "root before the step": (ascending(-0.5, -0.2), 1.0),
    "dip after the step": (ascending(1.2, 1.4), 1.0),
    "zero throughout": (np.zeros(7), 1.0),
}


def test_first_rise_finds_the_roots_it_should(rise):
    polynomials, lengths, roots = zip(*RISES.values(), strict=True)
    rises, found = rise(polynomials, lengths)
    assert rises.all(), np.array(list(RISES))[~rises]
    # The root of a triple zero is known to the cube root of the rounding only.
    tolerance = np.where(np.array(list(RISES)) == "triple root", 1e-5, 1e-10) * np.array(lengths)
    assert np.all(np.abs(found - roots) <= tolerance), found - roots


def test_first_rise_finds_none_where_there_is_none(rise):
    polynomials, lengths = zip(*STAYS.values(), strict=True)
    rises, times = rise(polynomials, lengths)
    assert not rises.any(), np.array(list(STAYS))[rises]
    np.testing.assert_array_equal(times, lengths)


def test_a_double_root_is_no_rise_but_two_near_ones_are(rise):
    where = np.linspace(0.05, 0.95, 200)
    for sign in (1, -1):  # touched from above, and from below
        rises, times = rise([sign * ascending(a, a) for a in where], np.ones(200))
        assert not rises.any() and np.all(times == 1)
    for apart in (1e-6, 1e-5):
        rises, times = rise([ascending(a - apart, a + apart) for a in where], np.ones(200))
        assert rises.all()
        np.testing.assert_allclose(times, where + apart, rtol=0, atol=1e-9)
        above = [ascending(a, a) + np.array([apart**2, 0, 0]) for a in where]
        assert not rise(above, np.ones(200))[0].any()


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), size=st.sampled_from([1.0, 1e-8, 1e8]))
def test_first_rise_ends_always_and_is_right_where_meant(rise, seed, size):
    rng = np.random.default_rng(seed)
    polynomials = rng.normal(size=(1000, 7)) * 10 ** rng.uniform(-3, 1, (1000, 7)) * size
    polynomials *= rng.random((1000, 7)) < rng.uniform(0.2, 1)
    rises, times = rise(polynomials, np.ones(1000))
    assert np.all((times > 0) & (times <= 1) | (polynomials[:, 0] >= 0))
    for p, rising, time in zip(polynomials[:100], rises, times, strict=False):
        roots = np.roots(p[::-1])
        turns = np.roots(np.polyder(p[::-1]))
        if any(np.abs(r.imag) < 1e-3 and r.imag != 0 for r in [*roots, *turns]):
            continue  # too close a call
        roots = np.sort(roots[np.isreal(roots) & (roots.real > 0) & (roots.real < 1)].real)
        turns = turns[np.isreal(turns) & (turns.real > 0) & (turns.real < 1)]
        starts_level = np.any(p[:2] == 0)
        if starts_level or np.sum(p) <= 0 or len(turns) > 1 or np.any(np.diff(roots) < 1e-6):
            continue  # not what it is for
        assert rising == (len(roots) > 0)
        assert time == pytest.approx(roots[-1] if rising else 1, abs=1e-7)


def test_rising_root_of_functions_that_are_not_polynomials():
    def root(function, low, high):
        return bracketed_newton(function, jnp.array(low), jnp.array(high))

    def atan(t):  # from so far Newton's iteration runs away
        return jnp.arctan(t - 2), 1 / (1 + (t - 2) ** 2)

    def kink(t):
        return jnp.where(t < 1, -1.0, t - 1), jnp.where(t < 1, 0.0, 1.0)

    assert root(lambda t: (t**2 - 2, 2 * t), 0.0, 2.0) == pytest.approx(np.sqrt(2), rel=1e-15)
    assert root(lambda t: (jnp.exp(t) - 1, jnp.exp(t)), -3.0, 30.0) == pytest.approx(0, abs=1e-14)
    assert root(atan, -50.0, 80.0) == pytest.approx(2, rel=1e-14)
    assert root(kink, 0.0, 3.0) == pytest.approx(1, rel=1e-14)
    assert root(lambda t: (t, jnp.ones_like(t)), 0.5, 0.5) == 0.5
    assert root(lambda t: (t - 3, jnp.ones_like(t)), 1.0, 3.0) == 3.0


def test_value_slope_and_curvature_of_a_polynomial():
    t = jnp.array(0.7)
    np.testing.assert_allclose(polynomial_jet([t, t, t])(jnp.array(2.0)), (4.9, 3.5, 1.4))


def test_first_rise_is_a_constant_to_derivatives():
    def root(a):
        value, yes = [-a, jnp.ones_like(a), jnp.zeros_like(a)], jnp.asarray(True)
        return rise_of(Crossing(value, [], yes, ~yes, yes), jnp.array(1.0)).time

    value, derivative = jax.jvp(root, (jnp.array(0.3),), (jnp.array(1.0),))
    assert value == pytest.approx(0.3, rel=1e-15) and derivative == 0


# Landing


def assert_same_derivatives(function, expected, p, order):
    """Derivatives of orders 0 to `order` by a vector; ten directions determine them."""
    directions = np.random.default_rng(0).normal(size=(10, len(p)))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)

    def along(function):
        return lambda p, v: jax.jvp(lambda p: function(p, v), (p,), (v,))

    both = lambda p, v: (function(p), expected(p))
    for _ in range(order):
        both = along(both)
    results = jax.tree.leaves(jax.jit(jax.vmap(both, (None, 0)))(p, directions))
    for found, right in zip(results[::2], results[1::2], strict=True):
        np.testing.assert_allclose(found, right, rtol=1e-11, atol=1e-11)


def landing(vector_field, event, start, time, order):
    """(z, v) and time where the event is zero, `time` being what is known of the latter."""
    near = evaluate_series(solution_series(vector_field, start, order), lax.stop_gradient(time))
    state, delay = Method(vector_field, Taylor(order), TOLERANCE).refine_event(event, near)
    return jnp.stack([*state, lax.stop_gradient(time) + delay])


def test_landing_of_a_ball_with_its_derivatives():
    """z'' = -g from height z with speed v: t = (v + sqrt(v^2 + 2 g z)) / g."""

    def time(p):
        z, v, g = p
        return (v + jnp.sqrt(v**2 + 2 * g * z)) / g

    def land_it(p):
        z, v, g = p

        def fall(state):
            return state[1], -g * jnp.ones_like(state[1])

        return landing(fall, lambda state: -state[0], (z, v), time(p), order=4)

    def expected(p):
        z, v, g = p
        return jnp.stack([jnp.zeros_like(z), -jnp.sqrt(v**2 + 2 * g * z), time(p)])

    assert_same_derivatives(land_it, expected, jnp.array([0.7, 0.4, 1.3]), order=4)


class Fall(NamedTuple):
    z: Any
    v: Any
    note: Any = None


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_rates_need_not_have_the_structure_or_type_of_a_state(dtype):
    """A list with an integer, of a state with nothing in one place."""
    method = Method(lambda state: [state.v, -1], Taylor(4), 1e-6)
    along = jax.jvp(
        lambda z: method.refine_event(lambda y: -y.z, Fall(z, -2 + 0 * z)),
        (jnp.zeros((), dtype),),
        (jnp.ones((), dtype),),
    )
    (end, delay), (change, later) = along
    assert end.note is None and end.z == 0 and end.v == -2 and delay == 0
    # Higher by 1 at the speed 2, it lands 1/2 later, faster by g / 2.
    assert change.z == 0 and change.v == -0.5 and later == 0.5 and later.dtype == dtype


def test_landing_of_an_oscillator_on_a_level_that_is_varied_too():
    """q = r cos(t - a) falls to the level c at t = a + acos(c / r)."""

    def time(p):
        q, rate, level = p
        return jnp.arctan2(rate, q) + jnp.arccos(level / jnp.sqrt(q**2 + rate**2))

    def land_it(p):
        q, rate, level = p
        return landing(oscillator, lambda state: level - state[0], (q, rate), time(p), order=14)

    def expected(p):
        q, rate, level = p
        return jnp.stack([level, -jnp.sqrt(q**2 + rate**2 - level**2), time(p)])

    assert_same_derivatives(land_it, expected, jnp.array([0.6, 0.1, 0.45]), order=2)

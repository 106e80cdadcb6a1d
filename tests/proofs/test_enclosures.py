"""Arithmetic of enclosures, against exact rational numbers and forty digits."""

from fractions import Fraction

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest

import walker_jax as wj
from walker_jax.integrators.series import sincos as own_sincos
from walker_jax.kernels import kernel
from walker_jax.kernels.jaxprs import UnsupportedPrimitive
from walker_jax.proofs import elementary, enclosures
from walker_jax.proofs.elementary import enclose_sine_and_cosine
from walker_jax.proofs.enclosures import (
    BALLS,
    Enclosure,
    Space,
    ball,
    interval_between,
    monomials,
    rounded_once,
)
from walker_jax.proofs.evaluation import evaluate
from walker_jax.proofs.provable import check_provable, enclose_parameters

PLANE = Space(2, 2)
OPERATIONS = {
    "sum": lambda a, b: a + b,
    "difference": lambda a, b: a - b,
    "product": lambda a, b: a * b,
    "quotient": lambda a, b: a / b,
}
CORNERS = [0.0, 5e-324, 1e-310, 2.0**-1022, 1e-160, 1.0, 1 + 2.0**-52, 1 / 3, 1e150]


def corner_pairs() -> np.ndarray:
    signed = [s * c for c in CORNERS for s in (1, -1)]
    return np.array([(a, b) for a in signed for b in signed]).T


def random_numbers(rng, count: int) -> np.ndarray:
    return rng.normal(size=count) * 10.0 ** rng.integers(-12, 12, count)


def exact_misses(operation, a: np.ndarray, b: np.ndarray, found: Enclosure) -> int:
    """Results of exact arithmetic that an enclosure does not hold."""
    radius = np.broadcast_to(found.radius, np.shape(found.terms[0]))
    misses = 0
    for x, y, middle, r in zip(a, b, found.terms[0], radius, strict=True):
        if np.isfinite(middle) and np.isfinite(r):
            true = operation(Fraction(x), Fraction(y))
            misses += abs(true - Fraction(middle)) > Fraction(r)
    return misses


def check_operation(name: str, count: int, seed: int, calculate=None) -> int:
    """The misses of an operation on exact numbers, random ones and corners."""
    rng = np.random.default_rng(seed)
    a, b = random_numbers(rng, count), random_numbers(rng, count)
    # neighbours, whose difference cancels
    b[: count // 4] = a[: count // 4] * (1 + rng.integers(-3, 4, count // 4) * 2.0**-52)
    pairs = np.concatenate([[a, b], corner_pairs()], axis=1)
    if name == "quotient":
        pairs = pairs[:, pairs[1] != 0]
    operation = OPERATIONS[name]
    with np.errstate(all="ignore"):
        enclose = lambda x, y: operation(ball(x, 0.0), ball(y, 0.0))
        found = calculate(enclose, pairs[0], pairs[1]) if calculate else enclose(pairs[0], pairs[1])
    return exact_misses(operation, pairs[0], pairs[1], found)


@pytest.mark.parametrize("name", OPERATIONS)
def test_operations_hold_the_exact_results(name):
    assert check_operation(name, 3000, seed=1) == 0


@pytest.mark.slow
@pytest.mark.parametrize("name", OPERATIONS)
def test_operations_hold_a_million_exact_results(name):
    assert check_operation(name, 1_000_000, seed=2) == 0


def in_a_kernel(function, *pairs):
    """The same by machine code, where a product and a sum may be contracted to one operation."""
    one = lambda x, y: (lambda found: (found.terms[0], found.radius + 0 * x))(function(x, y))
    middle, radius = jax.jit(jax.vmap(kernel(one)))(*map(jnp.asarray, pairs))
    return ball(np.asarray(middle), np.asarray(radius))


@pytest.mark.parametrize("name", OPERATIONS)
def test_kernels_hold_the_exact_results(name):
    assert check_operation(name, 3000, seed=3, calculate=in_a_kernel) == 0


@pytest.mark.parametrize("part", ["ROUNDING", "TINY"])
def test_a_rounding_left_out_is_seen(monkeypatch, part):
    """Operations off by one rounding: the same test fails."""
    monkeypatch.setattr(enclosures, part, 0.0)
    assert check_operation("product", 3000, seed=1) > 0


def test_a_growth_left_out_is_seen(monkeypatch):
    """Radii have roundings too: their sum, rounded down, is no bound of a sum."""
    sums = lambda: evaluate_radius(ball(0.0, 1.0) + ball(0.0, 2.0**-53))
    assert sums() >= 1 + Fraction(2) ** -53
    monkeypatch.setattr(enclosures, "GROWTH", 1.0)
    assert sums() < 1 + Fraction(2) ** -53


def evaluate_radius(one: Enclosure) -> Fraction:
    return Fraction(one.radius)


def random_model(rng, count: int, space: Space) -> Enclosure:
    terms = [rng.normal(size=count) * 0.3 ** sum(p) for p in monomials(space)]
    return Enclosure(terms, np.abs(rng.normal(size=count)) * 1e-3, space)


def value_at(one: Enclosure, i: int, u: list[Fraction], error: int) -> Fraction:
    """A value that an enclosure stands for, at some u; with its error at one end."""
    value = Fraction(float(np.broadcast_to(one.radius, np.shape(one.terms[0]))[i])) * error
    for powers, term in zip(monomials(one.space), one.terms, strict=True):
        product = Fraction(0.0 if term is None else float(term[i]))
        for x, p in zip(u, powers, strict=True):
            product *= x**p
        value += product
    return value


@pytest.mark.parametrize("space", [Space(2, 1), PLANE, Space(3, 2), Space(1, 3)])
@pytest.mark.parametrize("name", ["sum", "product", "quotient"])
def test_polynomials_hold_the_exact_results(name, space):
    rng, count = np.random.default_rng(5), 60
    a, b = random_model(rng, count, space), random_model(rng, count, space)
    b = b + 4.0
    found = OPERATIONS[name](a, b)
    for i in range(count):
        u = [Fraction(float(x)) for x in rng.choice([-1, -0.7, 0.1, 1], space.variables)]
        for ea, eb in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
            true = OPERATIONS[name](value_at(a, i, u, ea), value_at(b, i, u, eb))
            off = abs(true - value_at(found, i, u, 0))
            assert off <= Fraction(float(found.radius[i]))


@pytest.mark.parametrize("space", [BALLS, Space(1, 1), PLANE])
def test_bounds_hold_all_values(space):
    """Of values far from zero too, whose last digits are larger than what they vary by."""
    rng, count = np.random.default_rng(10), 200
    one = random_model(rng, count, space)
    scale = 10.0 ** rng.uniform(-17, 0, count)
    small = Enclosure([one.terms[0], *[t * scale for t in one.terms[1:]]], scale, space)
    for i in range(count):
        ends = [[Fraction(s * np.sign(t[i])) for t in small.terms[1:3]] for s in (-1, 1)]
        values = [
            value_at(small, i, u[: space.variables], e) for u, e in zip(ends, (-1, 1), strict=True)
        ]
        assert Fraction(small.lower[i]) <= min(values) and max(values) <= Fraction(small.upper[i])
        assert max(map(abs, values)) <= Fraction(small.magnitude[i])


def test_a_quotient_by_what_may_be_zero_has_no_bounds():
    for radius in (1.0, 2.0):
        with np.errstate(all="ignore"):
            found = 1.0 / ball(np.array([1.0]), radius)
        assert found.radius[0] == np.inf and not found.lower[0] > 0


def test_constants_hold_all_numbers_that_round_to_them():
    """But whole ones are exact."""
    tenth = rounded_once(0.1, BALLS)
    assert 0 < abs(Fraction(tenth.midpoint) - Fraction(1, 10)) <= Fraction(tenth.radius)
    assert rounded_once(2.0, BALLS).radius == 0


def test_powers_may_be_negative():
    found = evaluate(lambda x: x**-2 + x**3, ball(np.array([2.0]), 0.0))
    assert abs(found.midpoint[0] - 8.25) <= found.radius[0] < 1e-13


def ends_left_out() -> int:
    rng = np.random.default_rng(11)
    low = rng.normal(size=2000)
    high = low + 10.0 ** rng.uniform(-17, 0, 2000)
    found = interval_between(low, high)
    middle, radius = np.asarray(found.midpoint), np.asarray(found.radius)
    values = zip(low.tolist(), high.tolist(), middle.tolist(), radius.tolist(), strict=True)
    return sum(
        max(abs(Fraction(a) - Fraction(m)), abs(Fraction(b) - Fraction(m))) > Fraction(r)
        for a, b, m, r in values
    )


def test_intervals_hold_their_ends(monkeypatch):
    assert ends_left_out() == 0
    monkeypatch.setattr(enclosures, "ROUNDING", 0.0)
    assert ends_left_out() > 0


def test_sums_of_products_hold_the_exact_results():
    """Next to powers of two a sum of products may be off by the roundings of all of them."""
    rng, space, count = np.random.default_rng(8), Space(1, 4), 1000
    near = lambda: 1 + 2.0**-52 * rng.integers(0, 2**26, count)
    a, b = (Enclosure([near(), near(), near(), None, None], 0.0, space) for _ in range(2))
    found = a * b
    for i in range(count):
        true = value_at(a, i, [Fraction(1)], 0) * value_at(b, i, [Fraction(1)], 0)
        assert abs(true - value_at(found, i, [Fraction(1)], 0)) <= Fraction(float(found.radius[i]))


def sine_misses(count: int, space: Space, seed: int) -> int:
    rng = np.random.default_rng(seed)
    middle = rng.uniform(-1, 1, count) * 10.0 ** rng.integers(-8, 5, count)
    middle[:40] = np.arange(40) * np.pi / 4
    terms = [middle, *[rng.normal(size=count) * 0.1 for _ in monomials(space)[1:]]]
    x = Enclosure(terms, np.abs(rng.normal(size=count)) * 1e-9, space)
    with np.errstate(all="ignore"):
        results = enclose_sine_and_cosine(x)
    misses = 0
    with mpmath.workdps(40):
        for i in range(count):
            u = [Fraction(float(v)) for v in rng.choice([-1, 0.3, 1], space.variables)]
            angle = value_at(x, i, u, int(rng.choice([-1, 1])))
            angle = mpmath.mpf(angle.numerator) / angle.denominator
            for found, function in zip(results, (mpmath.sin, mpmath.cos), strict=True):
                about = value_at(found, i, u, 0)
                off = abs(function(angle) - mpmath.mpf(about.numerator) / about.denominator)
                misses += off > found.radius[i]
    return misses


@pytest.mark.parametrize("space", [BALLS, Space(2, 1), PLANE])
def test_sines_hold_the_true_ones(space):
    assert sine_misses(600, space, seed=6) == 0


def test_a_remainder_left_out_is_seen(monkeypatch):
    """Without the remainder of the series of sine and cosine the same test fails."""
    monkeypatch.setattr(elementary, "TERMS", 6)
    assert sine_misses(600, BALLS, seed=6) == 0
    monkeypatch.setattr(elementary, "remainder_of_series", lambda odd: 0.0)
    assert sine_misses(600, BALLS, seed=6) > 0


def angles_reduced_in_error() -> int:
    """Angles whose distance from the nearest quarter turn is not in its interval."""
    rng = np.random.default_rng(9)
    x = rng.uniform(-1, 1, 2000) * 10.0 ** rng.uniform(-2, 5.9, 2000)
    turns, y = elementary.reduce_angle(x)
    middle, radius = np.asarray(y.midpoint), np.asarray(y.radius)
    with mpmath.workdps(40):
        rest = [mpmath.mpf(a) - k * mpmath.pi / 2 for a, k in zip(x.tolist(), turns, strict=True)]
        off = [abs(a - b) for a, b in zip(rest, middle.tolist(), strict=True)]
    assert np.all(y.magnitude <= elementary.REDUCED)
    return sum(a > b for a, b in zip(off, radius.tolist(), strict=True))


@pytest.mark.parametrize("part", ["ROUNDING", "REST_OF_HALF_PI"])
def test_reduced_angles_hold_the_true_ones(monkeypatch, part):
    assert angles_reduced_in_error() == 0
    monkeypatch.setattr(elementary, part, 0.0)
    assert angles_reduced_in_error() > 0


def test_beyond_the_reduction_nothing_is_claimed():
    sine, _ = enclose_sine_and_cosine(ball(np.array([1e8]), 0.0))
    assert sine.lower <= -1 and sine.upper >= 1


def test_a_jax_function_is_enclosed_as_it_stands():
    def function(x, y):
        return jnp.sin(x) ** 3 / (1 + y**2) - 0.1 * x

    rng = np.random.default_rng(7)
    x, y = rng.normal(size=(2, 200))
    found = evaluate(function, ball(x, 1e-7), ball(y, 1e-7))
    with mpmath.workdps(40):
        for i in range(200):
            a, b = mpmath.mpf(x[i]) + mpmath.mpf("1e-7"), mpmath.mpf(y[i]) - mpmath.mpf("1e-7")
            true = mpmath.sin(a) ** 3 / (1 + b**2) - a / 10
            assert abs(true - found.midpoint[i]) <= found.radius[i]
    assert np.all(found.radius < 1e-6)


def test_numbers_that_are_not_finite_prove_nothing():
    one = ball(np.array([1e200]), 0.0)
    with np.errstate(all="ignore"):
        cube = one * one * one
        assert not (cube.lower > 0) and not (cube.upper < 0)


def test_integers_and_stopped_gradients_are_refused():
    """An integer is a float cut off; and another `sincos` is not the package's own."""
    x = ball(np.array([0.5]), 0.0)
    with pytest.raises(UnsupportedPrimitive, match="proofs need float64 throughout, not int"):
        evaluate(lambda x: x.astype(int).astype(float), x)
    with pytest.raises(UnsupportedPrimitive, match="stop_gradient"):
        evaluate(jax.lax.stop_gradient, x)

    @jax.jit
    def sincos(x):
        return 2 * x, 3 * x

    double, triple = evaluate(sincos, x)
    assert double.midpoint == 1.0 and triple.midpoint == 1.5
    sine, _ = evaluate(own_sincos, x)
    assert abs(sine.midpoint - np.sin(0.5)) < 1e-15


def test_whole_parameters_are_rounded_too():
    """A parameter of 1 stands for all numbers that round to it, in kernels and in NumPy."""
    known = enclose_parameters(check_provable(wj.SpringWalker(0.004, 1.0)), BALLS)
    assert known.hip_stiffness.radius >= 2.0**-53

"""Kernels compute what JAX computes, cell by cell."""

import json
import subprocess
import sys
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from compiler_flags import AS_USERS
from jax import lax
from jax.scipy.special import erf, erfc

from walker_jax.kernels import compiled
from walker_jax.kernels.compiled import Compiled
from walker_jax.kernels.elementary import exp_float32, log_float32
from walker_jax.kernels.entries import ENTRYWISE
from walker_jax.kernels.jaxprs import UnsupportedPrimitive
from walker_jax.kernels.rules import RULES

SPECIAL = [0.0, -0.0, 1.0, -1.0, 0.5, np.inf, -np.inf, np.nan, 1e300, -1e-300, 2.5, -3.5]


def values(dtype, n=203, seed=0):
    rng = np.random.default_rng(seed)
    drawn = rng.normal(size=n) * 10.0 ** rng.integers(-3, 3, n)
    with np.errstate(over="ignore"):
        return np.concatenate([SPECIAL, drawn]).astype(dtype)


def run(function, *cells, shared=()):
    """By a kernel; cells are arrays with one number, or more, for each."""
    like = [jax.ShapeDtypeStruct(np.shape(x), np.asarray(x).dtype) for x in shared]
    like += [jax.ShapeDtypeStruct(x.shape[1:], x.dtype) for x in cells]
    closed, shapes = jax.make_jaxpr(function, return_shape=True)(*like)
    mapped = [False] * len(shared) + [True] * len(cells)
    compute, results = Compiled(closed).bind([*shared, *cells], mapped, len(cells[0]))
    compute(0, len(cells[0]))
    return jax.tree.unflatten(jax.tree.structure(shapes), results)


def of_both(function, *cells, shared=()):
    """The results of a kernel, and those of JAX, by the code that XLA makes for users."""
    mapped = jax.jit(jax.vmap(lambda *cell: function(*shared, *cell)), compiler_options=AS_USERS)
    expected = mapped(*map(jnp.asarray, cells))
    return run(function, *cells, shared=shared), jax.tree.map(np.asarray, expected)


def assert_same(function, *cells, ulps=4, shared=()):
    assert_equal(*of_both(function, *cells, shared=shared), ulps)


def of_all(functions, *cells):
    """The same of several functions, which are compiled as one."""
    return of_both(lambda *cell: {name: f(*cell) for name, f in functions.items()}, *cells)


def assert_equal(found, expected, ulps=4):
    for one, other in zip(*map(jax.tree.leaves, (found, expected)), strict=True):
        assert one.dtype == other.dtype and one.shape == other.shape
        if one.dtype.kind == "f":
            eps = np.finfo(one.dtype).eps
            np.testing.assert_allclose(one, other, rtol=ulps * eps, atol=0)
        else:
            np.testing.assert_array_equal(one, other)


ONE = {
    "abs": jnp.abs,
    "neg": lambda x: -x,
    "sqrt": jnp.sqrt,
    "rsqrt": lax.rsqrt,
    "floor": jnp.floor,
    "ceil": jnp.ceil,
    "sign": jnp.sign,
    "square": jnp.square,
    "to even": lambda x: lax.round(x, lax.RoundingMethod.TO_NEAREST_EVEN),
    "away from zero": lambda x: lax.round(x, lax.RoundingMethod.AWAY_FROM_ZERO),
    "power 5": lambda x: lax.integer_pow(x, 5),
    "power -2": lambda x: lax.integer_pow(x, -2),
    "power 0": lambda x: lax.integer_pow(x, 0),
    "is finite": jnp.isfinite,
    "clamp": lambda x: lax.clamp(jnp.asarray(-1, x.dtype), x, jnp.asarray(2, x.dtype)),
    "to int32": lambda x: x.astype(jnp.int32),
    "to int8": lambda x: x.astype(jnp.int8),
    "to uint8": lambda x: x.astype(jnp.uint8),
    "to bool": lambda x: x.astype(bool),
    "to float32 and back": lambda x: x.astype(jnp.float32).astype(x.dtype) * 2,
    "exp": jnp.exp,
    "exp2": jnp.exp2,
    "expm1": jnp.expm1,
    "log": jnp.log,
    "log1p": jnp.log1p,
    "log2": jnp.log2,
    "cbrt": jnp.cbrt,
    "sin": jnp.sin,
    "cos": jnp.cos,
    "tan": jnp.tan,
    "arcsin": jnp.arcsin,
    "arccos": jnp.arccos,
    "arctan": jnp.arctan,
    "sinh": jnp.sinh,
    "cosh": jnp.cosh,
    "tanh": jnp.tanh,
    "slope of arctanh": lambda x: jax.grad(jnp.arctanh)(0.9 * x / (1 + abs(x))),
    "polynomial": lambda x: jnp.polyval(jnp.array([1, 1, 2], x.dtype), jnp.clip(x, -9, 9)),
    "arcsinh": jnp.arcsinh,
    "arccosh": jnp.arccosh,
    "arctanh": jnp.arctanh,
    "erf": erf,
    "erfc": lambda x: erfc(jnp.clip(x, -5, 5)),  # beyond, XLA has fewer digits
    "stop gradient": lax.stop_gradient,
    "reciprocal": lambda x: 1 / x,
    "select": lambda x: jnp.where(x > 0.5, x, -x),
    "select of known": lambda x: jnp.where(True, x, -x),
}
# of XLA, which approximates these itself, or those of the C library
LOOSE = {
    "erfc": 40,
    "sinh": 40,
    "cosh": 40,
    "tan": 40,
    "arcsinh": 40,
    "arccosh": 40,
    "arctanh": 40,
    "cbrt": 40,
}
# beyond them XLA's functions have fewer digits
LARGEST = {"sin": 1e6, "cos": 1e6, "tan": 1e6, "exp2": 10}


FLOATS = pytest.mark.parametrize("dtype", [np.float64, np.float32])


@cache
def all_of_one_number(dtype):
    return of_all(ONE, values(dtype))


@FLOATS
@pytest.mark.parametrize("name", ONE)
def test_functions_of_one_number(name, dtype):
    kept = ~(np.abs(values(dtype)) > LARGEST.get(name, np.inf))
    found, expected = (each[name][kept] for each in all_of_one_number(dtype))
    if name == "cbrt":  # XLA's own may be off by 60 units in the last place
        expected = np.cbrt(values(dtype)[kept])
    assert_equal(found, expected, LOOSE.get(name, 10))


TWO = {
    "add": lambda a, b: a + b,
    "sub": lambda a, b: a - b,
    "mul": lambda a, b: a * b,
    "div": lambda a, b: a / b,
    "rem": lax.rem,
    "max": jnp.maximum,
    "min": jnp.minimum,
    "pow": jnp.power,
    "atan2": jnp.arctan2,
    "eq": lambda a, b: a == b,
    "ne": lambda a, b: a != b,
    "lt": lambda a, b: a < b,
    "le": lambda a, b: a <= b,
    "gt": lambda a, b: a > b,
    "ge": lambda a, b: a >= b,
    "logic": lambda a, b: ((a > 0) & (b > 0)) | ~(a < b) ^ (b == 1),
}


@cache
def all_of_two_numbers(dtype):
    x = values(dtype)
    y = np.concatenate([np.roll(x[:12], k) for k in range(12)] + [values(dtype, seed=1)])
    return of_all(TWO, np.concatenate([x[:12]] * 12 + [x]), y)


@FLOATS
@pytest.mark.parametrize("name", TWO)
def test_functions_of_two_numbers(name, dtype):
    found, expected = (each[name] for each in all_of_two_numbers(dtype))
    assert_equal(found, expected, ulps=40 if name == "pow" else 4)


INTEGERS = {
    "add": lambda a, b: a + b,
    "mul": lambda a, b: a * b,
    "div": lax.div,
    "rem": lax.rem,
    "divmod": lambda a, b: jnp.divmod(a, b),
    "max": jnp.maximum,
    "min": jnp.minimum,
    "lt": lambda a, b: a < b,
    "ne": lambda a, b: a != b,
    "abs": lambda a, b: jnp.abs(a),
    "sign": lambda a, b: jnp.sign(a),
    "power": lambda a, b: lax.integer_pow(b, 3),
    "bits": lambda a, b: (a & b) | (a ^ ~b),
    "left": lambda a, b: lax.shift_left(a, jnp.full_like(a, 2)),
    "right": lambda a, b: lax.shift_right_arithmetic(a, jnp.full_like(a, 2)),
    "logical right": lambda a, b: lax.shift_right_logical(a, jnp.full_like(a, 2)),
    "to float": lambda a, b: a.astype(jnp.float64) / b.astype(jnp.float32).astype(jnp.float64),
    "to int64": lambda a, b: a.astype(jnp.int64) * 3,
    "to int8": lambda a, b: a.astype(jnp.int8),
    "power of a float": lambda a, b: lax.pow(a.astype(jnp.float64), b),
}


@cache
def all_of_whole_numbers(dtype):
    rng = np.random.default_rng(2)
    low = 0 if dtype == np.uint8 else -100
    a, b = rng.integers(low, 120, 90), rng.integers(1, 9, 90)
    return of_all(INTEGERS, a.astype(dtype), b.astype(dtype))


@pytest.mark.parametrize("dtype", [np.int32, np.int64, np.uint8])
@pytest.mark.parametrize("name", INTEGERS)
def test_functions_of_whole_numbers(name, dtype):
    found, expected = (each[name] for each in all_of_whole_numbers(dtype))
    assert_equal(found, expected)


def test_all_primitives_that_work_entry_by_entry_are_covered():
    moved = {"copy", "copy_p", "stop_gradient"}
    assert ENTRYWISE - set(RULES) == moved


def test_logarithm_and_exponential_of_float32():
    rng = np.random.default_rng(0)
    x = np.exp(rng.uniform(-87, 88, 20_000)).astype(np.float32)
    logarithm, exponential = jax.jit(jax.vmap(log_float32)), jax.jit(jax.vmap(exp_float32))
    assert np.all(np.abs(logarithm(x) - np.log(x)) < 2e-7 * 88)
    tiny = np.array([1.5e-45, 1e-44, 3e-42, 1e-40, 1.1e-38], np.float32)  # 0 for XLA
    np.testing.assert_allclose(run(jnp.log, tiny), np.log(tiny.astype(float)), rtol=2e-7)
    close = rng.uniform(0.5, 2, 20_000).astype(np.float32)
    error = logarithm(close) - np.log(close.astype(np.float64)).astype(np.float32)
    assert np.all(np.abs(error) < 2e-7)
    edges = np.array([0, np.inf, -1, np.nan], np.float32)
    np.testing.assert_array_equal(logarithm(edges), [-np.inf, np.inf, np.nan, np.nan])
    y = rng.uniform(-86, 88, 20_000).astype(np.float32)
    np.testing.assert_allclose(exponential(y), np.exp(y.astype(np.float64)), rtol=3e-7)
    edges = np.array([0, np.inf, -np.inf, np.nan], np.float32)
    np.testing.assert_array_equal(exponential(edges), [1, np.inf, 0, np.nan])


def test_a_loop_ends_for_each_cell_by_itself():
    """The number of steps of Collatz' sequence."""

    def steps(n):
        def step(carry):
            n, count = carry
            return jnp.where(n % 2 == 0, n // 2, 3 * n + 1), count + 1

        return lax.while_loop(lambda carry: carry[0] > 1, step, (n, jnp.int32(0)))[1]

    n = np.arange(1, 200)
    assert_same(steps, n)
    assert run(steps, n)[26] == 111


ENDLESS = """
import json, signal
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from walker_jax.kernels.compiled import Compiled

jax.config.update("jax_enable_x64", True)
signal.setitimer(signal.ITIMER_VIRTUAL, 20)  # seconds of the processor at most, in loops for ever


def total(shared, n):
    def inner(i):
        # adds n - i until 12 is reached: for ever once i is n
        return lax.while_loop(lambda y: y < 12, lambda y: y + (n - i), jnp.int64(0))

    def outer(carry):
        i, sum_ = carry
        return i + 1, sum_ + inner(i)

    return lax.while_loop(lambda carry: carry[0] < n, outer, (jnp.int64(0), jnp.int64(0)))[1]


def chosen(shared, x):
    # adds x until 9 is reached: for ever unless x is positive
    count = lambda: lax.while_loop(lambda y: y < 9, lambda y: y + x, x)
    nested = lambda: lax.cond(x != 1, count, lambda: x - 100)
    return lax.cond(x > 0, nested, lambda: x)


for function, cells in ((total, [0, 5, 1, 3, 2, 0, 7, 4, 6, 1]), (chosen, range(-2, 4))):
    cells = np.array(cells)
    kernel = Compiled(jax.make_jaxpr(lambda cell: function((), cell))(cells[0]))
    compute, (results,) = kernel.bind([cells], [True], len(cells))
    compute(0, len(cells))
    print(results.tolist())
"""


def test_no_loop_waits_for_a_cell_that_is_not_at_work_in_it():
    """One that has ended, or that takes another branch, would go round the loop for ever."""
    run = subprocess.run([sys.executable, "-c", ENDLESS], capture_output=True, text=True)
    assert run.returncode == 0, (run.returncode, run.stderr)
    totals, chosen = map(json.loads, run.stdout.splitlines())
    sums = lambda m: sum(-(-12 // (m - i)) * (m - i) for i in range(m))
    assert totals == [sums(m) for m in (0, 5, 1, 3, 2, 0, 7, 4, 6, 1)]
    assert chosen == [-2, -1, 0, -99, 10, 9]


def test_terms_of_a_loop_are_not_taken_for_known_after_it():
    def function(x):
        total = lax.while_loop(lambda y: y > 3, lambda y: y - jnp.exp(-x) * jnp.exp(-x), x)
        return total + jnp.exp(-x), jnp.exp(-x) * jnp.exp(-x)

    assert_same(function, np.linspace(0.1, 4, 30), ulps=100)


def test_a_loop_of_one_turn_is_no_loop():
    def function(x):
        def once(carry):
            return jnp.array(True), jnp.sin(x) * carry[1]

        return lax.while_loop(lambda carry: ~carry[0], once, (jnp.array(False), 2 * x))[1]

    assert_same(function, np.linspace(-3, 3, 11))


def test_branches_are_chosen_for_each_cell():
    def function(i, x):
        count = lambda x: lax.while_loop(lambda y: y < 9, lambda y: y + x, x)
        switched = lax.switch(i, [jnp.sin, lambda x: x * x, count], x)
        return switched, lax.cond(x > 2, lambda: (x, i), lambda: (-x, jnp.int32(7)))

    i = np.arange(-2, 6).repeat(4).astype(np.int32)
    assert_same(function, i, np.linspace(1, 4, len(i)))


def test_loops_that_are_mapped_over_entries_of_a_cell():
    """Each entry goes on for as long as its own condition holds."""

    def function(x):
        double = lambda carry: (carry[0] * 2, carry[1] + carry[0])
        below = lambda carry: jnp.abs(carry[0]) < 9
        iterate = lambda x: lax.while_loop(below, double, (x, jnp.stack([x, -x])))
        return jax.vmap(iterate)(x * jnp.arange(1.0, 4.0))

    assert_same(function, np.linspace(0.1, 20, 33))


def test_derivatives():
    def function(x, direction):
        def step(carry):
            y, n = carry
            return jnp.sin(y) * x + y, n + 1

        iterate = lambda x: lax.while_loop(lambda c: c[1] < 6, step, (x, 0))[0]
        return jax.jvp(iterate, (x,), (direction,))

    assert_same(function, np.linspace(-2, 2, 21), np.linspace(1, 3, 21), ulps=50)


@FLOATS
def test_arrays_of_any_length_and_shape(dtype):
    rng = np.random.default_rng(0)
    shared = rng.normal(size=(2, 3)).astype(dtype), np.array([True, False, True])
    x, use = rng.normal(size=(40, 3)).astype(dtype), rng.uniform(size=(40, 3)) < 0.5

    def function(matrix, flags, x, use):
        chosen = jnp.where(use, x, 0) + jnp.where(flags, 1, 0)
        most = jnp.max(x), jnp.min(x), jnp.prod(x), jnp.any(use), jnp.all(use | flags)
        return {"product": matrix @ chosen, "flags": use ^ flags}, most, jnp.zeros((2,), jnp.int8)

    found, expected = of_both(function, x, use, shared=shared)
    assert_equal(found, expected, ulps=100)
    for n in (1, 2, 7, 8, 9, 15, 16, 17):
        found = run(function, x[:n], use[:n], shared=shared)
        assert_equal(found, jax.tree.map(lambda y, n=n: y[:n], expected), ulps=100)


def test_only_the_cells_asked_for_are_written():
    kernel = Compiled(jax.make_jaxpr(lambda shared, x: shared * x)(2.0, 0.0))
    x = np.arange(40.0)
    compute, (result,) = kernel.bind([np.float64(2), x], [False, True], 40)
    result[:] = -1
    compute(5, 5)
    assert np.all(result == -1)
    compute(3, 14)
    np.testing.assert_array_equal(result, np.where((x >= 3) & (x < 14), 2 * x, -1))


def test_a_cell_has_the_same_bits_in_any_company():
    def function(x):
        step = lambda carry: (jnp.sin(carry[0]) + x, carry[1] + 1)
        return lax.while_loop(lambda c: c[1] < jnp.abs(10 * x), step, (x, 0.0))[0]

    x = np.random.default_rng(0).normal(size=501)
    alone = np.array([run(function, x[i : i + 1])[0] for i in range(3)])
    together, backwards = run(function, x), run(function, x[::-1].copy())
    np.testing.assert_array_equal(together, backwards[::-1])
    np.testing.assert_array_equal(together[:3], alone)


@pytest.mark.parametrize(
    ("function", "named"),
    [
        (lambda x: jnp.sort(jnp.stack([x, -x])), "sort"),
        (lambda x: jnp.linalg.svd(jnp.eye(2) + x), "svd"),
        (lambda x: lax.complex(x, x) * 2, "complex128"),
        (lambda x: x.astype(jnp.float16), "float16"),
    ],
)
def test_what_no_kernel_can_do_is_named(function, named):
    with pytest.raises(UnsupportedPrimitive, match=named):
        run(function, np.ones(3))


# What the processor, or LLVM, leaves open


def test_integers_without_a_quotient_have_those_of_xla():
    least = np.iinfo(np.int32).min
    a = np.array([least, least, 7, -7, 0, 5], np.int32)
    b = np.array([-1, 0, 0, 0, 0, -1], np.int32)
    both = lambda a, b: (lax.div(a, b), lax.rem(a, b))
    assert_same(both, a, b)
    assert_same(both, a.astype(np.uint32), b.astype(np.uint32))
    # by a number that cells share
    assert_same(lambda s, v: both(v, s), a, shared=(np.int32(-1),))


@pytest.mark.parametrize("dtype", [np.int8, np.int32, np.int64, np.uint8, np.uint32])
def test_shifts_by_more_bits_than_there_are(dtype):
    bits = 8 * np.dtype(dtype).itemsize
    by = np.array([0, 1, bits - 1, bits, bits + 1, 100], dtype).repeat(3)
    x = np.tile(np.array([1, 77, np.iinfo(dtype).max - 3], dtype), 6)
    shifts = lax.shift_left, lax.shift_right_arithmetic, lax.shift_right_logical
    shifted = lambda x, by: [[f(x, by), f(x, jnp.full_like(x, 100))] for f in shifts]
    assert_same(shifted, x, by)


@FLOATS
def test_beyond_the_integers_of_a_type_is_the_last_of_them(dtype):
    """From the first number that is, a power of two; below, all are cut off towards zero."""
    kinds = np.int8, np.uint8, np.int32, np.uint32, np.int64, np.uint64
    powers = np.array([0, 7, 8, 31, 32, 63, 64])
    x = np.concatenate([2.0**powers, -(2.0**powers), [1.5, -1.5]]).astype(dtype)
    x = np.concatenate([x, np.nextafter(x, dtype(0)), np.nextafter(x, 4 * x)])
    found = run(lambda x: [x.astype(kind) for kind in kinds], x)
    for kind, values in zip(kinds, found, strict=True):
        low, high = int(np.iinfo(kind).min), int(np.iinfo(kind).max)
        assert values.dtype == kind
        assert values.tolist() == [min(max(int(each), low), high) for each in x.tolist()]


def test_signs_of_large_unsigned_numbers():
    assert_same(jnp.sign, np.array([0, 1, 2**31, 2**32 - 1], np.uint32))


def test_zero_by_what_is_none():
    assert_same(lambda x: 0.0 / x, np.array([0.0, np.nan, 2.0, np.inf]))


@pytest.mark.parametrize(
    ("function", "named"),
    [
        (lambda x: jnp.prod(jnp.stack([x])[:0]), "reduce_prod"),
        (lambda x: lax.bitcast_convert_type(x, jnp.uint32)[0], "bitcast"),
        (lambda x: jax.random.uniform(jax.random.key(0)) + x, "random"),
    ],
)
def test_what_no_kernel_is_made_of_does_not_break(function, named):
    with pytest.raises(UnsupportedPrimitive, match=named):
        run(function, np.ones(3))


def test_large_arrays_have_no_kernel():
    with pytest.raises(UnsupportedPrimitive, match="numbers"):
        run(lambda s, x: jnp.sum(s) * x, np.ones(3), shared=(np.ones(5000),))


def test_a_function_may_have_no_results():
    assert run(lambda x: (), np.ones(3)) == ()


def test_the_program_is_the_same_whenever_it_is_written(monkeypatch):
    """Not so if it depended on where objects lie in memory; nor would the last bits be."""
    programs, junk = [], []
    monkeypatch.setattr(compiled, "MachineCode", lambda source, *_: programs.append(source))

    def function(shared, x):
        waves = [jnp.sin(k * x) * jnp.cos(shared / k) for k in range(1, 9)]
        return sum(a * b + b * c for a, b, c in zip(waves, waves[1:], waves[2:], strict=False))

    change = lambda shared, x: jax.jvp(lambda x: function(shared, x), (x,), (x,))
    for size in (1, 10, 100, 1000, 10_000):
        Compiled(jax.make_jaxpr(change)(jnp.float64(2), jnp.float64(1)))
        junk.append([object() for _ in range(size)])  # so that the next ones lie elsewhere
        junk[::2] = [[] for _ in junk[::2]]
    assert len(programs) == 5 and len(set(programs)) == 1

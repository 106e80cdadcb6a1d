"""Unrolled functions against the functions themselves, and how little is left of them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from jax import lax

from walker_jax.kernels import kernel
from walker_jax.kernels.entries import EXACT
from walker_jax.kernels.scalars import unroll

SYMMETRIC = np.array([[3.0, 1.0, 0.5], [1.0, 4.0, -1.0], [0.5, -1.0, 5.0]])
V = jnp.array([0.3, -1.2, 0.8])
A = jnp.array([[1.5, 0.2, -0.4], [0.7, -2.0, 1.1], [0.3, 0.9, 0.6]])


@jax.custom_jvp
def with_its_own_slope(x):
    return jnp.sin(x)


with_its_own_slope.defjvp(lambda x, t: (jnp.sin(*x), 10 * t[0]))


@jax.custom_vjp
def with_its_own_transpose(x):
    return jnp.sin(x) * x


with_its_own_transpose.defvjp(lambda x: (jnp.sin(x) * x, x), lambda x, ct: (10 * ct * x,))

FUNCTIONS = {
    "entrywise": lambda v, A: jnp.sin(v) * jnp.exp(-v) / (1 + v**2) - jnp.sqrt(v * v + 1),
    "broadcast": lambda v, A: A - v + v[:, None] * 2.0,
    "powers": lambda v, A: (A**2, jnp.square(v) ** 1.5, 2.0**v, jnp.abs(v) ** -3),
    "choices": lambda v, A: (jnp.maximum(v, 0.1), jnp.clip(A, -1, 1), jnp.sign(v) * v),
    "angles": lambda v, A: (jnp.arctan2(v, A[0]), jnp.tan(v), jnp.tanh(v)),
    "index": lambda v, A: v[0] * A[1, 2] + A[-1, -2] * v[-1],
    "slices": lambda v, A: (v[1:], A[:2, 1:], A[::2, ::-1], v[::-1], v[-2:], A[None, 1]),
    "unpacking": lambda v, A: [row[0] * x for row, x in zip(A, v, strict=True)],
    "fancy-index": lambda v, A: (v[np.array([2, 0, -1])], A[np.array([0, 2]), np.array([1, -1])]),
    "jax-index": lambda v, A: (v[jnp.array([2, 0])], A[:, jnp.array([1, 1, -3])]),
    "mask": lambda v, A: A[np.array([True, False, True])] * v,
    "index-by-value": lambda v, A: A[jnp.argmax(v)] + v[jnp.argmin(v)],
    "index-beyond": lambda v, A: (
        v.at[jnp.array([0, 7])].get(mode="fill", fill_value=2.0),
        v.at[jnp.array([0, 7])].get(mode="clip"),
    ),
    "take": lambda v, A: jnp.take(A, jnp.array([2, 1]), axis=1),
    "slice-by-number": lambda v, A: lax.dynamic_slice(A, (1, 0), (2, 2)),
    "stack": lambda v, A: (jnp.stack([v, A[0]]), jnp.stack([v, A[1]], axis=1)),
    "concatenate": lambda v, A: jnp.concatenate([v, A[0], v[:1]]),
    "block": lambda v, A: jnp.block([[A, v[:, None]], [v, jnp.zeros(1)]]),
    "reshape": lambda v, A: (A.reshape(9)[2:8].reshape(3, 2), A.ravel(), v[:, None, None]),
    "transpose": lambda v, A: (A.T * v, jnp.stack([A, 2 * A]).transpose(2, 0, 1)),
    "rearrange": lambda v, A: (jnp.tile(v, 2), jnp.repeat(v, 2), jnp.roll(A, 1, 0), jnp.flip(A)),
    "matmul": lambda v, A: (A @ v, v @ A, v @ v, A @ A.T, A[:2] @ A[:, :1]),
    "batched-matmul": lambda v, A: jnp.stack([A, A.T]) @ jnp.stack([A, A]),
    "vmap": lambda v, A: jax.vmap(lambda row: row @ v * row)(A),
    "einsum": lambda v, A: (jnp.einsum("ij,j,kj->ik", A, v, A), jnp.einsum("ii->i", A)),
    "outer": lambda v, A: (jnp.outer(v, v), jnp.cross(v, A[0]), jnp.kron(v, v[:2])),
    "sum": lambda v, A: (A.sum(), A.sum(0), A.sum(axis=(0, 1)), v.mean(), jnp.trace(A)),
    "reductions": lambda v, A: (A.max(0), v.min(), jnp.prod(v), jnp.linalg.norm(v)),
    "eye": lambda v, A: jnp.eye(3) * v + jnp.diag(v) @ A - jnp.tril(A),
    "where": lambda v, A: (jnp.where(v > 0, v, -v), jnp.where(np.eye(3, dtype=bool), A, v)),
    "select": lambda v, A: lax.select_n(jnp.array(1), v, v**2, v**3),
    "at-set": lambda v, A: A.at[1].set(v).at[0, -1].add(v[0]).at[:, 1].multiply(2.0),
    "pad": lambda v, A: (jnp.pad(A, ((1, 0), (0, 2))), lax.pad(v, v[0], [(-1, 2, 1)])),
    "pad-less": lambda v, A: (
        lax.pad(A, v[1], [(2, -4, 2), (-1, -2, 0)]),
        lax.pad(v, 0.0, [(-2, -1, 0)]),
    ),
    "split": lambda v, A: (jnp.split(v, [1]), jnp.split(A, 3, axis=1)),
    "cumsum": lambda v, A: (jnp.cumsum(v), jnp.cumprod(A, 1), jnp.diff(v)),
    "sort": lambda v, A: (jnp.sort(v), A[jnp.argsort(v)]),
    "solve": lambda v, A: jnp.linalg.solve(A + jnp.asarray(SYMMETRIC), v),
    "inverse-of-constants": lambda v, A: jnp.linalg.inv(jnp.asarray(SYMMETRIC)) @ v,
    "sum-of-constants": lambda v, A: v * jnp.cumsum(jnp.arange(3.0)) + jnp.ones((0, 3)).sum(0),
    "loop": lambda v, A: lax.fori_loop(0, 4, lambda i, x: jnp.sin(A @ x), v),
    "loop-of-constants": lambda v, A: v * lax.fori_loop(0, 3, lambda i, x: 2 * x, 1.5),
    "scan": lambda v, A: lax.scan(lambda c, row: (c * row[0] + 1, c @ row), v, A),
    "cond": lambda v, A: lax.cond(v[0] > 0, lambda x: x @ A, lambda x: x, v),
    "map": lambda v, A: lax.map(lambda row: row @ v, A),
    "jit": lambda v, A: jax.jit(lambda x: jax.jit(jnp.sin)(x) + x[0])(v),
    "jvp": lambda v, A: jax.jvp(lambda x: jnp.sin(A @ x), (v,), (A[0],)),
    "grad": lambda v, A: jax.grad(lambda x: jnp.sin(x) @ A @ jnp.cos(x))(v),
    "checkpoint": lambda v, A: jax.checkpoint(lambda x: jnp.sin(x) @ A)(v),
    "stop-gradient": lambda v, A: lax.stop_gradient(v) * v,
    "relu": lambda v, A: jax.nn.relu(v - v[0]),
    "own-slope": lambda v, A: with_its_own_slope(v) * with_its_own_slope(v[0]),
    "constants-alone": lambda v, A: (jnp.ones(2), np.arange(3.0), 4.0, jnp.zeros((0, 3)), v),
    "the-arguments": lambda v, A: (A, v),
}


def together(names):
    """Some of the functions as one, which is compiled once."""
    return lambda v, A: {name: FUNCTIONS[name](v, A) for name in names}


def of_both(transformed, names):
    """A transformed function, and the same of the unrolled one, mapped over two arguments."""
    function = together(names)
    both = lambda v, A: (transformed(function)(v, A), transformed(unroll(function))(v, A))
    return jax.jit(jax.vmap(both))(jnp.stack([V, -V[::-1]]), jnp.stack([A, A.T + 0.1]))


def derivatives(function):
    """Forward in one direction; and backward, of a sum of all values.

    They are weighted, no two alike, lest errors cancel.
    """

    def results(v, A):
        values, slopes = jax.jvp(function, (v, A), (jnp.cos(jnp.arange(3.0)), jnp.sin(1 + A)))
        weights = iter(range(1000))
        cotangents = jax.tree.map(lambda x: jnp.cos(x + next(weights)), values)
        return slopes, jax.vjp(function, v, A)[1](cotangents)

    return results


@pytest.fixture(scope="module")
def values():
    return of_both(lambda function: function, FUNCTIONS)


def assert_equal(actual, expected, rtol=1e-13):
    assert jax.tree.structure(actual) == jax.tree.structure(expected)
    for a, b in zip(jax.tree.leaves(actual), jax.tree.leaves(expected), strict=True):
        assert jnp.shape(a) == jnp.shape(b) and jnp.asarray(a).dtype == jnp.asarray(b).dtype
        np.testing.assert_allclose(a, b, rtol=rtol, atol=rtol)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_value_is_that_of_the_function_itself(name, values):
    """Compiled and mapped."""
    plain, scalar = values
    assert_equal(scalar[name], plain[name])


@pytest.mark.slow
def test_derivatives_are_those_of_the_functions_themselves():
    """Forward and backward."""
    plain, scalar = of_both(derivatives, FUNCTIONS)
    assert all(np.min(np.abs(gradient)) > 0.01 for gradient in plain[1])
    assert_equal(scalar, plain, rtol=1e-12)


@pytest.mark.parametrize("name", ["matmul", "at-set", "jax-index", "scan"])
def test_value_is_that_of_the_function_without_compilation(name):
    assert_equal(unroll(FUNCTIONS[name])(V, A), FUNCTIONS[name](V, A))


def test_a_function_with_its_own_transpose_keeps_it():
    function = lambda x: with_its_own_transpose(x[0]) + x[1]
    x = jnp.array([2.0, 3.0])
    assert_equal(unroll(function)(x), function(x))
    assert_equal(jax.grad(unroll(function))(x), jnp.array([20.0, 1.0]))


SMALL = st.integers(1, 3)


@st.composite
def matrices(draw):
    """Two that can be multiplied, with many zeros and ones, and a vector."""
    rows, inner, columns = draw(SMALL), draw(SMALL), draw(SMALL)
    entries = st.sampled_from([0.0, 1.0, -1.0]) | st.floats(-10, 10)
    shapes = (rows, inner), (inner, columns), (columns,)
    return tuple(draw(arrays(float, shape, elements=entries)) for shape in shapes)


@pytest.mark.slow
@settings(max_examples=8, deadline=None)
@given(matrices(), st.booleans(), st.booleans())
def test_products_of_random_matrices_known_or_not(matrices, first_known, second_known):
    left, right, v = matrices
    known = {"left": left} if first_known else {}
    known |= {"right": right} if second_known else {}
    unknown = {"left": jnp.asarray(left), "right": jnp.asarray(right), "v": jnp.asarray(v)}

    def function(given):
        given = given | known
        product = jnp.asarray(given["left"]) @ jnp.asarray(given["right"])
        return product @ given["v"], {"sum": product.sum(0), "T": jnp.asarray(given["left"]).T}

    plain, scalar = function(unknown), unroll(function)(unknown)
    assert_equal(scalar, plain, rtol=1e-12)
    expected = left @ right @ v
    np.testing.assert_allclose(scalar[0], expected, rtol=1e-12, atol=1e-11)


def test_pytrees_go_in_and_come_out():
    def function(first, second):
        return {"a": [first["x"] + second[0], None], "b": (second[1].T, first["x"][0])}

    args = {"x": jnp.arange(2.0), "none": None}, (jnp.array(3.0), jnp.ones((2, 3)))
    assert_equal(unroll(function)(*args), function(*args))
    assert unroll(lambda: jnp.ones(2))().tolist() == [1, 1]
    assert unroll(lambda x: None)(1.0) is None


def test_python_numbers_and_numpy_arrays_are_arguments_too():
    function = lambda x, y, n: (x * y, x[0] + y, n + 1)
    args = np.arange(3.0), 2.0, 3
    assert_equal(unroll(function)(*args), tuple(map(jnp.asarray, function(*args))))


# What is left


def equations(function, *args):
    """Names of the operations of a function, and shapes of their results, calls read into."""
    found = []

    def read(jaxpr):
        for equation in jaxpr.eqns:
            inner = [p for p in equation.params.values() if hasattr(p, "jaxpr")]
            for closed in inner:
                read(closed.jaxpr)
            if not inner:
                found.extend((equation.primitive.name, v.aval.shape) for v in equation.outvars)

    read(jax.make_jaxpr(function)(*args).jaxpr)
    return found


def names(function, *args):
    """Of what an unrolled function of scalars computes: nothing but scalars."""
    left = equations(unroll(function), *(jnp.array(x, float) for x in args))
    assert all(shape == () for _, shape in left), left
    return sorted(name for name, _ in left)


def turned(a):
    return jnp.array([[jnp.cos(a), -jnp.sin(a), 0.0], [jnp.sin(a), jnp.cos(a), 0.0], [0, 0, 1.0]])


def test_no_arrays_and_fewer_operations_are_left():
    def function(a, x, y):
        point = turned(a) @ jnp.stack([x, y, jnp.ones(())])
        return list(turned(a).T @ point)

    few = names(function, 0.5, 1.0, 2.0)
    plain = sum(max(1, int(np.prod(shape))) for _, shape in equations(function, 0.5, 1.0, 2.0))
    # Two products and a sum each, of two entries each time; one sine, one cosine; no sign is left.
    assert few.count("sin") == few.count("cos") == 1
    assert few.count("mul") == 8 and few.count("add") == few.count("sub") == 2
    assert len(few) == 14 < 20 < plain / 3
    assert_equal(jnp.stack(unroll(function)(0.5, 1.0, 2.0)), jnp.array([1.0, 2.0, 1.0]))


def test_known_zeros_and_ones_drop_out():
    def function(x, y):
        matrix = jnp.stack([jnp.stack([x, 0 * x]), jnp.stack([jnp.zeros(()), y])])
        return list(matrix @ (matrix @ jnp.array([1.0, 0.0])))

    assert names(function, 2.0, 3.0) == ["mul"]
    assert names(lambda x: x + jnp.zeros(()) - 0.0, 2.0) == []
    assert names(lambda x: (x * jnp.ones(()) / 1.0, 1.0 * x), 2.0) == []
    assert names(lambda x: (x * 0.0, jnp.eye(2)[0, 1] * x), 2.0) == []
    assert names(lambda x: 0.0 / x, 2.0) == ["div"]  # which may have no value
    assert names(lambda x: list(jnp.eye(3) @ jnp.stack([x, -x, x])), 2.0) == ["neg"]
    assert names(lambda x: 0.0 - x, 2.0) == ["sub"]
    assert names(lambda x: 1.0 / x, 2.0) == ["div"]


def test_signs_pass_through_sums_and_products():
    assert names(lambda x, y: -x * -y, 2.0, 3.0) == ["mul"]
    assert names(lambda x, y: -x + y, 2.0, 3.0) == ["sub"]
    assert names(lambda x, y: x - -y, 2.0, 3.0) == ["add"]
    assert names(lambda x, y: -x - y, 2.0, 3.0) == ["add", "neg"]
    assert names(lambda x, y: y - (-x) / y, 2.0, 3.0) == ["add", "div"]
    assert names(lambda x: (-x, x * -1.0, lax.neg(-x)), 2.0) == ["mul", "neg"]
    assert names(lambda x: jnp.sqrt(lax.neg(-x)) + jnp.exp(-x), 2.0).count("neg") == 1
    chosen = names(lambda x: jnp.where(x > 0, -x, -2.0 - -x), 2.0)
    assert chosen == ["add", "gt", "neg", "select_n"]


def test_calls_of_a_number_and_of_its_negative_are_two():
    called = jax.jit(lambda x, y: x + 2.0 * y)
    function = lambda x, y: (called(x, y), called(-x, y), called(x, -y), called(-x, -y))
    assert list(map(float, unroll(function)(5.0, 7.0))) == [19.0, 9.0, -9.0, -19.0]
    assert names(function, 5.0, 7.0) == ["add", "mul", "neg", "sub", "sub"]


@pytest.mark.parametrize("at", [(0.3, 0.7, -1.9), (-2.5, 1e-9, 3e4)])
def test_signs_change_no_bit(at):
    def function(a, x, y):
        minus = -jnp.sin(a)
        pair = jnp.stack([minus * x - y, -(x / -y), -x - a, y - -minus])
        turns = lax.fori_loop(0, 3, lambda i, v: v * minus - pair[1], -pair)
        return -turns[0], jnp.where(a > 0, -x, -y), lax.integer_pow(minus, 3), pair.astype(bool)

    for found, right in zip(unroll(function)(*at), function(*at), strict=True):
        np.testing.assert_array_equal(found, right)


def test_what_is_known_is_computed_while_tracing():
    def function(x):
        angle = np.pi / 3
        return x * jnp.cos(jnp.asarray(angle)) * 2.0 + jnp.linalg.solve(jnp.eye(2), jnp.ones(2))[0]

    assert names(function, 2.0) == ["add", "mul", "mul"]
    assert unroll(function)(2.0) == pytest.approx(3.0, rel=1e-15)


def test_a_product_with_a_known_zero_is_zero_even_of_infinity():
    function = lambda x: (jnp.zeros(2) @ jnp.stack([x, x]), jnp.eye(2) @ jnp.stack([x, 1 + 0 * x]))
    zero, row = jax.jit(unroll(function))(np.inf)
    np.testing.assert_array_equal(zero, 0)
    np.testing.assert_array_equal(row, [np.inf, 1])


def test_equal_terms_are_computed_once():
    def function(x, y):
        one, other = jnp.sin(x * y), jnp.sin(y * x)
        return one + jnp.exp(x), jnp.exp(x) + other, jax.jit(jnp.exp)(x) * 2.0

    assert names(function, 1.0, 2.0) == ["add", "exp", "mul", "mul", "sin"]
    outer = lambda x: jnp.outer(jnp.stack([x, x + 1]), jnp.stack([x, x + 1]))
    assert names(lambda x: list(outer(x).ravel()), 1.0) == ["add", "mul", "mul", "mul"]
    # Not the same: the order of a difference, and other parameters.
    assert names(lambda x, y: (x - y, y - x), 1.0, 2.0) == ["sub", "sub"]
    assert names(lambda x: (x**2, x**3), 2.0) == ["integer_pow"] * 2


def test_operations_without_meaning_entry_by_entry_are_kept():
    left = equations(unroll(lambda v, A: jnp.linalg.solve(A, v)), V, A)
    assert {"lu", "custom_linear_solve"} & {name for name, _ in left}
    left = equations(unroll(FUNCTIONS["map"]), V, A)
    assert any(shape == (3,) for _, shape in left)


def test_effects_are_kept():
    seen = []
    function = lambda x: (jax.debug.callback(lambda y: seen.append(float(y)), x[1]), 2 * x)[1]
    np.testing.assert_array_equal(jax.jit(unroll(function))(V), 2 * V)
    jax.effects_barrier()
    assert seen == [-1.2]


# Kinds of numbers


def test_float32_gives_float32():
    """Also where known numbers of both kinds would be the same."""
    function = lambda v: (v @ v, jnp.eye(3, dtype=v.dtype) @ v * 2.0 + 1, jnp.linalg.norm(v))
    low, high = jax.jit(unroll(function))(V.astype(jnp.float32)), function(V)
    assert {x.dtype for x in low} == {jnp.dtype("float32")}
    for a, b in zip(low, high, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-6)

    def both(x):
        known = jnp.full((), 0.3, jnp.float32), jnp.full((), 0.3, jnp.float32).astype(float)
        return jnp.sin(known[0]), jnp.sin(known[1]), known[0] * known[0], known[1] * known[1], x

    assert_equal(unroll(both)(1.0), both(1.0), rtol=1e-16)


def test_whole_numbers_and_truth_values():
    def function(n, flag, x):
        return {
            "whole": (n + 1, n // 2, n % 3, -n, n * n, n.sum(), n @ n, n[::-1], n.max()),
            "small": (n.astype(jnp.int8), jnp.arange(3) * n, jnp.zeros((0, 3), int).sum(0)),
            "true": (flag, ~flag, flag & (n > 1), flag.any(), (n == 2) | flag, jnp.all(n > 0)),
            "mixed": jnp.where(flag, n, 0).astype(float) * x,
            "none": jnp.sum(jnp.where(flag, 1, 0)),
        }

    args = jnp.array([1, 2, 3]), jnp.array([True, False, True]), jnp.array(0.5)
    expected = jax.jit(function)(*args)
    for scalar in (unroll(function), jax.jit(unroll(function))):
        assert_equal(scalar(*args), expected, rtol=0)


def test_known_numbers_are_those_of_their_kind():
    """They wrap, overflow and round as arrays do."""

    def function(x):
        byte, word = jnp.full((), 1, jnp.uint8), jnp.full((), 2**31 - 1, jnp.int32)
        large = jnp.full((), 1e30, jnp.float32)
        third = jnp.full((), 1 / 3, jnp.float32)
        return -byte, word + word, word * word, large * large, third * third + third - 1, x

    assert_equal(jax.jit(unroll(function))(1.0), function(jnp.asarray(1.0)), rtol=0)


def test_products_that_widen_are_as_wide():
    def function(x):
        return jnp.matmul(x, x, preferred_element_type=jnp.float64)

    x = (V / 3).astype(jnp.float32)
    assert_equal(unroll(function)(x), function(x), rtol=1e-15)


def test_complex_numbers():
    function = lambda x: (lax.complex(x, 2 * x) * (1 + 2j), jnp.abs(lax.complex(x, x)))
    assert_equal(unroll(function)(V), function(V))


@pytest.mark.parametrize(
    "dtype",
    [np.float64, np.int32, np.bool_]
    + [pytest.param(one, marks=pytest.mark.slow) for one in (np.float32, np.uint8)],
)
def test_known_numbers_are_computed_as_jax_does(dtype):
    special = [0.0, 1.0, 0.1, 3.0, 7.0, 200.0]
    kind = np.dtype(dtype).kind
    special += [-0.0, -2.5, np.inf, -np.inf, np.nan, 1e30, 3e38] * (kind == "f")
    logical, of_reals = {"and", "not", "or"}, {"is_finite", "nextafter"}
    arithmetic = of_reals | {"abs", "add", "add_any", "mul", "neg", "sub"}
    undefined = {"f": logical, "b": arithmetic, "u": of_reals | {"abs"}}.get(kind, of_reals)
    numbers = np.array(special, dtype)
    left, right = (np.ravel(part) for part in np.meshgrid(numbers, numbers))
    alone = {"abs", "copy", "is_finite", "neg", "not"}
    for name in EXACT.keys() - undefined:
        function = EXACT[name]
        operands = (numbers,) if name in alone else (left, right)
        primitive = jax.lax.add_p if name == "add_any" else getattr(jax.lax, f"{name}_p")
        with np.errstate(all="ignore"):
            found = np.array(
                [function(*map(np.asarray, pair)) for pair in zip(*operands, strict=True)]
            )
        np.testing.assert_array_equal(found, primitive.bind(*map(jnp.asarray, operands)))
        assert found.dtype == primitive.bind(*map(jnp.asarray, operands)).dtype


def test_functions_of_one_code_are_told_apart_by_all_else():
    """Within one program, which keeps what it has traced of equal code."""

    def bound(value):
        return lambda x: value * x

    def by_position(value):
        return lambda x, by=value: by * x

    def by_keyword(value):
        return lambda x, *, by=value: by * x

    for make in (bound, by_position, by_keyword):
        two, three = unroll(make(2.0)), unroll(make(3.0))
        found = kernel(lambda x, two=two, three=three: (two(x), three(x)))(jnp.asarray(5.0))
        assert list(map(float, found)) == [10.0, 15.0]


def test_long_arrays_stay_whole():
    """Equations of a network are as many for wide layers as for narrow ones."""

    def network(width):
        rng = np.random.default_rng(width)
        first, second = rng.normal(size=(width, 3)), rng.normal(size=(width, width)) / width

        def function(x, bias):
            turned = jnp.array([[1.0, 0, 0], [0, jnp.cos(x[0]), 0], [0, 0, 1]]) @ x
            hidden = jnp.tanh(jnp.asarray(first) @ turned + bias)
            hidden = jax.nn.relu(jnp.asarray(second) @ hidden)
            return -jnp.sum(hidden) * x, hidden, hidden[:2]

        return function, (jnp.array([0.3, 0.2, 0.1]), jnp.asarray(rng.normal(size=width)))

    function, given = network(32)
    with_slopes = lambda f: jax.jit(lambda *x: (f(*x), jax.jacfwd(f, (0, 1))(*x)))(*given)
    both = (jax.tree.leaves(with_slopes(f)) for f in (unroll(function), function))
    for found, expected in zip(*both, strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-13, atol=1e-14)
    wider, more = network(40)
    narrow, wide = jax.make_jaxpr(unroll(function))(*given), jax.make_jaxpr(unroll(wider))(*more)
    assert len(narrow.eqns) == len(wide.eqns)

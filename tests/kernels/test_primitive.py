"""A function as a primitive of JAX: all that JAX does with one, against the function itself."""

import warnings
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax
from jax.extend.core import jaxpr_as_fun
from turns import AS, BOTH, MANY, RNG, XS, A, X, assert_same, by_loop, number, real, unrolled

from walker_jax.kernels import kernel, primitive
from walker_jax.kernels.program import Program, program_of

pytestmark = pytest.mark.usefixtures("few_together")


def repeated(function, loop):
    """A number after some calls, each of what the one before led to."""

    def last(a, x):
        following = lambda x: function(a, x)[0]
        if loop == "scan":
            return lax.scan(lambda x, _: (following(x), x), x, length=4)[0].sum()
        if loop == "for":
            return lax.fori_loop(0, 4, lambda _, x: following(x), x).sum()
        if loop == "while":
            step = lambda carry: (following(carry[0]), carry[1] + 1)
            return lax.while_loop(lambda carry: carry[1] < 4, step, (x, 0))[0].sum()
        return lax.cond(x[0] > 0, following, lambda x: x * a, x).sum()

    return last


def in_axes_elsewhere(f):
    along = jax.vmap(f, in_axes=(None, 1), out_axes=(1, 0, 0, -1))
    return jax.vmap(along, in_axes=(0, None), out_axes=(2, 1, 0, 1))(AS, XS.T)


def together(f):
    """Derivatives along directions in three axes, of which the machine code takes some at once."""
    along = lambda a, x, v: jax.jvp(partial(real(f), a), (x,), (v,))[1]
    over_directions = jax.vmap(along, (None, None, 0))
    over_both = jax.vmap(over_directions, (None, 0, 0))
    few, more = MANY[:, :3], MANY
    return (
        over_directions(A, X, more[0]),
        over_both(A, XS[:3], few),
        jax.vmap(over_both, (0, None, None))(AS, XS[:3], few),
        jax.vmap(over_both, (None, None, 1), 1)(A, XS[:3], MANY.reshape(3, 5, 100, 2)),
    )


def pulled(f):
    _, pull = jax.vjp(real(f), A, X)
    return pull((jnp.asarray([1.0, -2.0]), jnp.asarray(0.5)))


def without_some_results(f):
    """Cotangents of one result alone, of either."""
    return jax.grad(lambda x: f(A, x)[1])(X), jax.grad(lambda a: f(a, X)[0][1])(A)


def third(f):
    g = number(f)
    return jax.jacfwd(jax.jacrev(jax.jacfwd(g, 1), 1), 1)(A, X), jax.grad(jax.grad(jax.grad(g)))(
        A, X
    )


def transposed(f):
    """The transpose of what is linear in a direction, of first and of second derivatives."""
    along = lambda v, x=X: jax.jvp(lambda x: f(A, x)[0], (x,), (v,))[1]
    again = lambda v: jax.jvp(partial(along, v), (X,), (jnp.asarray([1.0, 2.0]),))[1]
    w = jnp.asarray([0.3, -0.7])
    return jax.linear_transpose(along, X)(w), jax.linear_transpose(again, X)(w)


def transposed_of_many(f):
    def again(v):
        along = lambda x, v: jax.jvp(lambda x: f(A, x)[0], (x,), (v,))[1]
        second = lambda x, v: jax.jvp(partial(along, v=v), (x,), (x,))[1]
        return jax.vmap(second)(XS, v), jax.vmap(second, (0, None))(XS, v[0])

    return jax.linear_transpose(again, XS)((XS, XS))


TRANSFORMED = {
    "values": lambda f: f(A, X),
    "jvp": lambda f: jax.jvp(real(f), (A, X), (A, X)),
    "vjp": pulled,
    "some results": without_some_results,
    "jacfwd": lambda f: jax.jacfwd(real(f), BOTH)(A, X),
    "jacrev": lambda f: jax.jacrev(real(f), BOTH)(A, X),
    "grad": lambda f: jax.grad(number(f), BOTH)(A, X),
    "hessian": lambda f: jax.hessian(number(f), BOTH)(A, X),
    "forward over forward": lambda f: jax.jacfwd(jax.jacfwd(real(f), BOTH), BOTH)(A, X),
    "reverse over reverse": lambda f: jax.jacrev(jax.jacrev(real(f), BOTH), BOTH)(A, X),
    "reverse over forward": lambda f: jax.jacrev(jax.jacfwd(real(f), BOTH), BOTH)(A, X),
    "third": third,
    "linearize": lambda f: jax.linearize(real(f), A, X)[1](A, X),
    "transposed": transposed,
    "transposed of many": transposed_of_many,
    "vmap over one": lambda f: jax.vmap(f, (None, 0))(A, XS),
    "vmap over the other": lambda f: jax.vmap(f, (0, None))(AS, X),
    "vmap over both": lambda f: jax.vmap(f)(AS, XS[:7]),
    "vmap nested": lambda f: jax.vmap(jax.vmap(f, (None, 0)), (0, None))(AS, XS),
    "vmap nested otherwise": lambda f: jax.vmap(jax.vmap(f, (0, None)), (None, 0))(AS, XS),
    "vmap thrice": lambda f: jax.vmap(jax.vmap(jax.vmap(f, (0, None)), (None, 0)))(
        jnp.outer(AS[:2], AS), jnp.stack([XS, XS])
    ),
    "vmap along other axes": in_axes_elsewhere,
    "vmap of grad": lambda f: jax.vmap(jax.grad(number(f), BOTH), (None, 0))(A, XS),
    "vmap of hessian": lambda f: jax.vmap(jax.hessian(number(f), BOTH), (0, None))(AS, X),
    "grad of vmap": lambda f: jax.grad(
        lambda a, x: jax.vmap(number(f), (None, 0))(a, x).sum(), BOTH
    )(A, XS),
    "jacfwd of vmap": lambda f: jax.jacfwd(jax.vmap(real(f), (None, 0)), BOTH)(A, XS),
    "jacrev of vmap": lambda f: jax.jacrev(jax.vmap(real(f), (0, None)), BOTH)(AS, X),
    "hessian of vmap": lambda f: jax.hessian(
        lambda a, x: jax.vmap(number(f), (None, 0))(a, x).sum(), BOTH
    )(A, XS[:3]),
    "many directions": together,
    "checkpoint": lambda f: jax.grad(jax.checkpoint(number(f)), BOTH)(A, X),
    "filters": lambda f: eqx.filter_vmap(eqx.filter_grad(number(f)), in_axes=(None, 0))(A, XS),
    "scan": lambda f: jax.grad(repeated(f, "scan"), BOTH)(A, X),
    "hessian of scan": lambda f: jax.hessian(repeated(f, "scan"), BOTH)(A, X),
    "scan of many": lambda f: jax.grad(
        lambda a, x: jax.vmap(repeated(f, "scan"), (None, 0))(a, x).sum(), BOTH
    )(A, XS),
    "for": lambda f: jax.grad(repeated(f, "for"), BOTH)(A, X),
    "while": lambda f: jax.jacfwd(repeated(f, "while"), BOTH)(A, X),
    "cond": lambda f: jax.vmap(jax.grad(repeated(f, "cond"), BOTH), (None, 0))(A, XS - 0.5),
}
AT_ONCE = "values", "jvp", "linearize", "vmap over one", "vmap nested"
"""What is computed outside of `jit` too, where XLA compiles each operation around it."""
LONG = {"third", "reverse over reverse", "reverse over forward", "transposed of many"}
LONG |= {"vmap thrice", "vmap of hessian", "hessian of vmap", "scan of many", "for", "filters"}
LONG |= {"hessian of scan", "jacrev of vmap"}
LIKE_OTHERS = {"vmap over the other", "vmap nested otherwise", "jacfwd of vmap", "jacrev"}
SLOW = LONG | LIKE_OTHERS
CASES = [pytest.param(name, marks=pytest.mark.slow if name in SLOW else ()) for name in TRANSFORMED]


@pytest.mark.parametrize("name", CASES)
def test_the_transformed_primitive_is_the_transformed_function(name):
    transform = TRANSFORMED[name]
    expected = jax.jit(lambda: transform(unrolled))()
    assert_same(eqx.filter_jit(lambda: transform(by_loop))(), expected)
    if name in AT_ONCE:
        assert_same(transform(by_loop), expected)


@pytest.fixture
def own(monkeypatch):
    """A function with programs of its own, and how many directions each compiled derivative has."""
    made: list[Program] = []

    def derivative(self, by, directions=1, take=Program.derivative):
        made.append(take(self, by, directions))
        return made[-1]

    monkeypatch.setattr(Program, "derivative", derivative)
    compiled = lambda: {one.origin[2] for one in made if one.origin and "compiled" in vars(one)}
    return kernel(lambda a, x: unrolled(a, x)), compiled


@pytest.mark.parametrize("jit", [jax.jit, pytest.param(lambda f: f, marks=pytest.mark.slow)])
def test_a_long_derivative_is_compiled_for_many_cells(jit, own, monkeypatch):
    """Along three directions at once; of fewer cells, each direction is a cell of its own."""
    monkeypatch.setattr(primitive, "LONG_CELLS", len(XS))
    function, compiled = own
    jacobian = lambda f: jax.vmap(jax.jacfwd(real(f), BOTH), (None, 0))
    gradient = lambda f: jax.vmap(jax.grad(number(f), BOTH), (None, 0))
    for xs, directions in ((XS[1:], {1}), (XS, {1, 3})):
        for derivatives in (jacobian, gradient):
            expected = jax.jit(derivatives(unrolled))(A, xs)
            assert_same(jit(derivatives(function))(A, xs), expected)
        assert compiled() == directions
    twice = lambda f: jax.vmap(jax.jacfwd(jax.jacfwd(real(f), BOTH), BOTH), (None, 0))
    assert_same(jax.jit(twice(function))(A, XS), jax.jit(twice(unrolled))(A, XS))


def test_directions_at_once_remain_where_more_would_be_long(own, monkeypatch):
    """Of directions in two axes, the inner ones are one program, the outer ones cells."""
    function, compiled = own
    size = program_of(function, *jax.tree.flatten((A, X))[::-1])[0].size
    monkeypatch.setattr(primitive, "MAX_OPERATIONS", (0, 5 * size))
    along = lambda f, v: jax.jvp(lambda x: real(f)(A, x), (X,), (v,))[1]
    nested = lambda f: jax.vmap(jax.vmap(partial(along, f)))(MANY[:2, :4])
    assert_same(jax.jit(nested, static_argnums=0)(function), nested(unrolled))
    assert compiled() == {4}


@pytest.mark.parametrize(
    "n", [0, *(pytest.param(n, marks=pytest.mark.slow) for n in (1, 7, 8, 9)), 1000]
)
def test_any_number_of_cells(n):
    """Values and derivatives of no cells too."""
    xs = jnp.asarray(RNG.random((n, 2)))
    together = lambda f: (
        jax.vmap(f, (None, 0))(A, xs),
        jax.vmap(jax.jacfwd(number(f), BOTH), (None, 0))(A, xs),
        jax.grad(lambda a: jax.vmap(number(f), (None, 0))(a, xs).sum())(A),
    )
    expected = jax.jit(lambda: together(unrolled))()
    assert_same(jax.jit(lambda: together(by_loop))(), expected, rtol=1e-11)
    outputs = jax.vmap(by_loop, (None, 0))(A, xs)
    assert_same(outputs, expected[0])


def test_no_cells_by_no_cells():
    """And derivatives along no directions."""
    over_both = lambda f: jax.vmap(jax.vmap(f, (0, None)), (None, 0))
    of_many = lambda x, v: jax.jvp(lambda x: by_loop(A, x)[0], (x,), (v,))[1]

    @jax.jit
    def look(none):
        found = jax.vmap(jax.vmap(of_many, (None, 0)), (0, None))
        along = jax.vmap(of_many, (None, 0))(X, none), found(XS, none), found(none, XS)
        return over_both(by_loop)(AS, none), over_both(by_loop)(AS[:0], XS)[0], along

    (y, z, count, high), of_none, along = look(jnp.zeros((0, 2)))
    assert y.shape == (0, 7, 2) and z.shape == count.shape == high.shape == (0, 7)
    assert of_none.shape == (9, 0, 2)
    assert [change.shape for change in along] == [(0, 2), (9, 0, 2), (0, 9, 2)]


def test_float32():
    cast = lambda value: value.astype(jnp.float32)
    derivatives = lambda f, a, x: (f(a, x), jax.jacrev(real(f), BOTH)(a, x))
    found = jax.jit(partial(derivatives, by_loop))(cast(A), cast(X))
    expected = jax.jit(partial(derivatives, unrolled))(cast(A), cast(X))
    assert {leaf.dtype.name for leaf in jax.tree.leaves(found)} == {"float32", "int64", "bool"}
    assert_same(found, expected, rtol=1e-5, atol=1e-6)


@kernel
def of_two_types(x, y):
    return x * x, y * y * x.astype(jnp.float64)


def test_operands_of_two_types():
    operands = jnp.float32(0.5), jnp.float64(0.25)

    def pulled(f):
        _, pull = jax.vjp(f, *operands)
        return pull((jnp.float32(2.0), jnp.float64(3.0)))

    found = jax.jit(lambda: pulled(of_two_types))()
    assert_same(found, jax.jit(lambda: pulled(of_two_types.__wrapped__))(), rtol=1e-6)


def test_a_linear_function_is_its_own_transpose():
    scaled = kernel(lambda x, y: (jnp.stack([x[0] + 2 * x[1], 3 * x[0], x[1]]) * y[0], 1))
    y = jnp.asarray([2.0])
    transposed = jax.jit(lambda w: jax.linear_transpose(lambda x: scaled(x, y)[0], X)(w)[0])
    w = jnp.asarray([1.0, -1.0, 0.5])
    np.testing.assert_allclose(transposed(w), [-4.0, 5.0], rtol=1e-15)
    ws = jnp.asarray(RNG.normal(size=(4, 3)))
    np.testing.assert_allclose(jax.vmap(transposed)(ws), jnp.stack(list(map(transposed, ws))))


def test_what_has_no_real_results_has_no_derivative():
    above = kernel(lambda x: (x > 0.5, jnp.floor(x).astype(int)))
    tangents = jax.jit(lambda x, v: jax.jvp(above, (x,), (v,))[1])(A, A)
    assert all(tangent.dtype == jax.dtypes.float0 for tangent in tangents)


def asked_for(monkeypatch, function, *args):
    """By which operands a function's derivatives are taken, and along how many directions."""
    asked = []

    def derivative(self, by, directions=1, take=Program.derivative):
        asked.append((by, directions))
        return take(self, by, directions)

    monkeypatch.setattr(Program, "derivative", derivative)
    jax.make_jaxpr(function)(*args)
    return asked


DERIVATIVES = {
    "none": (by_loop, set()),
    "forward by one": (lambda a, x: jax.jvp(lambda a: real(by_loop)(a, x), (a,), (a,)), {(0,)}),
    "forward by the other": (
        lambda a, x: jax.jvp(lambda x: real(by_loop)(a, x), (x,), (x,)),
        {(1,)},
    ),
    "reverse by one": (jax.grad(number(by_loop)), {(0,)}),
    "reverse by both": (jax.grad(number(by_loop), BOTH), {(0, 1)}),
    "of what is constant": (
        lambda a, x: jax.grad(number(by_loop))(a, lax.stop_gradient(x)),
        {(0,)},
    ),
}


@pytest.mark.parametrize("name", DERIVATIVES)
def test_derivatives_are_only_by_what_is_asked_for(name, monkeypatch):
    function, expected = DERIVATIVES[name]
    asked = asked_for(monkeypatch, function, A, X)
    assert {by for by, _ in asked} == expected
    sizes = 1, 2
    assert all(directions <= sum(sizes[i] for i in by) for by, directions in asked)


def test_donated_operands():
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Some donated buffers were not usable")
        xs = jnp.array(XS)
        expected = jax.jit(jax.vmap(unrolled, (None, 0)))(A, xs)
        found = jax.jit(jax.vmap(by_loop, (None, 0)), donate_argnums=1)(A, xs)
    assert_same(found, expected)


# What is like the function itself

COMPLEX = {
    "operand": (lambda z: jnp.abs(z), 1 + 1j),
    "within": (lambda x: jnp.exp(lax.complex(x, x)).real, 1.0),
    "result": (lambda x: jnp.exp(lax.complex(x, x)), 1.0),
}


@pytest.mark.parametrize("name", COMPLEX)
def test_derivatives_through_complex_numbers(name):
    function, x = COMPLEX[name]
    expected = jax.jvp(function, (x,), (x,))
    np.testing.assert_allclose(jax.jvp(kernel(function), (x,), (x,)), expected, rtol=1e-14)


def test_a_derivative_is_computed_in_the_modes_of_its_function():
    thirds = lambda x: (x * x * jnp.sin(jnp.arange(1.0, 4.0) / 3.0)).sum()
    function = kernel(thirds)
    value, pull = jax.vjp(function, 1.3)
    one = jnp.ones_like(value)
    with jax.enable_x64(False):
        (change,) = pull(one)
    expected = jax.grad(thirds)(1.3)
    assert change.dtype == np.float64
    np.testing.assert_allclose(change, expected, rtol=1e-15)
    np.testing.assert_allclose(jax.grad(function)(1.3), expected, rtol=1e-15)


def test_a_result_that_nobody_asks_for_leaves_gradients_alone():
    """Though its own derivative is infinite."""
    function = kernel(lambda x: jnp.stack([x[0] * x[1], jnp.sqrt(x[2])]))
    change = jax.grad(lambda x: function(x)[0])(jnp.array([1.0, 2.0, 0.0]))
    np.testing.assert_array_equal(change, [2.0, 1.0, 0.0])


def test_a_number_of_python_takes_the_type_of_the_other_operand():
    assert kernel(jnp.multiply)(2.0, np.float32(3)).dtype == np.float32


def test_logarithms_of_denormal_numbers():
    x = np.array([1e-40, 1e-44], np.float32)
    found = jax.vmap(kernel(jnp.log))(x)
    np.testing.assert_allclose(found, np.log(x.astype(float)), rtol=1e-6)


def nested(x):
    return by_loop(A, x)[0]


BY_XLA = {
    "a function of an entry": (lambda x: x.at[0].apply(jnp.sin), X),
    "a loop without turns": (lambda x: lax.scan(lambda c, _: (2 * c, c), x, X[:0]), X),
    "a key": (lambda key: jax.random.uniform(key), jax.random.key(0)),
    "pivoting": (lambda x: lax.linalg.qr(jnp.outer(x, x) + jnp.eye(2), pivoting=True)[1], X),
    "one of two numbers": (
        lambda x: lax.while_loop(
            lambda c: c < 3.0, lambda c: c + 1, lax.select_n(jnp.int32(x[0] > 0), 1.0, 2.0)
        ),
        X,
    ),
    "a primitive in a primitive": (lambda x: jaxpr_as_fun(jax.make_jaxpr(nested)(X))(x)[0], X),
    "many results": (lambda x: x[0] * jnp.arange(2000.0), X),
}


@pytest.mark.parametrize("name", BY_XLA)
def test_what_has_no_kernel_or_an_unusual_one_is_the_same(name):
    function, x = BY_XLA[name]
    for found, expected in zip(
        *map(jax.tree.leaves, (kernel(function)(x), function(x))), strict=True
    ):
        np.testing.assert_allclose(found, expected, rtol=1e-14)


def test_what_is_printed_is_printed_at_every_call(capfd):
    function = kernel(lambda x: (jax.debug.print("hey"), 2 * x)[1])
    function(1.0)
    function(2.0)
    jax.effects_barrier()
    assert capfd.readouterr().out == "hey\nhey\n"

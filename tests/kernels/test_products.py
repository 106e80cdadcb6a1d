"""Sums of products: values and derivatives, against JAX's own operations."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import export
from jax.extend.core import jaxprs_in_params

from walker_jax.kernels import kernel
from walker_jax.kernels.compiled import source_of
from walker_jax.kernels.products import sum_of_products, sum_of_products_p
from walker_jax.kernels.program import count_operations


def plainly(*operands):
    pairs = zip(operands[::2], operands[1::2], strict=False)
    start = operands[-1] if len(operands) % 2 else 0.0
    return start + sum(a * b for a, b in pairs)


def numbers(count: int, shape=(), dtype: Any = np.float64) -> list[jax.Array]:
    random = np.random.default_rng(count)
    return [jnp.asarray(random.normal(size=shape), dtype) for _ in range(count)]


def partner(operands, i: int):
    """The factor of an operand; that of the constant is 1."""
    return operands[i ^ 1] if i ^ 1 < len(operands) else np.ones_like(operands[i])


def jacobian(operands) -> list[np.ndarray]:
    """The derivative by each operand, entry by entry."""
    shape = operands[0].shape
    same = np.eye(int(np.prod(shape)), dtype=operands[0].dtype).reshape(shape * 2)
    return [same * np.asarray(partner(operands, i)) for i in range(len(operands))]


def hessian(operands) -> list[list[np.ndarray]]:
    """The second derivatives, which are 1 for an entry and its factor."""
    shape, count = operands[0].shape, range(len(operands))
    every = np.arange(int(np.prod(shape)))
    same = np.zeros((every.size,) * 3)
    same[every, every, every] = 1
    return [[same.reshape(shape * 3) * (j == i ^ 1) for j in count] for i in count]


def agree(found, expected, tolerance=1e-14) -> None:
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        assert one.dtype == other.dtype and one.shape == other.shape
        np.testing.assert_allclose(one, other, tolerance, tolerance)


def primitives(function, *args) -> list[str]:
    return [equation.primitive.name for equation in jax.make_jaxpr(function)(*args).eqns]


SIZES = [(2, (2, 2)), (3, ()), (6, (3,)), (7, ())]
MORE = [(n, shape) for n in (2, 3, 6, 7) for shape in ((), (3,), (2, 2)) if (n, shape) not in SIZES]


@pytest.mark.parametrize(
    ("count", "shape"), [*SIZES, *(pytest.param(*one, marks=pytest.mark.slow) for one in MORE)]
)
def test_values_and_derivatives(count, shape):
    given, changes = numbers(count, shape), numbers(count + 10, shape)[:count]
    assert primitives(sum_of_products, *given) == ["sum_of_products"]
    value, slopes = plainly(*map(np.asarray, given)), jacobian(given)
    agree(sum_of_products(*given), value)
    change = sum(np.tensordot(by, dx, len(shape)) for by, dx in zip(slopes, changes, strict=True))
    along = lambda *x: jax.jvp(sum_of_products, x, tuple(changes))
    agree(along(*given), (value, change))
    assert primitives(along, *given) == ["sum_of_products"] * 2  # the derivative is one sum too
    every = tuple(range(count))
    ways = jax.jacfwd, jax.jacrev, jax.hessian
    whole = jax.jit(
        lambda *x: [sum_of_products(*x), *(way(sum_of_products, every)(*x) for way in ways)]
    )
    agree(whole(*given), [value, slopes, slopes, hessian(given)])


def test_derivatives_by_some_operands():
    given = numbers(5)
    for by in range(5):
        agree(jax.grad(sum_of_products, by)(*given), jax.grad(plainly, by)(*given))
    only_constant = lambda c: sum_of_products(*given[:4], c)
    assert primitives(lambda c: jax.jvp(only_constant, (c,), (c,)), 1.0) == ["sum_of_products"]
    square = lambda x: sum_of_products(x, x, x, x, x)
    agree(jax.grad(square)(3.0), jnp.asarray(13.0))
    still = lambda x: sum_of_products(*map(jax.lax.stop_gradient, (x, x)))
    three = jnp.float64(3.0)
    agree(jax.jvp(still, (three,), (three,)), (three * three, 0 * three))


@pytest.mark.parametrize(
    ("shapes", "axes"),
    [
        ([(4,), (), (), (4,), ()], (0, None, None, 0, None)),
        ([(4, 2), (2, 4), (2,), (2,), (2,)], (0, 1, None, None, None)),
        ([(2,), (2,), (2, 4)], (None, None, 1)),
    ],
)
def test_batches(shapes, axes):
    given = [numbers(1, shape)[0] for shape in shapes]
    mapped = lambda f: jax.vmap(f, axes)
    agree(mapped(sum_of_products)(*given), mapped(plainly)(*given))
    total = lambda f: lambda *x: jnp.sum(jnp.sin(mapped(f)(*x)))
    every = tuple(range(len(given)))
    for derivative in (jax.grad, jax.jacfwd):
        found, expected = (
            jax.jit(derivative(total(f), every))(*given) for f in (sum_of_products, plainly)
        )
        agree(found, expected)


def test_batch_of_batches():
    a, b, c = numbers(3, (3,))
    table = lambda f: jax.vmap(lambda x: jax.vmap(lambda y: f(x, y, c[0], y, x))(b))(a)
    agree(table(sum_of_products), table(plainly))
    rows = lambda f: jax.vmap(lambda x: jax.vmap(lambda y: f(y, a, a, a, x * a))(b))(a)
    agree(rows(lambda y, *x: sum_of_products(y * jnp.ones(3), *x)), rows(plainly))


def test_several_types_are_promoted():
    x, vector = jnp.float64(2.0), jnp.arange(3.0)
    assert sum_of_products(2, x, 1.5) == 5.5
    agree(sum_of_products(x, vector, x, x, vector), plainly(x, vector, x, x, vector))
    single = numbers(4, (), np.float32)
    assert sum_of_products(*single).dtype == np.float32
    weak = jax.jit(lambda x: sum_of_products(jnp.sin(2.0), jnp.sin(2.0)) * x)
    assert weak(single[0]).dtype == np.float32
    assert primitives(lambda x: sum_of_products(x, 3.0), x) == ["mul"]


@pytest.mark.parametrize(
    ("dtype", "shape"),
    [
        (np.float32, ()),
        (np.float64, ()),
        (np.float64, (2, 2)),
        pytest.param(np.float32, (2, 2), marks=pytest.mark.slow),
    ],
)
def test_kernels(dtype, shape):
    """Machine code adds the same products, of numbers and of arrays, with their derivatives."""
    operands, tolerance = numbers(5, shape, dtype), 8 * float(np.finfo(dtype).eps)
    fast = kernel(sum_of_products)
    agree(fast(*operands), plainly(*map(np.asarray, operands)), tolerance)
    derivative = jax.jit(jax.jacfwd(fast, tuple(range(5))))
    agree(derivative(*operands), jacobian(operands), tolerance)
    zero = kernel(lambda x: sum_of_products(x, jnp.zeros_like(x), x, jnp.ones_like(x)))
    agree(zero(operands[0]), operands[0])


def test_a_product_and_its_sum_are_one_instruction():
    *_, source, _ = source_of(jax.make_jaxpr(sum_of_products)(*numbers(7)), 256)
    assert source.count(" = call contract <4 x double> @llvm.fmuladd.v4f64(") == 3
    assert not any(f" {name} " in source for name in ("fmul", "fadd"))
    *_, source, _ = source_of(jax.make_jaxpr(sum_of_products)(*numbers(4)), 256)
    assert source.count(" = call contract <4 x double> @llvm.fmuladd.v4f64(") == 1
    assert source.count(" = fmul ") == 1 and " fadd " not in source


def test_operations_are_counted():
    """A sum counts for its products and additions, and an inner function at each call."""
    five = jax.make_jaxpr(sum_of_products)(*numbers(5, (2,))).jaxpr
    assert count_operations(five) == 8
    inner = jax.jit(lambda x: x * x + x)
    twice = jax.make_jaxpr(lambda x: inner(inner(x)))(1.0).jaxpr
    assert count_operations(twice) == 4
    assert [*jaxprs_in_params(twice.eqns[0].params)] == [*jaxprs_in_params(twice.eqns[1].params)]


def test_shard_map():
    """Gradients by what all devices share are sums over devices."""
    mesh = jax.sharding.Mesh(np.array(jax.devices()[:1]), ("cells",))
    spec = jax.sharding.PartitionSpec
    x, p = jnp.arange(4.0), jnp.asarray(3.0)

    def loss(f):
        each = lambda p, x: jax.lax.psum(jnp.sum(jax.vmap(lambda x: f(p, x, x, x, p))(x)), "cells")
        whole = jax.shard_map(each, mesh=mesh, in_specs=(spec(), spec("cells")), out_specs=spec())
        return lambda p, x: whole(p, x)

    gradient = lambda f: jax.jit(jax.grad(loss(f), (0, 1)))(p, x)
    found, expected = gradient(sum_of_products), gradient(plainly)
    agree(found, expected)
    assert "sum_of_products" not in str(jax.make_jaxpr(loss(sum_of_products))(p, x))
    assert sum_of_products_p.name in str(jax.make_jaxpr(sum_of_products)(p, p))


def test_a_batch_may_have_a_symbolic_size():
    """A program of `jax.export` takes any number of cells, each with vectors and with numbers."""
    xs, y, z = numbers(5, (4, 3)), jnp.arange(3.0), jnp.array(2.0)
    cell = lambda x: jax.vmap(lambda a, b: sum_of_products(a, b, a, z, b))(x, y)
    (n,) = export.symbolic_shape("n")
    saved = export.export(jax.jit(jax.vmap(cell)))(jax.ShapeDtypeStruct((n, 3), y.dtype))
    for x in (xs[0], xs[1][:2]):
        agree(saved.call(x), plainly(x, y, x, z, jnp.broadcast_to(y, x.shape)))

"""A function as a primitive of JAX: all that JAX does with one, against the function itself."""

import os
import subprocess
import sys
import threading
import warnings
from collections import OrderedDict
from functools import partial
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import export, lax
from jax.extend.core import jaxpr_as_fun

from walker_jax.kernels import ffi, handler, kernel, primitive
from walker_jax.kernels import program as of_program
from walker_jax.kernels.program import Program

TURNS = 2


def turn(a, x, y):
    return y * a - jnp.sin(y) * x[0] + x[1] ** 2 * 0.1


def turns(x):
    return jnp.where(x[0] > 0.3, TURNS, TURNS - 1)


def results(a, x, y, count):
    return jnp.stack([y, x[0] * a]), y * x[1], count, y > 0.5


@kernel
def by_loop(a, x):
    """A vector, a number, an integer and a truth value of a number and a vector."""
    going = lambda carry: carry[1] < turns(x)
    advance = lambda carry: (turn(a, x, carry[0]), carry[1] + 1)
    return results(a, x, *lax.while_loop(going, advance, (x[0] + x[1], jnp.asarray(0))))


def unrolled(a, x):
    """The same of JAX alone, in whose derivatives no loop is."""
    y = x[0] + x[1]
    for k in range(TURNS):
        y = jnp.where(k < turns(x), turn(a, x, y), y)
    return results(a, x, y, turns(x))


A, X = jnp.asarray(0.9), jnp.asarray([0.35, 0.4])
RNG = np.random.default_rng(0)
AS, XS = jnp.asarray(RNG.random(7)), jnp.asarray(RNG.random((9, 2)))
BOTH = 0, 1
MANY = jnp.asarray(RNG.normal(size=(3, 500, 2)))


def real(function):
    return lambda a, x: function(a, x)[:2]


def number(function):
    """One number, in which all real results have a part."""

    def single(a, x):
        y, z = function(a, x)[:2]
        return jnp.sum(y**2) * z + y[1]

    return single


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


@pytest.fixture(autouse=True)
def few_together(monkeypatch):
    """Machine code of few directions at once compiles in no time; more are cells of their own."""
    monkeypatch.setattr(primitive, "MAX_OPERATIONS", (100, 100))


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


def assert_same(found, expected, rtol=1e-12, atol=1e-13):
    assert jax.tree.structure(found) == jax.tree.structure(expected)
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        assert one.shape == other.shape and one.dtype == other.dtype
        np.testing.assert_allclose(one, other, rtol=rtol, atol=atol)


AT_ONCE = "values", "jvp", "linearize", "vmap over one", "vmap nested"
"""What is computed outside of `jit` too, where XLA compiles each operation around it."""

LONG = {"third", "reverse over reverse", "reverse over forward", "transposed of many"}
LONG |= {"vmap thrice", "vmap of hessian", "hessian of vmap", "scan of many", "for", "filters"}
LONG |= {"hessian of scan", "jacrev of vmap"}
CASES = [pytest.param(name, marks=pytest.mark.slow if name in LONG else ()) for name in TRANSFORMED]


@pytest.mark.parametrize("name", CASES)
def test_the_transformed_primitive_is_the_transformed_function(name):
    transform = TRANSFORMED[name]
    expected = jax.jit(lambda: transform(unrolled))()
    assert_same(eqx.filter_jit(lambda: transform(by_loop))(), expected)
    if name in AT_ONCE:
        assert_same(transform(by_loop), expected)


@pytest.mark.parametrize(
    "n", [0, 1, *(pytest.param(n, marks=pytest.mark.slow) for n in (7, 8, 9)), 1000]
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


A_FUNCTION = """
from functools import partial
import jax, jax.numpy as jnp, numpy as np
from jax import lax
from jax.sharding import AxisType, NamedSharding, PartitionSpec as P
jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_dtype_promotion", "strict")
import walker_jax as wj
from walker_jax.kernels import kernel

@kernel
def function(a, x):
    step = lambda c: (c[0] * a - jnp.sin(c[0]) * x[1], c[1] + 1)
    y, k = lax.while_loop(lambda c: c[1] < jnp.where(x[0] > 0.5, 3, 2), step, (x[0], 0))
    return jnp.stack([y, y * a]), k
"""
ON_DEVICES = """
# One mesh; the derivative by an operand that all cells share is the total
a, xs = jnp.asarray(0.9), jnp.asarray(np.random.default_rng(0).random((400, 2)))
many = jax.vmap(function, (None, 0))
total = lambda a, xs: (many(a, xs)[0] ** 2).sum()
expected = jax.jit(many)(a, xs)
gradient = jax.jit(jax.grad(total, (0, 1)))(a, xs)
check = partial(jax.tree.map, partial(np.testing.assert_allclose, rtol=1e-12, atol=1e-14))
other = jax.device_put((a, xs[0]), jax.devices()[1])
assert all(x.devices() == {jax.devices()[1]} for x in function(*other))
for n in 1, 4:
    mesh = jax.make_mesh((n,), ("cells",), devices=jax.devices()[:n], axis_types=(AxisType.Auto,))
    sharded = jax.device_put(xs, NamedSharding(mesh, P("cells")))
    check(jax.jit(many)(a, sharded), expected)
    on_mesh = partial(jax.shard_map, mesh=mesh, in_specs=(P(), P("cells")))
    apart = jax.jit(on_mesh(many, out_specs=P("cells")))(a, sharded)
    assert len(apart[0].sharding.device_set) == n
    check(apart, expected)
    if n == 1:
        continue
    check(jax.jit(jax.grad(total, (0, 1)))(a, sharded), gradient)
    whole = on_mesh(lambda a, xs: lax.psum(total(a, xs), "cells"), out_specs=P())
    check(jax.jit(jax.grad(whole, (0, 1)))(a, sharded), gradient)
    check(jax.jit(jax.jacfwd(whole))(a, sharded), gradient[0])
    inside = on_mesh(jax.grad(total, (0, 1)), out_specs=(P(), P("cells")))
    check(jax.jit(inside)(a, sharded), gradient)
"""
ON_MESHES = """
# Each device computes its own: no cell is sent, and results are sharded as operands are
COLLECTIVES = "all-gather", "all-to-all", "collective-permute", "all-reduce"

def check(function, operands, shardings, results, collectives=()):
    expected = jax.jit(function)(*operands)
    put = lambda x, sharding: x if sharding is None else jax.device_put(x, sharding)
    operands = list(map(put, operands, shardings))
    compiled = jax.jit(function).lower(*operands).compile()
    found = compiled(*operands)
    for one, other in zip(*map(jax.tree.leaves, (found, expected)), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-14)
        assert one.sharding.is_equivalent_to(results, one.ndim), (one.sharding, results)
    text = compiled.as_text()
    assert "walker_jax" in text
    assert [name for name in COLLECTIVES if name in text] == list(collectives)

rng = np.random.default_rng(0)
a, many, xs = jnp.asarray(0.9), jnp.asarray(rng.random(80)), jnp.asarray(rng.random((80, 2)))
square = xs.reshape(8, 10, 2)
shared, each = jax.vmap(function, (None, 0)), jax.vmap(function)
nested = jax.vmap(shared, (None, 0))
total = lambda function: lambda a, x: (function(a, x)[0] ** 2).sum()
of_shared, of_each, of_nested = map(total, (shared, each, nested))
by_cells = {f: jax.grad(f, 1) for f in (of_shared, of_each, of_nested)}
by_first = {f: jax.grad(f) for f in (of_shared, of_each)}
along = lambda a, x: jax.jvp(lambda a, x: shared(a, x)[0], (a, x), (a, x))
columns = lambda a, x: jax.jacfwd(lambda a: shared(a, x)[0])(a)
for kind in AxisType.Auto, AxisType.Explicit:
    line = jax.make_mesh((4,), ("cells",), axis_types=(kind,))
    over, whole = NamedSharding(line, P("cells")), NamedSharding(line, P())
    for everywhere in None, whole:
        check(shared, (a, xs), (everywhere, over), over)
    check(each, (many, xs), (over, over), over)
    check(along, (a, xs), (None, over), over)
    check(columns, (a, xs), (None, over), over)
    check(by_cells[of_shared], (a, xs), (None, over), over)
    check(by_cells[of_each], (many, xs), (over, over), over)
    check(by_first[of_shared], (a, xs), (None, over), whole, ["all-reduce"])
    check(by_first[of_each], (many, xs), (over, over), over)
    mesh = jax.make_mesh((2, 2), ("i", "j"), axis_types=(kind,) * 2)
    for spec in P(("i", "j")), P("j"):
        over = NamedSharding(mesh, spec)
        check(shared, (a, xs), (None, over), over)
    over = NamedSharding(mesh, P("i", "j"))
    check(nested, (a, square), (None, over), over)
    check(by_cells[of_nested], (a, square), (None, over), over)

# Where XLA finds the shardings: one operand whole, both sharded, and over axes of their own
over = NamedSharding(jax.make_mesh((4,), ("cells",), axis_types=(AxisType.Auto,)), P("cells"))
check(each, (many, xs), (None, over), over)
mesh = jax.make_mesh((2, 2), ("i", "j"), axis_types=(AxisType.Auto,) * 2)
i, j, both = (NamedSharding(mesh, P(*names)) for names in ("i", "j", "ij"))
check(jax.vmap(shared, (0, None)), (many, xs), (i, j), both)
some = jax.shard_map(
    shared, mesh=mesh, in_specs=(P(), P("i")), out_specs=P("i"), axis_names={"i"}
)
cells = NamedSharding(mesh, P(("i", "j")))
check(some, (a, xs), (None, cells), cells)

# Cells that do not divide evenly: JAX permits them within, and not as a result
uneven = lambda a, x: shared(a, lax.with_sharding_constraint(x, over))
for n in 3, 10:
    np.testing.assert_array_equal(jax.jit(uneven)(a, xs[:n])[0], shared(a, xs[:n])[0])

# Strides, of one walker and of many
starts = jnp.asarray([0.2003109, -0.1998325]) * (1 + 0.01 * xs)
stride = lambda slope, x: wj.stride(wj.SimplestWalker(slope), x)
check(jax.vmap(stride), (0.009 + 1e-4 * many, starts), (over, over), over)
check(jax.vmap(stride, (None, 0)), (jnp.asarray(0.009), starts), (None, over), over)
"""


def test_cells_on_several_devices():
    """Also where JAX divides them: all in one process, as none has four devices of itself."""
    flags = {"XLA_FLAGS": "--xla_force_host_platform_device_count=4", "JAX_PLATFORMS": "cpu"}
    flags["JAX_DISABLE_MOST_OPTIMIZATIONS"] = "1"  # what XLA compiles is called once
    done = subprocess.run(
        [sys.executable, "-c", A_FUNCTION + ON_DEVICES + ON_MESHES],
        env=os.environ | flags,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr


# Programs for other processes

KERNEL_CALL = "custom_call @walker_jax"
CALLED = """
import sys
import jax, numpy as np
from jax import export
jax.config.update("jax_enable_x64", True)
program, given, to = sys.argv[1:]
call = export.deserialize(bytearray(open(program, "rb").read())).call
operands = [np.load(given)[name] for name in ("a", "x")]
results = jax.jit(call)(*operands)
gradient = jax.grad(lambda a, x: (call(a, x)[0] ** 2).sum(), (0, 1))(*operands)
np.savez(to, *results, *gradient)
assert "walker_jax" not in sys.modules
"""


def test_an_exported_program_runs_without_kernels(tmp_path):
    """In a process that knows none, for any number of cells, with its derivatives."""
    many = jax.jit(jax.vmap(by_loop, (None, 0)))
    (n,) = export.symbolic_shape("n")
    exported = export.export(many)(A, jax.ShapeDtypeStruct((n, 2), X.dtype))
    assert KERNEL_CALL in many.lower(A, XS).as_text()
    assert KERNEL_CALL not in exported.mlir_module()
    program, given, to = (str(tmp_path / name) for name in ("program", "given.npz", "to.npz"))
    Path(program).write_bytes(exported.serialize(vjp_order=1))
    np.savez(given, a=A, x=XS)
    call = [sys.executable, "-c", CALLED, program, given, to]
    done = subprocess.run(call, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    gradient = jax.grad(lambda a, x: (many(a, x)[0] ** 2).sum(), BOTH)(A, XS)
    with np.load(to) as found:
        expected = *many(A, XS), *gradient
        assert len(found.files) == len(expected)
        for one, other in zip(found.values(), expected, strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-13, atol=1e-15)


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


def test_a_derivative_is_computed_in_the_modes_in_which_its_function_was_traced():
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
    "a primitive in a primitive": (
        lambda x: jaxpr_as_fun(jax.make_jaxpr(nested)(X))(x)[0],
        X,
    ),
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


# The handler


def call(operands, results):
    """The handler, called with any buffers."""
    program, _ = of_program.program_of(
        by_loop, jax.tree.structure((A, X)), [*map(jax.typeof, (A, X))]
    )
    assert program.compiled is not None
    like = [jax.ShapeDtypeStruct(*result) for result in results]
    target = ffi.target(program.compiled)
    return jax.jit(lambda *operands: jax.ffi.ffi_call(target, like)(*operands))(*operands)


VECTOR, NUMBER, WHOLE, TRUTH = ((2,), "float64"), ((), "float64"), ((), "int64"), ((), "bool")
SINGLE = [VECTOR, NUMBER, WHOLE, TRUTH]
SEVEN = [((7, *shape), dtype) for shape, dtype in SINGLE]
WRONG = {
    "type of an operand": ((A.astype(jnp.float32), X), SINGLE),
    "size of an operand": ((A, jnp.ones(3)), SINGLE),
    "no size of an operand": ((A, jnp.ones(0)), SINGLE),
    "rank of an operand": ((A, jnp.asarray(1.0)), SINGLE),
    "cells of an operand along two axes": ((A, jnp.ones((2, 3, 2))), SEVEN),
    "cells of an operand": ((A, jnp.ones((6, 2))), SEVEN),
    "cells of an operand of one": ((A, jnp.ones((7, 2))), SINGLE),
    "operands too few": ((A,), SINGLE),
    "operands too many": ((A, X, X), SINGLE),
    "results too few": ((A, X), SINGLE[:3]),
    "results too many": ((A, X), [*SINGLE, NUMBER]),
    "type of a result": ((A, X), [*SINGLE[:2], ((), "int32"), TRUTH]),
    "size of a result": ((A, X), [((3,), "float64"), *SINGLE[1:]]),
    "rank of the first result": ((A, X), [NUMBER, *SINGLE[1:]]),
    "cells of the first result along two axes": ((A, X), [((2, 3, 2), "float64"), *SEVEN[1:]]),
    "rank of a later result": ((A, X), [*SEVEN[:3], TRUTH]),
    "cells of a result": ((A, X), [*SEVEN[:3], ((8,), "bool")]),
}


@pytest.mark.parametrize("name", WRONG)
def test_other_buffers_are_refused(name):
    with pytest.raises(jax.errors.JaxRuntimeError, match=handler.BUFFER_MISMATCH):
        jax.block_until_ready(call(*WRONG[name]))


def test_the_right_buffers_are_not():
    assert_same(tuple(call((A, X), SINGLE)), jax.jit(unrolled)(A, X))
    found = call((A, XS[:7]), SEVEN)
    assert_same(tuple(found), jax.jit(jax.vmap(unrolled, (None, 0)))(A, XS[:7]))
    six = [((2, 3, *shape), dtype) for shape, dtype in SINGLE]
    found = call((A, XS[:6].reshape(2, 3, 2)), six)
    expected = jax.jit(jax.vmap(jax.vmap(unrolled, (None, 0)), (None, 0)))
    assert_same(tuple(found), expected(A, XS[:6].reshape(2, 3, 2)))


def test_xla_computes_where_its_interface_is_unknown(monkeypatch):
    """That is told once."""
    monkeypatch.setattr(ffi, "VERSION", (0, 10**6))
    monkeypatch.setattr(of_program, "programs", OrderedDict())
    ffi.available.cache_clear()
    try:
        with pytest.warns(RuntimeWarning, match="more slowly") as told:
            many = jax.jit(jax.vmap(by_loop, (None, 0)))
            text = many.lower(A, XS).as_text()
            found = many(A, XS), jax.jit(jax.grad(number(by_loop), BOTH))(A, X)
        assert len(told) == 1 and "custom_call" not in text
    finally:
        ffi.available.cache_clear()
    monkeypatch.undo()
    assert "custom_call" in jax.jit(jax.vmap(by_loop, (None, 0))).lower(A, XS).as_text()
    expected = lambda a, x: (
        jax.vmap(unrolled, (None, 0))(a, XS),
        jax.grad(number(unrolled), BOTH)(a, x),
    )
    assert_same(found, jax.jit(expected)(A, X))


def test_several_threads_at_once():
    """Each with a function of its own, and all with one."""
    xs = jnp.asarray(RNG.random((20000, 2)))
    expected = jax.jit(jax.vmap(unrolled, (None, 0)))(A, xs)
    shared = jax.jit(jax.vmap(by_loop, (None, 0)))
    found = {}

    def compute(i):
        own = jax.jit(lambda a, x: jax.vmap(by_loop, (None, 0))(a, x + 0.0 * i))
        found[i] = [f(A, xs) for f in (shared, own) for _ in range(5)]

    threads = [threading.Thread(target=compute, args=(i,)) for i in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(found) == len(threads)
    for each in found.values():
        for one in each:
            assert_same(one, expected)


def test_cells_of_a_loop_that_ends_for_each_at_another_turn():
    """A call in each turn, within a loop over which cells are mapped."""

    def last(f, a, x):
        going = lambda carry: (carry[1] < 6) & (jnp.abs(carry[0]).sum() > 0.4)
        step = lambda carry: (f(a, carry[0])[0] * 0.7, carry[1] + 1)
        return lax.while_loop(going, step, (x, jnp.asarray(0)))

    both = lambda f: jax.vmap(jax.vmap(partial(last, f), (0, None)), (None, 0))(AS, XS)
    assert_same(jax.jit(lambda: both(by_loop))(), jax.jit(lambda: both(unrolled))())


def test_many_threads_compute_the_same_bits_as_one():
    """All at once, eight at a time, and outside of `jit`."""
    xs = jnp.asarray(RNG.random((100_000, 2)))
    many = jax.vmap(by_loop, (None, 0))
    found = jax.jit(many)(A, xs)
    in_parts = jax.jit(lambda xs: lax.map(lambda x: many(A, x), xs.reshape(-1, 50, 2)))(xs)
    for whole, parts, outside in zip(found, in_parts, many(A, xs), strict=True):
        np.testing.assert_array_equal(whole, parts.reshape(whole.shape))
        np.testing.assert_array_equal(whole, outside)


@pytest.mark.parametrize("n", [1, 100_000])
def test_denormal_numbers_are_kept(n):
    tiny = kernel(lambda x: x * 1e-310)
    found = jax.jit(jax.vmap(tiny))(jnp.ones(n))
    np.testing.assert_array_equal(found, np.full(n, 1e-310))
    # The mode of XLA's threads is theirs again.
    after = jax.jit(lambda x: jax.vmap(tiny)(x) * 0.5)(jnp.ones(n))
    np.testing.assert_array_equal(after, jax.jit(lambda x: x * 0.5)(jnp.full(n, 1e-310)))

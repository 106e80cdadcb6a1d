"""A kernel as XLA calls it: on several devices, in other processes, with other buffers."""

import os
import subprocess
import sys
import threading
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import export, lax
from jax.sharding import AxisType, NamedSharding
from jax.sharding import PartitionSpec as P
from turns import AS, BOTH, RNG, XS, A, X, assert_same, by_loop, number, unrolled

from walker_jax.identity import Cache
from walker_jax.kernels import ffi, handler, kernel
from walker_jax.kernels import program as of_program

pytestmark = pytest.mark.usefixtures("few_together")

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

# Walks, and searches for gaits
for follow in lambda w, x: wj.walk(w, x, 2), wj.find_gait:
    many = jax.vmap(lambda slope, x: follow(wj.SimplestWalker(slope), x), (None, 0))
    apart = jax.shard_map(many, mesh=over.mesh, in_specs=(P(), P("cells")), out_specs=P("cells"))
    found, expected = (jax.jit(f)(jnp.asarray(0.009), starts[:8]) for f in (apart, many))
    jax.tree.map(np.testing.assert_array_equal, found, expected)
"""


@pytest.mark.slow
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


@pytest.mark.parametrize("kind", [AxisType.Auto, AxisType.Explicit])
def test_xla_computes_on_meshes_what_has_no_kernel(kind):
    """Numbers in the function vary along no axis of a mesh, unlike its operands."""

    def function(a, x):
        return jnp.sort(jnp.stack([2.0 * x[0], a * x[1], jnp.sin(x[0] + 1.0)]))

    mesh = jax.make_mesh((1, 1), ("i", "j"), axis_types=(kind,) * 2)
    xs = jax.device_put(XS, NamedSharding(mesh, P("i")))
    value = lambda f: jax.vmap(f, (None, 0))
    gradient = lambda f: lambda a, x: jax.grad(lambda x: (value(f)(a, x) ** 3).sum())(x)
    for of in (value, gradient):
        own, expected = of(kernel(function)), jax.jit(of(function))(A, XS)
        found = [jax.jit(own)(A, xs)]
        for axes in ({"i"}, {"i", "j"}):
            specs = {"in_specs": (P(), P("i")), "out_specs": P("i"), "axis_names": axes}
            found.append(jax.jit(jax.shard_map(own, mesh=mesh, **specs))(A, xs))
        for one in found:
            np.testing.assert_allclose(one, expected, rtol=1e-12, atol=1e-14)


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
    monkeypatch.setattr(of_program, "programs", Cache())
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

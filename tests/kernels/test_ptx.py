"""Programs of threads: that they are PTX, and that they compute what programs of vectors do."""

import ctypes
import itertools
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from fake_card import LAUNCH, LOAD
from jax import lax
from jax.interpreters import mlir
from threads_of_cards import DTYPES, PTXAS, check_assembly, closed_of, elementary, ptx_of

import walker_jax as wj
from walker_jax.identity import Cache
from walker_jax.integrators.integrator import Integrator
from walker_jax.kernels import ffi, gpu, kernel, launcher, machine, object_cache, primitive, ptx
from walker_jax.kernels import program as of_program
from walker_jax.kernels.compiled import Compiled, source_of
from walker_jax.kernels.jaxprs import UnsupportedPrimitive
from walker_jax.kernels.machine import hash_source
from walker_jax.kernels.machine_code import MachineCode
from walker_jax.walking.stride import follow_stride

STARTS = [
    (wj.SimplestWalker(0.009), (0.2003, -0.1998)),
    (wj.SpringWalker(0.009, 2.0), (0.15, -0.16)),
    (wj.PointFootWalker(0.009, 1e-3), (0.2002, -0.1999)),
    (wj.RoundFootWalker(0.01), (0.19, -0.24, -0.05)),
    (wj.UpperBodyWalker(0.01), (0.2, -0.24, -0.03)),
    (wj.KneedWalker(0.05), (0.24, -0.35, -0.33)),
]
"""Walkers of all kinds, and a start about a gait of each."""
WALKERS = [
    pytest.param(
        *(walker, dtype), marks=[pytest.mark.slow] * (number > 0), id=f"{walker[0].label()}-{dtype}"
    )
    for number, (walker, dtype) in enumerate(itertools.product(STARTS, DTYPES))
]


def stride_of(walker, dtype):
    """A stride of a walker as a jaxpr, and starts about a gait."""
    model, start = walker
    model = jax.tree.map(lambda x: jnp.asarray(x, dtype), model)
    away = np.random.default_rng(0).uniform(-0.3, 0.3, (37, len(start)))
    starts = (np.asarray(start) * (1 + away)).astype(dtype)
    return closed_of(lambda x: [*wj.stride(model, x)[:2]], starts[0]), starts


# One lane and many


def with_one_lane(closed):
    """The program of a thread, compiled for this processor."""
    found = object.__new__(Compiled)
    found.operands, found.results, source, _ = source_of(closed, 0)
    found.code = MachineCode(source, hash_source(source))
    return found


def check_lanes(closed, xs, exact=True):
    """Both have the same functions, and so the same bits, but for the polynomial of exp in float32:
    there LLVM fuses other products with sums."""
    found = []
    for program in with_one_lane(closed), Compiled(closed):
        work, results = program.bind([xs], [True], len(xs))
        work(0, len(xs))
        found.append(results)
    for one, other in zip(*found, strict=True):
        if exact:
            np.testing.assert_array_equal(one, other)
        np.testing.assert_allclose(one, other, rtol=3e-7)


@pytest.mark.parametrize(("walker", "dtype"), WALKERS)
def test_one_lane_strides_as_many_do(walker, dtype):
    closed, starts = stride_of(walker, dtype)
    check_lanes(closed, starts)


@pytest.mark.parametrize("dtype", DTYPES)
def test_one_lane_computes_what_many_do(dtype):
    xs = np.random.default_rng(1).uniform(-3, 3, 50).astype(dtype)
    for function in elementary, of_floats, slopes_of_floats:
        check_lanes(closed_of(function, xs[0]), xs, exact=dtype == "float64")


# PTX


def check_text(text):
    assert ".version 6.0\n.target sm_70\n" in text
    assert text.count(".entry entry(") == 1 and ".func" not in text.replace(".func  (", "")
    assert f".maxnreg {ptx.REGISTERS}" in text and "call.uni" not in text


@pytest.mark.parametrize(("walker", "dtype"), WALKERS)
def test_ptx_of_a_stride(walker, dtype):
    closed, _ = stride_of(walker, dtype)
    text = ptx_of(closed)
    check_text(text)
    small = isinstance(walker[0], wj.SimplestWalker | wj.SpringWalker)
    assert ptx.Ptx([], [], text, "").threads == (64 if small else 256)


@pytest.mark.skipif(PTXAS is None, reason="needs ptxas, of the extra gpu-check")
@pytest.mark.parametrize(("walker", "dtype"), WALKERS)
def test_a_stride_is_assembled(walker, dtype, tmp_path):
    closed, _ = stride_of(walker, dtype)
    check_assembly(ptx_of(closed), tmp_path)


def of_floats(x):
    """What a processor computes without the C library."""
    y, n = x * x - 1, x.astype(jnp.int32)
    table = jnp.asarray(np.linspace(0, 1, 50), x.dtype)
    return [
        *(of(x) for of in (jnp.abs, jnp.sign, jnp.floor, jnp.ceil, jnp.round, jnp.square, jnp.exp)),
        *(of(x, y) for of in (jnp.maximum, jnp.minimum, jnp.add, jnp.subtract, jnp.divide)),
        *(jnp.sqrt(jnp.abs(x)), lax.rsqrt(x * x + 1), jnp.log(jnp.abs(x)), jnp.abs(x) ** 0.3),
        *(x**3, jnp.clip(x, -1, 1), lax.logistic(x), jnp.isfinite(x)),
        *(lax.round(x, lax.RoundingMethod.AWAY_FROM_ZERO), x > y, x == y, jnp.where(x > y, x, y)),
        *(n.astype(x.dtype), x.astype(jnp.uint8), x.astype(jnp.float32), x.astype(jnp.float64)),
        *(table[jnp.clip(n, 0, 49)], lax.clamp(y, x, y)),
        lax.while_loop(lambda z: z < 9, lambda z: z * 2 + 1, jnp.abs(x)),
        lax.cond(x > 0, lambda: jnp.exp(-x), lambda: y),
        jnp.linalg.solve(jnp.stack([jnp.stack([x, y]), jnp.stack([1 + y, x])]), jnp.stack([x, y])),
    ]


def slopes_of_floats(x):
    floats = lambda x: [y for y in of_floats(x) if y.dtype == x.dtype]
    return jax.jvp(floats, (x,), (jnp.ones_like(x),))[1]


def of_integers(x):
    n = jnp.asarray(3, x.dtype)
    return [
        *(x + n, x * n, x - n, lax.div(x, n), lax.rem(x, n), jnp.maximum(x, n), lax.sign(x)),
        *(x & n, x | n, x ^ n, ~x, x << n, x >> n, lax.shift_right_logical(x, n), jnp.abs(x)),
        *(x.astype(float), x > n, x**3, jnp.where(x == n, x, n), x.astype(bool)),
        lax.fori_loop(0, x.astype(jnp.int32), lambda _, y: y + n, x),
    ]


@pytest.mark.parametrize("kind", ["int8", "int16", "int32", "int64", "uint8", "uint32", "uint64"])
def test_ptx_of_integers(kind, tmp_path):
    check_text(text := ptx_of(closed_of(of_integers, jnp.asarray(5, kind)), in_memory=True))
    if PTXAS:
        check_assembly(text, tmp_path)


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize(
    "function", [of_floats, pytest.param(slopes_of_floats, marks=pytest.mark.slow)]
)
def test_ptx_of_floats(function, dtype, tmp_path):
    check_text(text := ptx_of(closed_of(function, jnp.asarray(0.7, dtype))))
    if PTXAS:
        check_assembly(text, tmp_path)


# Programs on disk


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv(object_cache.VARIABLE, str(tmp_path))
    monkeypatch.setattr(of_program, "programs", Cache())
    return tmp_path


def program_of_a_map():
    """As a process finds it that has none in memory."""
    of_program.programs.clear()
    leaves = wj.systems.HenonMap(), np.array([0.2, -0.2]), Integrator(1e-12)
    operands, structure = jax.tree.flatten(leaves)
    like = [jax.ShapeDtypeStruct(np.shape(x), float) for x in operands]
    return of_program.program_of(follow_stride, structure, like)[0]


MAPPED = False, False, True, False


def test_a_program_is_found_on_disk(folder):
    """With the facts of its trace, whatever else is known of it: its machine code is kept too."""
    first = program_of_a_map()
    made = first.ptx(MAPPED, False)
    assert made is not None and first.compiled is not None
    first.compiled.code.optimise()
    again = program_of_a_map()
    assert again.ptx(MAPPED, False) == made and again.compiled is not None
    assert "closed" not in vars(again)  # it was not traced
    other = program_of_a_map()
    spread = other.ptx((True,) * len(MAPPED), False)
    assert spread is not None and spread.text != made.text  # operands of each cell are others


@pytest.mark.parametrize("what", ["CARD", "PTX_VERSION", "REGISTERS", "libdevice"])
def test_a_name_on_disk_tells_all_of_a_program(what, monkeypatch):
    monkeypatch.setattr(ptx, "ptx_of", lambda source: "PTX")
    like = [jax.ShapeDtypeStruct((2,), float)]
    closed = closed_of(lambda x: 2 * x, np.ones(2))

    def name(mapped=True, in_memory=False, trace=None):
        return ptx.find_ptx(like, like, trace, lambda: closed, (mapped,), in_memory).digest

    before = {name(), name(False), name(True, True), name(trace="its name")}
    assert len(before) == 4
    known = {"REGISTERS": 96, "libdevice": lambda: b"another"}
    monkeypatch.setattr(ptx, what, known.get(what, "+ptx70"))
    assert name() not in before


def test_more_arrays_than_a_launch_takes():
    many = closed_of(lambda *xs: sum(xs), *[np.float32(1)] * ptx.MAX_ARRAYS)
    with pytest.raises(UnsupportedPrimitive, match="more than 500 arrays"):
        ptx_of(many)


# Lowering for cards


@pytest.fixture
def driver(monkeypatch):
    """One that says yes to everything."""
    load, launch = LOAD(lambda *_: 0), LAUNCH(lambda *_: 0)
    found = lambda kernel, *_: setattr(kernel._obj, "value", 1) or 0
    driver = SimpleNamespace(cuInit=lambda _: 0, cuLibraryLoadData=load)
    driver.cuLibraryGetKernel, driver.cuLaunchKernel = found, launch
    monkeypatch.setattr(ctypes, "CDLL", lambda _: driver)
    caches = launcher.load_driver, launcher.load_launcher
    for function in caches:
        function.cache_clear()
    yield driver
    for function in caches:
        function.cache_clear()


@pytest.mark.parametrize("route", gpu.ROUTES)
@pytest.mark.parametrize("jacobian", [False, True])
def test_a_program_for_cuda_holds_the_call(route, jacobian, driver, monkeypatch):
    one = kernel(lambda x: x[0] * jnp.sqrt(x))

    def text():
        many = jax.jit(jax.vmap(jax.jacfwd(one) if jacobian else lambda x: one(x)))
        return many.trace(jnp.ones((100, 2))).lower(lowering_platforms=("cuda",)).as_text()

    monkeypatch.setenv(machine.VARIABLE, "cpu")
    assert "custom_call" not in text()
    monkeypatch.delenv(machine.VARIABLE)
    token = gpu.trying.set(route)
    try:
        found = text()
    finally:
        gpu.trying.reset(token)
    assert found.count("custom_call @") == 1
    assert (f"@{gpu.PTX_CALL}(" if route.fixed else "@walker_jax_") in found


def test_an_exported_program_has_no_call(driver):
    token = gpu.trying.set(gpu.ROUTES[1])
    try:
        many = jax.jit(jax.vmap(kernel(lambda x: 2 * x)))
        exported = jax.export.export(many, platforms=("cuda",))(jnp.ones(3))
    finally:
        gpu.trying.reset(token)
    assert "custom_call" not in exported.mlir_module()


def test_what_xla_says_without_a_stream(driver, monkeypatch):
    """The function that is asked is that for streams, and errors of XLA reach XLA."""
    register = ffi.register
    monkeypatch.setattr(ffi, "registrations", {})
    monkeypatch.setattr(ffi, "register", lambda name, _, *more: register(name, "cpu", *more))
    mlir.register_lowering(primitive.kernel_p, gpu.lower_on_gpu, platform="cpu")
    token = gpu.trying.set(gpu.ROUTES[0])
    try:
        with pytest.raises(jax.errors.JaxRuntimeError, match="GPU context is not available"):
            jax.block_until_ready(jax.jit(kernel(lambda x: 17 * x))(1.0))
    finally:
        gpu.trying.reset(token)
        mlir.register_lowering(primitive.kernel_p, primitive.lower_on_cpu, platform="cpu")

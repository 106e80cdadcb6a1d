"""Programs of threads: that they are PTX, and that they compute what programs of vectors do."""

import ctypes
import importlib.util
import itertools
import re
import shutil
import subprocess
from collections import OrderedDict
from pathlib import Path
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import llvmlite.binding as llvm
import numpy as np
import pytest
from fake_card import LAUNCH, LOAD, for_processor, run
from jax import lax
from jax.interpreters import mlir
from scipy import special

import walker_jax as wj
from walker_jax.integrators.integrator import Integrator
from walker_jax.kernels import ffi, gpu, kernel, launcher, object_cache, primitive, ptx
from walker_jax.kernels import program as of_program
from walker_jax.kernels.compiled import Compiled, source_of
from walker_jax.kernels.jaxprs import UnsupportedPrimitive
from walker_jax.kernels.machine import load_program
from walker_jax.kernels.program import tracing_for_kernel
from walker_jax.walking.stride import follow_stride

DTYPES = ["float64", "float32"]
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
KNOWN = "sin cos tan asin acos atan sinh cosh tanh asinh acosh atanh exp exp2 expm1 log log1p cbrt"
TWICE = {"atan2": jnp.atan2, "pow": jnp.power, "fmod": lax.rem}
NO_LIBDEVICE = "needs libdevice, of the extra gpu-check"


def closed_of(function, *args):
    with tracing_for_kernel(True):
        return jax.make_jaxpr(function)(*args)


def stride_of(walker, dtype):
    """A stride of a walker as a jaxpr, and starts about a gait."""
    model, start = walker
    model = jax.tree.map(lambda x: jnp.asarray(x, dtype), model)
    away = np.random.default_rng(0).uniform(-0.3, 0.3, (37, len(start)))
    starts = (np.asarray(start) * (1 + away)).astype(dtype)
    return closed_of(lambda x: [*wj.stride(model, x)[:2]], starts[0]), starts


def ptx_of(closed, in_memory=False):
    given = closed.in_avals, closed.out_avals, None, lambda: closed
    return ptx.find_ptx(*given, (True,) * len(closed.in_avals), in_memory).text


def elementary(x):
    """All functions of the C library that kernels call."""
    one = [getattr(jnp, name)(x) for name in KNOWN.split()]
    return [*one, lax.erf(x), *(of(x, x + x) for of in TWICE.values())]


# One lane and many


def with_one_lane(closed):
    """The program of a thread, compiled for this processor."""
    found = object.__new__(Compiled)
    found.operands, found.results, source = source_of(closed, 0)
    found.begin(load_program(source))
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


def find_ptxas():
    wheels = importlib.util.find_spec("nvidia")
    places = map(Path, (wheels and wheels.submodule_search_locations) or ())
    return next((str(one) for place in places for one in place.glob("*/bin/ptxas")), None)


PTXAS = find_ptxas() or shutil.which("ptxas")


def check_text(text):
    assert ".version 6.0\n.target sm_70\n" in text
    assert text.count(".entry entry(") == 1 and ".func" not in text.replace(".func  (", "")
    assert f".maxnreg {ptx.REGISTERS}" in text and "call.uni" not in text


@pytest.mark.parametrize(("walker", "dtype"), WALKERS)
def test_ptx_of_a_stride(walker, dtype):
    closed, _ = stride_of(walker, dtype)
    check_text(ptx_of(closed))


@pytest.mark.skipif(PTXAS is None, reason="needs ptxas, of the extra gpu-check")
@pytest.mark.parametrize(("walker", "dtype"), WALKERS)
def test_a_stride_is_assembled(walker, dtype, tmp_path):
    closed, _ = stride_of(walker, dtype)
    check_assembly(ptx_of(closed), tmp_path)


def check_assembly(text, folder):
    assert PTXAS is not None
    (folder / "kernel.ptx").write_text(text)
    command = [PTXAS, "-arch=sm_90", "kernel.ptx", "-o", "kernel.cubin"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0 and not done.stderr


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


# libdevice

ERRORS = {"float64": 3, "float32": 5}
"""Largest errors of libdevice's functions, in units of the last digit: those of NVIDIA's table and
one more, as a processor's approximate square root and its like stand for a card's."""
# Instructions of a card, on a processor. Approximate ones are exact but for digits that they lack.
CARD = """
declare double @llvm.rint.f64(double)
declare float @llvm.rint.f32(float)
declare float @exp2f(float)
declare float @log2f(float)
declare double @llvm.fma.f64(double, double, double)
define double @card.rcp.approx.ftz.d(double %x) {
  %y = fdiv double 1.0, %x
  %bits = bitcast double %y to i64
  %high = and i64 %bits, -4294967296
  %z = bitcast i64 %high to double
  ret double %z
}
define float @card.ex2.approx.ftz.f32(float %x) {
  %y = call float @exp2f(float %x)
  ret float %y
}
define float @card.ex2.approx.f32(float %x) {
  %y = call float @exp2f(float %x)
  ret float %y
}
define float @card.lg2.approx.ftz.f(float %x) {
  %y = call float @log2f(float %x)
  ret float %y
}
define float @card.lg2.approx.f(float %x) {
  %y = call float @log2f(float %x)
  ret float %y
}
define float @card.rsqrt.approx.ftz.f(float %x) {
  %y = call float @llvm.sqrt.f32(float %x)
  %z = fdiv float 1.0, %y
  ret float %z
}
define float @card.sqrt.approx.f(float %x) {
  %y = call float @llvm.sqrt.f32(float %x)
  ret float %y
}
declare float @llvm.sqrt.f32(float)
define float @card.div.approx.f(float %x, float %y) {
  %z = fdiv float %x, %y
  ret float %z
}
define float @card.fabs.f32(float %x) {
  %y = call float @llvm.fabs.f32(float %x)
  ret float %y
}
declare float @llvm.fabs.f32(float)
declare double @llvm.fabs.f64(double)
define double @card.fabs.f64(double %x) {
  %y = call double @llvm.fabs.f64(double %x)
  ret double %y
}
define double @card.add.rn.d(double %x, double %y) {
  %z = fadd double %x, %y
  ret double %z
}
define double @card.mul.rn.d(double %x, double %y) {
  %z = fmul double %x, %y
  ret double %z
}
define float @card.add.rn.f(float %x, float %y) {
  %z = fadd float %x, %y
  ret float %z
}
define float @card.mul.rn.f(float %x, float %y) {
  %z = fmul float %x, %y
  ret float %z
}
define i32 @card.d2i.rn(double %x) {
  %y = call double @llvm.rint.f64(double %x)
  %n = fptosi double %y to i32
  ret i32 %n
}
define i32 @card.f2i.rn(float %x) {
  %y = call float @llvm.rint.f32(float %x)
  %n = fptosi float %y to i32
  ret i32 %n
}
define float @card.round.f(float %x) {
  %y = call float @llvm.rint.f32(float %x)
  ret float %y
}
define double @card.lohi.i2d(i32 %low, i32 %high) {
  %a = zext i32 %low to i64
  %b = zext i32 %high to i64
  %c = shl i64 %b, 32
  %d = or i64 %a, %c
  %x = bitcast i64 %d to double
  ret double %x
}
define double @card.rsqrt.d(double %x) {
  %y = call double @llvm.sqrt.f64(double %x)
  %z = call double @card.rcp.approx.ftz.d(double %y)
  ret double %z
}
declare double @llvm.sqrt.f64(double)
define float @card.rcp.f(float %x) {
  %y = fdiv float 1.0, %x
  ret float %y
}
define float @card.sub.f(float %x, float %y) {
  %z = fsub float %x, %y
  ret float %z
}
define double @card.either.d(double %x, double %y, double %z, double %w) {
  %equal = fcmp ueq double %x, %y
  %either = select i1 %equal, double %z, double %w
  ret double %either
}
define float @card.div.rn.f(float %x, float %y) {
  %z = fdiv float %x, %y
  ret float %z
}
define float @card.div.approx.ftz.f(float %x, float %y) {
  %z = fdiv float %x, %y
  ret float %z
}
define i32 @card.f2i.rz(float %x) {
  %n = fptosi float %x to i32
  ret i32 %n
}
define { i64, i64 } @halves(i128 %x) {
  %y = lshr i128 %x, 64
  %low = trunc i128 %x to i64
  %high = trunc i128 %y to i64
  %one = insertvalue { i64, i64 } undef, i64 %low, 0
  %both = insertvalue { i64, i64 } %one, i64 %high, 1
  ret { i64, i64 } %both
}
define i128 @whole(i64 %low, i64 %high) {
  %a = zext i64 %low to i128
  %b = zext i64 %high to i128
  %c = shl i128 %b, 64
  %d = or i128 %a, %c
  ret i128 %d
}
define { i64, i64 } @card.mad128(i64 %x, i64 %y, i64 %z) {
  %a = zext i64 %x to i128
  %b = zext i64 %y to i128
  %c = zext i64 %z to i128
  %d = mul i128 %a, %b
  %e = add i128 %d, %c
  %f = call { i64, i64 } @halves(i128 %e)
  ret { i64, i64 } %f
}
define { i64, i64 } @card.mul128(i64 %x, i64 %y) {
  %f = call { i64, i64 } @card.mad128(i64 %x, i64 %y, i64 0)
  ret { i64, i64 } %f
}
define { i64, i64 } @card.add128(i64 %x, i64 %y, i64 %z, i64 %w) {
  %a = call i128 @whole(i64 %x, i64 %y)
  %b = call i128 @whole(i64 %z, i64 %w)
  %c = add i128 %a, %b
  %f = call { i64, i64 } @halves(i128 %c)
  ret { i64, i64 } %f
}
define { i64, i64 } @card.sub128(i64 %x, i64 %y, i64 %z, i64 %w) {
  %a = call i128 @whole(i64 %x, i64 %y)
  %b = call i128 @whole(i64 %z, i64 %w)
  %c = sub i128 %a, %b
  %f = call { i64, i64 } @halves(i128 %c)
  ret { i64, i64 } %f
}
define { i32, i32 } @card.mad64(i32 %x, i32 %y, i32 %z) {
  %a = zext i32 %x to i64
  %b = zext i32 %y to i64
  %c = zext i32 %z to i64
  %d = mul i64 %a, %b
  %e = add i64 %d, %c
  %f = lshr i64 %e, 32
  %low = trunc i64 %e to i32
  %high = trunc i64 %f to i32
  %one = insertvalue { i32, i32 } undef, i32 %low, 0
  %both = insertvalue { i32, i32 } %one, i32 %high, 1
  ret { i32, i32 } %both
}
define i32 @card.d2i.lo(double %x) {
  %a = bitcast double %x to i64
  %n = trunc i64 %a to i32
  ret i32 %n
}
define i32 @card.d2i.hi(double %x) {
  %a = bitcast double %x to i64
  %b = lshr i64 %a, 32
  %n = trunc i64 %b to i32
  ret i32 %n
}
; towards zero: the digits beyond those of float32 are cut off
define float @cut(double %x) {
  %a = bitcast double %x to i64
  %b = and i64 %a, -536870912
  %y = bitcast i64 %b to double
  %z = fptrunc double %y to float
  ret float %z
}
define float @card.fma.rz.f(float %x, float %y, float %z) {
  %a = fpext float %x to double
  %b = fpext float %y to double
  %c = fpext float %z to double
  %d = call double @llvm.fma.f64(double %a, double %b, double %c)
  %e = call float @cut(double %d)
  ret float %e
}
define float @card.add.rz.f(float %x, float %y) {
  %a = call float @card.fma.rz.f(float %x, float 1.0, float %y)
  ret float %a
}
define float @card.mul.rz.f(float %x, float %y) {
  %a = call float @card.fma.rz.f(float %x, float %y, float 0.0)
  ret float %a
}
"""


ASSEMBLY = {
    "rsqrt.approx.ftz.f64": "rsqrt.d",
    "rcp.approx.ftz.f32": "rcp.f",
    "sub.rn.f32": "sub.f",
    "setp.equ.f64": "either.d",
    "sub.cc": "sub128",
    "add.cc": "add128",
    "=r,=r,r,r,r": "mad64",
    "=l,=l,l,l,l": "mad128",
    "=l,=l,l,l": "mul128",
}
"""By some of their words: instructions for cards within libdevice, and functions of `CARD`."""


def replace_assembly(found):
    if not found[0].startswith("asm"):
        return ""
    return "@card." + next(name for words, name in ASSEMBLY.items() if words in found[0])


def linked_for_processor(closed, monkeypatch):
    """The program of which PTX is made, with libdevice in it, compiled for this processor."""
    monkeypatch.setattr(llvm.TargetMachine, "emit_assembly", lambda _, module: str(module))
    operands, results, source = source_of(closed, 0)
    text = ptx.ptx_of(source + ptx.entry_of(operands, results, (True,), False))
    monkeypatch.undo()
    text = re.sub(r"(?m)^declare .*@llvm.nvvm.(?!read).*\n", "", text)
    text = re.sub(r"@llvm.nvvm.(?!read)", "@card.", text)
    text = re.sub(r'asm "[^"]*", "[^"]*"|, !\w[\w.]* !\d+', replace_assembly, text)
    declared = set(re.findall(r"(?m)^declare .* (@[\w.]+)\(", text))
    lines = CARD.strip().split("\n")
    own = "\n".join(
        line
        for line in lines
        if not (line.startswith("declare") and any(f"{one}(" in line for one in declared))
    )
    return for_processor(text + own + "\n")


@pytest.mark.skipif(ptx.libdevice() is None, reason=NO_LIBDEVICE)
@pytest.mark.parametrize("dtype", DTYPES)
def test_functions_of_libdevice(dtype, monkeypatch):
    """As a thread computes them, they are those of NumPy with more digits."""
    xs = np.random.default_rng(2).uniform(0.01, 0.99, 500).astype(dtype)
    more = np.longdouble if dtype == "float64" else np.float64
    closed = closed_of(elementary, xs[0])
    program, count = linked_for_processor(closed, monkeypatch)
    found = [np.empty(len(xs), aval.dtype) for aval in closed.out_avals]
    arguments = [len(xs), *(array.ctypes.data for array in (xs, *found))]
    assert count == len(arguments)
    run(program, arguments, -(-len(xs) // ptx.THREADS), ptx.THREADS)
    exact = xs.astype(more)
    one = [getattr(np, name)(exact) for name in KNOWN.split() if name != "acosh"]
    several = [
        special.erf(exact.astype(float)),
        np.atan2(exact, 2 * exact),
        exact ** (2 * exact),
        exact,
    ]
    names = [name for name in (*KNOWN.split(), "erf", *TWICE)]
    by_name = dict(zip(names, found, strict=True))
    assert np.isnan(by_name.pop("acosh")).all()  # of numbers below one
    for (name, values), expected in zip(by_name.items(), [*one, *several], strict=True):
        unit = np.spacing(np.abs(expected).astype(dtype))
        error = np.abs(values.astype(more) - expected) / unit
        assert error.max() < ERRORS[dtype], (name, error.max())


@pytest.mark.skipif(ptx.libdevice() is None, reason=NO_LIBDEVICE)
@pytest.mark.parametrize("dtype", DTYPES)
def test_ptx_with_libdevice(dtype, tmp_path):
    text = ptx_of(closed_of(elementary, jnp.asarray(0.7, dtype)))
    assert "__nv_" not in text
    if PTXAS:
        check_assembly(text, tmp_path)


def test_without_libdevice_sines_have_no_kernel(monkeypatch):
    monkeypatch.setattr(ptx, "libdevice", lambda: None)
    closed = closed_of(jnp.sin, 0.5)
    with pytest.raises(UnsupportedPrimitive, match="sin on a GPU without libdevice"):
        ptx_of(closed)
    program, _ = of_program.program_of(
        lambda x: jnp.sin(x), jax.tree.structure((0,)), [jax.ShapeDtypeStruct((), float)]
    )
    assert program.ptx((True,), False) is None and "on a GPU without" in str(program.why_not)
    assert program.compiled is not None


def test_where_libdevice_is_found(monkeypatch, tmp_path):
    (tmp_path / "nvvm/libdevice").mkdir(parents=True)
    (tmp_path / ptx.LIBDEVICE).write_bytes(b"functions")
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
    for name in "CUDA_HOME", "CUDA_PATH":
        monkeypatch.setenv(name, str(tmp_path))
        assert ptx.libdevice.__wrapped__() == b"functions"
        monkeypatch.delenv(name)
    elsewhere = ptx.libdevice.__wrapped__()  # where CUDA is installed
    wheel = SimpleNamespace(submodule_search_locations=[str(tmp_path / "nvidia")])
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: wheel)
    (tmp_path / "nvidia/cuda_nvcc").mkdir(parents=True)
    assert ptx.libdevice.__wrapped__() == elsewhere
    (tmp_path / "nvvm").rename(tmp_path / "nvidia/cuda_nvcc/nvvm")
    assert ptx.libdevice.__wrapped__() == b"functions"


# Programs on disk


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv(object_cache.VARIABLE, str(tmp_path))
    monkeypatch.setattr(of_program, "programs", OrderedDict())
    return tmp_path


def program_of_a_map():
    """As a process finds it that has none in memory."""
    of_program.programs.clear()
    leaves = wj.HenonMap(), np.array([0.2, -0.2]), Integrator(1e-12)
    operands, structure = jax.tree.flatten(leaves)
    like = [jax.ShapeDtypeStruct(np.shape(x), float) for x in operands]
    return of_program.program_of(follow_stride, structure, like)[0]


MAPPED = False, False, True, False


def test_a_program_is_found_on_disk(folder):
    """With the facts of its trace, whatever else is known of it: its machine code is kept too."""
    first = program_of_a_map()
    made = first.ptx(MAPPED, False)
    assert made is not None and first.compiled is not None
    again = program_of_a_map()
    assert again.ptx(MAPPED, False) == made and again.compiled is not None
    assert "closed" not in vars(again)  # it was not traced
    other = program_of_a_map()
    spread = other.ptx((True,) * len(MAPPED), False)
    assert spread is not None and spread.text != made.text  # operands of each cell are others


@pytest.mark.parametrize("what", ["CARD", "PTX_VERSION", "THREADS", "REGISTERS", "libdevice"])
def test_a_name_on_disk_tells_all_that_a_program_depends_on(what, monkeypatch):
    monkeypatch.setattr(ptx, "ptx_of", lambda source: "PTX")
    like = [jax.ShapeDtypeStruct((2,), float)]
    closed = closed_of(lambda x: 2 * x, np.ones(2))

    def name(mapped=True, in_memory=False, trace=None):
        return ptx.find_ptx(like, like, trace, lambda: closed, (mapped,), in_memory).digest

    before = {name(), name(False), name(True, True), name(trace="its name")}
    assert len(before) == 4
    known = {"THREADS": 32, "REGISTERS": 96, "libdevice": lambda: b"another"}
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
def test_a_program_for_cuda_holds_the_call(route, jacobian, driver):
    one = kernel(lambda x: x[0] * jnp.sqrt(x))

    def text():
        many = jax.jit(jax.vmap(jax.jacfwd(one) if jacobian else lambda x: one(x)))
        return many.trace(jnp.ones((100, 2))).lower(lowering_platforms=("cuda",)).as_text()

    assert "custom_call" not in text()  # by default
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


def test_where_xla_has_no_stream_its_words_are_passed_on(driver, monkeypatch):
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

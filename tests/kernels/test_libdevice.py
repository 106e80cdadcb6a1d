"""Functions of libdevice in programs of threads."""

import importlib.util
import re
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import llvmlite.binding as llvm
import numpy as np
import pytest
from fake_card import for_processor, run
from scipy import special
from threads_of_cards import (
    DTYPES,
    KNOWN,
    PTXAS,
    TWICE,
    check_assembly,
    closed_of,
    elementary,
    ptx_of,
)

from walker_jax.kernels import program as of_program
from walker_jax.kernels import ptx
from walker_jax.kernels.compiled import source_of
from walker_jax.kernels.jaxprs import UnsupportedPrimitive

NO_LIBDEVICE = "needs libdevice, of the extra gpu-check"
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
    operands, results, source, _ = source_of(closed, 0)
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
    run(program, arguments, -(-len(xs) // 64), 64)
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

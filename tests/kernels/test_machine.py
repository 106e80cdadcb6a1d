"""Kernels that are switched off, or compiled for another processor, give the same answers."""

import jax
import llvmlite.binding as llvm
import numpy as np
import pytest

from walker_jax.checks import WrongUse
from walker_jax.execution.tiles import map_cells
from walker_jax.kernels import machine
from walker_jax.kernels.compiled import shapes_and_types
from walker_jax.kernels.emit import emit
from walker_jax.kernels.program import program_of

X86 = llvm.get_process_triple().startswith("x86_64")
XS = np.stack([np.linspace(0.05, 0.3, 64), np.linspace(-0.05, -0.31, 64)], axis=1)


def compute(shift: float):
    """A function that no other test has compiled, and its results."""

    def function(shared, x):
        return jax.numpy.sin(x[0]) * x[1] + shared, x[0] > 0.1

    return function, map_cells(function, (np.float64(shift), XS))


@pytest.mark.skipif(jax.default_backend() != "cpu", reason="a GPU has its own kernels")
@pytest.mark.parametrize("value", ["off", "OFF", "cpu", "CPU", "haswell", "nehalem", ""])
def test_answers_do_not_depend_on_kernels(value, monkeypatch):
    monkeypatch.delenv(machine.VARIABLE, raising=False)
    expected = compute(0.5)[1]
    monkeypatch.setenv(machine.VARIABLE, value)
    monkeypatch.setenv("WALKER_JAX_CACHE_DIR", "")
    if value in ("haswell", "nehalem") and not X86:
        pytest.skip("the named processors are of x86, and this machine is not")
    function, found = compute(0.5)
    np.testing.assert_allclose(found[0], expected[0], rtol=4e-16)
    np.testing.assert_array_equal(found[1], expected[1])
    operands, structure = jax.tree.flatten((np.float64(0.5), XS[0]))
    avals = [jax.ShapeDtypeStruct(np.shape(one), np.float64) for one in operands]
    program, _ = program_of(function, structure, avals)
    assert (program.compiled is None) == (value.lower() == "off")
    if value in ("haswell", "nehalem"):
        assert machine.processor() == (value, "")


@pytest.mark.skipif(jax.default_backend() != "cpu", reason="a GPU has its own kernels")
@pytest.mark.parametrize("value", ["on", "no such processor"])
def test_a_processor_that_there_is_not_is_refused(value, monkeypatch, capfd):
    """LLVM would end the process, or compile for the oldest of all processors."""
    monkeypatch.setenv(machine.VARIABLE, value)
    monkeypatch.setenv("WALKER_JAX_CACHE_DIR", "")
    own = llvm.get_host_cpu_name()
    with pytest.raises(WrongUse) as refusal:
        compute(0.25)
    assert str(refusal.value) == (
        f"WALKER_JAX_KERNELS must be off, cpu, or a processor that LLVM knows, such as {own}, "
        f"not {value}: unset it for this machine's own"
    )
    assert capfd.readouterr().err == ""


@pytest.mark.skipif(not X86, reason="the named processors are of x86, and this machine is not")
@pytest.mark.parametrize(
    ("name", "bits"), [("x86-64", 128), ("nehalem", 128), ("haswell", 256), ("znver4", 512)]
)
def test_vectors_are_as_long_as_the_registers_of_the_processor(name, bits, monkeypatch):
    """LLVM splits longer ones: compiling takes twice as long then, and running no less."""
    monkeypatch.setenv(machine.VARIABLE, name)
    assert machine.register_bits() == bits
    closed = jax.make_jaxpr(jax.numpy.sqrt)(np.float64(2.0))
    kinds = shapes_and_types(closed.in_avals)
    assert f"<{bits // 64} x double>" in emit(closed, kinds, kinds, machine.register_bits())[0]

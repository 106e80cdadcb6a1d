"""A jaxpr of one cell, compiled for arrays of cells."""

import ctypes
import gc
import math
import time
from collections.abc import Callable, Sequence
from contextlib import contextmanager

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr

from walker_jax.checks import WrongUse
from walker_jax.kernels.cell_functions import lanes_of
from walker_jax.kernels.emit import emit
from walker_jax.kernels.jaxprs import UnsupportedPrimitive
from walker_jax.kernels.machine import hash_source, processor, register_bits
from walker_jax.kernels.machine_code import MachineCode, report_compilation
from walker_jax.kernels.stored import is_long, keeps_arrays_in_memory

MAX_NUMBERS = 1000
"""Most numbers in the operands and results of one cell; each takes code of its own, unless it
belongs to a long array in memory."""


class Compiled:
    """The machine code of a jaxpr of one cell."""

    def __init__(self, closed: ClosedJaxpr, shared: bool = False):
        """Write the jaxpr's program; raise `UnsupportedPrimitive` if kernels do not support it.

        A `shared` program may be called by others (`shared_code`).
        """
        start = time.perf_counter()
        bits = register_bits()
        self.operands, self.results, source, callees = source_of(closed, bits, shared)
        self.made_for = processor(), lanes_of(self.operands, self.results, bits)
        """The processor, and the number of cells that it computes at once."""
        self.code = MachineCode(source, hash_source(source), callees)
        report_compilation(start)

    @classmethod
    def recall(cls, operands: Sequence, results: Sequence, digest: str) -> "Compiled | None":
        """Load the code for these abstract values from disk; None if it is not there."""
        code = MachineCode.recall(digest)
        if code is None:
            return None
        found = object.__new__(cls)
        found.operands, found.results = shapes_and_types(operands), shapes_and_types(results)
        found.made_for = processor(), lanes_of(found.operands, found.results, register_bits())
        found.code = code
        return found

    @property
    def digest(self) -> str:
        """The hash of the program's source."""
        return self.code.digest

    def bind(
        self, operands: Sequence, mapped: Sequence[bool], n: int
    ) -> tuple[Callable[[int, int], None], list[np.ndarray]]:
        """Return a function (start, stop) that fills results[start:stop], and these empty results.

        `mapped` marks the operands with the n cells along their first axes; all cells share the
        others. Several threads may call the function at once.
        """
        self.code.expect(n)
        results = [np.empty((n, *shape), dtype) for shape, dtype in self.results]
        given, steps = [], []
        for value, each, (shape, dtype) in zip(operands, mapped, self.operands, strict=True):
            array, expected = np.ascontiguousarray(value, dtype), (n, *shape) if each else shape
            if array.size != math.prod(expected):
                raise WrongUse(f"shape {array.shape} of an array must be {expected}")
            given.append(array)
            steps.append(math.prod(shape) if each else 0)
        arrays = [*given, *results]
        pointers = (ctypes.c_void_p * len(arrays))(*(array.ctypes.data for array in arrays))
        strides = (ctypes.c_int64 * len(steps))(*steps)
        # The default argument keeps the arrays alive as long as the function.
        compute = lambda start, stop, _=arrays: self.code.run(start, stop, pointers, strides)
        return compute, results


def source_of(
    closed: ClosedJaxpr, bits: int, shared: bool = False
) -> tuple[list, list, str, list[MachineCode]]:
    """Return shapes and types of operands and results, the source, and what it calls (`emit`)."""
    avals = [*closed.in_avals, *closed.out_avals]
    if any(jnp.issubdtype(aval.dtype, jax.dtypes.extended) for aval in avals):
        raise UnsupportedPrimitive("a key to random numbers")
    operands, results = shapes_and_types(closed.in_avals), shapes_and_types(closed.out_avals)
    stored = keeps_arrays_in_memory(closed.jaxpr, bits)
    registers = [aval for aval in avals if not (stored and is_long(aval))]
    if sum(math.prod(aval.shape) for aval in registers) > MAX_NUMBERS:
        raise UnsupportedPrimitive(f"more than {MAX_NUMBERS} numbers")
    with without_garbage_collection():
        return operands, results, *emit(closed, operands, results, bits, shared)


def shapes_and_types(avals: Sequence) -> list[tuple[tuple[int, ...], np.dtype]]:
    return [(aval.shape, np.dtype(aval.dtype)) for aval in avals]


@contextmanager
def without_garbage_collection():
    """Suspend garbage collection: tracing keeps many small objects, and it would cost a fifth."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()

"""A jaxpr of one cell, compiled for arrays of cells."""

import ctypes
import gc
import math
import time
from collections.abc import Callable, Sequence
from contextlib import contextmanager
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr

from walker_jax.checks import WrongUse
from walker_jax.kernels.emit import emit
from walker_jax.kernels.jaxprs import UnsupportedPrimitive
from walker_jax.kernels.machine import hash_source, load_program, recall_program, register_bits

MAX_NUMBERS = 1000
"""Most numbers in the operands and results of one cell; each takes code of its own."""


class Compiled:
    """The machine code of a jaxpr of one cell."""

    def __init__(self, closed: ClosedJaxpr):
        """Compile the jaxpr, or raise `UnsupportedPrimitive` if kernels do not support it."""
        start = time.perf_counter()
        self.operands, self.results, source = source_of(closed, register_bits())
        self.digest = hash_source(source)
        self.begin(load_program(source))
        seconds = time.perf_counter() - start
        jax.monitoring.record_event_duration_secs("/walker_jax/compile_kernel", seconds)

    @classmethod
    def recall(cls, operands: Sequence, results: Sequence, digest: str) -> "Compiled | None":
        """Load the code for these abstract values from disk; None if it is not there."""
        engine = recall_program(digest)
        if engine is None:
            return None
        found = object.__new__(cls)
        found.operands, found.results = shapes_and_types(operands), shapes_and_types(results)
        found.digest = digest
        found.begin(engine)
        return found

    def begin(self, engine: Any) -> None:
        """Keep a program in memory, and find its entry."""
        self.engine = engine
        kind = ctypes.CFUNCTYPE(None, *[ctypes.c_int64] * 2, *[ctypes.c_void_p] * 2)
        self.run = kind(engine.get_function_address("kernel"))

    def bind(
        self, operands: Sequence, mapped: Sequence[bool], n: int
    ) -> tuple[Callable[[int, int], None], list[np.ndarray]]:
        """Return a function (start, stop) that fills results[start:stop], and these empty results.

        `mapped` marks the operands with the n cells along their first axes; all cells share the
        others. Several threads may call the function at once.
        """
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
        compute = lambda start, stop, _=arrays: self.run(start, stop, pointers, strides)
        return compute, results


def source_of(closed: ClosedJaxpr, bits: int) -> tuple[list, list, str]:
    """Return shapes and types of operands and results, and the program's source (`emit`)."""
    avals = [*closed.in_avals, *closed.out_avals]
    if any(jnp.issubdtype(aval.dtype, jax.dtypes.extended) for aval in avals):
        raise UnsupportedPrimitive("a key to random numbers")
    operands, results = shapes_and_types(closed.in_avals), shapes_and_types(closed.out_avals)
    if sum(math.prod(shape) for shape, _ in (*operands, *results)) > MAX_NUMBERS:
        raise UnsupportedPrimitive(f"more than {MAX_NUMBERS} numbers")
    with without_garbage_collection():
        return operands, results, emit(closed, operands, results, bits)


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

"""A JAX function of one cell, compile_program for arrays of cells."""

import ctypes
import gc
import math
import time
from collections.abc import Callable
from contextlib import contextmanager

import jax
import numpy as np
from jaxtyping import PyTree

from walker_jax.checks import WrongUse
from walker_jax.kernels.emit import emit
from walker_jax.kernels.machine import compile_program
from walker_jax.kernels.rules import UnsupportedPrimitive

LARGEST = 1000
"""Numbers that go into a program, of what cells share and of one cell."""

tracing_for_kernel = jax.make_user_context(False)
"""Whether a function is traced for a kernel, and so may be longer than XLA has it."""


class Kernel:
    """A compile_program function of (shared, cell), for arrays of cells."""

    def __init__(self, function: Callable, shared: PyTree, cell: PyTree):
        """Compile it for leaves of these shapes and types; may raise `UnsupportedPrimitive`."""
        with without_garbage_collection():
            self.compile(function, shared, cell)

    def compile(self, function: Callable, shared: PyTree, cell: PyTree) -> None:
        start = time.perf_counter()
        with tracing_for_kernel(True):
            closed, shapes = jax.make_jaxpr(function, return_shape=True)(shared, cell)
        self.structure = jax.tree.structure(shapes)
        avals = [variable.aval for variable in closed.jaxpr.invars]
        split = len(jax.tree.leaves(shared))
        if sum(math.prod(aval.shape) for aval in avals) > LARGEST:
            raise UnsupportedPrimitive(f"more than {LARGEST} numbers")
        described = lambda leaves: [(leaf.shape, np.dtype(leaf.dtype)) for leaf in leaves]
        self.shared, self.cell = described(avals[:split]), described(avals[split:])
        self.results = described(jax.tree.leaves(shapes))
        self.run = compile_program(emit(closed, self.shared, self.cell, self.results))
        seconds = time.perf_counter() - start
        jax.monitoring.record_event_duration_secs("/walker_jax/compile_kernel", seconds)

    def bind(
        self, shared: PyTree, cells: PyTree, n: int
    ) -> tuple[Callable[[int, int], None], PyTree[np.ndarray]]:
        """A function that computes results[start:stop] of n cells, and the results, still empty.

        It may run in several threads at once.
        """
        results = [np.empty((n, *shape), dtype) for shape, dtype in self.results]
        given = contiguous(shared, self.shared) + contiguous(cells, self.cell, n)
        arrays = [*given, *results]
        pointers = (ctypes.c_void_p * len(arrays))(*(array.ctypes.data for array in arrays))
        # The arrays must live as long as it does.
        compute = lambda start, stop, _=arrays: self.run(start, stop, pointers)
        return compute, jax.tree.unflatten(self.structure, results)


@contextmanager
def without_garbage_collection():
    """Traces are made of many small objects that live on; to look through them takes a fifth."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


def contiguous(tree: PyTree, like: list, *lead: int) -> list[np.ndarray]:
    """The leaves of a tree as a kernel reads them: of these shapes and types, in C's order."""
    pairs = zip(jax.tree.leaves(tree), like, strict=True)
    arrays = [np.ascontiguousarray(leaf, dtype) for leaf, (_, dtype) in pairs]
    for array, (shape, _) in zip(arrays, like, strict=True):
        if array.size != math.prod((*lead, *shape)):
            raise WrongUse(f"shape {array.shape} of an array must be {(*lead, *shape)}")
    return arrays

"""The machine code of a program: made quickly at first if it is long, and optimised when it pays.

LLVM takes about ten seconds to optimise the longest programs, derivatives of strides in space. It
makes code without optimisation in a seventh of that, which takes two to four times as long for each
cell. So few cells are computed by such code. Both compute the same bits: in either, LLVM fuses the
same products with sums, as no optimisation moves instructions from block to block.
"""

import ctypes
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import jax
import llvmlite.binding as llvm

from walker_jax.kernels.machine import (
    QUICK,
    hash_source,
    keep_source,
    keeps_bits,
    load_program,
    recall_program,
    recall_source,
)

LONG_SOURCE = 2_000_000
"""Characters of a program from which on it is made quickly at first: two seconds to optimise."""
MANY_CELLS = 20_000
"""Cells of one call for which such a program is optimised at once."""
TRIAL = 3e-7
"""Seconds of work by unoptimised code, for each character of the source, before it is optimised: a
quarter of what LLVM then takes."""
PIECE = 64
"""Cells after which a thread looks whether the code has been optimised."""
ENTRY = ctypes.CFUNCTYPE(None, *[ctypes.c_int64] * 2, *[ctypes.c_void_p] * 2)


@contextmanager
def timed_compilation() -> Iterator[None]:
    """Tell JAX's listeners how long a kernel took to compile."""
    start = time.perf_counter()
    yield
    seconds = time.perf_counter() - start
    jax.monitoring.record_event_duration_secs("/walker_jax/compile_kernel", seconds)


class MachineCode:
    """Code that any number of threads may run at once."""

    def __init__(self, source: str):
        """Begin with the source of a program; code is made when it is known for how many cells."""
        self.begin(hash_source(source), source)

    @classmethod
    def recall(cls, digest: str) -> "MachineCode | None":
        """Load the code of the program whose source has this digest, if it is on disk."""
        engine = recall_program(digest)
        source = recall_source(digest) if engine is None else None
        if engine is None and source is None:
            return None
        found = object.__new__(cls)
        found.begin(digest, source)
        if engine is not None:
            found.use(engine)
        return found

    def begin(self, digest: str, source: str | None) -> None:
        self.digest = digest
        self.source = source
        """What is left to be optimised, if anything."""
        self.engines: list[llvm.ExecutionEngine] = []
        """All code that has been in use; a thread may still run what was first."""
        self.entry: Any = None
        self.worked = 0.0
        """Seconds of work by unoptimised code."""
        self.compiling = threading.Lock()

    def use(self, engine: llvm.ExecutionEngine) -> None:
        self.engines.append(engine)
        self.entry = ENTRY(engine.get_function_address("kernel"))

    def run(self, start: int, stop: int, addresses: Any, strides: Any) -> None:
        """Compute results[start:stop] (`emit`)."""
        while start < stop and (source := self.source) is not None:
            end, begun = min(start + PIECE, stop), time.thread_time()
            self.entry(start, end, addresses, strides)
            start, self.worked = end, self.worked + time.thread_time() - begun
            if self.worked > TRIAL * len(source):
                self.optimise(wait=False)
        self.entry(start, stop, addresses, strides)

    def expect(self, cells: int) -> None:
        """Make the code that suits a call for this many cells."""
        source = self.source
        if source is None:
            return
        if cells > MANY_CELLS or len(source) < LONG_SOURCE or not keeps_bits():
            self.optimise()
        elif self.entry is None:
            with self.compiling:
                if self.entry is None:
                    keep_source(source)
                    with timed_compilation():
                        self.use(load_program(source, QUICK))

    def optimise(self, *, wait: bool = True) -> None:
        """Optimise the code, once; unless it is to wait, return if another thread compiles."""
        if self.source is None or not self.compiling.acquire(blocking=wait):
            return
        try:
            if self.source is not None:
                with timed_compilation():
                    self.use(load_program(self.source))
                self.source = None
        finally:
            self.compiling.release()

    def address(self) -> int:
        """Return the address of the optimised code, for calls that nobody counts."""
        self.optimise()
        found = ctypes.cast(self.entry, ctypes.c_void_p).value
        assert found is not None
        return found

"""The machine code of a program: made quickly at first if it is long, and optimised when it pays.

LLVM takes 0.2 seconds to optimise a stride of the simplest walker, and seven for the longest
programs, derivatives of strides in space. Code that is not optimised is made in 0.06 seconds and
one second, but then takes two to four times as long for each cell, so it computes only the first
cells. Both compute the same bits: LLVM fuses a product with a sum only within a block, when it
selects instructions, and does so alike for both.
"""

import ctypes
import functools
import threading
import time
from collections.abc import Sequence
from typing import Any

import jax
import llvmlite.binding as llvm

from walker_jax.kernels.cell_functions import FUNCTION, SLOT, SLOTS
from walker_jax.kernels.machine import (
    QUICK,
    allows_quick_code,
    keep_source,
    load_program,
    processor,
    recall_program,
    recall_source,
)

LONG_SOURCE = 200_000, 10_000_000
"""Fewest and most characters of a program that is made quickly at first.

LLVM optimises the shortest in a tenth of a second. Unoptimised, the longest take 1 or 2 MiB of a
thread's stack, by the length of vectors: each number has a place of its own there.
"""
MANY_CELLS = 20_000
"""Cells of one call for which such a program is optimised at once."""
TRIAL_SECONDS = 3e-7
"""Seconds of work by unoptimised code, for each character of the source, before it is optimised: as
much as LLVM then takes for the shortest, and less for the longest."""
PIECE = 64
"""Cells after which a thread looks whether the code has been optimised."""
MOST_CALLEES = 64
"""Most programs kept that were loaded from disk because others call them."""
ENTRY = ctypes.CFUNCTYPE(None, *[ctypes.c_int64] * 2, *[ctypes.c_void_p] * 2)


def report_compilation(start: float) -> None:
    """Tell JAX's listeners how long a part of a kernel's compilation took."""
    seconds = time.perf_counter() - start
    jax.monitoring.record_event_duration_secs("/walker_jax/compile_kernel", seconds)


@functools.lru_cache(MOST_CALLEES)
def recall_callee(digest: str, made_for: tuple) -> "MachineCode | None":
    """Load code for a processor that other code calls; None if it is not on disk."""
    return MachineCode.recall(digest)


class MachineCode:
    """Code that any number of threads may run at once."""

    def __init__(self, source: str | None, digest: str, callees: "Sequence[MachineCode]" = ()):
        """Begin with the source of a program; code is made when it is known for how many cells."""
        self.digest = digest
        self.source = source
        """What is left to be optimised, if anything."""
        self.callees = callees
        """Code of other kernels that it calls."""
        self.engines: list[llvm.ExecutionEngine] = []
        """All code so far: a thread may still run the first."""
        self.entry: Any = None
        self.worked = 0.0
        """Seconds of work by unoptimised code."""
        self.compiling = threading.Lock()

    @classmethod
    def recall(cls, digest: str) -> "MachineCode | None":
        """Load the code of the program whose source has this digest, if it is on disk."""
        program = recall_program(digest)
        source = recall_source(digest) if program is None else None
        if program is None and source is None:
            return None
        engine, code = program or (None, (source or "").encode())
        names = sorted({name.decode() for name in SLOTS.findall(code)})
        known = [recall_callee(name, processor()) for name in names]
        callees = [one for one in known if one is not None]
        if len(callees) < len(known):
            recall_callee.cache_clear()  # another process may yet write it
            return None
        found = cls(source, digest, callees)
        if engine is not None:
            found.use(engine)
        return found

    def use(self, engine: llvm.ExecutionEngine, *, quick: bool = False) -> None:
        """Run this code from now on; what it calls is optimised too, unless it is to be quick."""
        for other in self.callees:
            slot = engine.get_global_value_address(SLOT.format(other.digest))
            ctypes.c_int64.from_address(slot).value = other.address_of_cell(quick)
        self.engines.append(engine)
        self.entry = ENTRY(engine.get_function_address("kernel"))

    def address_of_cell(self, quick: bool) -> int:
        """Return the address of the function that other code calls."""
        self.make_quickly() if quick else self.optimise()
        return self.engines[-1].get_function_address(FUNCTION)

    @property
    def work(self) -> int:
        """Characters of the source that is left to be optimised, with that of what it calls."""
        return len(self.source or "") + sum(other.work for other in self.callees)

    def run(self, start: int, stop: int, addresses: Any, strides: Any) -> None:
        """Compute results[start:stop] (`emit`)."""
        while start < stop and self.source is not None:
            end, begun = min(start + PIECE, stop), time.thread_time()
            self.entry(start, end, addresses, strides)
            start, self.worked = end, self.worked + time.thread_time() - begun
            if self.worked > TRIAL_SECONDS * self.work:
                self.optimise(wait=False)
        self.entry(start, stop, addresses, strides)

    def expect(self, cells: int) -> None:
        """Make the code that suits a call for this many cells."""
        if self.source is None or (self.entry is not None and cells <= MANY_CELLS):
            return  # at once: all that asks LLVM waits while it compiles in another thread
        least, most = LONG_SOURCE
        if cells > MANY_CELLS or not least <= self.work <= most or not allows_quick_code():
            self.optimise()
        else:
            self.make_quickly()

    def make_quickly(self) -> None:
        """Make code that is not optimised, if there is none yet."""
        source, start = self.source, time.perf_counter()
        with self.compiling:
            if self.entry is None and source is not None:
                keep_source(source)
                self.use(load_program(source, QUICK), quick=True)
        report_compilation(start)

    def optimise(self, *, wait: bool = True) -> None:
        """Optimise the code, once; unless it is to wait, return if another thread compiles it."""
        if self.source is None or not self.compiling.acquire(blocking=wait):
            return
        start = time.perf_counter()
        try:
            if self.source is not None:
                self.use(load_program(self.source))
                self.source = None
        finally:
            self.compiling.release()
        report_compilation(start)

    def address(self) -> int:
        """Return the address of the optimised code, for calls that nobody counts."""
        self.optimise()
        found = ctypes.cast(self.entry, ctypes.c_void_p).value
        assert found is not None
        return found

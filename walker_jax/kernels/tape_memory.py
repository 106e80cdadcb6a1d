"""Tapes in the memory of a program, on its stack: each lane has its own rows, one after another.

Between the equations of a program a tape is an array, all entries of which are its memory.
"""

import math
from typing import Any, no_type_check

import numpy as np
from llvmlite import ir

from walker_jax.kernels.memory import LONG, entry_type

LANE = ir.IntType(32)


@no_type_check  # as the emitter
class TapeMemory:
    """The memory of a tape: as many rows as a computed index may name."""

    def __init__(self, emitter, shape: tuple[int, ...], over: int, dtype):
        self.emitter, self.dtype = emitter, dtype
        self.rows, self.size = shape[over], math.prod(shape)
        self.width = self.size // self.rows
        with emitter.builder.goto_entry_block():
            kind = entry_type(emitter, dtype)
            self.start = emitter.builder.alloca(kind, LONG(self.size * emitter.lanes))

    def places(self, index, dtype) -> list:
        """Return where each lane's row begins, for an index that is clipped to the rows."""
        builder, emitter = self.emitter.builder, self.emitter
        index = emitter.vector(index, dtype)
        last = emitter.vector(self.rows - 1, dtype)
        index = emitter.intrinsic(
            "smin", emitter.intrinsic("smax", index, emitter.vector(0, dtype)), last
        )
        each = self.width * emitter.lanes
        begins = []
        for lane in range(emitter.lanes):
            place = builder.extract_element(index, LANE(lane))
            place = place if place.type == LONG else builder.sext(place, LONG)
            begins.append(builder.add(builder.mul(place, LONG(each)), LONG(lane)))
        return begins

    def entry(self, begin, k: int) -> Any:
        builder = self.emitter.builder
        return builder.gep(self.start, [builder.add(begin, LONG(k * self.emitter.lanes))])


@no_type_check
def whole(memory: TapeMemory, shape: tuple[int, ...]) -> np.ndarray:
    """Return a tape as the array that stands for it."""
    return np.broadcast_to(np.array(memory, object), shape)


@no_type_check
def memory_of(array: np.ndarray) -> TapeMemory | None:
    """Return the memory of a tape; None for any other array."""
    first = array.flat[0] if isinstance(array, np.ndarray) and array.size else None
    return first if isinstance(first, TapeMemory) else None


@no_type_check
def new_tape(emitter, equation, operands: list[np.ndarray]) -> list[np.ndarray]:
    aval = equation.outvars[0].aval
    return [whole(TapeMemory(emitter, aval.shape, equation.params["over"], aval.dtype), aval.shape)]


@no_type_check
def write_row(emitter, equation, operands: list[np.ndarray]) -> list[np.ndarray]:
    tape, index, row = operands
    memory, builder = memory_of(tape), emitter.builder
    begins = memory.places(index[()], equation.invars[1].aval.dtype)
    for k, entry in enumerate(row.ravel()):
        vector = emitter.vector(entry, memory.dtype)
        if memory.dtype.kind == "b":
            vector = builder.zext(vector, ir.VectorType(ir.IntType(8), emitter.lanes))
        for lane, begin in enumerate(begins):
            value = builder.extract_element(vector, LANE(lane))
            builder.store(value, memory.entry(begin, k))
    return [tape]


@no_type_check
def read_row(emitter, equation, operands: list[np.ndarray]) -> list[np.ndarray]:
    tape, index = operands
    memory, builder = memory_of(tape), emitter.builder
    begins = memory.places(index[()], equation.invars[1].aval.dtype)
    row = np.empty(equation.outvars[0].aval.shape, object)
    for k, place in enumerate(np.ndindex(*row.shape)):
        vector = ir.Constant(
            ir.VectorType(entry_type(emitter, memory.dtype), emitter.lanes), ir.Undefined
        )
        for lane, begin in enumerate(begins):
            value = builder.load(memory.entry(begin, k))
            vector = builder.insert_element(vector, value, LANE(lane))
        row[place] = (
            builder.trunc(vector, emitter.type(bool)) if memory.dtype.kind == "b" else vector
        )
    return [row]

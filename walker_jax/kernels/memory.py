"""Arrays of cells in memory, read and written for all lanes at once."""

import math
from typing import Any, no_type_check

import numpy as np
from llvmlite import ir

LONG, BYTE = ir.IntType(64), ir.IntType(8)
ADDRESS = BYTE.as_pointer()


@no_type_check  # as the emitter
def entry_type(emitter, dtype) -> ir.Type:
    """Return the type of an entry in memory, where a truth value takes a byte."""
    return BYTE if dtype.kind == "b" else emitter.scalar_type(dtype)


@no_type_check
class Memory:
    """The arrays of operands and results, with the entries of one cell after those of another."""

    def __init__(self, emitter, addresses: ir.Value):
        self.emitter, self.builder = emitter, emitter.builder
        self.addresses = addresses
        self.cells: list[ir.Value] = []
        """The number of each lane's cell."""

    def array(self, i: int, dtype) -> ir.Value:
        """Return the pointer to array number i."""
        address = self.builder.load(self.builder.gep(self.addresses, [LONG(i)]))
        return self.builder.bitcast(address, entry_type(self.emitter, dtype).as_pointer())

    def take_cells(self, first: ir.Value, last: ir.Value) -> None:
        """Assign the cells from the first on to the lanes.

        Lanes beyond the last cell compute that cell again, and write the same results.
        """
        builder, self.cells = self.builder, []
        for i in range(self.emitter.lanes):
            mine = builder.add(first, LONG(i))
            self.cells.append(builder.select(builder.icmp_signed("<", mine, last), mine, last))

    def load(self, array: ir.Value, stride: ir.Value, shape, dtype) -> np.ndarray:
        """Load the entries of an operand; each is a vector with a value for each lane's cell."""
        builder = self.builder
        begins = [builder.mul(cell, stride) for cell in self.cells]
        values = np.empty(shape, object)
        for i, place in enumerate(np.ndindex(*shape)):
            vector = ir.Constant(
                ir.VectorType(entry_type(self.emitter, dtype), len(begins)), ir.Undefined
            )
            for lane, begin in enumerate(begins):
                value = builder.load(self.entry(array, begin, i))
                vector = builder.insert_element(vector, value, ir.IntType(32)(lane))
            if dtype.kind == "b":
                vector = builder.trunc(vector, self.emitter.type(dtype))
            values[place] = vector
        return values

    def store(self, array: ir.Value, values: np.ndarray, shape, dtype) -> None:
        """Write the entries of a result, for each lane's cell."""
        builder = self.builder
        begins = [builder.mul(cell, LONG(math.prod(shape))) for cell in self.cells]
        for i, place in enumerate(np.ndindex(*shape)):
            vector = self.emitter.vector(values[place], dtype)
            if dtype.kind == "b":
                vector = builder.zext(vector, ir.VectorType(BYTE, len(begins)))
            for lane, begin in enumerate(begins):
                value = builder.extract_element(vector, ir.IntType(32)(lane))
                builder.store(value, self.entry(array, begin, i))

    def entry(self, array: ir.Value, begin: ir.Value, i: int) -> Any:
        """Return the pointer to entry i of the cell that begins there."""
        return self.builder.gep(array, [self.builder.add(begin, LONG(i))])

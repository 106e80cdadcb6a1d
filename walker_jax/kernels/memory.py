"""Arrays of cells in memory, read and written for all lanes at once."""

import math
from typing import Any, no_type_check

import numpy as np
from llvmlite import ir

LONG, BYTE = ir.IntType(64), ir.IntType(8)
ADDRESS = BYTE.as_pointer()
SHARED = 256
"""Fewest entries of a long operand of which the lanes have no copies if all cells share it."""


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
        if (store := self.emitter.store) is not None and store.holds(shape):
            return self.load_long(array, stride, begins, shape, dtype)
        values = np.empty(shape, object)
        for i, place in enumerate(np.ndindex(*shape)):
            values[place] = self.gather(array, begins, LONG(i), dtype)
        return values

    def gather(self, array: ir.Value, begins: list, i: Any, dtype) -> Any:
        """Load entry number i for each lane's cell."""
        builder = self.builder
        vector = ir.Constant(
            ir.VectorType(entry_type(self.emitter, dtype), len(begins)), ir.Undefined
        )
        for lane, begin in enumerate(begins):
            value = builder.load(self.entry(array, begin, i))
            vector = builder.insert_element(vector, value, ir.IntType(32)(lane))
        return builder.trunc(vector, self.emitter.type(dtype)) if dtype.kind == "b" else vector

    def load_long(self, array: ir.Value, stride: ir.Value, begins: list, shape, dtype) -> Any:
        """Copy a long operand to memory of the lanes; leave a large one that all cells share."""
        builder, store = self.builder, self.emitter.store
        found, size = store.allocate(shape, dtype), math.prod(shape)
        flag = LONG(0)
        if size >= SHARED:
            flag = builder.icmp_signed("==", stride, LONG(0))
            base = builder.bitcast(array, ADDRESS)
            twin = store.array(base, shape, dtype, True)
            twin.places = twin.whole = found.whole  # views of both have the same places
            found.shared = flag, twin

        def copy():
            with store.counting(size) as i:
                offset = builder.mul(i, LONG(found.bytes))
                store.store(found, offset, self.gather(array, begins, i, dtype))

        if found.shared is None:
            copy()
        else:
            with builder.if_then(builder.not_(flag)):
                copy()
        return found

    def store(self, array: ir.Value, values: np.ndarray, shape, dtype) -> None:
        """Write the entries of a result, for each lane's cell."""
        builder = self.builder
        begins = [builder.mul(cell, LONG(math.prod(shape))) for cell in self.cells]
        if (store := self.emitter.store) is not None and store.holds(shape):
            found = store.copied(values, dtype)
            with store.counting(found.size) as i:
                offset = builder.mul(i, LONG(found.bytes))
                self.scatter(array, begins, i, store.load(found, offset), dtype)
            return
        for i, place in enumerate(np.ndindex(*shape)):
            vector = self.emitter.vector(values[place], dtype)
            self.scatter(array, begins, LONG(i), vector, dtype)

    def scatter(self, array: ir.Value, begins: list, i: Any, vector: Any, dtype) -> None:
        """Write entry number i for each lane's cell."""
        builder = self.builder
        if dtype.kind == "b":
            vector = builder.zext(vector, ir.VectorType(BYTE, len(begins)))
        for lane, begin in enumerate(begins):
            value = builder.extract_element(vector, ir.IntType(32)(lane))
            builder.store(value, self.entry(array, begin, i))

    def entry(self, array: ir.Value, begin: ir.Value, i: Any) -> Any:
        """Return the pointer to entry i of the cell that begins there."""
        return self.builder.gep(array, [self.builder.add(begin, i)])

"""The memory of long arrays (`stored`), and loops over their entries."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import Any, no_type_check

import numpy as np
from llvmlite import ir

from walker_jax.kernels.indexing import put_in_memory
from walker_jax.kernels.jaxprs import UnsupportedPrimitive
from walker_jax.kernels.lifetimes import ALIGNMENT, Distance
from walker_jax.kernels.memory import ADDRESS, entry_type
from walker_jax.kernels.memory import LONG as INTEGER
from walker_jax.kernels.shortcuts import is_known
from walker_jax.kernels.stored import Stored, is_long

MAX_BYTES = 2**25
"""Most bytes of the arrays in memory; beyond the processor's cache, XLA is faster."""
MAX_UNROLLED = 256
"""Most entries of a stored array that is read number by number, where no rule loops over it."""


@no_type_check  # as the emitter
class Store:
    """The memory of one thread that runs a program, and the arrays in it."""

    def __init__(self, emitter):
        self.emitter = emitter
        self.block: Any = None
        """The pointer to the memory."""
        self.size: Any = None
        """Its size, a number in the program that is known when the program is complete."""
        self.lifetimes, self.arrays = emitter.lifetimes, 0
        self.tables: dict[tuple, Stored] = {}
        self.functions: dict[tuple, ir.Function] = {}
        """Functions of the program, by what they do."""

    # Memory.

    def holds(self, shape: tuple[int, ...]) -> bool:
        """Return whether an array of this shape is in memory."""
        return is_long(np.broadcast_to(0, shape))

    def open(self) -> None:
        """Ask for memory, where the program begins."""
        builder, module = self.emitter.builder, self.emitter.builder.module
        self.size = ir.GlobalVariable(module, INTEGER, "size")
        self.size.global_constant, self.size.linkage = True, "internal"
        ask = ir.Function(module, ir.FunctionType(ADDRESS, [INTEGER]), "malloc")
        self.given = builder.call(ask, [builder.load(self.size)])
        whole = builder.ptrtoint(self.given, INTEGER)
        aligned = builder.and_(builder.add(whole, INTEGER(ALIGNMENT - 1)), INTEGER(-ALIGNMENT))
        self.block = builder.inttoptr(aligned, ADDRESS)

    def close(self) -> None:
        """Give the memory back, where the program ends."""
        builder = self.emitter.builder
        size = self.lifetimes.place()
        if size > MAX_BYTES:
            raise UnsupportedPrimitive(f"arrays of more than {MAX_BYTES} bytes")
        self.size.initializer = INTEGER(size + ALIGNMENT)
        give = ir.Function(builder.module, ir.FunctionType(ir.VoidType(), [ADDRESS]), "free")
        builder.call(give, [self.given])

    def allocate(self, shape: Sequence[int], dtype) -> Stored:
        """Return a new array without values."""
        found = self.array(self.block, shape, np.dtype(dtype), False)
        if found.size * found.bytes > MAX_BYTES:
            raise UnsupportedPrimitive(f"arrays of more than {MAX_BYTES} bytes")
        found.span = self.lifetimes.begin(found.size * found.bytes)
        return found

    def array(self, base, shape: Sequence[int], dtype, for_all: bool) -> Stored:
        self.arrays += 1
        found = Stored(base, np.empty(shape, np.int8), dtype, self.arrays)
        size = 1 if dtype.kind == "b" else dtype.itemsize
        found.bytes, found.for_all = size * (1 if for_all else self.emitter.lanes), for_all
        return found

    def table(self, values: np.ndarray) -> Stored:
        """Return an array of known numbers, which is a part of the program."""
        key = values.shape, values.dtype, values.tobytes()
        if key not in self.tables:
            if values.nbytes > MAX_BYTES:
                raise UnsupportedPrimitive(f"arrays of more than {MAX_BYTES} bytes")
            base = put_in_memory(self.emitter, values.ravel()).bitcast(ADDRESS)
            self.tables[key] = self.array(base, values.shape, values.dtype, True)
        return self.tables[key]

    # Entries.

    def pointer(self, array: Stored, offset: Any = None) -> Any:
        """Return the pointer to an entry, so many bytes after the first one."""
        builder, place = self.emitter.builder, array.base
        place = place if offset is None else builder.gep(place, [offset])
        if array.span is None:
            return self.move(place, array.start)
        self.lifetimes.use(array.span)
        return builder.gep(place, [Distance(array.span, array.start)])

    def move(self, place: Any, step: int) -> Any:
        return self.emitter.builder.gep(place, [INTEGER(step)]) if step else place

    def load(self, array: Stored, offset: Any = None) -> Any:
        """Return an entry as a vector, so many bytes after the first one."""
        return self.load_from(self.pointer(array, offset), 0, array.dtype, array.for_all)

    def load_from(self, base: Any, step: int, dtype, for_all: bool) -> Any:
        emitter, builder = self.emitter, self.emitter.builder
        element = entry_type(emitter, dtype)
        kind = ir.VectorType(element, emitter.lanes)
        place = self.move(base, step)
        value = builder.load(builder.bitcast(place, (element if for_all else kind).as_pointer()))
        value = self.splat(value, kind) if for_all else value
        return builder.trunc(value, emitter.type(dtype)) if dtype.kind == "b" else value

    def splat(self, value: Any, kind: ir.VectorType) -> Any:
        """Return a vector with one value in all lanes."""
        builder, none = self.emitter.builder, ir.Constant(kind, ir.Undefined)
        first = builder.insert_element(none, value, ir.IntType(32)(0))
        zeros = ir.Constant(ir.VectorType(ir.IntType(32), kind.count), None)
        return builder.shuffle_vector(first, none, zeros)

    def store(self, array: Stored, offset: Any, vector: Any) -> None:
        """Write an entry, so many bytes after the first one."""
        self.store_to(self.pointer(array, offset), 0, array.dtype, vector)

    def store_to(self, base: Any, step: int, dtype, vector: Any) -> None:
        emitter, builder = self.emitter, self.emitter.builder
        kind = ir.VectorType(entry_type(emitter, dtype), emitter.lanes)
        vector = builder.zext(vector, kind) if dtype.kind == "b" else vector
        builder.store(vector, builder.bitcast(self.move(base, step), kind.as_pointer()))

    # Loops.

    @contextmanager
    def counting(self, count: int) -> Iterator[Any]:
        """Emit what is emitted within as a loop over 0 ... count - 1, with count > 0."""
        emitter, builder = self.emitter, self.emitter.builder
        if count == 1:
            yield INTEGER(0)
            return
        i, each, known = self.begin_loop(), builder.block, len(emitter.known)
        yield i
        self.end_loop(i, each, count, known)

    def repeat(self, count: int, values: list, turn: Callable) -> list:
        """Emit a loop of turns (number, values) -> values; return the last values."""
        if count == 1:
            return turn(INTEGER(0), values)
        builder, before, known = (
            self.emitter.builder,
            self.emitter.builder.block,
            len(self.emitter.known),
        )
        i, each = self.begin_loop(), builder.block
        carried = [builder.phi(value.type) for value in values]
        results = turn(i, carried)
        for one, first, result in zip(carried, values, results, strict=True):
            one.add_incoming(first, before)
            one.add_incoming(result, builder.block)
        self.end_loop(i, each, count, known)
        return results

    def begin_loop(self) -> Any:
        builder = self.emitter.builder
        before, each = builder.block, builder.append_basic_block("each")
        builder.branch(each)
        builder.position_at_end(each)
        i = builder.phi(INTEGER)
        i.add_incoming(INTEGER(0), before)
        return i

    def end_loop(self, i: Any, each: Any, count: int, known: int) -> None:
        builder, terms = self.emitter.builder, self.emitter.known
        following = builder.add(i, INTEGER(1))
        i.add_incoming(following, builder.block)
        after = builder.append_basic_block("all")
        builder.cbranch(builder.icmp_signed("<", following, INTEGER(count)), each, after)
        builder.position_at_end(after)
        while len(terms) > known:  # terms of the loop alone
            terms.popitem()

    def for_each(self, shape: Sequence[int], views: Sequence[Any], act: Callable) -> None:
        """Emit a loop over all entries of arrays of one shape.

        `act` emits the work at one of them, given for each array the distance of the entry from
        the first one, in bytes; arrays that are none have None.
        """
        sizes, steps = merged_axes(shape, [one.steps for one in views if one is not None])
        with ExitStack() as loops:
            indices = [loops.enter_context(self.counting(size)) for size in sizes]
            offsets: dict[tuple, Any] = {}
            for each in steps:
                if each not in offsets:
                    offsets[each] = self.offset(indices, each)
            remaining = iter(steps)
            act([None if one is None else offsets[next(remaining)] for one in views])

    def offset(self, indices: Sequence[Any], steps: Sequence[int]) -> Any:
        """Return the distance of an entry from the first one; None if there is none."""
        builder, total = self.emitter.builder, None
        for i, step in zip(indices, steps, strict=True):
            if step:
                part = builder.mul(i, INTEGER(step))
                total = part if total is None else builder.add(total, part)
        return total

    # Arrays of either kind.

    def copy(self, target: Stored, source: Any, where: Any = None) -> None:
        """Copy an array of the same shape to memory, in the lanes of a flag if there is one."""
        emitter, builder = self.emitter, self.emitter.builder
        if isinstance(source, Stored) and source.shared is not None:
            flag, twin = source.shared
            whole, alone = builder.if_else(flag), source.view(source.places)
            alone.shared = None
            with whole as (then, otherwise):
                with then:
                    self.copy(target, twin, where)
                with otherwise:
                    self.copy(target, alone, where)
            return
        source = source if isinstance(source, Stored) else self.uniform_or_table(source, target)
        if isinstance(source, np.ndarray):
            for place in np.ndindex(source.shape):
                part = target.view(target.places[(*place, ...)])
                self.copy(part, source[place], where)
            return
        stored = isinstance(source, Stored)

        def act(offsets):
            value = (
                self.load(source, offsets[1]) if stored else emitter.vector(source, target.dtype)
            )
            if where is not None:
                value = builder.select(where, value, self.load(target, offsets[0]))
            self.store(target, offsets[0], value)

        self.for_each(target.shape, [target, source if stored else None], act)

    def uniform_or_table(self, entries: Any, like: Any) -> Any:
        """Return the one entry of an array, if all are the same, or a table of known numbers."""
        if not isinstance(entries, np.ndarray):
            return entries
        first = entries.flat[0]
        known = all(map(is_known, entries.flat))
        if known:
            values = np.asarray(entries.tolist(), like.dtype)
            same = values.tobytes() == values.flat[0].tobytes() * values.size
            return first if same else self.table(values)
        return first if all(one is first for one in entries.flat) else entries

    def in_memory(self, entries: Any, dtype) -> Any:
        """Return an array in memory, or the one entry of an array whose entries are the same."""
        if isinstance(entries, Stored):
            return entries if entries.shared is None else self.copied(entries)
        like = np.empty((), dtype)
        found = self.uniform_or_table(entries, like)
        if not isinstance(found, np.ndarray):
            return found
        return self.once(
            ("stored", *map(self.emitter.identity, entries.flat), entries.shape),
            lambda: self.copied(entries, dtype),
        )

    def copied(self, array: Any, dtype=None) -> Stored:
        """Return a copy whose entries follow each other in memory."""
        found = self.allocate(array.shape, array.dtype if dtype is None else dtype)
        self.copy(found, array)
        return found

    def once(self, key: tuple, compute: Callable) -> Any:
        """Return a result, the same one for equal keys."""
        known = self.emitter.known
        if key not in known:
            known[key] = compute()
        return known[key]

    def entries(self, array: Any) -> np.ndarray:
        """Return an array whose entries are vectors in registers."""
        if not isinstance(array, Stored):
            return array
        if array.size > MAX_UNROLLED:
            raise UnsupportedPrimitive(f"single numbers of an array of {array.size}")
        array = self.in_memory(array, array.dtype)
        found = np.empty(array.shape, object)
        for place in np.ndindex(found.shape):
            one = array.view(array.places[(*place, ...)])
            found[place] = self.once(("entry", one.key()), lambda one=one: self.load(one))
        return found

    # Values that differ from lane to lane, or from turn to turn.

    def update(self, targets: list, sources: list, flags: Any = None) -> None:
        """Copy arrays to others in the lanes of a flag, all at once.

        With several flags, each is of one of the equal parts of which an array consists.
        """
        numbers = {target.number for target in targets if target is not None}
        pairs = [(a, b) for a, b in zip(targets, sources, strict=True) if a is not None]
        read = lambda b: self.copied(b) if isinstance(b, Stored) and b.number in numbers else b
        pairs = [(a, b if b is a else read(b)) for a, b in pairs]
        for target, source in pairs:
            if source is target:
                continue
            if flags is None or len(flags) == 1:
                self.copy(target, source, flags and flags[0])
                continue
            source = source if isinstance(source, Stored) else self.copied(source, target.dtype)
            source = self.in_memory(source, source.dtype)
            parts = target.places.reshape(len(flags), -1)
            if not source.is_view(source.places.reshape(parts.shape)):
                source = self.copied(source)
            for i, flag in enumerate(flags):
                part = source.view(source.places.reshape(parts.shape)[i, ...])
                self.copy(target.view(parts[i, ...]), part, flag)


def merged_axes(
    shape: Sequence[int], steps: Sequence[Sequence[int]]
) -> tuple[list[int], list[tuple[int, ...]]]:
    """Merge axes along which the entries of all arrays follow each other.

    Returns the lengths of the axes that are left, and the steps of each array along them.
    """
    sizes: list[int] = []
    along: list[list[int]] = []
    for size, *each in zip(shape, *steps, strict=True):
        if size == 1:
            continue
        if sizes and all(a == b * size for a, b in zip(along[-1], each, strict=True)):
            sizes[-1], along[-1] = sizes[-1] * size, each
        else:
            sizes.append(size)
            along.append(each)
    return sizes, [tuple(axis[i] for axis in along) for i in range(len(steps))]

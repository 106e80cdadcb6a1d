"""A jaxpr of one cell as a program for LLVM, whose every number is a vector, one for each cell."""

import contextlib
import math
from collections.abc import Callable
from typing import Any, no_type_check

import jax
import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal, Primitive
from llvmlite import ir

from walker_jax.kernels.jaxprs import CALLS_WITH_DERIVATIVES
from walker_jax.kernels.rules import (
    FAST,
    REDUCTIONS,
    RULES,
    UnsupportedPrimitive,
    in_library,
    is_float,
    is_floating,
)
from walker_jax.kernels.scalars import Unrolling, is_number

BITS = 512
"""Of a vector; LLVM makes shorter ones of it where the processor has no such."""

FLOATS = {np.dtype(np.float32): ir.FloatType(), np.dtype(np.float64): ir.DoubleType()}


class Complex:
    """A complex entry, of two real ones."""

    def __init__(self, real, imag):
        self.real, self.imag = real, imag


@no_type_check  # as its base
class LLVMEmitter(Unrolling):
    """A jaxpr written as LLVM instructions: an entry is a number, a vector of one, or `Complex`."""

    def __init__(self, builder: ir.IRBuilder, lanes: int):
        super().__init__()
        self.builder = builder
        self.lanes = lanes
        self.active: Any = None
        """Which lanes are at work, where not all are."""

    # Types and constants.

    def scalar_type(self, dtype):
        try:
            dtype = np.dtype(dtype)
        except TypeError:  # one of JAX's own
            raise UnsupportedPrimitive(str(dtype)) from None
        if dtype.kind == "b":
            return ir.IntType(1)
        if dtype in FLOATS:
            return FLOATS[dtype]
        if dtype.kind in "iu":
            return ir.IntType(8 * dtype.itemsize)
        raise UnsupportedPrimitive(str(dtype))

    def type(self, dtype):
        return ir.VectorType(self.scalar_type(dtype), self.lanes)

    def vector(self, entry, dtype) -> Any:
        """An entry as a vector."""
        if not is_number(entry):
            return entry
        kind = self.scalar_type(dtype)
        value = np.asarray(entry, dtype).item()
        value = int(value) if isinstance(kind, ir.IntType) else value
        return ir.Constant(self.type(dtype), [ir.Constant(kind, value)] * self.lanes)

    def intrinsic(self, name: str, *operands: Any, result: ir.Type | None = None):
        kind = operands[0].type if result is None else result
        letter = lambda t: f"v{t.count}{self.letter(t.element)}"
        types = [kind, operands[0].type] if result is not None else [kind]
        full = ".".join([f"llvm.{name}", *map(letter, types)])
        module = self.builder.module
        function = module.globals.get(full)
        if function is None:
            function = ir.Function(
                module, ir.FunctionType(kind, [operand.type for operand in operands]), full
            )
        return self.builder.call(function, operands, fastmath=FAST if is_float(kind) else ())

    def by_library(self, name: str, dtype, *operands: Any):
        """A function of the C library, one cell after the other."""
        kind, builder = self.scalar_type(dtype), self.builder
        full = name + ("f" if dtype == np.float32 else "")
        if not in_library(full):
            raise UnsupportedPrimitive(name)
        function = builder.module.globals.get(full)
        if function is None:
            function = ir.Function(
                builder.module, ir.FunctionType(kind, [kind] * len(operands)), full
            )
        result = ir.Constant(self.type(dtype), ir.Undefined)
        for lane in range(self.lanes):
            place = ir.Constant(ir.IntType(32), lane)
            values = [builder.extract_element(operand, place) for operand in operands]
            result = builder.insert_element(result, builder.call(function, values), place)
        return result

    @staticmethod
    def letter(kind) -> str:
        if isinstance(kind, ir.IntType):
            return f"i{kind.width}"
        return "f64" if isinstance(kind, ir.DoubleType) else "f32"

    # Values.

    def split(self, value) -> np.ndarray:
        if isinstance(value, jax.Array):
            value = np.asarray(value)
        if np.iscomplexobj(value):
            entries = np.empty(np.shape(value), object)
            for place in np.ndindex(entries.shape):
                number = complex(value[place])
                entries[place] = Complex(number.real, number.imag)
            return entries
        return super().split(value)

    def evaluate(self, primitive: Primitive, params: dict, operands: list, dtypes: list) -> Any:
        if all(map(is_number, operands)):
            return super().evaluate(primitive, params, operands, dtypes)
        rule = RULES.get(primitive.name)
        if rule is None or any(isinstance(operand, Complex) for operand in operands):
            raise UnsupportedPrimitive(primitive.name)
        vectors = [self.vector(x, dtype) for x, dtype in zip(operands, dtypes, strict=True)]
        return rule(self, params, dtypes, *vectors)

    def term(self, primitive: Primitive, params: dict, operands: list, dtypes: list) -> Any:
        name = primitive.name
        if name == "select_n" and is_number(operands[0]):
            return operands[1 + int(operands[0])]
        if name in ("select_n", "stop_gradient", "convert_element_type", "copy", "copy_p") and any(
            isinstance(operand, Complex) for operand in operands
        ):
            part = lambda which: [getattr(o, which, o) for o in operands]
            real = np.dtype(np.float32 if dtypes[-1] == np.complex64 else np.float64)
            dtypes = [real if np.dtype(d).kind == "c" else d for d in dtypes]
            parts = (self.term(primitive, params, part(p), dtypes) for p in ("real", "imag"))
            return Complex(*parts)
        if name == "stop_gradient":
            return operands[0]
        return super().term(primitive, params, operands, dtypes)

    def keep(self, equation, operands: list[np.ndarray]) -> list[np.ndarray]:
        if all(is_number(entry) for operand in operands for entry in operand.ravel()):
            with contextlib.suppress(TypeError):  # a key to random numbers, which has no digits
                return super().keep(equation, operands)
        raise UnsupportedPrimitive(equation.primitive.name)

    def parts(self, equation, operands: list[np.ndarray]) -> list[np.ndarray]:
        """A complex number of its parts, or one of these."""
        name = equation.primitive.name
        result = np.empty(equation.outvars[0].aval.shape, object)
        for place in np.ndindex(*result.shape):
            entries = [operand[place] for operand in operands]
            result[place] = Complex(*entries) if name == "complex" else getattr(entries[0], name)
        return [result]

    def reduce(self, equation, operands: list[np.ndarray]) -> list[np.ndarray]:
        (operand,), axes, like = operands, equation.params["axes"], equation.outvars[0].aval
        if operand.size == 0:
            raise UnsupportedPrimitive(equation.primitive.name)
        primitive = REDUCTIONS[equation.primitive.name]
        moved = np.moveaxis(operand, axes, range(len(axes)))
        result = np.empty(like.shape, object)
        for place in np.ndindex(*like.shape):
            first, *others = moved[(..., *place)].ravel()
            for other in others:
                first = self.term(primitive, {}, [first, other], [like.dtype] * 2)
            result[place] = first
        return [result]

    # Loops.

    def loop(self, equation, operands: list[np.ndarray]) -> list[np.ndarray]:
        """A while loop. Lanes that have ended keep their values until the last one has."""
        params = equation.params
        condition, body = params["cond_jaxpr"], params["body_jaxpr"]
        count, more = params["cond_nconsts"], params["body_nconsts"]
        of_condition, of_body = operands[:count], operands[count : count + more]
        carry = operands[count + more :]

        if runs_once(condition.jaxpr, body.jaxpr, carry, count, more):
            return self.interpret(body, [*of_body, *carry])

        avals = [variable.aval for variable in body.jaxpr.outvars]
        flat, kinds = self.flattened(carry, avals)
        initial = [self.vector(x, dtype) for x, dtype in zip(flat, kinds, strict=True)]
        builder = self.builder
        before = builder.block
        head = builder.append_basic_block("head")
        turn = builder.append_basic_block("turn")
        done = builder.append_basic_block("done")
        builder.branch(head)
        builder.position_at_end(head)
        phis = [builder.phi(value.type) for value in initial]
        for phi, value in zip(phis, initial, strict=True):
            phi.add_incoming(value, before)

        known, lanes = len(self.known), self.active
        values = self.gathered(phis, avals)
        ((going,),) = map(np.ravel, self.interpret(condition, [*of_condition, *values]))
        going = self.vector(going, bool)
        if lanes is not None:
            going = builder.and_(going, lanes)
        bits = builder.bitcast(going, ir.IntType(self.lanes))
        builder.cbranch(
            builder.icmp_unsigned("!=", bits, ir.Constant(ir.IntType(self.lanes), 0)), turn, done
        )

        builder.position_at_end(turn)
        self.active = going
        results, _ = self.flattened(self.interpret(body, [*of_body, *values]), avals)
        for phi, result, dtype in zip(phis, results, kinds, strict=True):
            new = builder.select(going, self.vector(result, dtype), phi)
            phi.add_incoming(new, builder.block)
        builder.branch(head)
        builder.position_at_end(done)
        self.active = lanes
        while len(self.known) > known:  # of what came before or after a loop, none is from inside
            self.known.popitem()
        return self.gathered(phis, avals)

    def choice(self, equation, operands: list[np.ndarray]) -> list[np.ndarray]:
        """One of several functions: all are computed, unless it is known which is wanted."""
        branches, (which, *inputs) = equation.params["branches"], operands
        index = which[()]
        if is_number(index):
            branches = [branches[min(max(int(index), 0), len(branches) - 1)]]
        results, lanes = [], self.active
        avals = [variable.aval for variable in branches[0].jaxpr.outvars]
        for i, branch in enumerate(branches):
            if len(branches) > 1:
                mine = self.builder.icmp_signed("==", index, self.vector(i, np.int32))
                self.active = mine if lanes is None else self.builder.and_(mine, lanes)
            results.append(self.flattened(self.interpret(branch, inputs), avals))
        self.active = lanes
        chosen, kinds = results[-1]
        for i, (entries, _) in reversed(list(enumerate(results[:-1]))):
            before = self.builder.icmp_signed("<=", index, self.vector(i, np.int32))
            chosen = [
                self.builder.select(before, self.vector(one, dtype), self.vector(other, dtype))
                for one, other, dtype in zip(entries, chosen, kinds, strict=True)
            ]
        return self.gathered(chosen, avals)

    def flattened(self, arrays: list[np.ndarray], avals) -> tuple[list, list]:
        """All entries of arrays, complex ones as two, and their types."""
        flat, kinds = [], []
        for array, aval in zip(arrays, avals, strict=True):
            for entry in array.ravel():
                if isinstance(entry, Complex):
                    flat += [entry.real, entry.imag]
                    kinds += [np.finfo(aval.dtype).dtype] * 2
                else:
                    flat.append(entry)
                    kinds.append(aval.dtype)
        return flat, kinds

    def gathered(self, flat: list, avals) -> list[np.ndarray]:
        """The arrays of such a list."""
        remaining = iter(flat)
        arrays = []
        for aval in avals:
            result = np.empty(aval.shape, object)
            for place in np.ndindex(aval.shape):
                pair = np.dtype(aval.dtype).kind == "c"
                result[place] = (
                    Complex(next(remaining), next(remaining)) if pair else next(remaining)
                )
            arrays.append(result)
        return arrays

    def inline(self, function: Callable, *vectors: Any, dtype) -> Any:
        """A function of JAX scalars."""
        like = [jax.ShapeDtypeStruct((), dtype)] * len(vectors)
        closed = jax.make_jaxpr(function)(*like)
        inputs = []
        for vector in vectors:
            entry = np.empty((), object)
            entry[()] = vector
            inputs.append(entry)
        (result,) = self.interpret(closed, inputs)
        return self.vector(result[()], dtype)


LLVMEmitter.rules = {
    **Unrolling.rules,
    **CALLS_WITH_DERIVATIVES,
    **dict.fromkeys(("complex", "real", "imag"), LLVMEmitter.parts),
    **dict.fromkeys(REDUCTIONS, LLVMEmitter.reduce),
    "cond": LLVMEmitter.choice,
    "while": LLVMEmitter.loop,
}


def runs_once(condition: Jaxpr, body: Jaxpr, carry: list, count: int, more: int) -> bool:
    """Whether a loop is one of a single turn, whose condition hangs on a flag that the body sets.

    That is how `integrate.once` keeps XLA from computing its results several times.
    """
    if count or len(condition.eqns) != 1 or condition.eqns[0].primitive.name != "not":
        return False
    (flag,) = condition.eqns[0].invars
    if condition.outvars[0] is not condition.eqns[0].outvars[0] or flag not in condition.invars:
        return False
    place = condition.invars.index(flag)
    first, last = carry[place][()], body.outvars[place]
    return is_number(first) and not first and isinstance(last, Literal) and bool(last.val)


def emit(closed: ClosedJaxpr, shared: list, cell: list, results: list) -> str:
    """A program that computes results[start:stop]: void kernel(start, stop, addresses).

    The addresses are of the arrays that cells share, then of those of cells and of results.
    """
    floats = [dtype.itemsize for _, dtype in (*cell, *results) if is_floating(dtype)]
    lanes = BITS // 8 // max(floats, default=8)
    module = ir.Module("kernel")
    number, pointer = ir.IntType(64), ir.IntType(8).as_pointer()
    kind = ir.FunctionType(ir.VoidType(), [number, number, pointer.as_pointer()])
    function = ir.Function(module, kind, "kernel")
    start, stop, addresses = function.args
    before, head, turn, done = map(function.append_basic_block, ("before", "head", "turn", "done"))
    builder = ir.IRBuilder(before)
    emitter = LLVMEmitter(builder, lanes)
    long = lambda value: ir.Constant(number, value)
    lane = lambda value: ir.Constant(ir.IntType(32), value)

    def in_memory(dtype):
        return ir.IntType(8) if dtype.kind == "b" else emitter.scalar_type(dtype)

    def array_at(i: int, dtype):
        address = builder.load(builder.gep(addresses, [long(i)]))
        return builder.bitcast(address, in_memory(dtype).as_pointer())

    arrays = [array_at(i, dtype) for i, (_, dtype) in enumerate((*shared, *cell, *results))]
    of_shared = arrays[: len(shared)]
    of_cells = arrays[len(shared) : len(shared) + len(cell)]

    def load(array, places: list, dtype):
        """A vector of what stands at each lane's place of an array."""
        vector = ir.Constant(ir.VectorType(in_memory(dtype), lanes), ir.Undefined)
        for i, place in enumerate(places):
            value = builder.load(builder.gep(array, [place]))
            vector = builder.insert_element(vector, value, lane(i))
        return builder.trunc(vector, emitter.type(dtype)) if dtype.kind == "b" else vector

    def entries(array, shape, dtype, places_of: Callable[[int], list]):
        values = np.empty(shape, object)
        for i, place in enumerate(np.ndindex(*shape)):
            values[place] = load(array, places_of(i), dtype)
        return values

    constants = [
        entries(array, shape, dtype, lambda i: [long(i)] * lanes)
        for array, (shape, dtype) in zip(of_shared, shared, strict=True)
    ]
    last = builder.sub(stop, long(1))
    builder.branch(head)

    builder.position_at_end(head)
    first = builder.phi(number)
    first.add_incoming(start, before)
    builder.cbranch(builder.icmp_signed("<", first, stop), turn, done)

    builder.position_at_end(turn)
    # Lanes beyond the last cell work on that one too, and write the same results.
    cells = []
    for i in range(lanes):
        mine = builder.add(first, long(i))
        cells.append(builder.select(builder.icmp_signed("<", mine, last), mine, last))

    def places_in(shape) -> Callable[[int], list]:
        size = math.prod(shape)
        return lambda i: [builder.add(builder.mul(one, long(size)), long(i)) for one in cells]

    inputs = [
        entries(array, shape, dtype, places_in(shape))
        for array, (shape, dtype) in zip(of_cells, cell, strict=True)
    ]
    outputs = emitter.interpret(closed, constants + inputs)
    ends = zip(arrays[len(arrays) - len(results) :], outputs, results, strict=True)
    for array, output, (shape, dtype) in ends:
        for i, place in enumerate(np.ndindex(*shape)):
            vector = emitter.vector(output[place], dtype)
            if dtype.kind == "b":
                vector = builder.zext(vector, ir.VectorType(in_memory(dtype), lanes))
            for j, where in enumerate(places_in(shape)(i)):
                value = builder.extract_element(vector, lane(j))
                builder.store(value, builder.gep(array, [where]))
    first.add_incoming(builder.add(first, long(lanes)), builder.block)
    builder.branch(head)
    builder.position_at_end(done)
    builder.ret_void()
    return str(module)

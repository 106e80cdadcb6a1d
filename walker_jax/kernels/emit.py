"""The LLVM program of a jaxpr of one cell: each number is a vector with one lane per cell."""

import contextlib
import functools
import inspect
import math
from collections.abc import Callable
from typing import Any, no_type_check

import jax
import numpy as np
from jax.extend.core import ClosedJaxpr, Primitive
from llvmlite import ir

from walker_jax.kernels import control, indexing, tape_memory
from walker_jax.kernels.builder import FAST, Builder
from walker_jax.kernels.cell_functions import call_cell, call_other, define_cell, lanes_of, may_call
from walker_jax.kernels.entries import Unrolling
from walker_jax.kernels.jaxprs import (
    CALLS,
    CALLS_WITH_DERIVATIVES,
    SHARED_CALL,
    UnsupportedPrimitive,
    shape_dtype,
)
from walker_jax.kernels.lifetimes import Lifetimes
from walker_jax.kernels.memory import ADDRESS, LONG, Memory
from walker_jax.kernels.rules import (
    REDUCTIONS,
    RULES,
    in_library,
    is_float,
    is_floating,
)
from walker_jax.kernels.shortcuts import is_known
from walker_jax.kernels.store import Store
from walker_jax.kernels.stored import Stored, is_long, keeps_arrays_in_memory
from walker_jax.kernels.stored_rules import STORED_RULES
from walker_jax.kernels.substitutes import SUBSTITUTES

FLOATS = {np.dtype(np.float32): ir.FloatType(), np.dtype(np.float64): ir.DoubleType()}
"""The floating-point types that kernels support, as LLVM's."""


@no_type_check  # as its base
class LLVMEmitter(Unrolling):
    """Emits LLVM instructions for a jaxpr; an entry is a known number or a vector of all lanes."""

    def __init__(self, builder: Builder, lanes: int):
        super().__init__()
        self.builder = builder
        self.lanes = lanes
        self.callees: dict[str, Any] = {}
        """By digest: the machine code that it calls."""
        self.calls = 0
        """Number of calls that have been written."""
        self.active: Any = None
        """A flag for each lane, true if the lane is active; None if all are."""
        self.types: dict = {}
        """LLVM's vector type for each type of entry."""
        self.constants: dict[tuple, ir.Constant] = {}
        """Vectors by known entry and type; LLVM's library makes the text of each only once."""
        self.tables: dict[tuple[int, int], tuple] = {}
        """By identity of an array and axis: the array, and its tables in memory, if it is known."""
        self.functions: dict[Any, tuple] = {}
        """By primitive, parameters and types of operands, or by the identity of an equation: the
        function that a primitive calls, and the equation."""
        self.alternatives: dict[int, tuple] = {}
        """By identity of an entry that is one of two numbers: the entry, its flag, the numbers."""
        self.lifetimes = Lifetimes()
        self.store: Any = None
        """The `Store` of long arrays; None if all arrays are of entries in registers."""

    # Types and constants.

    def scalar_type(self, dtype):
        try:
            dtype = np.dtype(dtype)
        except TypeError:  # a type of JAX that NumPy does not know
            raise UnsupportedPrimitive(str(dtype)) from None
        if dtype.kind == "b":
            return ir.IntType(1)
        if dtype in FLOATS:
            return FLOATS[dtype]
        if dtype.kind in "iu":
            return ir.IntType(8 * dtype.itemsize)
        raise UnsupportedPrimitive(str(dtype))

    def type(self, dtype):
        found = self.types.get(dtype)
        if found is None:
            found = self.types[dtype] = ir.VectorType(self.scalar_type(dtype), self.lanes)
        return found

    def vector(self, entry, dtype) -> Any:
        """Return an entry as a vector."""
        if not is_known(entry):
            return entry
        key = *self.identity(entry), dtype
        if key not in self.constants:
            kind = self.scalar_type(dtype)
            value = np.asarray(entry, dtype).item()
            value = int(value) if isinstance(kind, ir.IntType) else value
            vector = ir.Constant(self.type(dtype), [ir.Constant(kind, value)] * self.lanes)
            self.constants[key] = vector
        return self.constants[key]

    def intrinsic(self, name: str, *operands: Any):
        """Call an intrinsic of LLVM on vectors of one type."""
        kind = operands[0].type
        full = f"llvm.{name}.v{kind.count}{kind.element.intrinsic_name}"
        function = self.declare(full, kind, operands)
        return self.builder.call(function, operands, fastmath=(FAST,) if is_float(kind) else ())

    def by_library(self, name: str, dtype, *operands: Any):
        """Call a function of the C library for one lane after the other."""
        kind, builder = self.scalar_type(dtype), self.builder
        full = name + ("f" if dtype == np.float32 else "")
        if not in_library(full):
            raise UnsupportedPrimitive(name)
        result = ir.Constant(self.type(dtype), ir.Undefined)
        for lane in range(self.lanes):
            place = ir.Constant(ir.IntType(32), lane)
            values = [builder.extract_element(operand, place) for operand in operands]
            function = self.declare(full, kind, values)
            result = builder.insert_element(result, builder.call(function, values), place)
        return result

    def declare(self, name: str, kind: ir.Type, operands) -> ir.Function:
        """Declare an external function with a result of this type."""
        module = self.builder.module
        if name not in module.globals:
            ir.Function(module, ir.FunctionType(kind, [one.type for one in operands]), name)
        return module.globals[name]

    # Values.

    def apply(self, equation, operands: list) -> list:
        """Return the results of an equation; of long arrays, by a loop if there is a rule."""
        if self.store is None or not (
            any(isinstance(x, Stored) for x in operands)
            or any(is_long(variable.aval) for variable in equation.outvars)
        ):
            return super().apply(equation, operands)
        name = equation.primitive.name
        if name in STORED_RULES and not self.all_known(operands):
            results = STORED_RULES[name](self, equation, operands)
            if results is not None:
                pairs = zip(results, equation.outvars, strict=True)
                return [x if is_long(v.aval) else self.store.entries(x) for x, v in pairs]
        if not (name in PASSED_ON or self.inner(equation) is not None):
            operands = [self.store.entries(operand) for operand in operands]
        return super().apply(equation, operands)

    def all_known(self, operands: list) -> bool:
        """Return whether all entries of some arrays are known numbers."""
        return not any(isinstance(x, Stored) for x in operands) and all(
            is_known(entry) for operand in operands for entry in operand.ravel()
        )

    def identity(self, entry) -> tuple:
        return entry.key() if isinstance(entry, Stored) else super().identity(entry)

    def entries_of(self, value) -> Any:
        if isinstance(value, Stored):
            return value
        if isinstance(value, jax.Array):
            value = np.asarray(value)
        return super().entries_of(value)

    def evaluate_term(
        self, primitive: Primitive, params: dict, operands: list, dtypes: list
    ) -> Any:
        if all(map(is_known, operands)):
            return super().evaluate_term(primitive, params, operands, dtypes)
        rule = RULES.get(primitive.name)
        if rule is None:
            raise UnsupportedPrimitive(primitive.name)
        vectors = [self.vector(x, dtype) for x, dtype in zip(operands, dtypes, strict=True)]
        return rule(self, params, dtypes, *vectors)

    def add_product(self, total, a, b, dtype):
        """Return total + a b, as one instruction where the processor has it."""
        known = is_known(a) or is_known(b) or (is_known(total) and total == 0)
        if known or not is_floating(dtype):
            return super().add_product(total, a, b, dtype)
        key = "add_product", self.identity(total), *sorted(map(self.identity, (a, b))), dtype
        if key not in self.known:
            self.known[key] = self.builder.fused(a, b, self.vector(total, dtype))
        return self.known[key]

    def term(self, primitive: Primitive, params: dict, operands: list, dtypes: list) -> Any:
        name = primitive.name
        if name == "stop_gradient":
            return operands[0]
        result = super().term(primitive, params, operands, dtypes)
        flag = name == "select_n" and len(operands) == 3 and dtypes[0] == np.dtype(bool)
        if flag and all(map(is_known, operands[1:])):
            self.alternatives[id(result)] = (result, *operands)
        return result

    def default_rule(self, equation, operands: list[np.ndarray]) -> list[np.ndarray]:
        primitive = equation.primitive
        if equation.effects or primitive.name.endswith("callback"):
            # An effect would happen once, while the program is emitted.
            raise UnsupportedPrimitive(primitive.name)
        by_xla = primitive.name != "cond" and not implemented_in_jax(primitive)
        if by_xla and self.all_known(operands):
            with contextlib.suppress(TypeError):  # a random key has no numerical value
                return super().default_rule(equation, operands)
        if primitive.name in ARRAY_RULES:
            return ARRAY_RULES[primitive.name](self, equation, operands)
        inner = self.inner(equation)
        if inner is None:
            raise UnsupportedPrimitive(primitive.name)
        return self.interpret(inner, operands)

    def inner(self, equation) -> ClosedJaxpr | None:
        """Return the function that an equation calls, if it calls one."""
        primitive, params = equation.primitive, equation.params
        if primitive.name == "kernel" and not any(params["mapped"]):
            return params["program"].closed
        if primitive.name in SUBSTITUTES:
            function = SUBSTITUTES[primitive.name](params)
        elif implemented_in_jax(primitive):
            function = functools.partial(primitive.impl, **params)
        else:
            return None
        like = [shape_dtype(variable.aval) for variable in equation.invars]
        key: Any = primitive, *params.items(), *like
        try:
            hash(key)
        except TypeError:  # of an array among the parameters
            key = id(equation)
        if key not in self.functions:
            self.functions[key] = jax.make_jaxpr(function)(*like), equation
        return self.functions[key][0]

    def reduce(self, equation, operands: list[np.ndarray]) -> list[np.ndarray]:
        if operands[0].size == 0:
            raise UnsupportedPrimitive(equation.primitive.name)
        primitive = REDUCTIONS[equation.primitive.name]
        dtypes = [equation.outvars[0].aval.dtype] * 2
        combine = lambda one, other: self.term(primitive, {}, [one, other], dtypes)
        return self.fold(equation, operands, lambda entries: functools.reduce(combine, entries))

    # Arrays and entries.

    def short_ones(self, values: list, avals=None) -> list:
        """Return the values of arrays in registers; by default the abstract ones."""
        pairs = zip(values, values if avals is None else avals, strict=True)
        return [one for one, aval in pairs if self.store is None or not is_long(aval)]

    def flatten(self, arrays: list, avals) -> tuple[list, list]:
        """Return all entries of arrays in registers, and their types."""
        entries = [entry for array in self.short_ones(arrays, avals) for entry in array.ravel()]
        avals = self.short_ones(avals)
        return entries, [aval.dtype for aval in avals for _ in range(math.prod(aval.shape))]

    def unflatten(self, flat: list, avals, buffers: list) -> list:
        """Rebuild arrays from a flat list of their entries: the inverse of `flatten`."""
        remaining = iter(flat)
        arrays: list[Any] = [
            np.empty(aval.shape, object) if buffer is None else buffer
            for aval, buffer in zip(avals, buffers, strict=True)
        ]
        for array, buffer in zip(arrays, buffers, strict=True):
            for place in np.ndindex(array.shape) if buffer is None else ():
                array[place] = next(remaining)
        return arrays

    def new_buffers(self, avals) -> list:
        """Return memory for each long array; None for others."""
        if self.store is None:
            return [None] * len(avals)
        new = lambda aval: self.store.allocate(aval.shape, aval.dtype) if is_long(aval) else None
        return [new(aval) for aval in avals]

    def fill(self, buffers: list, arrays: list, flags: list | None = None) -> None:
        """Copy long arrays to their memory, in the lanes of the flags alone."""
        if any(buffer is not None for buffer in buffers):
            self.store.update(buffers, arrays, flags)

    def in_registers(self, array) -> np.ndarray:
        return array if self.store is None else self.store.entries(array)

    def inline(self, function: Callable, *vectors: Any, dtype) -> Any:
        """Emit the instructions of a function of JAX scalars."""
        like = [jax.ShapeDtypeStruct((), dtype)] * len(vectors)
        closed = jax.make_jaxpr(function)(*like)
        inputs = []
        for vector in vectors:
            entry = np.empty((), object)
            entry[()] = vector
            inputs.append(entry)
        (result,) = self.interpret(closed, inputs)
        return self.vector(result[()], dtype)


def custom_linear_solve(emitter, equation, operands: list[np.ndarray]) -> list[np.ndarray]:
    """Solve by the solver that the equation carries."""
    lengths, jaxprs = equation.params["const_lengths"], equation.params["jaxprs"]
    first = lengths.matvec + lengths.vecmat
    inputs = [*operands[first : first + lengths.solve], *operands[sum(lengths) :]]
    return emitter.interpret(jaxprs.solve, inputs)


ARRAY_RULES: dict[str, Callable] = {
    "while": control.loop,
    "cond": control.choice,
    "custom_linear_solve": custom_linear_solve,
    "dynamic_slice": indexing.dynamic_slice,
    "dynamic_update_slice": indexing.dynamic_update_slice,
    "gather": indexing.gather,
    **dict.fromkeys(indexing.COMBINATIONS, indexing.scatter),
}
"""Rules of primitives of whole arrays: (emitter, equation, operands) -> results."""


PASSED_ON = {"while", "cond", "custom_linear_solve", *CALLS, *CALLS_WITH_DERIVATIVES}
"""Primitives whose inner functions get long arrays as they are."""


def implemented_in_jax(primitive: Primitive) -> bool:
    """Return whether a JAX function implements a primitive, as for those of Equinox and lineax.

    Such primitives only add rules for transformations to that function.
    """
    if primitive.name == "kernel":
        return False
    return inspect.isfunction(primitive.impl) and not primitive.impl.__module__.startswith("jax.")


LLVMEmitter.rules = {
    **Unrolling.rules,
    **dict.fromkeys(CALLS_WITH_DERIVATIVES, LLVMEmitter.call),
    **dict.fromkeys(REDUCTIONS, LLVMEmitter.reduce),
    SHARED_CALL: call_other,
    "new_tape": tape_memory.new_tape,
    "write_row": tape_memory.write_row,
    "read_row": tape_memory.read_row,
}


def emit(
    closed: ClosedJaxpr, operands: list, results: list, bits: int, shared: bool = False
) -> tuple[str, list]:
    """Write the source of a program that computes results[start:stop] in vectors of `bits` bits.

    A vector should fill one register of the processor. LLVM splits a longer one over several
    registers, and a long function then runs out of them: with registers of 256 bits, vectors of 512
    take twice as long to compile and run no faster.

    The program is void kernel(start, stop, addresses, strides). The addresses point to the arrays
    of the operands, then to those of the results. A stride is the distance between the entries of
    two successive cells in an operand; it is 0 for an operand that all cells share. A `shared`
    program also has a function that others call (`cell_functions`). Returns all code called too.
    """
    lanes = lanes_of(operands, results, bits)
    arguments = [LONG, LONG, ADDRESS.as_pointer(), LONG.as_pointer()]
    module = ir.Module("kernel")
    function = ir.Function(module, ir.FunctionType(ir.VoidType(), arguments), "kernel")
    start, stop, addresses, strides = function.args
    before, head, turn, done = map(function.append_basic_block, ("before", "head", "turn", "done"))
    builder = Builder(before)
    emitter = LLVMEmitter(builder, lanes)
    if keeps_arrays_in_memory(closed.jaxpr, bits):
        emitter.store = Store(emitter)
        emitter.store.open()
    memory = Memory(emitter, addresses)
    arrays = [memory.array(i, dtype) for i, (_, dtype) in enumerate((*operands, *results))]
    steps = [builder.load(builder.gep(strides, [LONG(i)])) for i in range(len(operands))]
    last: Any = builder.sub(stop, LONG(1))
    builder.branch(head)

    builder.position_at_end(head)
    first = builder.phi(LONG)
    first.add_incoming(start, before)
    builder.cbranch(builder.icmp_signed("<", first, stop), turn, done)

    builder.position_at_end(turn)
    memory.take_cells(first, last)
    inputs = [
        memory.load(array, step, *operand)
        for array, step, operand in zip(arrays, steps, operands, strict=False)
    ]
    if shared and may_call(emitter):
        outputs = call_cell(emitter, define_cell(emitter, closed), closed, inputs)
    else:
        outputs = emitter.interpret(closed, inputs)
    for array, output, result in zip(arrays[len(operands) :], outputs, results, strict=True):
        memory.store(array, output, *result)
    first.add_incoming(builder.add(first, LONG(lanes)), builder.block)
    builder.branch(head)
    builder.position_at_end(done)
    if emitter.store is not None:
        emitter.store.close()
    builder.ret_void()
    return str(module), [*emitter.callees.values()]

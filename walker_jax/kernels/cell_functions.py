"""Functions of a vector of cells, which the machine code of other kernels calls (`shared_code`).

A large program computes its cells in a function of its own. The function takes the entries of the
operands and a flag for each lane, true if the lane is active, and returns the entries of the
results. A program that calls the function of another finds its address in a slot, a number in
memory whose name holds the digest of the other's source.
"""

import re
from collections.abc import Sequence
from typing import Any, no_type_check

import numpy as np
from jax.extend.core import ClosedJaxpr
from llvmlite import ir

from walker_jax.kernels.builder import Builder
from walker_jax.kernels.machine import processor
from walker_jax.kernels.memory import LONG
from walker_jax.kernels.rules import is_floating
from walker_jax.kernels.shortcuts import is_known

FUNCTION = "cell"
"""Name of the function in its own program."""
SLOT = "slot_{}"
"""Name of a slot."""
SLOTS = re.compile(SLOT.format("([0-9a-f]{64})").encode())
"""Names of slots in a program's source, or in its machine code, whose tables list them."""


def lanes_of(operands: list, results: list, bits: int) -> int:
    """Return the number of cells of a vector; with 0 bits one, as for a thread."""
    floats = [dtype.itemsize for _, dtype in (*operands, *results) if is_floating(dtype)]
    return max(1, bits // 8 // max(floats, default=8))


@no_type_check  # as the emitter
def may_call(emitter) -> bool:
    """Return whether a program calls others, as no thread does, nor a program with a store."""
    return emitter.lanes > 1 and emitter.store is None


@no_type_check
def signature(emitter, given: Sequence, returned: Sequence) -> ir.FunctionType:
    """Return the type of the function of cells with operands and results of these kinds."""
    types = lambda avals: [emitter.type(aval.dtype) for aval in avals for _ in range(aval.size)]
    flags = emitter.type(np.dtype(bool))
    return ir.FunctionType(ir.LiteralStructType(types(returned)), [*types(given), flags])


@no_type_check
def define_cell(emitter, closed: ClosedJaxpr) -> ir.Function:
    """Write the function of a jaxpr of one cell."""
    kind = signature(emitter, closed.in_avals, closed.out_avals)
    function = ir.Function(emitter.builder.module, kind, FUNCTION)
    inner = type(emitter)(Builder(function.append_basic_block()), emitter.lanes)
    inner.callees = emitter.callees
    *entries, inner.active = function.args
    inputs = inner.unflatten(entries, closed.in_avals, [None] * len(closed.in_avals))
    outputs = inner.interpret(closed, inputs)
    results: Any = ir.Constant(kind.return_type, ir.Undefined)
    for i, (entry, dtype) in enumerate(zip(*inner.flatten(outputs, closed.out_avals), strict=True)):
        results = inner.builder.insert_value(results, inner.vector(entry, dtype), i)
    inner.builder.ret(results)
    return function


@no_type_check
def call_cell(emitter, function: Any, closed: ClosedJaxpr, operands: list) -> list[np.ndarray]:
    """Call such a function for the active lanes."""
    flat = zip(*emitter.flatten(operands, closed.in_avals), strict=True)
    vectors = [emitter.vector(entry, dtype) for entry, dtype in flat]
    active = emitter.vector(True, np.dtype(bool)) if emitter.active is None else emitter.active
    builder, avals = emitter.builder, closed.out_avals
    emitter.calls += 1
    results = builder.call(function, [*vectors, active])
    entries = [builder.extract_value(results, i) for i in range(len(results.type.elements))]
    return emitter.unflatten(entries, avals, [None] * len(avals))


@no_type_check
def call_other(emitter, equation, operands: list) -> list[np.ndarray]:
    """Call the machine code of another kernel, or include its function.

    It is included where its own code has other lanes, and where some numbers are known, as they
    shorten it.
    """
    program, closed = equation.params["program"], equation.params["jaxpr"]
    entries, _ = emitter.flatten(operands, closed.in_avals)
    other = program.compiled if may_call(emitter) and not any(map(is_known, entries)) else None
    if other is None or other.made_for != (processor(), emitter.lanes):
        return emitter.call(equation, operands)
    emitter.callees[other.digest] = other.code
    key = "cell", other.digest, *map(emitter.identity, entries)
    if key not in emitter.known:
        builder, name = emitter.builder, SLOT.format(other.digest)
        if name not in builder.module.globals:
            ir.GlobalVariable(builder.module, LONG, name).initializer = LONG(0)
        kind = signature(emitter, closed.in_avals, closed.out_avals).as_pointer()
        function = builder.inttoptr(builder.load(builder.module.globals[name]), kind)
        emitter.known[key] = call_cell(emitter, function, closed, operands)
    return emitter.known[key]

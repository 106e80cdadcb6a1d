"""Loops and branches that may take a different course in each lane.

A loop is unrolled if its number of turns is small and known before it begins. The loop counter is
then a known number in each turn, and so are the indices and coefficients that depend on it. The
loop over the stages of a Runge-Kutta method starts at the first stage, or at the second if the
previous step supplied the first; such a loop is unrolled for both starts. A jump skips a long
branch that no lane takes.
"""

from collections.abc import Callable, Iterator
from functools import reduce
from typing import Any, no_type_check

import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal, subjaxprs
from llvmlite import ir

from walker_jax.kernels.jaxprs import UnsupportedPrimitive
from walker_jax.kernels.running_sums import RunningSum, add_to, take_out_sums
from walker_jax.kernels.shortcuts import is_known
from walker_jax.kernels.stored import Stored
from walker_jax.kernels.tape_memory import memory_of

MAX_UNROLLED_TURNS = 16
"""Most turns of an unrolled loop: room for the 14 stages of Dopri8."""
MIN_EQUATIONS_TO_SKIP = 20
"""Fewest equations of a branch worth a jump: a shorter branch costs less than the jump."""


@no_type_check  # as the emitter
def loop(emitter, equation, operands: list[np.ndarray]) -> list[np.ndarray]:
    """Emit a while loop that runs until all lanes have ended; ended lanes keep their values.

    A loop that `jax.vmap` has mapped over entries within a cell has a condition for each entry.
    """
    params, builder = equation.params, emitter.builder
    condition, body = params["cond_jaxpr"], params["body_jaxpr"]
    count, more = params["cond_nconsts"], params["body_nconsts"]
    of_condition, of_body = operands[:count], operands[count : count + more]
    carry = operands[count + more :]

    turns = known_turns(emitter, condition, body, of_condition, of_body, carry)
    if turns is not None:
        for _ in range(turns):
            carry = emitter.interpret(body, [*of_body, *carry])
        return carry

    avals = [variable.aval for variable in body.jaxpr.outvars]
    for which, cases in alternative_starts(emitter, carry):
        started = [case(carry) for case in cases]
        turns = [
            known_turns(emitter, condition, body, of_condition, of_body, start) for start in started
        ]
        if None not in turns:
            flags = builder.not_(which), which
            runs = [
                lambda start=s: loop(emitter, equation, [*operands[: count + more], *start])
                for s in started
            ]
            return merge_lanes(emitter, flags, runs, avals)

    return emit_loop(emitter, condition, body, of_condition, of_body, carry)


@no_type_check
def emit_loop(
    emitter, condition: ClosedJaxpr, body: ClosedJaxpr, of_condition, of_body, carry
) -> list[np.ndarray]:
    """Emit the blocks of a loop whose number of turns is not known before it."""
    builder, avals = emitter.builder, [variable.aval for variable in body.jaxpr.outvars]
    tapes = {i: array for i, array in enumerate(carry) if memory_of(array)}  # written in place
    others = [i for i in range(len(carry)) if i not in tapes]
    avals = [avals[i] for i in others]
    buffers = emitter.new_buffers(avals)
    emitter.fill(buffers, [carry[i] for i in others])

    def with_tapes(entries: list) -> list:
        found = zip(others, emitter.unflatten(entries, avals, buffers), strict=True)
        found = tapes | dict(found)
        return [found[i] for i in range(len(carry))]

    flat, kinds = emitter.flatten([carry[i] for i in others], avals)
    initial = [emitter.vector(x, dtype) for x, dtype in zip(flat, kinds, strict=True)]
    before = builder.block
    head = builder.append_basic_block("head")
    turn = builder.append_basic_block("turn")
    done = builder.append_basic_block("done")
    builder.branch(head)
    builder.position_at_end(head)
    phis = [builder.phi(value.type) for value in initial]
    for phi, value in zip(phis, initial, strict=True):
        phi.add_incoming(value, before)

    sums: list[RunningSum] = []
    if emitter.store is not None and condition.out_avals[0].ndim == 0:
        body, sums = take_out_sums(body, len(of_body))
    known, lanes, begun = len(emitter.known), emitter.active, emitter.lifetimes.begin_loop()
    values = with_tapes(phis)
    (flags,) = emitter.interpret(condition, [*of_condition, *values])
    flags = [emitter.vector(flag, bool) for flag in np.ravel(emitter.in_registers(flags))]
    if lanes is not None:
        flags = [builder.and_(flag, lanes) for flag in flags]
    going = reduce(builder.or_, flags)
    builder.cbranch(any_lane(emitter, going), turn, done)

    builder.position_at_end(turn)
    emitter.active = going
    following = emitter.interpret(body, [*of_body, *values])
    add_to(emitter, sums, [values[one.place] for one in sums], following, flags[0])
    if any(memory_of(following[i]) is not memory_of(tape) for i, tape in tapes.items()):
        raise UnsupportedPrimitive("a loop that replaces a tape")
    following = [following[i] for i in others]
    results, _ = emitter.flatten(following, avals)
    emitter.fill(buffers, following, flags)
    # Entries of a mapped loop come first in each value.
    sizes = [aval.size // len(flags) for aval in emitter.short_ones(avals)]
    owners = [i for size in sizes for i in np.repeat(range(len(flags)), size)]
    for phi, result, dtype, owner in zip(phis, results, kinds, owners, strict=True):
        new = builder.select(flags[owner], emitter.vector(result, dtype), phi)
        phi.add_incoming(new, builder.block)
    builder.branch(head)
    builder.position_at_end(done)
    emitter.active = lanes
    forget_terms(emitter, known)
    emitter.lifetimes.end_loop(begun)
    return with_tapes(phis)


@no_type_check
def any_lane(emitter, flags) -> Any:
    bits = ir.IntType(emitter.lanes)
    flags = emitter.builder.bitcast(flags, bits)
    return emitter.builder.icmp_unsigned("!=", flags, ir.Constant(bits, 0))


@no_type_check
def forget_terms(emitter, known: int) -> None:
    """Forget the terms that a block computed: after it they are undefined if it was skipped."""
    while len(emitter.known) > known:
        emitter.known.popitem()


@no_type_check
def known_turns(
    emitter, condition: ClosedJaxpr, body: ClosedJaxpr, of_condition, of_body, carry
) -> int | None:
    """Return the number of turns of a loop; None if it is large, or unknown before the loop."""
    for turn in range(MAX_UNROLLED_TURNS + 1):
        (going,) = known_part(emitter, condition, [*of_condition, *carry])
        if going is None or going.ndim:
            return None
        if not going[()]:
            return turn
        carry = known_part(emitter, body, [*of_body, *carry])
    return None


@no_type_check
def known_part(emitter, closed: ClosedJaxpr, inputs: list) -> list:
    """Return the results that follow from known inputs alone; None for all others."""
    known = lambda x: x is not None and all(map(is_known, x.ravel()))
    values: dict = dict(
        zip(closed.jaxpr.constvars, map(emitter.entries_of, closed.consts), strict=True)
    )
    values |= zip(closed.jaxpr.invars, inputs, strict=True)
    read = lambda v: emitter.entries_of(np.asarray(v.val)) if isinstance(v, Literal) else values[v]
    for equation in closed.jaxpr.eqns:
        operands = [read(variable) for variable in equation.invars]
        if all(map(known, operands)):
            results = emitter.apply(equation, operands)
        elif (inner := emitter.inner(equation)) is not None:
            results = known_part(emitter, inner, operands)
        else:
            results = [None] * len(equation.outvars)
        values |= zip(equation.outvars, results, strict=True)
    results = map(read, closed.jaxpr.outvars)
    return [result if known(result) else None for result in results]


@no_type_check
def alternative_starts(emitter, carry: list[np.ndarray]) -> Iterator:
    """Yield the flag of each carry entry that is one of two numbers, and the carry with either."""

    def replace(entry, number):
        def case(carry):
            new = [array if isinstance(array, Stored) else array.copy() for array in carry]
            for array in new:
                if isinstance(array, Stored):
                    continue
                for place in np.ndindex(array.shape):
                    array[place] = number if array[place] is entry else array[place]
            return new

        return case

    for entry in (array[()] for array in carry if array.shape == ()):
        if id(entry) in emitter.alternatives:
            _, which, *numbers = emitter.alternatives[id(entry)]
            yield which, [replace(entry, number) for number in numbers]


@no_type_check
def choice(emitter, equation, operands: list[np.ndarray]) -> list[np.ndarray]:
    """Emit one of several functions; if the index is unknown, each lane chooses its own."""
    branches, (which, *inputs) = equation.params["branches"], operands
    builder, index, last = emitter.builder, which[()], len(branches) - 1
    if is_known(index) or last == 0:
        return emitter.interpret(branches[min(max(int(index), 0), last) if last else 0], inputs)
    avals = [variable.aval for variable in branches[0].jaxpr.outvars]
    number = lambda i: emitter.vector(i, np.int32)
    compared = ["<=", *["=="] * (last - 1), ">="]
    flags = [builder.icmp_signed(sign, index, number(i)) for i, sign in enumerate(compared)]
    runs = [lambda branch=branch: emitter.interpret(branch, inputs) for branch in branches]
    jumps = [count_equations(branch.jaxpr) >= MIN_EQUATIONS_TO_SKIP for branch in branches]
    return merge_lanes(emitter, flags, runs, avals, jumps)


def count_equations(jaxpr: Jaxpr) -> int:
    """Count equations, including those of inner functions; a loop always counts as long."""
    inner = sum(map(count_equations, subjaxprs(jaxpr)))
    return inner + sum(
        MIN_EQUATIONS_TO_SKIP if e.primitive.name == "while" else 1 for e in jaxpr.eqns
    )


@no_type_check
def merge_lanes(
    emitter, flags, functions: list[Callable], avals, jumps: list[bool] | None = None
) -> list[np.ndarray]:
    """Return, in each lane, the values of the function whose flag is set there.

    A function with a jump is skipped if no active lane has its flag set.
    """
    builder, lanes, chosen = emitter.builder, emitter.active, None
    buffers = emitter.new_buffers(avals)
    for i, (mine, function) in enumerate(zip(flags, functions, strict=True)):
        at_work = mine if lanes is None else builder.and_(mine, lanes)
        jump, known, calls = jumps is None or jumps[i], len(emitter.known), emitter.calls
        first = chosen is None
        if jump and first:
            emitter.fill(buffers, [np.zeros((), object)] * len(buffers))
        before = builder.block
        if jump:
            taken, done = builder.append_basic_block("taken"), builder.append_basic_block("joined")
            builder.cbranch(any_lane(emitter, at_work), taken, done)
            builder.position_at_end(taken)
        begun, emitter.active = builder.block, at_work
        found = function()
        flat, kinds = emitter.flatten(found, avals)
        emitter.fill(buffers, found, None if first and not jump else [mine])
        if chosen is None:  # zeros, so that an inactive lane neither traps nor keeps a loop running
            chosen = [emitter.vector(0, dtype) for dtype in kinds] if jump else flat
        pairs = zip(flat, chosen, kinds, strict=True)
        new = [
            one
            if one is other
            else builder.select(mine, emitter.vector(one, dtype), emitter.vector(other, dtype))
            for one, other, dtype in pairs
        ]
        if jump:
            after = builder.block
            builder.branch(done)
            builder.position_at_end(done)
            phis = [builder.phi(emitter.type(dtype)) for dtype in kinds]
            for phi, one, other, dtype in zip(phis, new, chosen, kinds, strict=True):
                phi.add_incoming(emitter.vector(one, dtype), after)
                phi.add_incoming(emitter.vector(other, dtype), before)
            new = phis
        if jump or builder.block is not begun or emitter.calls != calls:
            forget_terms(emitter, known)  # loops and calls compute the active lanes alone
        emitter.active, chosen = lanes, new
    return emitter.unflatten(chosen, avals, buffers)

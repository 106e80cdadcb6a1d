"""Loops and branches of which each lane takes its own turns.

A loop whose number of turns is known before it begins, and small, is unrolled: what counts its
turns is then known in each, and so are the indices and coefficients that hang on it.
"""

from typing import Any, no_type_check

import numpy as np
from jax.extend.core import ClosedJaxpr
from jax.interpreters.partial_eval import dce_jaxpr
from llvmlite import ir

from walker_jax.kernels.scalars import is_number

UNROLLED = 16
"""Turns of a loop that is unrolled, at most: the stages of a Runge-Kutta method, and some more."""


@no_type_check  # as the emitter
def loop(emitter, equation, operands: list[np.ndarray]) -> list[np.ndarray]:
    """A while loop. Lanes that have ended keep their values until the last one has."""
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
    flat, kinds = emitter.flattened(carry, avals)
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

    known, lanes = len(emitter.known), emitter.active
    values = emitter.gathered(phis, avals)
    ((going,),) = map(np.ravel, emitter.interpret(condition, [*of_condition, *values]))
    going = emitter.vector(going, bool)
    if lanes is not None:
        going = builder.and_(going, lanes)
    builder.cbranch(any_lane(emitter, going), turn, done)

    builder.position_at_end(turn)
    emitter.active = going
    results, _ = emitter.flattened(emitter.interpret(body, [*of_body, *values]), avals)
    for phi, result, dtype in zip(phis, results, kinds, strict=True):
        new = builder.select(going, emitter.vector(result, dtype), phi)
        phi.add_incoming(new, builder.block)
    builder.branch(head)
    builder.position_at_end(done)
    emitter.active = lanes
    forget(emitter, known)
    return emitter.gathered(phis, avals)


@no_type_check
def any_lane(emitter, flags) -> Any:
    bits = ir.IntType(emitter.lanes)
    flags = emitter.builder.bitcast(flags, bits)
    return emitter.builder.icmp_unsigned("!=", flags, ir.Constant(bits, 0))


@no_type_check
def forget(emitter, known: int) -> None:
    """Of terms known to a block that may not have run, none is known behind it."""
    while len(emitter.known) > known:
        emitter.known.popitem()


@no_type_check
def known_turns(
    emitter, condition: ClosedJaxpr, body: ClosedJaxpr, of_condition, of_body, carry
) -> int | None:
    """How many turns a loop takes, if what its condition hangs on is known in each, and few."""
    count, more = len(of_condition), len(of_body)
    test, of_test = needed(condition, [True])
    wanted = of_test[count:]
    while True:
        step, of_step = needed(body, wanted)
        grown = [a or b for a, b in zip(wanted, of_step[more:], strict=True)]
        if grown == wanted:
            break
        wanted = grown
    pick = lambda values, flags: [v for v, flag in zip(values, flags, strict=True) if flag]
    tested, stepped = pick(of_condition, of_test[:count]), pick(of_body, of_step[:more])
    state = dict(zip(range(len(carry)), carry, strict=True))
    places = pick(range(len(carry)), wanted)
    started = [*tested, *stepped, *(carry[place] for place in places)]
    if not all(is_number(entry) for array in started for entry in array.ravel()):
        return None
    for turn in range(UNROLLED + 1):
        now = pick([state[place] for place in range(len(carry))], of_test[count:])
        ((going,),) = map(np.ravel, emitter.interpret(test, [*tested, *now]))
        if not is_number(going):
            return None
        if not going:
            return turn
        now = pick([state[place] for place in range(len(carry))], of_step[more:])
        state |= zip(places, emitter.interpret(step, [*stepped, *now]), strict=True)
    return None


def needed(closed: ClosedJaxpr, outputs: list[bool]) -> tuple[ClosedJaxpr, list[bool]]:
    """What of a function is needed for some of its outputs, and which of its inputs are."""
    jaxpr, inputs = dce_jaxpr(closed.jaxpr, outputs)
    return ClosedJaxpr(jaxpr, closed.consts), inputs


@no_type_check
def choice(emitter, equation, operands: list[np.ndarray]) -> list[np.ndarray]:
    """One of several functions: all are computed, unless it is known which is wanted."""
    branches, (which, *inputs) = equation.params["branches"], operands
    builder, index = emitter.builder, which[()]
    if is_number(index):
        branches = [branches[min(max(int(index), 0), len(branches) - 1)]]
    results, lanes = [], emitter.active
    avals = [variable.aval for variable in branches[0].jaxpr.outvars]
    for i, branch in enumerate(branches):
        if len(branches) > 1:
            mine = builder.icmp_signed("==", index, emitter.vector(i, np.int32))
            emitter.active = mine if lanes is None else builder.and_(mine, lanes)
        results.append(emitter.flattened(emitter.interpret(branch, inputs), avals))
    emitter.active = lanes
    chosen, kinds = results[-1]
    for i, (entries, _) in reversed(list(enumerate(results[:-1]))):
        before = builder.icmp_signed("<=", index, emitter.vector(i, np.int32))
        chosen = [
            builder.select(before, emitter.vector(one, dtype), emitter.vector(other, dtype))
            for one, other, dtype in zip(entries, chosen, kinds, strict=True)
        ]
    return emitter.gathered(chosen, avals)

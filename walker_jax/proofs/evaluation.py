"""Enclosures of the results of a JAX function: its jaxpr, interpreted primitive by primitive.

The vector field of a walker, the recurrences of its Taylor series, its guards and its impact are
thus enclosed as they stand in the package; none is written a second time.

A number in the jaxpr, such as 1/3, is the rounding of the number that is meant. It becomes an
interval that holds all real numbers with that rounding. In the functions of the package's provable
walkers, each number is whole or was rounded once. In a user's own class, a number that Python or
NumPy computed before JAX saw it counts as rounded once.
"""

from collections.abc import Callable
from functools import cache, lru_cache

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import jaxprs_in_params

from walker_jax.integrators.series import sincos
from walker_jax.kernels.jaxprs import (
    CALLS,
    Interpreter,
    UnsupportedPrimitive,
    called_function,
)
from walker_jax.kernels.products import add_one_by_one
from walker_jax.kernels.program_cache import user_code_states
from walker_jax.proofs.elementary import enclose_sine_and_cosine
from walker_jax.proofs.enclosures import (
    BALLS,
    Enclosure,
    Space,
    as_enclosure,
    exactly,
    is_enclosure,
    rounded_once,
)


def evaluate(function: Callable, *args):
    """Enclose function(*args) for every choice of numbers from the arguments' enclosures.

    **Arguments:**

    - `function`: takes PyTrees of scalars; it is traced once for each structure of its arguments.
    - `args`: PyTrees of enclosures in one space, of intervals, and of numbers.

    **Raises** `UnsupportedPrimitive` if the function has a primitive without a rule here.
    """
    leaves, structure = jax.tree.flatten(args, is_leaf=is_enclosure)
    spaces = [one.space for one in leaves if is_enclosure(one)]
    space = max(spaces, default=BALLS)
    closed, results = traced(function, structure, user_code_states(function, structure))
    values = EnclosureInterpreter(space).interpret(
        closed, [as_enclosure(one, space) for one in leaves]
    )
    return jax.tree.unflatten(results, values)


@cache
def traced(function: Callable, structure, code):
    """Return the jaxpr of a function of scalars, and the structure of its results.

    `code` describes the user's own code that the function runs, so changed code is traced anew.
    """
    flat = lambda *leaves: function(*jax.tree.unflatten(structure, leaves))
    number = jax.ShapeDtypeStruct((), jnp.float64)
    count = structure.num_leaves
    with jax.ensure_compile_time_eval():
        closed, shapes = jax.make_jaxpr(flat, return_shape=True)(*[number] * count)
    check_numbers(closed.jaxpr)
    return closed, jax.tree.structure(shapes)


def check_numbers(jaxpr) -> None:
    """Refuse values that are not float64.

    The rules treat every value as a real number, but integers are truncated and their sums wrap.
    """
    for equation in jaxpr.eqns:
        if is_own_sincos(equation):
            continue
        for result in equation.outvars:
            if result.aval.dtype != jnp.float64:
                raise UnsupportedPrimitive(
                    f"proofs need float64 throughout, not {result.aval.dtype} as from "
                    f"{equation.primitive.name!r}"
                )
        for inner in jaxprs_in_params(equation.params):
            check_numbers(inner)


def is_own_sincos(equation) -> bool:
    """Return whether a call is to the package's sine and cosine, not to a namesake."""
    called = equation.params.get("jaxpr")
    return equation.params.get("name") == "sincos" and text_of(called) == own_sincos()


@lru_cache(64)
def text_of(jaxpr) -> str:
    """Return a jaxpr as text, made once: to write one takes longer than to enclose its results."""
    return str(jaxpr)


@cache
def own_sincos() -> str:
    """Return the jaxpr of the package's sine and cosine as text, with all digits of numbers."""
    with jax.ensure_compile_time_eval():
        (call,) = jax.make_jaxpr(sincos)(jax.ShapeDtypeStruct((), jnp.float64)).eqns
    return str(call.params["jaxpr"])


class EnclosureInterpreter(Interpreter):
    """Interpreter that encloses the results of a jaxpr, all in one space."""

    def __init__(self, space: Space):
        self.space = space
        self.pairs: dict[int, tuple] = {}
        """Sine and cosine of each operand, by its id, beside the operand: while it lives, no other
        object gets its id."""

    def constant(self, value) -> Enclosure:
        if np.shape(value):
            raise UnsupportedPrimitive("proofs need functions of scalars, not of arrays")
        return rounded_once(float(value), self.space)

    def default_rule(self, equation, operands: list) -> list:
        raise UnsupportedPrimitive(f"proofs have no rule for {equation.primitive.name!r}")

    def sine_and_cosine(self, x: Enclosure) -> tuple[Enclosure, Enclosure]:
        if id(x) not in self.pairs:
            self.pairs[id(x)] = enclose_sine_and_cosine(x), x
        return self.pairs[id(x)][0]


def rule_of(operation: Callable) -> Callable:
    """Return the rule of a primitive that is one operation on its operands."""
    return lambda interpreter, equation, operands: [operation(*operands)]


def call_rule(interpreter: EnclosureInterpreter, equation, operands: list) -> list:
    """Interpret a call.

    The package computes sine and cosine by polynomials close to them; the equations mean the exact
    functions, and these are enclosed.
    """
    if is_own_sincos(equation):
        return [*interpreter.sine_and_cosine(operands[0])]
    return interpreter.interpret(called_function(equation), operands)


def power_rule(interpreter: EnclosureInterpreter, equation, operands: list) -> list:
    (x,), exponent = operands, equation.params["y"]
    value = exactly(1.0, interpreter.space)
    for _ in range(abs(exponent)):
        value = value * x
    return [value if exponent >= 0 else 1.0 / value]


def broadcast_rule(interpreter: EnclosureInterpreter, equation, operands: list) -> list:
    """Return the operand: a scalar that is reshaped to a scalar does not change."""
    if equation.outvars[0].aval.shape:
        raise UnsupportedPrimitive("proofs need functions of scalars, not of arrays")
    return operands[:1]


EnclosureInterpreter.rules = {
    **dict.fromkeys(CALLS, call_rule),
    **dict.fromkeys(("add", "add_any"), rule_of(lambda a, b: a + b)),
    **dict.fromkeys(("copy", "copy_p", "convert_element_type"), rule_of(lambda a: a)),
    "broadcast_in_dim": broadcast_rule,
    "reshape": broadcast_rule,
    "squeeze": broadcast_rule,
    "cos": lambda interpreter, equation, operands: [interpreter.sine_and_cosine(*operands)[1]],
    "div": rule_of(lambda a, b: a / b),
    "integer_pow": power_rule,
    "mul": rule_of(lambda a, b: a * b),
    "neg": rule_of(lambda a: -a),
    "sin": lambda interpreter, equation, operands: [interpreter.sine_and_cosine(*operands)[0]],
    "square": rule_of(lambda a: a * a),
    "sub": rule_of(lambda a, b: a - b),
    "sum_of_products": rule_of(add_one_by_one),
}

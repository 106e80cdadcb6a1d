"""Enclosures of what a JAX function returns: its jaxpr, one primitive after the other.

So the vector field of a walker, the recurrences of its Taylor series, its guards and its impact
are enclosed as they stand in the package, and are not written a second time.

Numbers in the jaxpr, such as 1/3, are roundings of the numbers that are meant: each is an interval
that holds every real number it may be the rounding of. All numbers in the functions of walkers
with a proof are whole, or were rounded once. In a class of a user's own, a number that Python or
NumPy computed before JAX saw it is taken for one that was rounded once.
"""

from collections.abc import Callable
from functools import cache

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
from walker_jax.kernels.program_cache import user_code_states
from walker_jax.proofs.elementary import sine_and_cosine
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
    """Enclosures of function(*args), for every choice of numbers from those of the arguments.

    **Arguments:**

    - `function`: of PyTrees of scalars; it is traced once for each structure of its arguments.
    - `args`: PyTrees of enclosures of one space, of intervals, and of numbers.

    **Raises** `UnsupportedPrimitive` if the function holds a primitive that has no rule here.
    """
    leaves, structure = jax.tree.flatten(args, is_leaf=is_enclosure)
    spaces = [one.space for one in leaves if is_enclosure(one)]
    space = max(spaces, default=BALLS)
    closed, results = traced(function, structure, user_code_states(function, structure))
    values = Evaluation(space).interpret(closed, [as_enclosure(one, space) for one in leaves])
    return jax.tree.unflatten(results, values)


@cache
def traced(function: Callable, structure, code):
    """The jaxpr of a function of scalars, and the structure of its results.

    `code` describes the user's own code that it runs: other code is traced anew.
    """
    flat = lambda *leaves: function(*jax.tree.unflatten(structure, leaves))
    number = jax.ShapeDtypeStruct((), jnp.float64)
    count = structure.num_leaves
    with jax.ensure_compile_time_eval():
        closed, shapes = jax.make_jaxpr(flat, return_shape=True)(*[number] * count)
    check_numbers(closed.jaxpr)
    return closed, jax.tree.structure(shapes)


def check_numbers(jaxpr) -> None:
    """Refuse all that is not of float64: an integer would be the float cut off, or another sum."""
    for equation in jaxpr.eqns:
        if is_own_sincos(equation):
            continue
        for result in equation.outvars:
            if result.aval.dtype != jnp.float64:
                raise UnsupportedPrimitive(
                    f"proofs need float64 throughout, not {result.aval.dtype} by "
                    f"{equation.primitive.name!r}"
                )
        for inner in jaxprs_in_params(equation.params):
            check_numbers(inner)


def is_own_sincos(equation) -> bool:
    """Whether a call is that of the package's own sine and cosine, and no other of that name."""
    return equation.params.get("name") == "sincos" and (
        str(equation.params["jaxpr"]) == own_sincos()
    )


@cache
def own_sincos() -> str:
    """The program of the package's sine and cosine, with all digits of its numbers."""
    with jax.ensure_compile_time_eval():
        (call,) = jax.make_jaxpr(sincos)(jax.ShapeDtypeStruct((), jnp.float64)).eqns
    return str(call.params["jaxpr"])


class Evaluation(Interpreter):
    """Computes enclosures of a jaxpr's results, all of one space."""

    def __init__(self, space: Space):
        self.space = space
        self.pairs: dict[int, tuple] = {}
        """By operand: its sine and cosine, and the operand, which keeps its id from others."""

    def constant(self, value) -> Enclosure:
        if np.shape(value):
            raise UnsupportedPrimitive("proofs need functions of scalars, not of arrays")
        return rounded_once(float(value), self.space)

    def keep(self, equation, operands: list) -> list:
        raise UnsupportedPrimitive(f"no enclosure is known of {equation.primitive.name!r}")

    def sine_and_cosine(self, x: Enclosure) -> tuple[Enclosure, Enclosure]:
        if id(x) not in self.pairs:
            self.pairs[id(x)] = sine_and_cosine(x), x
        return self.pairs[id(x)][0]


def by(operation: Callable) -> Callable:
    return lambda evaluation, equation, operands: [operation(*operands)]


def call_rule(evaluation: Evaluation, equation, operands: list) -> list:
    """A call; the package's own sine and cosine, polynomials near to them, are taken as meant."""
    if is_own_sincos(equation):
        return [*evaluation.sine_and_cosine(operands[0])]
    return evaluation.interpret(called_function(equation), operands)


def power_rule(evaluation: Evaluation, equation, operands: list) -> list:
    (x,), exponent = operands, equation.params["y"]
    value = exactly(1.0, evaluation.space)
    for _ in range(abs(exponent)):
        value = value * x
    return [value if exponent >= 0 else 1.0 / value]


def broadcast_rule(evaluation: Evaluation, equation, operands: list) -> list:
    """A scalar made another scalar: nothing changes."""
    if equation.outvars[0].aval.shape:
        raise UnsupportedPrimitive("proofs need functions of scalars, not of arrays")
    return operands[:1]


Evaluation.rules = {
    **dict.fromkeys(CALLS, call_rule),
    **dict.fromkeys(("add", "add_any"), by(lambda a, b: a + b)),
    **dict.fromkeys(("copy", "copy_p", "convert_element_type"), by(lambda a: a)),
    "broadcast_in_dim": broadcast_rule,
    "reshape": broadcast_rule,
    "squeeze": broadcast_rule,
    "cos": lambda evaluation, equation, operands: [evaluation.sine_and_cosine(*operands)[1]],
    "div": by(lambda a, b: a / b),
    "integer_pow": power_rule,
    "mul": by(lambda a, b: a * b),
    "neg": by(lambda a: -a),
    "sin": lambda evaluation, equation, operands: [evaluation.sine_and_cosine(*operands)[0]],
    "square": by(lambda a: a * a),
    "sub": by(lambda a, b: a - b),
}

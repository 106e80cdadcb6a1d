"""One walk over jaxprs: equation after equation, by a rule looked up by the primitive's name.

What a value is, is the interpreter's own business: entries of an array, instructions, or a series.
"""

import abc
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, no_type_check

import jax
from jax.extend.core import ClosedJaxpr, JaxprEqn, Literal


@no_type_check  # what is called for every equation of a program
class Interpreter(abc.ABC):
    """Results of a jaxpr, given what its arguments are."""

    rules: ClassVar[Mapping[str, Callable[[Any, JaxprEqn, list], list]]]
    """By primitive: results of an equation, given the interpreter, the equation and its operands.
    """

    @abc.abstractmethod
    def constant(self, value) -> Any:
        """What a number or an array is that stands in the jaxpr."""

    @abc.abstractmethod
    def keep(self, equation: JaxprEqn, operands: list) -> list:
        """The results of a primitive that has no rule."""

    def interpret(self, closed: ClosedJaxpr, inputs: list) -> list:
        jaxpr = closed.jaxpr
        values: dict = dict(zip(jaxpr.constvars, map(self.constant, closed.consts), strict=True))
        values |= zip(jaxpr.invars, inputs, strict=True)

        def read(variable):
            known = isinstance(variable, Literal)
            return self.constant(variable.val) if known else values[variable]

        for equation in jaxpr.eqns:
            results = self.apply(equation, [read(variable) for variable in equation.invars])
            values |= zip(equation.outvars, results, strict=True)
        return [read(variable) for variable in jaxpr.outvars]

    def apply(self, equation: JaxprEqn, operands: list) -> list:
        """The results of an equation."""
        rule = self.rules.get(equation.primitive.name, type(self).keep)
        return rule(self, equation, operands)


def described(aval) -> jax.ShapeDtypeStruct:
    """An abstract value without what depends on where it is."""
    return jax.ShapeDtypeStruct(aval.shape, aval.dtype, weak_type=aval.weak_type)


def called(equation: JaxprEqn) -> ClosedJaxpr:
    """The function of a call."""
    params = equation.params
    inner = params["jaxpr"] if "jaxpr" in params else params["call_jaxpr"]
    return inner if isinstance(inner, ClosedJaxpr) else ClosedJaxpr(inner, ())


def enter(interpreter: Interpreter, equation: JaxprEqn, operands: list) -> list:
    """The results of a call: its function is read in its place."""
    return interpreter.interpret(called(equation), operands)


CALLS = dict.fromkeys(("jit", "pjit", "closed_call", "checkpoint", "remat2"), enter)
"""Rules for primitives that only call a function."""
CALLS_WITH_DERIVATIVES = dict.fromkeys(("custom_jvp_call", "custom_vjp_call"), enter)
"""Rules for those that also have one of their own for its derivatives, which is lost."""


def changes_entries(name: str, params: dict) -> bool:
    """Whether a scatter puts a function of an entry in its place, as `x.at[i].apply` does."""
    update = params["update_jaxpr"]
    return name == "scatter" and update is not None and update.outvars[0] is not update.invars[1]

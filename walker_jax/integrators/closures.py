"""Functions that are traced before they are called, as derivatives or short programs need."""

from collections.abc import Callable
from typing import Any, ClassVar

import equinox as eqx
import jax
from jax.core import Tracer

from walker_jax.kernels.entries import bind_primitive
from walker_jax.kernels.jaxprs import CALLS, CALLS_WITH_DERIVATIVES, Interpreter, enter


def convert_closure(function: Callable, *args) -> Callable:
    """Return a function of the arguments' types whose captured values are its leaves.

    From jax 0.11 on a jaxpr also holds its constants. equinox keeps the jaxpr beside them, so
    `custom_jvp` would keep their tracers.
    """
    converted = eqx.filter_closure_convert(function, *args)
    jaxpr: Any = getattr(converted, "jaxpr", None)
    if not getattr(jaxpr, "consts", None):
        return converted
    return eqx.tree_at(lambda one: one.jaxpr, converted, jaxpr.with_consts(()))


def compute_known_now(function: Callable, *args) -> Any:
    """Call a function; what follows from its constants alone is computed while it is traced."""
    closed, result = jax.make_jaxpr(function, return_shape=True)(*args)
    found = KnownNow().interpret(closed, jax.tree.leaves(args))
    return jax.tree.unflatten(jax.tree.structure(result), found)


class KnownNow(Interpreter):
    """Computes what follows from constants, and traces all else."""

    rules: ClassVar = {**CALLS}

    def constant(self, value):
        return value

    def default_rule(self, equation, operands):
        traced = any(isinstance(one, Tracer) for one in operands)
        if not traced and equation.primitive.name in CALLS_WITH_DERIVATIVES:
            return enter(self, equation, operands)
        return bind_primitive(equation.primitive, equation.params, operands, now=not traced)

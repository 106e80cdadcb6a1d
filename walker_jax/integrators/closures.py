"""Functions that are traced before they are called: their captured values, and their constants."""

from collections.abc import Callable
from typing import Any, ClassVar

import equinox as eqx
import jax
import numpy as np
from jax.core import Tracer

from walker_jax.kernels.entries import EXACT, bind_primitive, compute_exactly
from walker_jax.kernels.jaxprs import CALLS, CALLS_WITH_DERIVATIVES, Interpreter, enter, shape_dtype


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
    """Call a function; what follows from known numbers alone is computed while it is traced."""
    closed, result = jax.make_jaxpr(function, return_shape=True)(*args)
    found = KnownNow().interpret(closed, jax.tree.leaves(args))
    return jax.tree.unflatten(jax.tree.structure(result), found)


REDUCED = {"unvmap_all": np.all, "unvmap_any": np.any}
"""NumPy functions for what equinox asks of all cells at once; XLA would compile each."""


class KnownNow(Interpreter):
    """Computes what follows from known numbers, and traces all else."""

    rules: ClassVar = {**CALLS}

    def constant(self, value):
        return value

    def default_rule(self, equation, operands):
        primitive, params = equation.primitive, equation.params
        if primitive.name == "cond" and not isinstance(operands[0], Tracer):
            return self.interpret(params["branches"][int(operands[0])], operands[1:])
        if any(isinstance(one, Tracer) for one in operands):
            return bind_primitive(primitive, params, operands, now=False)
        if primitive.name in CALLS_WITH_DERIVATIVES:
            return enter(self, equation, operands)
        if primitive.name == "select_n" and np.ndim(operands[0]) == 0:
            return [operands[1 + int(operands[0])]]
        if primitive.name in REDUCED:
            return [REDUCED[primitive.name](operands[0])]
        if primitive.name in EXACT:
            dtypes = [shape_dtype(variable.aval).dtype for variable in equation.invars]
            return [compute_exactly(primitive.name, operands, dtypes)]
        return bind_primitive(primitive, params, operands, now=True)

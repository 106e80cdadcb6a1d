"""Walkers that theorems are about, and what they are given to these."""

from typing import Any

import jax
import numpy as np
from jax.core import Tracer
from jax.extend.core import jaxprs_in_params

from walker_jax.checks import WrongUse, check_precision, short
from walker_jax.proofs.enclosures import ROUNDING, Space, exactly
from walker_jax.systems.system import System
from walker_jax.walkers.abstract_point_foot import AbstractMasslessFootWalker
from walker_jax.walkers.model import Walker

OWN_HOOKS = (
    *("phases", "during_stride", "project", "feasible", "exchange_legs", "modes", "equations"),
    *("section", "lift", "contact", "is_ahead", "falls", "margin"),
)
"""Methods that a stride rests on, of which proofs know more than their values: another form, or
that the swing foot is on the ground at the start, and that no start has fallen."""

OWN_DERIVATIVES = {"custom_jvp_call", "custom_vjp_call", "call_hi_primitive", "stop_gradient"}


def check_provable(walker: System) -> AbstractMasslessFootWalker:
    """The walker, in float64; refuses walkers whose strides no proof here is about."""
    known = isinstance(walker, AbstractMasslessFootWalker) and all(
        getattr(type(walker), hook) is getattr(AbstractMasslessFootWalker, hook)
        for hook in OWN_HOOKS
    )
    if not known:
        raise WrongUse(
            "walker must be a SimplestWalker, SpringWalker or PoweredWalker, or one derived from "
            f"these that changes its equations alone, not {short(walker)}",
            of="walker",
        )
    check_precision(jax.numpy.asarray(0.0).dtype, "a proof")
    float64 = jax.tree.map(np.float64, walker)
    check_derivatives(float64)
    return float64


def check_derivatives(walker: Any) -> None:
    """Refuse equations with derivatives of their own, or none: proofs would take them for true."""
    state = walker.lift((0.1, -0.1))
    *_, mode = walker.modes()
    values = lambda state: [one.value(state) for one in (*mode.guards, *mode.conditions)]
    after = lambda state: walker.exchange_legs(walker.impact(state)[1])
    for function in (walker.vector_field, mode.rates, values, after, walker.project):
        found = names_in(jax.make_jaxpr(function)(state).jaxpr) & OWN_DERIVATIVES
        if found:
            raise WrongUse(
                "walker must have equations with no derivatives of their own, and no "
                f"{sorted(found)[0]}",
                of="walker",
            )


def names_in(jaxpr) -> set[str]:
    """The primitives of a function, and of all that it calls."""
    inner = (names_in(one) for equation in jaxpr.eqns for one in jaxprs_in_params(equation.params))
    return {equation.primitive.name for equation in jaxpr.eqns}.union(*inner)


def parameters_of(walker: Walker, space: Space) -> Any:
    """A walker with enclosures of its parameters: all numbers that round to these, also to whole
    ones."""
    number = lambda leaf: leaf if isinstance(leaf, Tracer) else np.float64(leaf)
    return jax.tree.map(
        lambda leaf: exactly(number(leaf), space).widened(abs(number(leaf)) * ROUNDING), walker
    )

"""Walkers that proofs cover, and enclosures of their parameters."""

from typing import Any

import jax
import numpy as np
from jax.core import Tracer

from walker_jax.checks import WrongUse, check_precision
from walker_jax.kernels.jaxprs import equations_in
from walker_jax.proofs.enclosures import ROUNDING, Space, exactly
from walker_jax.systems.system import System, arrays_of
from walker_jax.walkers.abstract_point_foot import AbstractMasslessFootWalker
from walker_jax.walkers.model import Walker

FIXED_METHODS = (
    *("phases", "during_stride", "project", "feasible", "exchange_legs", "equations"),
    *("section", "lift", "contact", "is_ahead", "falls", "margin", "modes"),
    *("begin", "launch", "may_launch"),
)
"""Methods that a walker must not override, because proofs assume more of them than their values:
another form of the same, that the swing foot is on the ground at the start, that no start has
fallen."""
OWN_DERIVATIVES = {"custom_jvp_call", "custom_vjp_call", "call_hi_primitive", "stop_gradient"}
"""Primitives whose derivatives may be set by hand, or are zero."""


def check_provable(walker: System) -> AbstractMasslessFootWalker:
    """Return the walker in float64; refuse a walker whose strides the proofs do not cover."""
    kind = AbstractMasslessFootWalker
    fixed = all(getattr(type(walker), one, None) is getattr(kind, one) for one in FIXED_METHODS)
    if not (isinstance(walker, AbstractMasslessFootWalker) and fixed):
        raise WrongUse(
            "walker must be a SimplestWalker, SpringWalker or PoweredWalker, or of a derived class "
            f"that changes only equations, not {type(walker).__name__}",
            of="walker",
        )
    if arrays := arrays_of(walker):
        raise WrongUse(
            f"walker must have single numbers for parameters, not the array {next(iter(arrays))}",
            of="walker",
        )
    check_precision(jax.numpy.result_type(float), "a proof")
    float64 = jax.tree.map(np.float64, walker)
    check_derivatives(float64)
    return float64


def check_derivatives(walker: Any) -> None:
    """Refuse equations that set their own derivatives, or drop them: proofs would trust these."""
    state = walker.lift((0.1, -0.1))
    mode = walker.modes()["swing"]
    values = lambda state: [one.value(state) for one in (*mode.guards, *mode.conditions)]
    after = lambda state: walker.exchange_legs(walker.impact(state)[1])
    for function in (walker.vector_field, values, after):
        equations = equations_in(jax.make_jaxpr(function)(state).jaxpr)
        found = {one.primitive.name for one in equations} & OWN_DERIVATIVES
        if found:
            raise WrongUse(
                "walker must have equations without derivatives of their own, so without "
                f"{sorted(found)[0]}",
                of="walker",
            )


def enclose_parameters(walker: Walker, space: Space) -> Any:
    """Return a walker whose parameters are enclosures: of all numbers that round to them.

    A whole parameter is no exception: it too may be a rounding.
    """
    number = lambda leaf: leaf if isinstance(leaf, Tracer) else np.float64(leaf)
    return jax.tree.map(
        lambda leaf: exactly(number(leaf), space).widened(abs(number(leaf)) * ROUNDING), walker
    )

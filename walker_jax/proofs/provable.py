"""Walkers that theorems are about, and what they are given to these."""

from typing import Any

import jax
import numpy as np
from jax.core import Tracer

from walker_jax.checks import WrongUse, check_precision, short
from walker_jax.proofs.enclosures import Space, rounded_once
from walker_jax.systems.system import System
from walker_jax.walkers.abstract_point_foot import AbstractMasslessFootWalker
from walker_jax.walkers.model import Walker

OWN_HOOKS = "phases", "during_stride", "project", "feasible", "exchange_legs", "modes", "equations"
"""Methods that a stride rests on, and that proofs have in another form."""


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
    return jax.tree.map(np.float64, walker)


def parameters_of(walker: Walker, space: Space) -> Any:
    """A walker with enclosures of its parameters: all numbers that round to these."""
    number = lambda leaf: leaf if isinstance(leaf, Tracer) else np.float64(leaf)
    return jax.tree.map(lambda leaf: rounded_once(number(leaf), space), walker)

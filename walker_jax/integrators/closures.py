"""Functions whose captured values are arguments, so that derivatives go through them."""

from collections.abc import Callable
from typing import Any

import equinox as eqx


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

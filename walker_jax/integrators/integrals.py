"""Equations of motion together with integrals along the motion, which they do not depend on."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import PyTree

from walker_jax.integrators.roots import Scalar


class WithIntegrals(eqx.Module):
    """The equations (y, w)' = (f(y), g(y)): integrals w are added up along a motion y.

    The errors of y do not depend on the size of w. The steps of a series are limited by those of y
    and of each of the functions g (`step_lengths`).
    """

    motion: Callable[[PyTree], PyTree]
    rates: dict[str, Callable[[Any], Scalar]]

    def __call__(self, state):
        return self.motion(state[0]), {name: g(state) for name, g in self.functions().items()}

    def functions(self) -> dict[str, Callable[[PyTree], Scalar]]:
        """Return the functions g of a state with integrals, by name."""

        def of_motion(name, g):
            return lambda state: jnp.asarray(g(state[0]), state[1][name].dtype)

        return {name: of_motion(name, g) for name, g in self.rates.items()}


def motion_of(field: Any, state: PyTree) -> tuple[Any, PyTree]:
    """Return the equations and the state, or its series, without integrals."""
    return (field.motion, state[0]) if isinstance(field, WithIntegrals) else (field, state)


def beside(field: Any, of_motion: PyTree, state: PyTree, of_integrals: Any) -> PyTree:
    """Return what is known of the motion's variables, if any is, beside the same of integrals."""
    if of_motion is None or not isinstance(field, WithIntegrals):
        return of_motion
    return of_motion, jax.tree.map(lambda _: of_integrals, state[1])

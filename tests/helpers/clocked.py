"""Machines of one number that changes for a unit of time."""

from typing import Any

import jax.numpy as jnp

import walker_jax as wj


class Clocked(wj.HybridSystem):
    """A number y, and the time since the start, in one array; the section is a unit of time on."""

    section = ("y",)

    def slope(self, y: Any, t: Any) -> Any:
        """The rate of y."""
        raise NotImplementedError

    def lift(self, x):
        return jnp.stack([x[0], 0 * x[0]])

    def project(self, state):
        return state[:1]

    def modes(self):
        field = lambda s: jnp.stack([self.slope(*s), 1 + 0 * s[1]])
        return {"flow": wj.Mode(field, (wj.Guard(lambda s: s[1] - 1, wj.SECTION),))}

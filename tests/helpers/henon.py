"""The map of Hénon, typed anew."""

from typing import Any

import jax.numpy as jnp

import walker_jax as wj


def henon(x, a, b):
    return jnp.stack([1 - a * x[0] ** 2 + x[1], b * x[0]])


def as_map(a: float, **more: Any) -> wj.Map:
    return wj.Map(henon, ("x", "y"), parameters={"a": a, "b": 0.3}, **more)

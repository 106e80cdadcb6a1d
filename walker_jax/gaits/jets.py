"""Derivatives of cycles up to the third order, along curves through their first states.

Along a curve x(t) = x_1 + t d_1 + t^2/2 d_2 a return map has the derivatives

    A d_1,    B(d_1, d_1) + A d_2,    C(d_1, d_1, d_1) + 3 B(d_1, d_2)

with its Jacobian A and its second and third derivatives B and C, symmetric multilinear functions.
Normal forms need nothing else of them. The derivatives of a cycle are chained: the image of a curve
under one stride is the curve from which the next stride begins.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from walker_jax.execution.tiles import map_cells
from walker_jax.integrators.integrator import Integrator
from walker_jax.systems.system import System
from walker_jax.systems.trees import select
from walker_jax.walking.iteration import with_parameters
from walker_jax.walking.stride import follow_stride


class Curves(NamedTuple):
    """A request for derivatives of a whole cycle along curves through its first state."""

    values: Float[np.ndarray, " parameters"]
    """Values of the parameters."""
    cycle: Float[np.ndarray, "period section"]
    first: Float[np.ndarray, "curves section"]
    """First derivatives of the curves."""
    second: Float[np.ndarray, "curves section"]
    """Second derivatives of the curves."""


class Jet(NamedTuple):
    """Derivatives of the ends of a cycle along curves, of the first to the third order."""

    first: Float[np.ndarray, "curves section"]
    second: Float[np.ndarray, "curves section"]
    third: Float[np.ndarray, "curves section"]


def differentiate_curves(
    system: System, parameters: Sequence[str], requests: Sequence[Curves], integrator: Integrator
) -> list[Jet]:
    """Compute the requested derivatives; every curve is a cell, followed stride by stride."""
    counts = [len(request.first) for request in requests]
    repeat = lambda rows: np.repeat(np.asarray(rows), counts, axis=0)
    jet = [np.concatenate([one.first for one in requests])]
    jet += [np.concatenate([one.second for one in requests]), np.zeros_like(jet[0])]
    values = repeat([one.values for one in requests])
    systems = with_parameters(system, parameters, values)
    periods = repeat([len(one.cycle) for one in requests])
    shared = integrator.in_dtype(jet[0].dtype)
    for i in range(periods.max()):
        left = np.flatnonzero(periods > i)
        starts = repeat([one.cycle[min(i, len(one.cycle) - 1)] for one in requests])
        cells = select(systems, left), starts[left], *(part[left] for part in jet)
        ends = map_cells(jet_of_stride, (shared, cells))
        for part, end in zip(jet, ends, strict=True):
            part[left] = end
    ends = np.cumsum(counts)[:-1]
    return [Jet(*parts) for parts in zip(*(np.split(part, ends) for part in jet), strict=True)]


def jet_of_stride(
    integrator: Integrator, cell
) -> tuple[Float[Array, " section"], Float[Array, " section"], Float[Array, " section"]]:
    """Return the first three derivatives of a stride's end along a curve through its start."""
    system, x, first, second, third = cell
    one = jnp.ones_like(x[0])

    def end(t):
        curve = x + t * (first + t / 2 * (second + t / 3 * third))
        return follow_stride(system, curve, integrator).state

    derivative = lambda function: lambda t: jax.jvp(function, (t,), (one,))
    ((_, by), (_, by2)), (_, (_, by3)) = derivative(derivative(derivative(end)))(0 * one)
    return by, by2, by3

"""Curves of gaits over a parameter, and their bifurcations."""

from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Bool, Complex, Float
from matplotlib.axes import Axes

from walker_jax.figures.style import DASHED, SOLID, first, look

FOLD: dict[str, Any] = {"marker": "<", "ms": 6, "mfc": "white", "mew": 1, "ls": ""}
DOUBLING: dict[str, Any] = {"marker": "o", "ms": 4.5, "mec": "white", "mew": 0.5, "ls": ""}
"""Signs of bifurcations."""


class Curve(NamedTuple):
    """A branch of gaits, with its bifurcations in their places among its points."""

    number: int
    """Of the branch."""
    period: int
    value: Float[np.ndarray, " n"]
    """Of the parameter."""
    states: Float[np.ndarray, "n period"]
    """The first coordinate at the start of each stride."""
    multipliers: Complex[np.ndarray, "n order"]
    stable: Bool[np.ndarray, " n"]
    """True for bifurcations too, at which both stable and unstable parts may end."""


def curves(data: xr.Dataset) -> list[Curve]:
    """The branches of a data set."""
    branch, event_branch = data["branch"].values, data["event_branch"].values
    states, event_states = (first(data[name]) for name in ("states", "event_states"))
    multipliers, event_multipliers = (
        data[name].values[..., 0] + 1j * data[name].values[..., 1]
        for name in ("multipliers", "event_multipliers")
    )
    found = []
    for number in np.unique(branch).tolist():
        ours = branch == number
        period = int(data["period"].values[ours][0])
        curve = Curve(
            number,
            period,
            data["value"].values[ours],
            states[ours, :period],
            multipliers[ours],
            data["stable"].values[ours],
        )
        for i in np.flatnonzero(event_branch == number):
            value, cycle = data["event_value"].values[i], event_states[i, :period]
            curve = with_event(curve, float(value), cycle, event_multipliers[i])
        found.append(curve)
    return found


def with_event(
    curve: Curve,
    value: float,
    states: Float[np.ndarray, " period"],
    multipliers: Complex[np.ndarray, " order"],
) -> Curve:
    """A branch with a bifurcation put between those two of its points where the detour is least."""
    path = np.column_stack([curve.value, curve.states])
    scale = np.maximum(np.ptp(path, axis=0), np.finfo(float).tiny)
    legs = np.linalg.norm(np.diff(path, axis=0) / scale, axis=1)
    away = np.linalg.norm((path - [value, *states]) / scale, axis=1)
    at = int((away[:-1] + away[1:] - legs).argmin()) + 1 if len(legs) else 1
    return curve._replace(
        value=np.insert(curve.value, at, value),
        states=np.insert(curve.states, at, states, axis=0),
        multipliers=np.insert(curve.multipliers, at, multipliers, axis=0),
        stable=np.insert(curve.stable, at, True),
    )


def cascade(data: xr.Dataset) -> list[Curve]:
    """The most stable gait of period one, those that leave it at its doublings, and so on."""
    family = data["branch"].values[data["on_cascade"].values]
    return [curve for curve in curves(data) if curve.number in family]


def refined(curve: Curve) -> Curve:
    """A branch with points between its own, where the multipliers' polynomial is interpolated."""
    count = len(curve.value)
    if count < 2:
        return curve
    at = np.linspace(0, count - 1, 16 * (count - 1) + 1)
    low = np.minimum(at.astype(int), count - 2)
    share = (at - low)[:, None]
    solid = curve.stable[:-1] & curve.stable[1:]
    polynomials = np.array([np.poly(row) for row in curve.multipliers])
    value, states, polynomials = (
        (1 - share) * points[low] + share * points[low + 1]
        for points in (curve.value[:, None], curve.states, polynomials)
    )
    return curve._replace(
        value=value[:, 0],
        states=states,
        multipliers=np.array([np.roots(row) for row in polynomials], complex),
        stable=np.where(share[:, 0] % 1, solid[low], curve.stable[at.astype(int)]),
    )


def draw_curve(
    ax: Axes,
    curve: Curve,
    heights: Float[np.ndarray, "n k"],
    *,
    stable: bool = True,
) -> None:
    """Lines along a branch: solid where it is stable, if that is wanted, dashed where it is not."""
    solid = curve.stable[:-1] & curve.stable[1:]
    changes = np.flatnonzero(solid[1:] != solid[:-1]) + 1
    colour, _ = look(curve.period)
    for start, stop in pairwise([0, *changes.tolist(), len(solid)]):
        if start < stop and (stable or not solid[start]):
            run = slice(start, stop + 1)
            order = 3 * solid[start] + 1 / curve.period
            style = SOLID if solid[start] else DASHED
            ax.plot(curve.value[run], heights[run], color=colour, zorder=2 + order, **style)


def draw_event(
    ax: Axes,
    values: Float[np.ndarray, " n"],
    heights: Float[np.ndarray, " n"],
    period: int,
    *,
    fold: bool,
) -> None:
    """The signs of a bifurcation."""
    colour, _ = look(period)
    ax.plot(values, heights, color=colour, zorder=7, **(FOLD if fold else DOUBLING))

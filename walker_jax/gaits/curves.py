"""Curves of gaits over a parameter, read from a bifurcation diagram, and its cascade.

The cascade is the most stable gait of period one, the gaits that branch off at its period
doublings, those that branch off at theirs, and so on.
"""

from typing import NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Bool, Complex, Float

from walker_jax.systems.outcomes import Outcome

PARTS_PER_INTERVAL = 16
"""Parts of the interval between two points of a curve, for its multipliers: where two of them meet
their modulus has a kink, and elsewhere it looks smooth."""


class Curve(NamedTuple):
    """A branch of gaits, with its bifurcations among its points."""

    number: int
    """Number of the branch."""
    period: int
    value: Float[np.ndarray, " n"]
    """Values of the parameter."""
    states: Float[np.ndarray, "n period"]
    """The first coordinate at the start of each stride."""
    multipliers: Complex[np.ndarray, "n order"]
    stable: Bool[np.ndarray, " n"]
    """Also true at bifurcations, where stable and unstable parts meet."""
    doublings: Float[np.ndarray, " doublings"]
    """Values of the parameter at its period doublings."""

    @property
    def spectral_radius(self) -> Float[np.ndarray, " n"]:
        """Modulus of the largest multiplier."""
        return np.abs(self.multipliers).max(axis=1)

    @property
    def stable_intervals(self) -> Bool[np.ndarray, " pieces"]:
        """Whether the gaits between each point and the next are stable."""
        return self.stable[:-1] & self.stable[1:]


def read_curves(data: xr.Dataset) -> list[Curve]:
    """Return the branches of a data set of the kind "gait branches"."""
    branch, states = data["branch"].values, first_coordinate(data["states"])
    multipliers, doubles = (
        complex_multipliers(data["multipliers"]),
        ~data["event_fold"].values.astype(bool),
    )
    found = []
    for number in np.unique(branch).tolist():
        own = branch == number
        period = int(data["period"].values[own][0])
        curve = Curve(
            number,
            period,
            data["value"].values[own],
            states[own, :period],
            multipliers[own],
            data["stable"].values[own].astype(bool),
            data["event_value"].values[(data["event_branch"].values == number) & doubles],
        )
        for kind in ("event", "torus"):
            for i in np.flatnonzero(data[f"{kind}_branch"].values == number):
                cycle = first_coordinate(data[f"{kind}_states"])[i, :period]
                there = complex_multipliers(data[f"{kind}_multipliers"])[i]
                curve = insert_event(curve, float(data[f"{kind}_value"][i]), cycle, there)
        found.append(curve)
    return found


def insert_event(
    curve: Curve,
    value: float,
    states: Float[np.ndarray, " period"],
    multipliers: Complex[np.ndarray, " order"],
) -> Curve:
    """Insert a bifurcation between the two points where it lengthens the curve least."""
    path = np.column_stack([curve.value, curve.states])
    scale = np.maximum(np.ptp(path, axis=0), np.finfo(float).tiny)
    lengths = np.linalg.norm(np.diff(path, axis=0) / scale, axis=1)
    distances = np.linalg.norm((path - [value, *states]) / scale, axis=1)
    at = int((distances[:-1] + distances[1:] - lengths).argmin()) + 1 if len(lengths) else 1
    return curve._replace(
        value=np.insert(curve.value, at, value),
        states=np.insert(curve.states, at, states, axis=0),
        multipliers=np.insert(curve.multipliers, at, multipliers, axis=0),
        stable=np.insert(curve.stable, at, True),
    )


def cascade_curves(data: xr.Dataset) -> list[Curve]:
    """Return the curves of the cascade, that of period one first."""
    members = data["branch"].values[data["on_cascade"].values.astype(bool)]
    return [curve for curve in read_curves(data) if curve.number in members]


def interpolate_multipliers(curve: Curve) -> Curve:
    """Add interpolated points to a curve, between its own.

    The coefficients of the polynomial whose roots are the multipliers are interpolated linearly.
    """
    count = len(curve.value)
    if count < 2:
        return curve
    at = np.linspace(0, count - 1, PARTS_PER_INTERVAL * (count - 1) + 1)
    low = np.minimum(at.astype(int), count - 2)
    share = (at - low)[:, None]
    polynomials = np.array([np.poly(row) for row in curve.multipliers])
    value, states, polynomials = (
        (1 - share) * points[low] + share * points[low + 1]
        for points in (curve.value[:, None], curve.states, polynomials)
    )
    inside = share[:, 0] % 1 > 0
    return curve._replace(
        value=value[:, 0],
        states=states,
        multipliers=np.array([np.roots(row) for row in polynomials], complex),
        stable=np.where(inside, curve.stable_intervals[low], curve.stable[at.astype(int)]),
    )


def complex_multipliers(parts: xr.DataArray) -> Complex[np.ndarray, "n order"]:
    """Return multipliers whose real and imaginary parts are along the last dimension."""
    return parts.values[..., 0] + 1j * parts.values[..., 1]


def first_coordinate(states: xr.DataArray) -> Float[np.ndarray, "..."]:
    """Return the first coordinate of states on the section."""
    return states.isel(coordinate=0).values


def attractor_states(data: xr.Dataset) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Values of the parameter and first coordinates of all recorded states on attractors."""
    orbit = first_coordinate(data["orbit"])
    known = np.isfinite(orbit) & (data["fate"].values == Outcome.STRIDE)[..., None]
    return data["sample_value"].values[np.nonzero(known)[0]], orbit[known]


def loss_of_attractor(data: xr.Dataset) -> float:
    """Return the middle of the interval in which walking is lost; NaN if it is not lost."""
    return float(data["lost"].values.mean())


def cascade_interval(data: xr.Dataset) -> tuple[float, float] | None:
    """Return the first period doubling of the cascade and the loss of walking; None if unknown."""
    doublings = [value for curve in cascade_curves(data) for value in curve.doublings.tolist()]
    low, high = min(doublings, default=np.inf), loss_of_attractor(data)
    return (low, high) if low < high else None


def final_gaits(data: xr.Dataset) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """First coordinates and step times of the gaits of period one at the end of the range."""
    value, period = data["value"].values, data["period"].values
    last = (period == 1) & np.isclose(value, value.max(initial=-np.inf), rtol=1e-9)
    return first_coordinate(data["states"])[last, 0], data["step_times"].values[last, 0]

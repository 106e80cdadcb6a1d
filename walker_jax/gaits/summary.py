"""Summaries of gaits and bifurcation diagrams, as dictionaries for JSON."""

import numpy as np
import xarray as xr

from walker_jax.gaits.cycles import Gait


def summarise_gait(gait: Gait) -> dict:
    """A gait; each multiplier as its real and its imaginary part."""
    return {
        "period": len(gait.states),
        "states": np.asarray(gait.states),
        "multipliers": [
            [value.real, value.imag] for value in np.asarray(gait.multipliers).tolist()
        ],
        "step_times": np.asarray(gait.step_times),
        "stable": bool(gait.stable),
        "residual": float(gait.residual),
    }


def summarise_bifurcations(data: xr.Dataset) -> dict:
    """Bifurcations and the loss of walking, from a `bifurcation_diagram` over the slope.

    **Returns** `doublings` of the cascade that starts from the long gait, `other_doublings`,
    `folds` and `neimark_sackers`, each in ascending order of period, then of slope; `lost`, the
    slopes `below` and `above` the loss of walking; and `stable_beyond`, the intervals of slope
    beyond it in which a gait born at a fold is stable.
    """
    fold, cascade = data["event_fold"].values, data["cascade"].values
    below, above = map(float, data["lost"].values)
    return {
        "doublings": list_events(data, ~fold & cascade),
        "other_doublings": list_events(data, ~fold & ~cascade),
        "folds": list_events(data, fold),
        "neimark_sackers": list_tori(data),
        "lost": {"below": below, "above": above},
        "stable_beyond": find_stable_intervals(data, above),
    }


def list_events(data: xr.Dataset, chosen: np.ndarray) -> list[dict]:
    """The bifurcations chosen, in ascending order of period, then of slope."""
    periods, slopes = data["event_period"].values, data["event_value"].values
    order = [i for i in np.lexsort([slopes, periods]) if chosen[i]]
    events = []
    for i in order:
        period = int(periods[i])
        fold = bool(data["event_fold"].values[i])
        kind = {"period": period} if fold else {"from": period, "to": 2 * period}
        state = data["event_states"].values[i, 0]
        events.append({**kind, "slope": float(slopes[i]), "state": state})
    return events


def list_tori(data: xr.Dataset) -> list[dict]:
    """The Neimark-Sacker points in the same order, and the angles of their pairs of multipliers."""
    if "torus_value" not in data:
        return []
    periods, slopes = data["torus_period"].values, data["torus_value"].values
    angles = np.arctan2(*np.moveaxis(data["torus_multipliers"].values[:, 0, ::-1], 1, 0))
    return [
        {
            **{"period": int(periods[i]), "slope": float(slopes[i])},
            **{"angle": abs(float(angles[i])), "state": data["torus_states"].values[i, 0]},
        }
        for i in np.lexsort([slopes, periods])
    ]


def find_stable_intervals(data: xr.Dataset, above: float) -> list[dict]:
    """Intervals from the fold to the first doubling of branches born beyond the loss of walking."""
    branches, slopes = data["event_branch"].values, data["event_value"].values
    intervals = []
    for branch in np.unique(branches[data["event_fold"].values]):
        own = branches == branch
        ends = np.sort(slopes[own])
        if len(ends) > 1 and ends[0] > above:
            period = int(data["event_period"].values[own][0])
            intervals.append({"period": period, "from": float(ends[0]), "to": float(ends[1])})
    return intervals

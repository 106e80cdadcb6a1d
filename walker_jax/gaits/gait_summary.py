"""Summaries of gaits, bifurcation diagrams and charts, as dictionaries for JSON."""

import numpy as np
import xarray as xr
from jaxtyping import Float

from walker_jax.gaits.charts import NO_GAIT, words_in
from walker_jax.gaits.cycles import Gait
from walker_jax.gaits.defining_systems import DOUBLING, TORUS
from walker_jax.gaits.normal_forms import criticality
from walker_jax.systems.outcomes import Outcome

LONGEST_LISTED_PERIOD = 8
"""Longest period whose share of the cells is given separately."""


def summarise_gait(gait: Gait) -> dict:
    """Summarise a gait; each multiplier is a pair, its real and its imaginary part."""
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
    """Summarise the bifurcations and the loss of walking of a `bifurcation_diagram`.

    **Returns** `doublings` of the cascade that starts from the most stable gait of period one,
    `other_doublings`, `folds` and `neimark_sackers`, in ascending order of period, then of the
    parameter. Each has the `slope`, or the `value` of another parameter, and the `criticality` if
    known. `lost` has the values `below` and `above` the loss of walking, and `stable_beyond` the
    intervals beyond it in which a gait born at a fold is stable.
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


def summarise_chart(data: xr.Dataset) -> dict:
    """Curves of bifurcations and shares of the cells, from a `chart`.

    **Returns** `curves`, each with its `kind`, `period`, the `criticality` of its parts, the values
    and the reason at both `ends`, and its `special` points; and `cells`, the share of each period,
    of longer ones and none, of failures, of undecided cells and of those without a gait.
    """
    curves = []
    for i, (kind, period) in enumerate(
        zip(words_in(data, "line_kind"), data["line_period"].values.tolist(), strict=True)
    ):
        own = data["curve"].values == i
        found = {criticality(kind, s) for s in data["curve_coefficient"].values[own].tolist()}
        places = data["curve_value"].values[own][[0, -1]]
        reasons = words_in(data, "line_end")[i]
        curves.append(
            {
                "kind": kind,
                "period": period,
                "criticality": sorted(found - {""}),
                "ends": [
                    {"values": place, "reason": reason}
                    for place, reason in zip(places, reasons, strict=True)
                ],
                "special": [
                    {
                        "kind": words_in(data, "special_kind")[j],
                        "values": data["special_value"].values[j],
                        "state": data["special_states"].values[j, 0],
                        "multipliers": data["special_multipliers"].values[j],
                    }
                    for j in np.flatnonzero(data["special_curve"].values == i)
                ],
            }
        )
    fate, periods = data["cell_fate"].values, data["cell_period"].values
    walks, short = fate == Outcome.STRIDE, (periods > 0) & (periods <= LONGEST_LISTED_PERIOD)
    shares = {f"period {n}": walks & (periods == n) for n in np.unique(periods[walks & short])}
    shares |= {"no period, or a longer one": walks & ~short}
    undecided, none = fate == Outcome.UNDECIDED, fate == NO_GAIT
    shares |= {"fails": ~walks & ~undecided & ~none, "undecided": undecided, "no gait": none}
    shares = {name: float(cells.mean()) for name, cells in shares.items() if cells.any()}
    return {"curves": curves, "cells": shares}


def list_events(data: xr.Dataset, chosen: np.ndarray) -> list[dict]:
    """List the chosen bifurcations, in ascending order of period, then of value."""
    periods, values = data["event_period"].values, data["event_value"].values
    order = [i for i in np.lexsort([values, periods]) if chosen[i]]
    events = []
    for i in order:
        period = int(periods[i])
        fold = bool(data["event_fold"].values[i])
        kind = {"period": period} if fold else {"from": period, "to": 2 * period}
        state = data["event_states"].values[i, 0]
        event = {**kind, value_key(data.attrs["parameter"]): float(values[i]), "state": state}
        events.append(event | ({} if fold else read_criticality(data, "event", int(i))))
    return events


def read_criticality(data: xr.Dataset, name: str, i: int) -> dict[str, str]:
    """Return whether a doubling or Neimark-Sacker point is super- or subcritical, if known.

    `name` is the dimension along which the point is listed.
    """
    if f"{name}_coefficient" not in data:
        return {}
    kind = DOUBLING if name == "event" else TORUS
    found = criticality(kind, float(data[f"{name}_coefficient"].values[i]))
    return {"criticality": found} if found else {}


def value_key(parameter: str) -> str:
    """Return the key of a parameter's value in an event; its name might be another key there."""
    return "slope" if parameter == "slope" else "value"


def list_tori(data: xr.Dataset) -> list[dict]:
    """List the Neimark-Sacker points in the same order, with the angles of their multipliers."""
    periods, values = data["torus_period"].values, data["torus_value"].values
    angles = np.arctan2(*np.moveaxis(data["torus_multipliers"].values[:, 0, ::-1], 1, 0))
    return [
        {
            **{"period": int(periods[i]), value_key(data.attrs["parameter"]): float(values[i])},
            **{"angle": abs(float(angles[i])), "state": data["torus_states"].values[i, 0]},
            **read_criticality(data, "torus", int(i)),
        }
        for i in np.lexsort([values, periods])
    ]


def find_stable_intervals(data: xr.Dataset, above: float) -> list[dict]:
    """Find the intervals of stable gaits on branches born at a fold beyond the loss of walking.

    An interval ends in a bifurcation or with its branch. If a branch has no gait between its fold
    and the doubling after it, the interval between these two is stable.
    """
    fold, branch, slope = (data[f"event_{name}"].values for name in ("fold", "branch", "value"))
    intervals = []
    for one in np.unique(branch[fold]):
        tori = data["torus_value"].values[data["torus_branch"].values == one]
        losses = np.r_[slope[(branch == one) & ~fold], tori]
        ends = np.sort(np.r_[slope[(branch == one) & fold], losses])
        if not ends[0] > above:
            continue
        own = data["branch"].values == one
        slopes, stable = data["value"].values[own], np.flatnonzero(data["stable"].values[own])
        runs = np.split(stable, np.flatnonzero(np.diff(stable) > 1) + 1) if len(stable) else []
        found = [between(ends, slopes[run].min(), slopes[run].max()) for run in runs]
        if not found and len(ends) > 1 and ends[1] in losses:
            found = [(ends[0], ends[1])]
        period = int(data["event_period"].values[branch == one][0])
        intervals += [{"period": period, "from": float(a), "to": float(b)} for a, b in found]
    return intervals


def between(ends: Float[np.ndarray, " n"], low: float, high: float) -> tuple[float, float]:
    """Return the nearest ends that enclose an interval; its own end on a side that has none."""
    return max(ends[ends <= low], default=low), min(ends[ends >= high], default=high)

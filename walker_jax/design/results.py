"""Results read from the data sets of optimisations and sweeps, and their summaries."""

import json
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Bool, Float

from walker_jax.design.evaluation import SCAN_STAGE
from walker_jax.systems.outcomes import names_in

if TYPE_CHECKING:
    import pandas

ENDS = ("start", "optimum")


class Run(NamedTuple):
    """The evaluations of one run, over one parameter."""

    best: bool
    """Whether the run led to the optimum."""
    stage: np.ndarray
    parameter: Float[np.ndarray, " n"]
    value: Float[np.ndarray, " n"]


class Scan(NamedTuple):
    """The objective over one parameter, with others as in the optimum, one of the points."""

    parameter: Float[np.ndarray, " n"]
    value: Float[np.ndarray, " n"]
    allowed: Bool[np.ndarray, " n"]
    """Whether the limits allow each point."""
    forbidden: list[tuple[float, float]]
    """Intervals from forbidden points to the next allowed ones."""


def is_optimum(data: xr.Dataset) -> bool:
    """Return whether an optimisation found an optimum."""
    return "found" in data and bool(data["found"])


def free_parameters(data: xr.Dataset) -> list[str]:
    """Return the free parameters."""
    return data["parameter"].values.tolist()


def weights(data: xr.Dataset) -> dict[str, float]:
    """Return the weights of the objective."""
    return {name: float(one) for name, one in json.loads(data.attrs["objective"]).items()}


def bounds(data: xr.Dataset, parameter: str) -> tuple[float, float]:
    """Return the bounds of a parameter."""
    low, high = json.loads(data.attrs["bounds"])[parameter]
    return float(low), float(high)


def limits(data: xr.Dataset) -> dict[str, tuple[float | None, float | None]]:
    """Return the lowest and the highest allowed value of measures."""
    number = lambda end: None if end is None else float(end)
    pairs = json.loads(data.attrs["limits"])
    return {name: (number(low), number(high)) for name, (low, high) in pairs.items()}


def slice_coordinates(data: xr.Dataset) -> dict[str, float]:
    """Return the fixed coordinates of the slice in which areas are measured or basins shown."""
    region = json.loads(data.attrs["region"])
    shown = {name: data[name] for name in names_in(data, "section") if name in data}
    return {name: float(at) for name, at in region.items() if not isinstance(at, list)} | {
        name: float(at) for name, at in shown.items() if at.ndim == 0
    }


def runs(data: xr.Dataset, parameter: str) -> list[Run]:
    """Return all runs, over one parameter."""
    at = data["parameters"].sel(parameter=parameter).values
    run, stage, value = (data[name].values for name in ("run", "stage", "value"))
    optimal = (data["parameters"] == data["optimum"]).all("parameter").values
    best = run[optimal & (stage != SCAN_STAGE)][-1]
    found = []
    for number in np.unique(run[stage >= 0]).tolist():
        own = (stage >= 0) & (run == number)
        found.append(Run(number == best, stage[own], at[own], value[own]))
    return found


def scan_of(data: xr.Dataset, parameter: str) -> Scan | None:
    """Return the scan over a parameter, if there is one."""
    if "scan_value" not in data:
        return None
    own = data.sel(parameter=parameter)
    at, value, allowed = (own[f"scan_{name}"].values for name in ("parameters", "value", "allowed"))
    allowed, optimum = allowed.astype(bool), float(own["optimum"])
    if optimum not in at:  # if a limit binds, the forbidden interval begins at the optimum
        place = np.searchsorted(at, optimum)
        at = np.insert(at, place, optimum)
        value = np.insert(value, place, float(own["objective_optimum"]))
        allowed = np.insert(allowed, place, True)
    forbidden = ~(allowed[:-1] & allowed[1:])
    turns = np.flatnonzero(np.diff(forbidden, prepend=False, append=False))
    intervals = [(low, high) for low, high in at[turns].reshape(-1, 2).tolist()]
    return Scan(at, value, allowed, intervals)


def improvement(data: xr.Dataset) -> float | None:
    """Return the exact objective at the optimum over that at the start; None unless positive."""
    start, optimum = float(data["exact_start"]), float(data["exact_optimum"])
    return optimum / start if start > 0 and optimum > 0 else None


def area_at(data: xr.Dataset, side: str) -> float | None:
    """Return the area of the basin at the start or the optimum, if that alone was optimised."""
    given = weights(data)
    return float(data[f"exact_{side}"]) / given["area"] if [*given] == ["area"] else None


def binding_limits(data: xr.Dataset) -> list[str]:
    """Return the measures whose limits bind at the optimum."""
    return data["measure"].values[data["binding"].values.astype(bool)].tolist()


def summarise_optimum(data: xr.Dataset) -> dict:
    """Summarise the start and the optimum that `optimise` found, for JSON."""
    names = data["parameter"].values.tolist()
    by_name = lambda key: dict(zip(names, data[key].values.tolist(), strict=True))
    at_ends = lambda key: {end: float(data[key.format(end)]) for end in ENDS}
    return {
        "start": by_name("start"),
        "optimum": by_name("optimum"),
        "objective": at_ends("objective_{}"),
        "exact": at_ends("exact_{}"),
        "exact_error": at_ends("exact_{}_error"),
        "at_bound": [name for name, side in by_name("at_bound").items() if side],
        "binding": binding_limits(data),
        "note": {end: str(data[f"note_{end}"].values) for end in ENDS},
        "evaluations": data.sizes["evaluation"],
        "converged": bool(data["converged"]),
        "out_of_time": bool(data["out_of_time"]),
        **{name: float(data[name]) for name in ("first_seconds",) if name in data},
    }


def tabulate_sweep(data: xr.Dataset, names: list[str]) -> "pandas.DataFrame":
    """Tabulate the scalar variables, with a row for each combination of the parameters."""
    single = [name for name in data if set(data[name].dims) == set(names)]
    table = data[single].load()
    return table.stack(point=names).to_dataframe()[[str(name) for name in single]].reset_index()

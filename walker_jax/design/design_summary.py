"""Summaries of optimisations and sweeps."""

from typing import TYPE_CHECKING

import xarray as xr

from walker_jax.design.results import binding_limits

if TYPE_CHECKING:
    import pandas

ENDS = ("start", "optimum")


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
    }


def tabulate_sweep(data: xr.Dataset, names: list[str]) -> "pandas.DataFrame":
    """Tabulate the scalar variables, with a row for each combination of the parameters."""
    single = [name for name in data if set(data[name].dims) == set(names)]
    table = data[single].load()
    return table.stack(point=names).to_dataframe()[[str(name) for name in single]].reset_index()

"""The variables of the data set that `robustness` returns, in groups, and a summary for JSON.

A group has the names of its variables by their keys in JSON. Their types are in
`storage/kinds.toml`.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from walker_jax.storage.schema import KINDS, with_dims
from walker_jax.systems.outcomes import failures_of, name_of_outcome
from walker_jax.systems.system import System


def alike(*names: str) -> dict[str, str]:
    """Return a group of variables that have their keys for names."""
    return dict(zip(names, names, strict=True))


def estimate(name: str, key: str = "value") -> dict[str, str]:
    """Return the group of an estimated number: itself, by `key`, and its interval's ends."""
    return {key: name, "low": f"{name}_low", "high": f"{name}_high"}


GAIT = {
    "period": "gait_period",
    "state": "gait_state",
    **alike("multiplier", "step_time", "return_strides"),
}
LEAST_DISTURBANCE = {
    "size": "least_disturbance",
    "direction": "direction",
    "state": "failing_state",
    "failure": "failure",
    "strides": "failing_strides",
}
LEAST_FALL = {
    "size": "least_fall",
    "direction": "fall_direction",
    "state": "fall_state",
    "failure": "fall_failure",
    "strides": "fall_strides",
}
STEP_DOWN = alike("step_down", "step_down_failure", "step_down_fall")
STABILITY = estimate("stability") | alike("in_time")
RETURN = alike(
    *("median_strides", "slowest_strides", "mean_strides"),
    *("pace", "median_pace", "mean_shock", "largest_shock"),
)
DIMENSION = estimate("dimension")
GROUND = estimate("steps_to_fall", "mean")
"""Variables that require a ground."""
GROUPS = GAIT, LEAST_DISTURBANCE, LEAST_FALL, STEP_DOWN, STABILITY, RETURN, DIMENSION
FIELDS = ("note", *(name for group in GROUPS for name in group.values()))
"""The variables of a gait.

To add one, compute it in `measure_gait`, put it in a group here, from which JSON and sweeps take
it, and in `storage/kinds.toml`.
"""
VARIABLES = KINDS["robustness"].variables
TYPES = {"real": float, "integer": int}


def variables(group: Mapping[str, str], values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the variables of a group, given values by its keys."""
    typed = {
        name: np.asarray(values[key], TYPES[VARIABLES[name].type]) for key, name in group.items()
    }
    return with_dims("robustness", typed)


def without_gait(walker: System) -> dict:
    """Return the variables that `robustness` adds where no gait attracts."""
    unknown = {"real": np.nan, "integer": -1, "text": np.array("", object)}
    state = "coordinate", np.full(len(walker.section), np.nan)
    values = {
        name: state if VARIABLES[name].dims else unknown[VARIABLES[name].type] for name in FIELDS
    }
    return values | {"gait_period": 0}


def summarise_robustness(data: xr.Dataset, at: Mapping[str, float]) -> dict:
    """Return the results of `robustness`, `at` a value, for JSON; None where no gait attracts."""
    attracts = int(data["gait_period"]) > 0
    values = lambda group: {
        key: value_of(data, name) if attracts else None for key, name in group.items()
    }
    disturbances = {"disturbances": float(data.attrs["disturbances"])}
    of_gait = {
        "gait": values(GAIT),
        "least_disturbance": values(LEAST_DISTURBANCE),
        "least_fall": values(LEAST_FALL),
        **values(STEP_DOWN),
        "basin_stability": values(STABILITY) | disturbances | values(RETURN),
        "boundary_dimension": values(DIMENSION),
    }
    if "steps_to_fall" in data:
        of_gait["steps_to_fall"] = values(GROUND) | {"ground": float(data.attrs["ground"])}
    at_border = float(data["at_border"])  # NaN in a row without a grid
    return {
        **at,
        "area": float(data["total_area"]),
        "area_error": float(data["total_area_error"]),
        "at_border": int(at_border) if np.isfinite(at_border) else None,
        "note": value_of(data, "note"),
        **(of_gait if attracts else dict.fromkeys(of_gait)),
    }


def value_of(data: xr.Dataset, name: str) -> Any:
    """Return the value of a variable; None for no outcome."""
    value, kind = data[name].values, VARIABLES[name]
    if kind.dims:
        return value
    if name.endswith("failure"):
        return None if value < 0 else name_of_outcome(int(value), failures_of(data))
    return (TYPES | {"text": str})[kind.type](value)

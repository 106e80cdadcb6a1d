"""The variables of the data set that `robustness` returns, in groups, and a summary for JSON."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from walker_jax.gaits.cycles import Gait
from walker_jax.stability.sampling import BasinStability
from walker_jax.stability.steps_down import LeastStepDown
from walker_jax.systems.outcomes import failures_of, name_of_outcome
from walker_jax.systems.system import System


class Field(NamedTuple):
    """A variable of the data set that `robustness` returns."""

    name: str
    kind: str
    """Kind: "number"; "vector" over the section's coordinates; "text"; or "count" or "outcome",
    whole numbers."""


def numbers(*names: str) -> dict[str, Field]:
    """Return variables that are numbers, by their own names."""
    return {name: Field(name, "number") for name in names}


def estimate(name: str, key: str = "value") -> dict[str, Field]:
    """Return the variables of an estimated number: itself, by `key`, and its interval's ends."""
    ends = {end: Field(f"{name}_{end}", "number") for end in ("low", "high")}
    return {key: Field(name, "number")} | ends


GAIT = {
    "period": Field("gait_period", "count"),
    "state": Field("gait_state", "vector"),
    **numbers("multiplier", "step_time", "return_strides"),
}
LEAST_DISTURBANCE = {
    "size": Field("least_disturbance", "number"),
    "direction": Field("direction", "vector"),
    "state": Field("failing_state", "vector"),
    "failure": Field("failure", "outcome"),
    "strides": Field("failing_strides", "count"),
}
LEAST_FALL = {
    "size": Field("least_fall", "number"),
    "direction": Field("fall_direction", "vector"),
    "state": Field("fall_state", "vector"),
    "failure": Field("fall_failure", "outcome"),
    "strides": Field("fall_strides", "count"),
}
STEP_DOWN = {
    "step_down": Field("step_down", "number"),
    "step_down_failure": Field("step_down_failure", "outcome"),
    "step_down_fall": Field("step_down_fall", "number"),
}
STABILITY = estimate("stability") | numbers("in_time")
RETURN = numbers("median_strides", "slowest_strides", "mean_strides") | numbers(
    "pace", "median_pace", "mean_shock", "largest_shock"
)
DIMENSION = estimate("dimension")
GROUND = estimate("steps_to_fall", "mean")
"""Variables that require a ground."""
GROUND_NAMES = tuple(field.name for field in GROUND.values())
NOTE = Field("note", "text")
GROUPS = GAIT, LEAST_DISTURBANCE, LEAST_FALL, STEP_DOWN, STABILITY, RETURN, DIMENSION
FIELDS = (NOTE, *(field for group in GROUPS for field in group.values()))
"""The variables of a gait.

To add one, compute it in `measure_gait`, put it in a group here, from which JSON and sweeps take
it, and in `storage/kinds.toml`.
"""
WITHOUT_GAIT = {"gait_period": 0}
"""Values where no gait attracts, if they differ from NaN, -1 and empty text."""


Group = Mapping[str, Field]


def variables(group: Group, values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the variables of a group, given values by its keys."""
    kinds = {"number": float, "count": int, "outcome": int}
    as_vector = lambda value: ("coordinate", np.asarray(value))
    return {
        field.name: kinds.get(field.kind, as_vector)(values[key]) for key, field in group.items()
    }


def variables_of_gait(gait: Gait) -> dict[str, Any]:
    """Return the variables of a gait, with its first state."""
    about = {
        "period": len(gait.states),
        "state": gait.states[0],
        "multiplier": np.abs(gait.multipliers[0]),
        "step_time": np.mean(gait.step_times),
        "return_strides": gait.return_strides,
    }
    return variables(GAIT, about)


def variables_of_steps(down: LeastStepDown, fall: LeastStepDown) -> dict[str, Any]:
    """Return the variables of the least step down, and of the least one that causes a fall."""
    about = {"step_down": down.size, "step_down_failure": down.failure}
    return variables(STEP_DOWN, about | {"step_down_fall": fall.size})


def variables_of_return(stability: BasinStability) -> dict[str, Any]:
    """Return the variables of the return to the gait."""
    about = {"median_strides": stability.median, "slowest_strides": stability.slowest}
    return variables(RETURN, stability._asdict() | about | {"mean_strides": stability.mean})


def without_gait(walker: System) -> dict:
    """Return the variables that `robustness` adds where no gait attracts."""
    of_kind = lambda *kinds: [field.name for field in FIELDS if field.kind in kinds]
    unknown_state = "coordinate", np.full(len(walker.section), np.nan)
    numbers = dict.fromkeys(of_kind("number"), np.nan)
    vectors = dict.fromkeys(of_kind("vector"), unknown_state)
    whole = dict.fromkeys(of_kind("count", "outcome"), -1)
    return numbers | vectors | whole | {NOTE.name: np.array("", object)} | WITHOUT_GAIT


def summarise_robustness(data: xr.Dataset, at: Mapping[str, float]) -> dict:
    """Return the results of `robustness`, `at` a value, for JSON; None where no gait attracts."""
    attracts = int(data["gait_period"]) > 0
    values = lambda group: {
        key: value_of(data, field) if attracts else None for key, field in group.items()
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
        "note": value_of(data, NOTE),
        **(of_gait if attracts else dict.fromkeys(of_gait)),
    }


def value_of(data: xr.Dataset, field: Field) -> Any:
    """Return the value of a field; None for no outcome."""
    value = data[field.name].values
    if field.kind == "vector":
        return value
    if field.kind in ("outcome", "text"):
        if field.kind == "text":
            return str(value)
        if value < 0:
            return None
        return name_of_outcome(int(value), failures_of(data))
    return float(value) if field.kind == "number" else int(value)

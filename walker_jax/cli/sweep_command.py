"""`walker-jax sweep`."""

from collections.abc import Mapping
from typing import Any

import walker_jax as wj
from walker_jax.cli import library as lib
from walker_jax.cli.answers import Output, Pieces, request_for, terms_of
from walker_jax.cli.commands import command
from walker_jax.cli.options import RANGE, Axis, named, option
from walker_jax.cli.section import asked_of, axes_option, region_on
from walker_jax.refusals import WrongUse

GAIT = "total_area", "total_area_error", "gait_period", "multiplier", "speed", "failed"
SHOWN = *GAIT, "least_disturbance", "least_fall", "step_down", "step_down_fall"
"""Columns that are printed; the data set has more."""


@command(
    examples=(
        "sweep --over slope=0.002:0.01:5",
        "sweep --walker spring --over slope=0.002:0.01:5 --over hip-stiffness=0:9:4 --workers 2",
    ),
    time="Some seconds for each combination, half a minute with --robust.",
    out="sweep.zarr",
)
def sweep(
    walker: "wj.System",
    pieces: Pieces,
    output: Output,
    over: dict[str, Axis] = named(
        "Values of a parameter; give it again for others.", RANGE, sets={"parameter": "--over"}
    ),
    axes: dict[str, Any] = axes_option("Region"),
    levels: int = option(2, "Levels of refinement of the areas.", least=0),
    check: int = option(500_000, "Starts that check each area.", least=0),
    robust: bool = option(False, "All numbers of `robustness` too; half a minute each."),
    strides: int = option(200, "Strides at most."),
    seed: int = option(0, "Seed of random numbers.", least=0),
):
    """Compute basins, gaits and areas over one or more parameters, all combinations of them.

    Results are saved as they are computed: the same command resumes an interrupted run. The picture
    shows the area over the first two parameters. The default region is all of the section.
    """
    values = values_of(over)
    if not values:
        raise WrongUse("--over is required: a parameter and its values, such as slope=0.002:0.01:5")
    grid = region_on(walker, axes)
    how: Any = {"over": values, "levels": levels, "check": check, "robust": robust}
    how |= {"strides": strides, "seed": seed}
    request = request_for("sweep", walker, without=values, axes=asked_of(grid), **how)
    how |= {"cluster": pieces.cluster, **output.place(request)}
    data = output.produce(request, lambda: wj.sweep(walker, grid=grid, **how), "sweep", kept=True)
    rows = lib.tabulate_sweep(data, [*values])
    points = rows.to_dict(orient="records")
    yield {"walker": request["walker"], "points": points}
    shown = [name for name in (*values, *SHOWN) if name in rows]
    yield rows[shown].map("{:.6g}".format).to_string(index=False)
    where = lambda row: ", ".join(f"{name} {row[name]:.6g}" for name in values)
    for row in points:
        if row["failed"]:
            yield f"  failed at {where(row)}: {row.get('reason') or 'no reason was kept'}"
        if row.get("note"):
            yield f"  {where(row)}: {row['note']}"
    best = max(points, key=lambda row: -1.0 if row["failed"] else row["total_area"])
    if best["total_area"] > 0:
        at = where(best).replace("_", "-")
        yield f"  The basin is largest at {at}: walker-jax optimise searches around."
    else:
        cycle = terms_of(walker).cycle
        yield f"  No basin has any area: try other values, or a region that holds a {cycle}."
    yield output.places()


def values_of(over: Mapping[str, Axis]) -> dict[str, list[float]]:
    """Return the values of each parameter that --over names, as many as a sweep can have."""
    for name, (low, high, count) in over.items():
        if count > lib.MAX_COMBINATIONS:
            given = f"{name.replace('_', '-')}={low:g}:{high:g}:{count}"
            raise WrongUse(f"--over {given} must have N of at most {lib.MAX_COMBINATIONS}")
    return {name: lib.space_decimals(*ends) for name, ends in over.items()}

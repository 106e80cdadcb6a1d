"""`walker-jax sweep`."""

import math
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

import walker_jax as wj
from walker_jax.checks import WrongUse
from walker_jax.cli.answers import draw, find_earlier, print_json, request_for
from walker_jax.cli.options import (
    Axes,
    AxisOption,
    Json,
    Out,
    Overwrite,
    PictureOfData,
    RegionSum,
    RegionTheta,
    Scheduler,
    Seed,
    SlicePlace,
    Workers,
    asked_of,
    cluster_from,
    grid_from,
    hyphenated,
    read_numbers,
)
from walker_jax.cli.walker_options import takes_walker
from walker_jax.design.summary import tabulate_sweep
from walker_jax.design.sweeps import MAX_COMBINATIONS, check_values
from walker_jax.systems.system import System
from walker_jax.walkers.parameters import describe_walker, space_decimals

SHOWN = (
    "total_area",
    "total_area_error",
    "gait_period",
    "multiplier",
    "speed",
    "failed",
    "least_disturbance",
)
SHOWN += ("least_fall", "step_down", "step_down_fall")
"""Columns that are printed; the data set has more."""


@takes_walker(systems=True)
def sweep(
    walker: System,
    over: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=LO:HI:N", help="Values of a parameter; give it again for others."
        ),
    ] = None,
    theta: RegionTheta = None,
    sum_: RegionSum = None,
    at_phidot: SlicePlace = None,
    phidot: Annotated[
        AxisOption | None, typer.Option(metavar="LO HI N", help="The same for volumes, not areas.")
    ] = None,
    axis: Axes = None,
    levels: Annotated[int, typer.Option(min=0, help="Levels of refinement of the areas.")] = 2,
    check: Annotated[int, typer.Option(min=0, help="Starts that check each area.")] = 500_000,
    robust: Annotated[
        bool, typer.Option("--robust", help="All numbers of `robustness` too; half a minute each.")
    ] = False,
    strides: Annotated[int, typer.Option(min=1, help="Strides at most.")] = 200,
    seed: Seed = 0,
    workers: Workers = None,
    scheduler: Scheduler = None,
    out: Out = Path("sweep.zarr"),
    figure: PictureOfData = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Compute basins, gaits and areas over one or more parameters, all combinations of them.

    Results are saved as they are computed: the same command resumes an interrupted run. The picture
    shows the area over the first two parameters.
    """
    from walker_jax import figures

    values = values_of(over or [])
    if not values:
        raise WrongUse("--over is required: a parameter and its values, such as slope=0.002:0.01:5")
    check_values(walker, {name: np.array(given) for name, given in values.items()})
    cluster = cluster_from(workers, scheduler)
    grid = grid_from(walker, theta, sum_, at_phidot, phidot, axis)
    about = {name: v for name, v in describe_walker(walker).items() if name not in values}
    options: Any = {"levels": levels, "check": check, "robust": robust, "strides": strides}
    options |= {"seed": seed}
    asked = {"over": values, "axes": asked_of(grid)}
    request = request_for("sweep", walker, walker=about, **asked, **options)
    figure, data = find_earlier(out, figure, request, overwrite=overwrite)
    if data is None:
        options |= {"out": out, "request": request, "overwrite": overwrite}
        data = wj.sweep(walker, values, grid, cluster=cluster, progress=True, **options)
    draw(figures.sweep(data), figure, request)
    rows = tabulate_sweep(data, [*values])
    if as_json:
        print_json({"walker": about, "points": rows.to_dict(orient="records")})
        return
    shown = [name for name in (*values, *SHOWN) if name in rows]
    print(rows[shown].map("{:.6g}".format).to_string(index=False))
    for row in rows.to_dict(orient="records"):
        where = ", ".join(f"{name} {row[name]:.6g}" for name in values)
        if row["failed"]:
            print(f"  failed at {where}: {row.get('reason') or 'no reason was kept'}")
        if row.get("note"):
            print(f"  {where}: {row['note']}")
    print(f"  data set {out}, picture {figure}")


def values_of(over: list[str]) -> dict[str, list[float]]:
    """The values of each parameter that --over names."""
    values: dict[str, list[float]] = {}
    for text in over:
        name, (low, high, count) = read_numbers("--over", "NAME=LO:HI:N", (float, float, int), text)
        if not low < high or count < 2 or not math.isfinite(high - low):
            raise WrongUse(f"--over {text} must have LO below HI, both finite, and N of 2 or more")
        if name in values:
            raise WrongUse(f"--over is given twice for {hyphenated(name)}")
        if count > MAX_COMBINATIONS:
            raise WrongUse(f"--over {text} must have N of at most {MAX_COMBINATIONS}")
        values[name] = space_decimals(low, high, count)
    return values

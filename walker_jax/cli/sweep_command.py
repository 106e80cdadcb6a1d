"""`walker-jax sweep`."""

import math
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

import walker_jax as wj
from walker_jax.checks import WrongUse
from walker_jax.cli.answers import description, draw, made_before, print_json
from walker_jax.cli.app import app
from walker_jax.cli.options import (
    PHIDOT_HELP,
    Axis,
    Json,
    Out,
    Overwrite,
    PictureOfData,
    Scheduler,
    Workers,
    cluster_of,
    region_of,
    takes_walker,
)
from walker_jax.walkers.model import Walker


@app.command()
@takes_walker
def sweep(
    walker: Walker,
    over: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=LO:HI:N", help="Values of a parameter; give it again for others."
        ),
    ] = None,
    theta: Annotated[
        Axis | None, typer.Option(metavar="LO HI N", help="Stance angle, rad (default: all).")
    ] = None,
    sum_: Annotated[
        Axis | None, typer.Option("--sum", metavar="LO HI N", help="theta + thetadot.")
    ] = None,
    at_phidot: Annotated[
        float | None, typer.Option(help=f"{PHIDOT_HELP}: where the slice is.")
    ] = None,
    levels: Annotated[int, typer.Option(min=0, help="Of refinement of the areas.")] = 2,
    check: Annotated[int, typer.Option(min=0, help="Starts that check each area.")] = 500_000,
    robust: Annotated[
        bool, typer.Option("--robust", help="All numbers of `robustness` too; half a minute each.")
    ] = False,
    strides: Annotated[int, typer.Option(min=1, help="Strides at most.")] = 200,
    workers: Workers = None,
    scheduler: Scheduler = None,
    out: Out = Path("sweep.zarr"),
    figure: PictureOfData = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Compute basins, gaits and areas over one or more parameters, all combinations of them.

    What has been computed is kept as it goes: after an interruption the same command goes on. The
    picture shows the area over the first two parameters.
    """
    from walker_jax import figures
    from walker_jax.design.sweeps import check_values

    values = values_of(over or [])
    if not values:
        raise WrongUse("--over is required: a parameter and its values, such as slope=0.002:0.01:5")
    check_values(walker, {name: np.array(some) for name, some in values.items()})
    cluster = cluster_of(workers, scheduler)
    grid = region_of(walker, theta, sum_, at_phidot)
    about = {name: v for name, v in description(walker).items() if name not in values}
    request = {
        "command": "sweep",
        "walker": about,
        "over": values,
        "axes": {} if grid is None else grid.box,
        "levels": levels,
        "check": check,
        "robust": robust,
        "strides": strides,
        "version": version("walker-jax"),
    }
    figure, data = made_before(out, figure, request, overwrite=overwrite)
    if data is None:
        options: Any = {"out": out, "request": request, "overwrite": overwrite}
        options |= {"levels": levels, "check": check, "robust": robust, "strides": strides}
        options |= {"cluster": cluster, "progress": True}
        data = wj.sweep(walker, values, grid, **options)
    draw(figures.sweep(data), figure, request)
    names = [*values]
    table = data[[name for name in data if set(data[name].dims) == set(names)]].load()
    rows = table.stack(point=names).to_dataframe()[[str(name) for name in table]].reset_index()
    if as_json:
        print_json({"walker": about, "points": rows.to_dict(orient="records")})
        return
    shown = [*names, "total_area", "total_area_error", "multiplier", "speed", "failed"]
    shown += ["least_disturbance", "least_fall", "step_down", "step_down_fall"]
    shown = [name for name in shown if name in rows]
    print(rows[shown].map("{:.6g}".format).to_string(index=False))
    for row in rows.to_dict(orient="records"):
        if row["failed"]:
            where = ", ".join(f"{name} {row[name]:.6g}" for name in names)
            print(f"  failed at {where}: {row.get('reason') or 'no reason was kept'}")
    print(f"  data set {out}, picture {figure}")


def values_of(over: list[str]) -> dict[str, list[float]]:
    """The values of each parameter that --over names."""
    from walker_jax.design.sweeps import MAX_COMBINATIONS

    values: dict[str, list[float]] = {}
    for text in over:
        name, _, span = text.partition("=")
        try:
            low, high, count = span.split(":")
            ends = float(low), float(high)
            number = int(count)
        except ValueError:
            raise WrongUse(f"--over must be NAME=LO:HI:N, not {text}") from None
        if not ends[0] < ends[1] or number < 2 or not math.isfinite(ends[1] - ends[0]):
            raise WrongUse(f"--over {text} must have LO below HI, both finite, and N of 2 or more")
        name = name.replace("-", "_")
        if name in values:
            raise WrongUse(f"--over is given twice for {name}")
        if number > MAX_COMBINATIONS:
            raise WrongUse(f"--over {text} must have N of at most {MAX_COMBINATIONS}")
        spaced, least = np.linspace(*ends, number), 1e-12 * (ends[1] - ends[0])
        values[name] = [float(f"{x:.12g}") if abs(x) > least else 0.0 for x in spaced]
    return values

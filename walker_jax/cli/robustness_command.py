"""`walker-jax robustness`."""

from importlib.metadata import version
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

import walker_jax as wj
from walker_jax import storage
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
    finite,
    region_of,
    takes_walker,
)
from walker_jax.walkers.model import Walker


@app.command()
@takes_walker
def robustness(
    walker: Walker,
    theta: Annotated[
        Axis | None,
        typer.Option(metavar="LO HI N", help="Stance angle, rad (default: 0 0.7854 200)."),
    ] = None,
    sum_: Annotated[
        Axis | None,
        typer.Option(
            "--sum",
            metavar="LO HI N",
            help="theta + thetadot (default: -0.12 0.06 200; -1.1 0.1 800 but for the simplest).",
        ),
    ] = None,
    at_phidot: Annotated[
        float | None,
        typer.Option(help=f"{PHIDOT_HELP}: a slice there (default: at the gait)."),
    ] = None,
    levels: Annotated[
        int, typer.Option(min=0, max=8, help="Times that cells on a boundary are cut in two.")
    ] = 4,
    disturbances: Annotated[
        float, typer.Option(help="Of basin stability: at most, as a part of the gait's own state.")
    ] = 0.1,
    strides: Annotated[
        int, typer.Option(min=1, help="Strides in which a walker may come back.")
    ] = 500,
    low: Annotated[
        float | None, typer.Option("--from", help="Lowest slope of a table over slopes, rad.")
    ] = None,
    high: Annotated[float | None, typer.Option("--to", help="Highest slope, rad.")] = None,
    count: Annotated[
        int | None, typer.Option(min=2, help="Slopes in the table (default: 20).")
    ] = None,
    out: Out = Path("robustness.zarr"),
    figure: PictureOfData = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Measure how large a disturbance a gait survives, on one slope or over many.

    The area of the basin with its error, the least disturbance from which the walker does not come
    back and, where that leads to another motion, the least one from which it falls, the least step
    down, the part of random disturbances that is survived, and the dimension
    of the boundary. By default over all angles of a walker on point feet, and in a slice around the
    gait of any other.
    """
    from walker_jax import figures
    from walker_jax.walkers.parameters import check_parameter

    if (low is None) != (high is None):
        raise WrongUse("--from and --to are for a table over slopes: give both or none")
    if low is None and count is not None:
        raise WrongUse("--count is for a table over slopes: give --from and --to too")
    finite(disturbances=disturbances)
    if disturbances <= 0:
        raise WrongUse(f"--disturbances must be above 0, not {disturbances}")
    grid = region_of(walker, theta, sum_, at_phidot)
    slopes = None
    if low is not None and high is not None:
        check_parameter(walker, "slope", low, high)
        if not low < high:
            raise WrongUse(f"--from {low:g} must be below --to {high:g}")
        slopes = np.linspace(low, high, count or 20).round(12)
    about = description(walker)
    slope = about["slope"] if slopes is None else about.pop("slope")
    request = {
        "command": "robustness",
        "walker": about,
        "slopes": None if slopes is None else slopes.tolist(),
        "axes": {} if grid is None else grid.box,
        "levels": levels,
        "disturbances": disturbances,
        "strides": strides,
        "version": version("walker-jax"),
    }
    figure, data = made_before(out, figure, request, overwrite=overwrite)
    if data is None:
        options = {"levels": levels, "disturbances": disturbances, "strides": strides}
        if slopes is None:
            data = wj.robustness(walker, grid, **options)
        else:
            data = wj.robustness_table(walker, slopes, "slope", grid, progress=True, **options)
        data = storage.save(data, out, request)
    if slopes is None:
        picture, rows = figures.robustness(data), [measures(data, slope)]
    else:
        picture = figures.robustness_table(data)
        rows = [measures(data.isel(slope=i), float(slope)) for i, slope in enumerate(slopes)]
    draw(picture, figure, request)
    if as_json:
        print_json({"walker": about} | (rows[0] if slopes is None else {"slopes": rows}))
        return
    values = [f"{name} {value:g}" for name, value in about.items() if name not in ("name", "slope")]
    print(", ".join([f"Robustness, {about['name']}", *values]))
    for row in rows:
        print_measures(row)
    print(f"  data set {out}, picture {figure}")


def measures(data, slope: float) -> dict:
    """The answer of `robustness` on one slope."""
    number = lambda name: float(data[name]) if name in data else None
    failure = lambda name: wj.Outcome(int(data[name])).name if name in data else None
    interval = lambda name: {
        "value": number(name),
        "low": number(f"{name}_low"),
        "high": number(f"{name}_high"),
    }
    answer = {
        "slope": slope,
        "area": number("total_area"),
        "area_error": number("total_area_error"),
    }
    if int(data["gait_period"]) == 0:
        absent = ("gait", "least_disturbance", "least_fall", "step_down", "step_down_failure")
        absent += ("step_down_fall", "basin_stability", "boundary_dimension")
        return answer | dict.fromkeys(absent)
    return answer | {
        "gait": {
            "period": int(data["gait_period"]),
            "state": data["gait_state"].values,
            "multiplier": number("multiplier"),
            "step_time": number("step_time"),
        },
        "least_disturbance": {
            "size": number("least_disturbance"),
            "direction": data["direction"].values,
            "state": data["failing_state"].values,
            "failure": failure("failure"),
            "strides": int(data["failing_strides"]),
        },
        "least_fall": {
            "size": number("least_fall"),
            "direction": data["fall_direction"].values,
            "state": data["fall_state"].values,
            "failure": failure("fall_failure"),
            "strides": int(data["fall_strides"]),
        }
        if "least_fall" in data
        else None,
        "step_down": number("step_down"),
        "step_down_failure": failure("step_down_failure"),
        "step_down_fall": number("step_down_fall"),
        "basin_stability": {
            **interval("stability"),
            "disturbances": float(data.attrs["disturbances"]),
            "median_strides": number("median_strides"),
            "slowest_strides": number("slowest_strides"),
        },
        "boundary_dimension": interval("dimension"),
    }


def said_of(disturbance: dict) -> str:
    """A least disturbance in words."""
    along = ", ".join(f"{value:.4f}" for value in disturbance["direction"])
    how = "comes to another motion"
    if disturbance["failure"] != "STRIDE":
        how = f"{disturbance['failure']} after {disturbance['strides']} strides"
    return f"{disturbance['size']:.8f} along ({along}): {how}"


def print_measures(row: dict) -> None:
    """The answer of `robustness` on one slope, in words."""
    print(f"  slope {row['slope']:g}: area {row['area']:.7g} +- {row['area_error']:.1g}")
    if row["gait"] is None:
        print("    no gait attracts")
        return
    gait, least = row["gait"], row["least_disturbance"]
    survived, dimension = row["basin_stability"], row["boundary_dimension"]
    print(f"    gait of period {gait['period']}, largest multiplier {gait['multiplier']:.6f}")
    print(f"    least disturbance {said_of(least)}")
    if least["failure"] == "STRIDE" and row["least_fall"] is not None:
        print(f"    least one from which it falls {said_of(row['least_fall'])}")
    down = f"{row['step_down']:.8f}"
    if row["step_down_failure"] == "STRIDE":
        down += f": comes to another motion; falls from {row['step_down_fall']:.8f}"
    print(f"    least step down {down}")
    print(
        f"    {survived['value']:.1%} ({survived['low']:.1%} to {survived['high']:.1%}) of "
        f"disturbances up to {survived['disturbances']:g} of the gait's state are survived; "
        f"half of them are over in {survived['median_strides']:g} strides, "
        f"95 of 100 in {survived['slowest_strides']:g}"
    )
    print(
        f"    dimension of the boundary {dimension['value']:.3f} "
        f"({dimension['low']:.3f} to {dimension['high']:.3f})"
    )

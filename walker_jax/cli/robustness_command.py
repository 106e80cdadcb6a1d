"""`walker-jax robustness`."""

from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

import walker_jax as wj
from walker_jax import storage
from walker_jax.basins.windows import grid_along
from walker_jax.checks import WrongUse
from walker_jax.cli.answers import draw, find_earlier, listed, print_json, request_for
from walker_jax.cli.options import (
    PHIDOT_HELP,
    Axes,
    AxisOption,
    Json,
    Out,
    Overwrite,
    PictureOfData,
    Seed,
    asked_of,
    check_finite,
    check_range,
    check_section,
    grid_from,
    hyphenated,
    refuse_for_systems,
    window_from,
)
from walker_jax.cli.walker_options import takes_walker
from walker_jax.design.evaluation import check_starts
from walker_jax.stability.summary import summarise_robustness
from walker_jax.systems.system import System
from walker_jax.walkers.model import Walker, is_planar
from walker_jax.walkers.parameters import describe_walker, space_decimals


@takes_walker(systems=True, ranges_over="over", or_one_value=True)
def robustness(
    walker: System,
    over: Annotated[
        str, typer.Option(metavar="NAME", help="The parameter of a table, with --from and --to.")
    ] = "slope",
    theta: Annotated[
        AxisOption | None,
        typer.Option(metavar="LO HI N", help="Stance angle, rad (default: 0 0.7854 200)."),
    ] = None,
    sum_: Annotated[
        AxisOption | None,
        typer.Option(
            "--sum",
            metavar="LO HI N",
            help="theta + thetadot (default: -0.12 0.06 200; -1.1 0.1 800 but for the simplest).",
        ),
    ] = None,
    at_phidot: Annotated[
        float | None,
        typer.Option(help=f"{PHIDOT_HELP}: a slice there (else at the gait)."),
    ] = None,
    axis: Axes = None,
    levels: Annotated[
        int, typer.Option(min=0, max=8, help="Times that cells on a boundary are cut in two.")
    ] = 4,
    disturbances: Annotated[
        float,
        typer.Option(
            help="Largest disturbance for basin stability, as a share of the gait's state."
        ),
    ] = 0.1,
    strides: Annotated[
        int, typer.Option(min=1, help="Strides in which a walker may come back.")
    ] = 500,
    ground: Annotated[
        float | None,
        typer.Option(
            min=0, help="Standard deviation of steps of rough ground: how long walks last there."
        ),
    ] = None,
    seed: Seed = 0,
    low: Annotated[
        float | None, typer.Option("--from", help="Lowest slope, or value, of a table.")
    ] = None,
    high: Annotated[float | None, typer.Option("--to", help="Highest.")] = None,
    count: Annotated[
        int | None, typer.Option(min=2, help="Rows of the table (default: 20).")
    ] = None,
    out: Out = Path("robustness.zarr"),
    figure: PictureOfData = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Measure how large a disturbance a gait survives, on one slope or over many.

    The measures are the area of the basin with its error; the least disturbance (minimal fatal
    shock) from which the walker does not return to its gait and, where that leads to another
    motion, the least one from which it falls; the least step down; the fraction of random
    disturbances that it survives; the dimension of the boundary; and with --ground the mean number
    of strides until it falls there. The default region has all
    angles of a walker on point feet, is a slice around the gait of any other, and of any other
    system the region in which its gaits are searched for.
    """
    from walker_jax import figures

    if (low is None) != (high is None):
        raise WrongUse("--from and --to are for a table: give both or none")
    if low is None and count is not None:
        raise WrongUse("--count is for a table: give --from and --to too")
    check_finite(disturbances=disturbances, ground=0.0 if ground is None else ground)
    if disturbances <= 0:
        raise WrongUse(f"--disturbances must be above 0, not {disturbances}")
    grid = grid_from(walker, theta, sum_, at_phidot, axis=axis)
    refuse_for_systems(walker, ground=ground)
    if not isinstance(walker, Walker):
        check_section(walker, axis)
        grid = grid or grid_along(window_from(walker, axis, {}))
    about, name = describe_walker(walker), over.replace("-", "_")
    values = None
    if low is not None and high is not None:
        check_range(walker, name, low, high)
        values = space_decimals(low, high, count or 20)
        about.pop(name)
    elif name != "slope":
        raise WrongUse("--over is for a table: give --from and --to too")
    at = {"slope": about["slope"]} if values is None and "slope" in about else {}
    options: Any = {
        "levels": levels,
        "disturbances": disturbances,
        "strides": strides,
        "seed": seed,
    } | ({} if ground is None else {"ground": ground})
    if isinstance(walker, Walker) and not is_planar(walker):
        options["check"] = check_starts(walker, exact=True)
    asked = {"over": values and {name: values}, "axes": asked_of(grid)}
    request = request_for("robustness", walker, walker=about, **asked, **options)
    figure, data = find_earlier(out, figure, request, overwrite=overwrite)
    if data is None:
        if values is None:
            data = wj.robustness(walker, grid, progress=True, **options)
        else:
            data = wj.robustness_table(walker, values, name, grid, progress=True, **options)
        data = storage.save(data, out, request)
    if values is None:
        picture, rows = figures.robustness(data), [summarise_robustness(data, at)]
    else:
        picture = figures.robustness_table(data)
        rows = [
            summarise_robustness(data.isel({name: i}), {name: value})
            for i, value in enumerate(values)
        ]
    draw(picture, figure, request)
    if as_json:
        many = "slopes" if name == "slope" else "values"
        print_json({"walker": about} | (rows[0] if values is None else {many: rows}))
        return
    about = {key: value for key, value in about.items() if key not in at}
    about.pop("name")
    others = [f"{key} {value:g}" for key, value in about.items()]
    print(", ".join([f"Robustness, {walker.label()}", *others]))
    for row, value in zip(rows, [at.get("slope")] if values is None else values, strict=True):
        print_measures(row, "" if value is None else f"{hyphenated(name)} {value:g}: ")
    print(f"  data set {out}, picture {figure}")


def print_measures(row: dict, where: str) -> None:
    """The answer of `robustness` on one slope, in words."""
    print(f"  {where}area {row['area']:.7g} +- {row['area_error']:.1g}")
    if row["at_border"]:
        print(f"    the basin reaches the border of the grid, in {row['at_border']} cells")
    if row["note"]:
        print(f"    {row['note']}")
    if row["gait"] is None:
        print("    no gait attracts")
        return
    gait, smallest = row["gait"], row["least_disturbance"]
    survived, dimension = row["basin_stability"], row["boundary_dimension"]
    print(f"    gait of period {gait['period']}, largest multiplier {gait['multiplier']:.6f}")
    print(f"    least disturbance {disturbance_in_words(smallest)}")
    if smallest["failure"] == "STRIDE" and row["least_fall"] is not None:
        fall = row["least_fall"]
        words = "none found" if fall["failure"] is None else disturbance_in_words(fall)
        print(f"    least one from which it falls {words}")
    if np.isfinite(row["step_down"]):  # it is not known of walkers in space
        down = f"{row['step_down']:.8f}"
        if row["step_down_failure"] == "STRIDE":
            down += f": leads to another motion; falls from {row['step_down_fall']:.8f}"
        print(f"    least step down {down}")
    print(
        f"    {survived['value']:.1%} ({survived['low']:.1%} to {survived['high']:.1%}) of "
        f"disturbances up to {survived['disturbances']:g} of the gait's state are survived; "
        f"half of them are over in {survived['median_strides']:g} strides, "
        f"95 of 100 in {survived['slowest_strides']:g}"
    )
    if survived["mean_strides"] is not None:  # a data set of an earlier version lacks it
        print(
            f"    {survived['in_time']:.1%} are over in 10 strides; on average they take "
            f"{survived['mean_strides']:.4g}, and small ones shrink by a factor of e in "
            f"{gait['return_strides']:.3g}; the largest that is survived is "
            f"{survived['largest_shock']:.3g}"
        )
    print(
        f"    dimension of the boundary {dimension['value']:.3f} "
        f"({dimension['low']:.3f} to {dimension['high']:.3f})"
    )
    if "steps_to_fall" in row:
        print_walks(row["steps_to_fall"])


def print_walks(walks: dict) -> None:
    """How long walks last on rough ground, in words."""
    mean, low, high = (
        "inf" if value is None or not np.isfinite(value) else f"{value:.4g}"
        for value in (walks["mean"], walks["low"], walks["high"])
    )
    print(
        f"    on ground with steps of standard deviation {walks['ground']:g} it falls after {mean} "
        f"strides on average ({low} to {high})"
    )


def disturbance_in_words(disturbance: dict) -> str:
    """A least disturbance in words."""
    end = "leads to another motion"
    if disturbance["failure"] is None:
        return "unknown: from all that were tried it returns"
    if disturbance["failure"] != "STRIDE":
        end = f"{disturbance['failure']} after {disturbance['strides']} strides"
    return f"{disturbance['size']:.8f} along ({listed(disturbance['direction'], '.4f')}): {end}"

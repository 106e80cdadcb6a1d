"""`walker-jax robustness`."""

from collections.abc import Iterator
from typing import Any

import walker_jax as wj
from walker_jax.cli import library as lib
from walker_jax.cli.answers import WALKING, Output, Terms, listed, request_for, slope_of, terms_of
from walker_jax.cli.commands import command
from walker_jax.cli.options import hyphenated, only_given, option, refuse, underscored
from walker_jax.cli.section import (
    asked_of,
    axes_of_region,
    axes_option,
    check_section,
    region_on,
)
from walker_jax.cli.walker_options import check_range


def region_of(walker: "wj.System", axes: dict[str, Any]) -> "wj.Grid | None":
    """Return the grid of the region; None for a `basin_region` of the system's own.

    The default for other systems is the region of their gaits.
    """
    grid = region_on(walker, axes)
    if type(walker).basin_region is not wj.System.basin_region:
        return grid
    check_section(walker, axes)
    return grid or lib.grid_along(axes_of_region(walker))


@command(
    examples=(
        "robustness --slope 0.009",
        "robustness --slope 0.009 --ground 0.0002",
        "robustness --from 0.002 --to 0.018 --count 17 --out slopes.zarr",
    ),
    time="Twenty seconds or more for each slope; minutes for walkers with knees.",
    out="robustness.zarr",
)
def robustness(
    walker: "wj.System",
    output: Output,
    parameter: str = option("slope", "The parameter of a table.", "--over", needs="low"),
    low: float | None = option(None, "Its lowest value.", "--from", needs="high"),
    high: float | None = option(None, "Its highest value.", "--to", needs="low"),
    count: int = option(20, "Rows of the table.", least=2, most=10_000, needs="low"),
    axes: dict[str, Any] = axes_option("Region"),
    levels: int = option(4, "Halve boundary cells this many times.", least=0, most=8),
    disturbances: float = option(
        0.1, "Largest disturbance for basin stability, as a share of the gait's state.", above=0
    ),
    strides: int = option(500, "Strides in which a walker may come back."),
    ground: float | None = option(
        None, "Standard deviation of steps of rough ground: how long walks last there.", least=0
    ),
    seed: int = option(0, "Seed of random numbers.", least=0),
):
    """Measure how large a disturbance a gait survives, on one slope or over many.

    The measures: the basin's area; the least disturbance from which the walker does not return to
    its gait, and the least from which it falls; the least step down; the fraction of random
    disturbances that it survives; the dimension of the boundary; and on rough ground the mean
    number of strides until it falls. The default region is --theta 0 0.7854 200, and for the
    simplest walker --sum -0.12 0.06 200, for others --sum -1.1 0.1 800.
    """
    name, values = underscored(parameter), None
    if low is not None and high is not None:
        check_range(walker, name, low, high)
        values = lib.space_decimals(low, high, count)
    if not lib.is_planar(walker):
        plane = f"is for walkers in the plane, not for {walker.label()}: leave it out"
        refuse(plane, ground=ground)
    how: Any = {"levels": levels, "disturbances": disturbances, "strides": strides}
    how |= only_given(ground=ground) | {"seed": seed}
    shape = walker.picture()
    if shape is not None and shape.axes == 3:
        how["check"] = lib.check_starts(walker, exact=True)
    grid = region_of(walker, axes)
    asked = {"over": values and {name: values}, "axes": asked_of(grid), **how}
    request = request_for("robustness", walker, without=[name] * bool(values), **asked)
    over: Any = {} if values is None else {"values": values, "parameter": name}
    picture = "robustness" if values is None else "robustness_table"
    measure = lambda: wj.robustness(walker, grid, progress=True, **over, **how)
    data = output.produce(request, measure, picture)
    about = request["walker"]
    at = [slope_of(about)] if values is None else [{name: value} for value in values]
    parts = [data] if values is None else [data.isel({name: i}) for i in range(len(values))]
    rows = [*map(lib.summarise_robustness, parts, at)]
    if values is None:
        answer, advice = rows[0], "--from and --to show how these depend on a parameter"
    else:
        answer = {"slopes" if name == "slope" else "values": rows}
        advice = "walker-jax optimise searches for the best between these values"
    yield {"walker": about} | answer
    shown = {key: value for key, value in about.items() if key not in at[0]}
    yield f"Robustness, {lib.write_description(shown)}"
    for row, place in zip(rows, at, strict=True):
        where = "".join(f"{hyphenated(key)} {value:g}: " for key, value in place.items())
        yield from measures_in_words(row, where, terms_of(walker))
    yield f"  {advice}."
    yield output.places()


def measures_in_words(row: dict, where: str, terms: Terms = WALKING) -> Iterator[str]:
    """Write the answer of `robustness` at one value of the parameter."""
    yield f"  {where}area {row['area']:.7g} +- {row['area_error']:.1g}"
    if row["at_border"]:
        yield f"    the basin reaches the border of the grid, in {row['at_border']} cells"
    if row["note"]:
        yield f"    {row['note']}"
    if row["gait"] is None:
        yield f"    no {terms.cycle} attracts"
        return
    gait, smallest = row["gait"], row["least_disturbance"]
    multiplier = f"largest multiplier {gait['multiplier']:.6f}"
    yield f"    {terms.cycle} of period {gait['period']}, {multiplier}"
    yield f"    least disturbance {disturbance_in_words(smallest, terms)}"
    if smallest["failure"] == "STRIDE" and row["least_fall"] is not None:
        fall = row["least_fall"]
        words = "none found" if fall["failure"] is None else disturbance_in_words(fall, terms)
        yield f"    least one from which it falls {words}"
    if row["step_down"] < float("inf"):  # it is not computed for walkers in space
        down = f"{row['step_down']:.8f}"
        if row["step_down_failure"] == "STRIDE":
            down += f": leads to another motion; falls from {row['step_down_fall']:.8f}"
        yield f"    least step down {down}"
    survived = row["basin_stability"]
    yield (
        f"    {survived['value']:.1%} ({survived['low']:.1%} to {survived['high']:.1%}) of "
        f"disturbances up to {survived['disturbances']:g} of the {terms.cycle}'s state are "
        f"survived; half of them are over in {survived['median_strides']:g} {terms.step}s, "
        f"95 of 100 in {survived['slowest_strides']:g}"
    )
    yield (
        f"    {survived['in_time']:.1%} are over in 10 {terms.step}s; on average they take "
        f"{survived['mean_strides']:.4g}, and small ones shrink by a factor of e in "
        f"{gait['return_strides']:.3g}; the largest that is survived is "
        f"{survived['largest_shock']:.3g}"
    )
    dimension = row["boundary_dimension"]
    interval = f"{dimension['low']:.3f} to {dimension['high']:.3f}"
    yield f"    dimension of the boundary {dimension['value']:.3f} ({interval})"
    if "steps_to_fall" in row:
        walks = row["steps_to_fall"]
        mean, low, high = (
            "inf" if walks[name] is None else f"{walks[name]:.4g}"
            for name in ("mean", "low", "high")
        )
        ground = f"on ground with steps of standard deviation {walks['ground']:g}"
        yield f"    {ground} it falls after {mean} strides on average ({low} to {high})"


def disturbance_in_words(disturbance: dict, terms: Terms) -> str:
    """Write a least disturbance."""
    end = "leads to another motion"
    if disturbance["failure"] is None:
        return "unknown: from all that were tried it returns"
    if disturbance["failure"] != "STRIDE":
        after = f"after {disturbance['strides']} {terms.step}s"
        end = f"{lib.outcome_in_words(disturbance['failure'])} {after}"
    return f"{disturbance['size']:.8f} along ({listed(disturbance['direction'], '.4f')}): {end}"

"""`walker-jax robustness`."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import walker_jax as wj
from walker_jax.basins.windows import grid_along
from walker_jax.checks import WrongUse
from walker_jax.cli.answers import Output, listed, request_for, slope_of
from walker_jax.cli.conclusions import conclude_robustness
from walker_jax.cli.groups import option
from walker_jax.cli.options import (
    check_finite,
    check_range,
    hyphenated,
    refuse,
    refuse_without_ground,
    underscored,
)
from walker_jax.cli.section import AXIS, Axis, Region, asked_of, axes_of_region, check_section
from walker_jax.cli.walker_options import takes_walker
from walker_jax.design.evaluation import check_starts
from walker_jax.grids import Grid
from walker_jax.stability.robustness_fields import summarise_robustness
from walker_jax.systems.outcomes import outcome_in_words
from walker_jax.systems.system import System
from walker_jax.walkers.parameters import space_decimals, write_description


@dataclass(frozen=True)
class BasinRegion(Region):
    theta: Axis | None = option(None, "Stance angle, rad (default: 0 0.7854 200).", **AXIS)
    sum: Axis | None = option(
        None,
        "theta + thetadot (simplest: -0.12 0.06 200, else -1.1 0.1 800).",
        **AXIS,
    )

    def grid(self, walker: System) -> Grid | None:
        """Return the grid of the region; None for a `basin_region` of the system's own.

        The default for other systems is the region of their gaits.
        """
        grid = super().grid(walker)
        if type(walker).basin_region is not System.basin_region:
            return grid
        check_section(walker, self.axis)
        return grid or grid_along(axes_of_region(walker))


@dataclass(frozen=True)
class Options:
    theme = "Measures"
    levels: int = option(4, "Halve boundary cells this many times.", min=0, max=8)
    disturbances: float = option(
        0.1, "Largest disturbance for basin stability, as a share of the gait's state."
    )
    strides: int = option(500, "Strides in which a walker may come back.", min=1)
    ground: float | None = option(
        None,
        "Standard deviation of steps of rough ground: how long walks last there.",
        min=0,
    )
    seed: int = option(0, "Seed of random numbers.", min=0)

    def settings(self, walker: System) -> dict[str, Any]:
        """Return the arguments of the library's `robustness`."""
        check_finite(disturbances=self.disturbances, ground=self.ground)
        if self.disturbances <= 0:
            raise WrongUse(f"--disturbances must be above 0, not {self.disturbances}")
        refuse_without_ground(walker, ground=self.ground)
        given = {name: value for name, value in vars(self).items() if value is not None}
        picture = walker.picture()
        if picture is not None and picture.axes == 3:
            given["check"] = check_starts(walker, exact=True)
        return given


@dataclass(frozen=True)
class Table:
    theme = "Slopes"
    over: str = option("slope", "The parameter of a table, with --from and --to.", metavar="NAME")
    low: float | None = option(None, "Lowest slope, or value, of a table.", "--from")
    high: float | None = option(None, "Highest.", "--to")
    count: int | None = option(None, "Rows of the table (default: 20).", min=2)

    def values(self, walker: System) -> list[float] | None:
        """Return the values of the parameter; None without a table."""
        name = underscored(self.over)
        if (self.low is None) != (self.high is None):
            raise WrongUse("--from and --to are for a table: give both or none")
        if self.low is None or self.high is None:
            over = None if name == "slope" else name
            refuse("is for a table: give --from and --to too", count=self.count, over=over)
            return None
        check_range(walker, name, self.low, self.high)
        return space_decimals(self.low, self.high, self.count or 20)


@takes_walker(systems=True, ranges_over="over", or_one_value=True)
def robustness(
    walker: System,
    table: Table,
    region: BasinRegion,
    options: Options,
    output: Output = Output(Path("robustness.zarr")),
) -> None:
    """Measure how large a disturbance a gait survives, on one slope or over many.

    The measures: the basin's area; the least disturbance from which the walker does not return to
    its gait, and the least from which it falls; the least step down; the fraction of random
    disturbances that it survives; the dimension of the boundary; and on rough ground the mean
    number of strides until it falls.
    """
    name, values = underscored(table.over), table.values(walker)
    how, grid = options.settings(walker), region.grid(walker)
    asked = {"over": values and {name: values}, "axes": asked_of(grid), **how}
    request = request_for("robustness", walker, without=[name] * bool(values), **asked)
    measure: Any = partial(wj.robustness, walker)
    if values is not None:
        measure = partial(wj.robustness_table, walker, values, name)
    picture = "robustness" if values is None else "robustness_table"
    data = output.produce(request, lambda: measure(grid, progress=True, **how), picture)
    about = request["walker"]
    if values is None:
        at = slope_of(about)
        answer: dict[str, Any] = summarise_robustness(data, at)
        rows, places = [answer], [f"slope {value:g}: " for value in at.values()] or [""]
        about = {key: value for key, value in about.items() if key not in at}
    else:
        rows = [
            summarise_robustness(data.isel({name: i}), {name: value})
            for i, value in enumerate(values)
        ]
        answer = {"slopes" if name == "slope" else "values": rows}
        places = [f"{hyphenated(name)} {value:g}: " for value in values]
    lines = [f"Robustness, {write_description(about)}"]
    for row, place in zip(rows, places, strict=True):
        lines += measures_in_words(row, place)
    lines.append(f"  {conclude_robustness(rows, hyphenated(name))}")
    output.tell({"walker": request["walker"]} | answer, lines)


def measures_in_words(row: dict, where: str) -> Iterator[str]:
    """Write the answer of `robustness` at one value of the parameter."""
    yield f"  {where}area {row['area']:.7g} +- {row['area_error']:.1g}"
    if row["at_border"]:
        yield f"    the basin reaches the border of the grid, in {row['at_border']} cells"
    if row["note"]:
        yield f"    {row['note']}"
    if row["gait"] is None:
        yield "    no gait attracts"
        return
    gait, smallest = row["gait"], row["least_disturbance"]
    yield f"    gait of period {gait['period']}, largest multiplier {gait['multiplier']:.6f}"
    yield f"    least disturbance {disturbance_in_words(smallest)}"
    if smallest["failure"] == "STRIDE" and row["least_fall"] is not None:
        fall = row["least_fall"]
        words = "none found" if fall["failure"] is None else disturbance_in_words(fall)
        yield f"    least one from which it falls {words}"
    if np.isfinite(row["step_down"]):  # it is not computed for walkers in space
        down = f"{row['step_down']:.8f}"
        if row["step_down_failure"] == "STRIDE":
            down += f": leads to another motion; falls from {row['step_down_fall']:.8f}"
        yield f"    least step down {down}"
    yield from returns_in_words(row["basin_stability"], gait)
    dimension = row["boundary_dimension"]
    interval = f"{dimension['low']:.3f} to {dimension['high']:.3f}"
    yield f"    dimension of the boundary {dimension['value']:.3f} ({interval})"
    if "steps_to_fall" in row:
        yield walks_in_words(row["steps_to_fall"])


def returns_in_words(survived: dict, gait: dict) -> Iterator[str]:
    """Describe which disturbances are survived, and how soon they decay."""
    yield (
        f"    {survived['value']:.1%} ({survived['low']:.1%} to {survived['high']:.1%}) of "
        f"disturbances up to {survived['disturbances']:g} of the gait's state are survived; "
        f"half of them are over in {survived['median_strides']:g} strides, "
        f"95 of 100 in {survived['slowest_strides']:g}"
    )
    yield (
        f"    {survived['in_time']:.1%} are over in 10 strides; on average they take "
        f"{survived['mean_strides']:.4g}, and small ones shrink by a factor of e in "
        f"{gait['return_strides']:.3g}; the largest that is survived is "
        f"{survived['largest_shock']:.3g}"
    )


def walks_in_words(walks: dict) -> str:
    """Write how long walks last on rough ground."""
    mean, low, high = (
        "inf" if value is None or not np.isfinite(value) else f"{value:.4g}"
        for value in (walks["mean"], walks["low"], walks["high"])
    )
    return (
        f"    on ground with steps of standard deviation {walks['ground']:g} it falls after {mean} "
        f"strides on average ({low} to {high})"
    )


def disturbance_in_words(disturbance: dict) -> str:
    """Write a least disturbance."""
    end = "leads to another motion"
    if disturbance["failure"] is None:
        return "unknown: from all that were tried it returns"
    if disturbance["failure"] != "STRIDE":
        end = f"{outcome_in_words(disturbance['failure'])} after {disturbance['strides']} strides"
    return f"{disturbance['size']:.8f} along ({listed(disturbance['direction'], '.4f')}): {end}"

"""`walker-jax sweep`."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import walker_jax as wj
from walker_jax.checks import WrongUse
from walker_jax.cli.answers import Output, request_for
from walker_jax.cli.conclusions import conclude_sweep
from walker_jax.cli.groups import option
from walker_jax.cli.options import Pieces, read_range, refuse_again
from walker_jax.cli.section import Volume, asked_of
from walker_jax.cli.walker_options import takes_walker
from walker_jax.design.results import tabulate_sweep
from walker_jax.design.sweeps import MAX_COMBINATIONS, check_values
from walker_jax.systems.system import System
from walker_jax.walkers.parameters import space_decimals

if TYPE_CHECKING:
    import pandas

GAIT = "total_area", "total_area_error", "gait_period", "multiplier", "speed", "failed"
SHOWN = *GAIT, "least_disturbance", "least_fall", "step_down", "step_down_fall"
"""Columns that are printed; the data set has more."""


@dataclass(frozen=True)
class Options:
    theme = "Combinations"
    over: list[str] | None = option(
        None, "Values of a parameter; give it again for others.", metavar="NAME=LO:HI:N"
    )
    levels: int = option(2, "Levels of refinement of the areas.", min=0)
    check: int = option(500_000, "Starts that check each area.", min=0)
    robust: bool = option(False, "All numbers of `robustness` too; half a minute each.")
    strides: int = option(200, "Strides at most.", min=1)
    seed: int = option(0, "Seed of random numbers.", min=0)


@takes_walker(systems=True)
def sweep(
    walker: System,
    options: Options,
    region: Volume,
    pieces: Pieces,
    output: Output = Output(Path("sweep.zarr")),
) -> None:
    """Compute basins, gaits and areas over one or more parameters, all combinations of them.

    Results are saved as they are computed: the same command resumes an interrupted run. The picture
    shows the area over the first two parameters.
    """
    values = values_of(options.over or [])
    if not values:
        raise WrongUse("--over is required: a parameter and its values, such as slope=0.002:0.01:5")
    check_values(walker, {name: np.array(given) for name, given in values.items()})
    cluster, grid = pieces.cluster(), region.grid(walker)
    how: Any = vars(options) | {"over": values}
    request = request_for("sweep", walker, without=values, axes=asked_of(grid), **how)
    how |= {"cluster": cluster, "progress": True, **output.place(request)}
    data = output.produce(request, lambda: wj.sweep(walker, grid=grid, **how), "sweep", kept=True)
    rows = tabulate_sweep(data, [*values])
    answer = {"walker": request["walker"], "points": rows.to_dict(orient="records")}
    output.tell(answer, rows_in_words(rows, [*values]))


def rows_in_words(rows: "pandas.DataFrame", names: list[str]) -> Iterator[str]:
    """Write the table of `sweep` over these parameters, and its notes."""
    shown = [name for name in (*names, *SHOWN) if name in rows]
    yield rows[shown].map("{:.6g}".format).to_string(index=False)
    for row in rows.to_dict(orient="records"):
        where = ", ".join(f"{name} {row[name]:.6g}" for name in names)
        if row["failed"]:
            yield f"  failed at {where}: {row.get('reason') or 'no reason was kept'}"
        if row.get("note"):
            yield f"  {where}: {row['note']}"
    yield f"  {conclude_sweep(rows.to_dict(orient='records'), names)}"


def values_of(over: list[str]) -> dict[str, list[float]]:
    """Read the values of each parameter that --over names."""
    values: dict[str, list[float]] = {}
    for text in over:
        name, low, high, count = read_range("--over", text)
        refuse_again("--over", name, values)
        if count > MAX_COMBINATIONS:
            raise WrongUse(f"--over {text} must have N of at most {MAX_COMBINATIONS}")
        values[name] = space_decimals(low, high, count)
    return values

"""`walker-jax continuation`."""

from pathlib import Path
from typing import Annotated

import typer

import walker_jax as wj
from walker_jax import storage
from walker_jax.checks import WrongUse
from walker_jax.cli.answers import draw, find_earlier, print_json, request_for
from walker_jax.cli.options import (
    Axes,
    Json,
    Out,
    Overwrite,
    PictureOfData,
    RegionSum,
    RegionTheta,
    SlicePlace,
    asked_of,
    grid_from,
    hyphenated,
)
from walker_jax.cli.sweep_command import values_of
from walker_jax.cli.walker_options import takes_walker
from walker_jax.stability.basin_fractions import summarise_fractions
from walker_jax.systems.system import System
from walker_jax.walkers.model import Walker
from walker_jax.walkers.parameters import check_parameter, describe_walker

DEFAULT = "slope=0.002:0.02:37"
"""The slopes over which walkers are followed."""


@takes_walker(systems=True)
def continuation(
    walker: System,
    over: Annotated[
        str, typer.Option(metavar="NAME=LO:HI:N", help="Values of a parameter.")
    ] = DEFAULT,
    theta: RegionTheta = None,
    sum_: RegionSum = None,
    at_phidot: SlicePlace = None,
    axis: Axes = None,
    samples: Annotated[int, typer.Option(min=1, help="Starts in the region.")] = 100_000,
    strides: Annotated[int, typer.Option(min=1, help="Strides at most.")] = 500,
    seed: Annotated[int, typer.Option(min=0, help="Of the starts.")] = 0,
    out: Out = Path("continuation.zarr"),
    figure: PictureOfData = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Follow the attractors over a parameter, and the fractions of a region that converge to each.

    A gait keeps its number along its branch: it is born and it ends at folds and period doublings.
    """
    from walker_jax import figures

    if over == DEFAULT and not isinstance(walker, Walker):
        raise WrongUse("--over is required: a parameter of the system and its values, NAME=LO:HI:N")
    ((name, values),) = values_of([over]).items()
    check_parameter(walker, name, *values)
    region = grid_from(walker, theta, sum_, at_phidot, axis=axis)
    about = {key: value for key, value in describe_walker(walker).items() if key != name}
    options = {"samples": samples, "strides": strides, "seed": seed}
    asked = {"over": {name: values}, "axes": asked_of(region)}
    request = request_for("continuation", walker, walker=about, **asked, **options)
    figure, data = find_earlier(out, figure, request, overwrite=overwrite)
    if data is None:
        data = wj.continue_basins(walker, name, values, region, progress=True, **options)
        data = storage.save(data, out, request)
    draw(figures.basin_fractions(data), figure, request)
    answer = summarise_fractions(data)
    if as_json:
        print_json({"walker": about, "parameter": name} | answer)
        return
    print(f"Attractors of {about['name']}, {hyphenated(name)} from {values[0]:g} to {values[-1]:g}")
    for one in answer["attractors"]:
        period = f"period {one['period']}" if one["period"] else "no period"
        print(
            f"  {one['number']}: {period}, from {one['first']:g} to {one['last']:g}; "
            f"at most {one['largest_fraction']:.3%} of the region"
        )
    for event in answer["bifurcations"]:
        kind = "fold" if event["kind"] == "fold" else "period doubling"
        print(f"    {kind} of {event['attractor']} at {event['value']:.12f}")
    print(f"  data set {out}, picture {figure}")

"""`walker-jax continuation`."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import walker_jax as wj
from walker_jax.checks import WrongUse
from walker_jax.cli.answers import Output, request_for
from walker_jax.cli.conclusions import conclude_continuation
from walker_jax.cli.groups import option
from walker_jax.cli.options import hyphenated
from walker_jax.cli.section import Region, asked_of
from walker_jax.cli.sweep_command import values_of
from walker_jax.cli.walker_options import takes_walker
from walker_jax.stability.basin_fractions import summarise_fractions
from walker_jax.systems.system import System
from walker_jax.walkers.parameters import check_parameter

DEFAULT = "slope=0.002:0.02:37"
"""The slopes over which walkers are followed."""


@dataclass(frozen=True)
class Options:
    theme = "Continuation"
    over: str = option(DEFAULT, "Values of a parameter.", metavar="NAME=LO:HI:N")
    samples: int = option(100_000, "Starts in the region.", min=1)
    strides: int = option(500, "Strides at most.", min=1)
    seed: int = option(0, "Of the starts.", min=0)


@takes_walker(systems=True)
def continuation(
    walker: System,
    options: Options,
    region: Region,
    output: Output = Output(Path("continuation.zarr")),
) -> None:
    """Follow the attractors over a parameter, and the fractions of a region that converge to each.

    A gait keeps its number along its branch: it is born and it ends at folds and period doublings.
    """
    if options.over == DEFAULT and "slope" not in walker.spans:
        raise WrongUse("--over is required: a parameter of the system and its values, NAME=LO:HI:N")
    ((name, values),) = values_of([options.over]).items()
    check_parameter(walker, name, *values)
    how = {"samples": options.samples, "strides": options.strides, "seed": options.seed}
    grid = region.grid(walker)
    asked = {"over": {name: values}, "axes": asked_of(grid)}
    request = request_for("continuation", walker, without=[name], **asked, **how)
    data = output.produce(
        request,
        lambda: wj.continue_basins(walker, name, values, grid, progress=True, **how),
        "basin_fractions",
    )
    answer = summarise_fractions(data)
    about = request["walker"]
    ends = f"{hyphenated(name)} from {values[0]:g} to {values[-1]:g}"
    lines = [f"Attractors of {about['name']}, {ends}", *attractors_in_words(answer)]
    output.tell({"walker": about, "parameter": name} | answer, lines)


def attractors_in_words(answer: dict) -> Iterator[str]:
    """Write the answer of `continuation`."""
    for one in answer["attractors"]:
        period = f"period {one['period']}" if one["period"] else "no period"
        span = f"from {one['first']:g} to {one['last']:g}"
        most = f"at most {one['largest_fraction']:.3%} of the region"
        yield f"  {one['number']}: {period}, {span}; {most}"
    for event in answer["bifurcations"]:
        kind = "fold" if event["kind"] == "fold" else "period doubling"
        yield f"    {kind} of {event['attractor']} at {event['value']:.12f}"
    yield f"  {conclude_continuation(answer['attractors'])}"

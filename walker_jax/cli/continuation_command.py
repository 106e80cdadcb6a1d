"""`walker-jax continuation`."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import walker_jax as wj
from walker_jax.cli.answers import Output, Terms, request_for, terms_of
from walker_jax.cli.commands import command
from walker_jax.cli.options import RANGE, Group, Named, hyphenated, option, whole
from walker_jax.cli.section import Region, asked_of
from walker_jax.cli.sweep_command import values_of
from walker_jax.refusals import WrongUse

DEFAULT = "slope", (0.002, 0.02, 37)
"""The slopes over which walkers are followed."""


class Continuation(Group, theme="Continuation"):
    over: Any = option("slope=0.002:0.02:37", "Values of a parameter.", type=Named(RANGE))
    samples: int = whole(100_000, "Starts in the region.")
    strides: int = whole(500, "Strides at most.")
    seed: int = whole(0, "Of the starts.", least=0)


@command(
    *(Continuation, Region, Output(Path("continuation.zarr"))),
    examples=(
        "continuation --over slope=0.002:0.02:37",
        "continuation --walker powered --slope 0 --over push-off=0.02:0.1:17 --out powered.zarr",
    ),
    time="A minute or two for the example.",
)
def continuation(walker: "wj.System", asked: Continuation, region: Region, output: Output) -> None:
    """Follow the attractors over a parameter, and the fractions of a region that converge to each.

    A gait keeps its number along its branch: it is born and it ends at folds and period doublings.
    """
    from walker_jax.stability.basin_fractions import summarise_fractions
    from walker_jax.walkers.parameters import check_parameter

    if asked.over == DEFAULT and "slope" not in walker.spans:
        raise WrongUse(
            f"--over is required: a parameter of the system and its values, NAME={RANGE}"
        )
    ((name, values),) = values_of(dict([asked.over])).items()
    check_parameter(walker, name, *values)
    how: Any = {"samples": asked.samples, "strides": asked.strides, "seed": asked.seed}
    grid = region.grid(walker)
    about_axes = {"over": {name: values}, "axes": asked_of(grid)}
    request = request_for("continuation", walker, without=[name], **about_axes, **how)
    data = output.produce(
        request,
        lambda: wj.continue_basins(walker, name, values, grid, progress=True, **how),
        "basin_fractions",
    )
    answer, about = summarise_fractions(data), request["walker"]
    ends = f"{hyphenated(name)} from {values[0]:g} to {values[-1]:g}"
    lines = [
        f"Attractors of {about['name']}, {ends}",
        *attractors_in_words(answer, terms_of(walker)),
    ]
    output.tell({"walker": about, "parameter": name} | answer, lines)


def attractors_in_words(answer: dict, terms: Terms) -> Iterator[str]:
    """Write the answer of `continuation`."""
    for one in answer["attractors"]:
        period = f"period {one['period']}" if one["period"] else "no period"
        span = f"from {one['first']:g} to {one['last']:g}"
        most = f"at most {one['largest_fraction']:.3%} of the region"
        yield f"  {one['number']}: {period}, {span}; {most}"
    for event in answer["bifurcations"]:
        kind = "fold" if event["kind"] == "fold" else "period doubling"
        yield f"    {kind} of {event['attractor']} at {event['value']:.12f}"
    if answer["attractors"]:
        yield "  More --samples make these fractions more precise."
    else:
        yield f"  No start converges: try another --over, or a region that holds a {terms.cycle}."

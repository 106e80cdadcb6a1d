"""`walker-jax continuation`."""

from collections.abc import Iterator
from typing import Any

import walker_jax as wj
from walker_jax.cli import library as lib
from walker_jax.cli.answers import Output, Terms, request_for, terms_of
from walker_jax.cli.commands import command
from walker_jax.cli.options import RANGE, Named, hyphenated, option
from walker_jax.cli.section import asked_of, axes_option, region_on
from walker_jax.cli.sweep_command import values_of
from walker_jax.refusals import WrongUse

DEFAULT = "slope", (0.002, 0.02, 37)
"""The slopes over which walkers are followed."""


@command(
    examples=(
        "continuation --over slope=0.002:0.02:37",
        "continuation --walker powered --slope 0 --over push-off=0.02:0.1:17 --out powered.zarr",
    ),
    time="A minute or two for the example.",
    out="continuation.zarr",
)
def continuation(
    walker: "wj.System",
    output: Output,
    parameter: Any = option(
        "slope=0.002:0.02:37", "Values of a parameter.", "--over", type=Named(RANGE)
    ),
    axes: dict[str, Any] = axes_option("Region"),
    samples: int = option(100_000, "Starts in the region."),
    strides: int = option(500, "Strides at most."),
    seed: int = option(0, "Of the starts.", least=0),
):
    """Follow the attractors over a parameter, and the fractions of a region that converge to each.

    A gait keeps its number along its branch: it is born and it ends at folds and period doublings.
    The default region is all of the section.
    """
    if parameter == DEFAULT and "slope" not in walker.spans:
        raise WrongUse(
            f"--over is required: a parameter of the system and its values, NAME={RANGE}"
        )
    ((name, values),) = values_of(dict([parameter])).items()
    how: Any = {"samples": samples, "strides": strides, "seed": seed}
    grid = region_on(walker, axes)
    asked_for = {"over": {name: values}, "axes": asked_of(grid), **how}
    request = request_for("continuation", walker, without=[name], **asked_for)
    compute = lambda: wj.continue_basins(walker, name, values, grid, progress=True, **how)
    answer = lib.summarise_fractions(output.produce(request, compute, "basin_fractions"))
    about = request["walker"]
    yield {"walker": about, "parameter": name} | answer
    span = f"{hyphenated(name)} from {values[0]:g} to {values[-1]:g}"
    yield f"Attractors of {about['name']}, {span}"
    yield from attractors_in_words(answer, terms_of(walker))
    yield output.places()


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

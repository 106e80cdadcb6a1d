"""`walker-jax chart`."""

from collections.abc import Iterator
from typing import Any

import walker_jax as wj
from walker_jax.cli import library as lib
from walker_jax.cli.answers import Output, Terms, listed, request_for, terms_of
from walker_jax.cli.commands import command
from walker_jax.cli.options import RANGE, Axis, hyphenated, named, option
from walker_jax.cli.section import start_on, start_option
from walker_jax.refusals import WrongUse


@command(
    examples=(
        "chart --walker spring --over slope=0.001:0.1:120 --over hip-stiffness=0:1:90",
        "chart --walker round-foot --foot-radius 0.1 --over slope=0.001:0.2:120 "
        "--over foot-radius=0:0.5:90",
        "chart --system henon --a 0.1 --over a=-0.5:1.5:120 --over b=-0.5:0.6:90",
    ),
    time="Half a minute; a minute for walkers with mass on their legs.",
    out="chart.zarr",
)
def chart(
    walker: "wj.System",
    output: Output,
    over: dict[str, Axis] = named(
        "A parameter, its ends and number of cells: give two.",
        RANGE,
        sets={"parameter": "--over", "cells": "the N of --over"},
    ),
    start: dict[str, float] = start_option("Where the search for the gait begins"),
    period_max: int = option(4, "Longest period of which curves are followed.", most=64),
    strides: int = option(1000, "Strides before the period is read."),
):
    """Chart two parameters: curves of bifurcations, and the periods of attractors between them.

    The gait is followed from the walker's own values of both, which the ranges must hold.
    """
    for name, (low, high, count) in over.items():
        lib.check_parameter(walker, name, low, high)
        own, typed = float(lib.value_of(walker, name)), hyphenated(name)
        if not low <= own <= high:
            ends = f"{typed}={low:g}:{high:g}:{count}"
            raise WrongUse(f"--over {ends} must hold the {typed} {own:g}")
    if len(over) != 2:
        raise WrongUse(f"--over is required twice: two parameters, each as NAME={RANGE}")
    bounds = {name: (low, high) for name, (low, high, _) in over.items()}
    cells = tuple(count for *_, count in over.values())
    how: Any = {"cells": cells, "period_max": period_max, "strides": strides}
    guess, ranges = [*start_on(walker, start).values()] or None, {**over}
    request = request_for("chart", walker, start=guess, over=ranges, **how)

    def compute():
        gait, *_ = lib.selection.select_gaits(walker, guess=guess, instead="try another start")
        return wj.chart(walker, bounds, gait, progress=True, **how)

    answer = lib.summarise_chart(output.produce(request, compute, "chart"))
    about = request["walker"]
    yield {"walker": about, "parameters": [*bounds]} | answer
    yield f"Bifurcations of {about['name']} over {' and '.join(map(hyphenated, bounds))}"
    yield from chart_in_words(answer, [*bounds], terms_of(walker))
    yield output.places()


def chart_in_words(answer: dict, names: list[str], terms: Terms) -> Iterator[str]:
    """Write the answer of `chart`."""
    for curve in answer["curves"]:
        told = "".join(f", {one}" for one in curve["criticality"])
        yield f"  {curve['kind']} of period {curve['period']}{told}:"
        for end in curve["ends"]:
            place = listed(end["values"], ".9f")
            reason = end["reason"].replace("gait", terms.cycle).replace("stride", terms.step)
            yield f"    to ({place}): {reason}"
        for one in curve["special"]:
            yield f"    {one['kind']} at ({listed(one['values'], '.12f')})"
    if not answer["curves"]:
        yield f"  no bifurcation over {' or '.join(map(hyphenated, names))}"
    shares = ", ".join(f"{name} {share:.1%}" for name, share in answer["cells"].items())
    yield f"  cells: {shares.replace('gait', terms.cycle)}"
    yield f"  walker-jax bifurcation shows all {terms.cycle}s along one parameter."

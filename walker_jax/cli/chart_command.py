"""`walker-jax chart`."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import walker_jax as wj
from walker_jax.checks import WrongUse
from walker_jax.cli.answers import Output, listed, request_for
from walker_jax.cli.conclusions import conclude_chart
from walker_jax.cli.groups import option
from walker_jax.cli.options import RANGE_FORM, hyphenated, read_range, refuse_again
from walker_jax.cli.section import START, start_from, state_from
from walker_jax.cli.walker_options import takes_walker
from walker_jax.gaits.gait_summary import summarise_chart
from walker_jax.gaits.selection import select_gaits
from walker_jax.systems.system import System
from walker_jax.walkers.parameters import check_parameter, value_of


@dataclass(frozen=True)
class Options:
    theme = "Chart"
    over: list[str] | None = option(
        None, "A parameter, its ends and number of cells: give two.", metavar=RANGE_FORM
    )
    start: list[str] | None = START
    period_max: int = option(4, "Longest period of which curves are followed.", min=1, max=64)
    strides: int = option(1000, "Strides before the period is read.", min=1)

    def ranges(self, system: System) -> dict[str, tuple[float, float, int]]:
        """Return the ends and the number of cells of each of two parameters."""
        found: dict[str, tuple[float, float, int]] = {}
        for text in self.over or ():
            name, low, high, count = read_range("--over", text)
            refuse_again("--over", name, found)
            check_parameter(system, name, low, high)
            own = float(value_of(system, name))
            if not low <= own <= high:
                raise WrongUse(f"--over {text} must hold the {hyphenated(name)} {own:g}")
            found[name] = low, high, count
        if len(found) != 2:
            raise WrongUse(f"--over is required twice: two parameters, each as {RANGE_FORM}")
        return found


@takes_walker(systems=True)
def chart(
    walker: System,
    options: Options,
    output: Output = Output(Path("chart.zarr")),
) -> None:
    """Chart two parameters: curves of bifurcations, and the periods of attractors between them.

    The gait is followed from the walker's own values of both, which the ranges must hold.
    """
    ranges = options.ranges(walker)
    how: dict[str, Any] = {
        "cells": tuple(count for *_, count in ranges.values()),
        "period_max": options.period_max,
        "strides": options.strides,
    }
    bounds = {name: (low, high) for name, (low, high, _) in ranges.items()}
    begin = state_from(walker, start_from(walker, options.start)) if options.start else None
    asked = {
        "start": None if begin is None else begin.tolist(),
        "over": {name: list(ends) for name, ends in ranges.items()},
    }
    request = request_for("chart", walker, **asked, **{**how, "cells": list(how["cells"])})

    def compute():
        (gait, *_) = select_gaits(walker, guess=begin, instead="try another --start")
        return wj.chart(walker, bounds, gait, progress=True, **how)

    data = output.produce(request, compute, "chart")
    answer = summarise_chart(data)
    about = request["walker"]
    title = f"Bifurcations of {about['name']} over {' and '.join(map(hyphenated, ranges))}"
    lines = [title, *chart_in_words(answer, [*ranges])]
    output.tell({"walker": about, "parameters": [*ranges]} | answer, lines)


def chart_in_words(answer: dict, names: list[str]) -> Iterator[str]:
    """Write the answer of `chart`."""
    for curve in answer["curves"]:
        told = ", ".join(curve["criticality"])
        yield f"  {curve['kind']} of period {curve['period']}{f', {told}' if told else ''}:"
        for end in curve["ends"]:
            place = listed(end["values"], ".9f")
            yield f"    to ({place}): {end['reason']}"
        for one in curve["special"]:
            yield f"    {one['kind']} at ({listed(one['values'], '.12f')})"
    if not answer["curves"]:
        yield f"  no bifurcation over {' or '.join(map(hyphenated, names))}"
    shares = ", ".join(f"{name} {share:.1%}" for name, share in answer["cells"].items())
    yield f"  cells: {shares}"
    yield f"  {conclude_chart(len(answer['curves']), len(answer['cells']))}"

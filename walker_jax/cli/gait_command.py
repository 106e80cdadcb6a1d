"""`walker-jax gait`."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click

import walker_jax as wj
from walker_jax.cli.answers import Files, draw, is_map, listed, request_for, slope_of, terms_of
from walker_jax.cli.commands import command
from walker_jax.cli.options import Group, Number, number, option, place, refuse, whole
from walker_jax.cli.section import (
    PHIDOT,
    check_start,
    has_own_options,
    refuse_own,
    start_option,
    state_from,
)
from walker_jax.cli.unit_options import InUnits, Sizes


class Search(Group, theme="Search"):
    """The kind of gaits to search for, and the start of the search."""

    period: int = whole(1, "Strides in a cycle.")
    all: bool = option(False, "All gaits of the period, stable or not.")
    guess: tuple[float, float] | None = option(
        None,
        "Where the search begins.",
        type=click.Tuple([Number(), Number()]),
        metavar="THETA THETADOT",
        excludes=("start", "all"),
    )
    phidot: float | None = number(None, f"{PHIDOT}: with --guess.")
    start: dict[str, float] = start_option("all", "phidot")

    def coordinates(self, walker: "wj.System") -> dict[str, float]:
        """Return the coordinates of the state in which the search begins, if it is given."""
        refuse_own(walker, guess=self.guess, phidot=self.phidot)
        check_start(walker, self.start)
        if self.start:
            return self.start
        if self.guess is None:
            refuse("is for --guess alone: give it too", phidot=self.phidot)
            return {}
        given = dict(zip(("theta", "thetadot"), self.guess, strict=True))
        return given | ({} if self.phidot is None else {"phidot": self.phidot})

    def instead(self, walker: "wj.System") -> str:
        """Return the advice to give if no gait is found."""
        if self.guess is not None or self.start:
            return f"try another {'--start' if self.start else '--guess'}"
        form = "--guess THETA THETADOT" if has_own_options(walker) else "--start NAME=VALUE"
        return f"try {form}"


class Picture(Group, theme="Picture"):
    figure: Path | None = place("Where a picture of the Floquet multipliers goes.")


@command(
    *(Search, Picture, InUnits, Files),
    examples=(
        "gait --slope 0.009",
        "gait --walker round-foot --foot-radius 0.3 --figure multipliers.png",
        "gait --walker kneed",
        "gait --walker powered --slope 0 --push-off 0.05",
        "gait --slope 0.0125 --period 3 --all",
        "gait --slope 0.009 --units length=0.8 --units mass=10",
        "gait --system duffing --start x=-1.3 --start v=-0.2 --period 3",
    ),
    time="A few seconds; twenty for walkers with mass on their legs, when they are compiled.",
)
def gait(
    walker: "wj.System", search: Search, picture: Picture, units: InUnits, files: Files
) -> None:
    """Find the gaits of a walker: cycles of strides, and their stability."""
    from walker_jax.execution.progress import bar
    from walker_jax.gaits import selection
    from walker_jax.gaits.gait_summary import summarise_gait
    from walker_jax.walkers.parameters import describe_briefly

    given, figure, sizes = search.coordinates(walker), picture.figure, units.of(walker)
    begin = state_from(walker, given) if given else None
    guess = None if begin is None else begin.tolist()
    request = request_for("gait", walker, period=search.period, guess=guess, all=search.all)
    files.check_figure(figure, request)
    with bar(f"search for {terms_of(walker).cycle}s", True):
        how: Any = {"every": search.all, "instead": search.instead(walker)}
        found = selection.select_gaits(walker, search.period, begin, **how)
    if figure is not None:
        from walker_jax import figures

        title = f"{describe_briefly(walker)}: Floquet multipliers"
        draw(figures.multipliers(found, title=title), figure, request)
    about, stable = request["walker"], sum(bool(one.stable) for one in found)
    found = [
        one._replace(
            states=sizes.states(one.states, walker.section), step_times=sizes.times(one.step_times)
        )
        for one in found
    ]
    answer = {"gaits": [summarise_gait(one) for one in found], "walker": about, **sizes.named}
    lines = [line for one in found for line in gait_in_words(walker, about, one, sizes)]
    if stable:
        which = "it" if len(found) == 1 else f"{stable} of these {len(found)}"
        lines.append(f"Nearby starts converge to {which}: walker-jax basin shows from where.")
    else:
        lines.append("None is stable: walker-jax bifurcation shows where one is.")
    lines += [] if figure is None else [f"picture {figure}"]
    files.tell(slope_of(about) | answer, lines)


def gait_in_words(walker: "wj.System", about: dict, gait: "wj.Gait", sizes: Sizes) -> Iterator[str]:
    """Write the stability of a gait, and a line for each stride; a map's steps have no time."""
    noun = terms_of(walker).cycle
    kind, period = "stable" if gait.stable else "unstable", len(gait.states)
    where = f"at slope {about['slope']:g} rad" if "slope" in about else f"of {about['name']}"
    multipliers = listed(gait.multipliers, ".8g")
    yield f"{kind} {noun} of period {period} {where}, multipliers {multipliers}"
    timeless = is_map(walker, gait.step_times)
    for state, duration in zip(gait.states, gait.step_times, strict=True):
        pairs = zip(walker.section, state, strict=True)
        coordinates = "  ".join(f"{name} {value:.13f}{sizes.unit(name)}" for name, value in pairs)
        time = f"  step time {duration:.10f}{sizes.unit('time')}"
        yield f"  {coordinates}" + ("" if timeless else time)

"""`walker-jax gait`."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import walker_jax as wj
from walker_jax.cli import library as lib
from walker_jax.cli.answers import (
    Files,
    check_picture,
    draw,
    is_map,
    listed,
    request_for,
    slope_of,
    terms_of,
)
from walker_jax.cli.commands import command
from walker_jax.cli.options import Group, option, refuse
from walker_jax.cli.section import PHIDOT, check_start, has_own_options, start_option, state_from
from walker_jax.cli.unit_options import InUnits


class Search(Group, theme="Search"):
    """The kind of gaits to search for, and the start of the search."""

    period: int = option(1, "Strides in a cycle.")
    all: bool = option(False, "All gaits of the period, stable or not.")
    guess: tuple[float, float] | None = option(
        None,
        "Where the search begins.",
        metavar="THETA THETADOT",
        excludes=("start", "all"),
    )
    phidot: float | None = option(None, f"{PHIDOT}: with --guess.")
    start: dict[str, float] = start_option("all", "phidot")

    def coordinates(self, walker: "wj.System") -> dict[str, float]:
        """Return the coordinates of the state in which the search begins, if it is given."""
        check_start(walker, self.start, guess=self.guess, phidot=self.phidot)
        if self.start:
            return self.start
        if self.guess is None:
            refuse("is for --guess alone: give it too", phidot=self.phidot)
            return {}
        given = dict(zip(("theta", "thetadot"), self.guess, strict=True))
        return given | ({} if self.phidot is None else {"phidot": self.phidot})


class Picture(Group, theme="Picture"):
    figure: Path | None = option(None, "Where a picture of the Floquet multipliers goes.")


@command(
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
def gait(walker: "wj.System", search: Search, picture: Picture, units: InUnits, files: Files):
    """Find the gaits of a walker: cycles of strides, and their stability."""
    given, figure = search.coordinates(walker), picture.figure
    units.check(walker)
    begin = state_from(walker, given) if given else None
    guess = None if begin is None else begin.tolist()
    request = request_for("gait", walker, period=search.period, guess=guess, all=search.all)
    check_picture(figure, request, overwrite=files.overwrite)
    with lib.bar(f"search for {terms_of(walker).cycle}s", True):
        way = "--guess THETA THETADOT" if has_own_options(walker) else "--start NAME=VALUE"
        if given:
            way = "another --start" if search.start else "another --guess"
        how: Any = {"every": search.all, "instead": f"try {way}"}
        found = lib.selection.select_gaits(walker, search.period, begin, **how)
    if figure is not None:
        title = f"{lib.describe_briefly(walker)}: Floquet multipliers"
        draw(wj.figures.multipliers(found, title=title), figure, request)
    about, stable = request["walker"], sum(bool(one.stable) for one in found)
    for i, one in enumerate(found):
        states, times = units.states(one.states, walker.section), units.times(one.step_times)
        found[i] = one._replace(states=states, step_times=times)
    answer = {"gaits": [*map(lib.summarise_gait, found)], "walker": about, **units.named}
    lines = [line for one in found for line in gait_in_words(walker, about, one, units)]
    if stable:
        which = "it" if len(found) == 1 else f"{stable} of these {len(found)}"
        lines.append(f"Nearby starts converge to {which}: walker-jax basin shows from where.")
    else:
        lines.append("None is stable: walker-jax bifurcation shows where one is.")
    lines += [f"picture {figure}"] * (figure is not None)
    return slope_of(about) | answer, lines


def gait_in_words(
    walker: "wj.System", about: dict, gait: "wj.Gait", units: InUnits
) -> Iterator[str]:
    """Write the stability of a gait, and a line for each stride; a map's steps have no time."""
    noun = terms_of(walker).cycle
    kind, period = "stable" if gait.stable else "unstable", len(gait.states)
    where = f"at slope {about['slope']:g} rad" if "slope" in about else f"of {about['name']}"
    multipliers = listed(gait.multipliers, ".8g")
    yield f"{kind} {noun} of period {period} {where}, multipliers {multipliers}"
    timeless = is_map(walker, gait.step_times)
    for state, duration in zip(gait.states, gait.step_times, strict=True):
        pairs = zip(walker.section, state, strict=True)
        coordinates = "  ".join(f"{name} {value:.13f}{units.unit(name)}" for name, value in pairs)
        time = f"  step time {duration:.10f}{units.unit('time')}"
        yield f"  {coordinates}" + ("" if timeless else time)

"""`walker-jax gait`."""

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
from walker_jax.cli.section import PHIDOT, Start, has_own_options, refuse_own, start_option
from walker_jax.cli.unit_options import InUnits


class Search(Group):
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


class Picture(Group):
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
    phidot, figure = search.phidot, picture.figure
    refuse_own(walker, guess=search.guess, phidot=phidot)
    if search.guess is None:
        refuse("is for --guess alone: give it too", phidot=phidot)
    theta, thetadot = search.guess or (None, None)
    start = Start(theta, thetadot, phidot, search.start).coordinates(walker)
    units.check(walker)
    guess = [*start.values()] or None
    request = request_for("gait", walker, period=search.period, guess=guess, all=search.all)
    check_picture(figure, request, overwrite=files.overwrite)
    cycle = terms_of(walker).cycle
    with lib.bar(f"search for {cycle}s", True):
        way = "--guess THETA THETADOT" if has_own_options(walker) else "--start NAME=VALUE"
        if start:
            way = "another --start" if search.start else "another --guess"
        how: Any = {"every": search.all, "instead": f"try {way}"}
        found = lib.selection.select_gaits(walker, search.period, guess, **how)
    if figure is not None:
        title = f"{lib.describe_briefly(walker)}: Floquet multipliers"
        draw(wj.figures.multipliers(found, title=title), figure, request)
    about, stable = request["walker"], sum(bool(one.stable) for one in found)
    for i, one in enumerate(found):
        states, times = units.states(one.states, walker.section), units.times(one.step_times)
        found[i] = one._replace(states=states, step_times=times)
    gaits = [*map(lib.summarise_gait, found)]
    yield slope_of(about) | {"gaits": gaits, "walker": about, **units.named}
    where = f"at slope {about['slope']:g} rad" if "slope" in about else f"of {about['name']}"
    for one in found:
        kind, period = "stable" if one.stable else "unstable", len(one.states)
        multipliers = listed(one.multipliers, ".8g")
        yield f"{kind} {cycle} of period {period} {where}, multipliers {multipliers}"
        timeless = is_map(walker, one.step_times)
        for state, duration in zip(one.states, one.step_times, strict=True):
            pairs = zip(walker.section, state, strict=True)
            placed = "  ".join(f"{name} {value:.13f}{units.unit(name)}" for name, value in pairs)
            time = f"  step time {duration:.10f}{units.unit('time')}"
            yield f"  {placed}" + ("" if timeless else time)
    if stable:
        which = "it" if len(found) == 1 else f"{stable} of these {len(found)}"
        yield f"Nearby starts converge to {which}: walker-jax basin shows from where."
    else:
        yield "None is stable: walker-jax bifurcation shows where one is."
    if figure is not None:
        yield f"picture {figure}"

"""`walker-jax gait`."""

from pathlib import Path
from typing import Any

import walker_jax as wj
from walker_jax.cli import library as lib
from walker_jax.cli.answers import (
    OVERWRITE,
    check_picture,
    draw,
    is_map,
    listed,
    request_for,
    slope_of,
    terms_of,
)
from walker_jax.cli.commands import command
from walker_jax.cli.options import option
from walker_jax.cli.section import start_on, start_option
from walker_jax.cli.unit_options import UNITS, chosen_units, units_named

GUESS: Any = (
    tuple[float, float],
    option(
        None,
        "Short for --theta and --thetadot.",
        metavar="THETA THETADOT",
        keys=["theta", "thetadot"],
    ),
)


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
def gait(
    walker: "wj.System",
    start: dict[str, float] = start_option("Where the search begins", guess=GUESS),
    period: int = option(1, "Strides in a cycle."),
    all: bool = option(False, "All gaits of the period, stable or not.", excludes=["start"]),
    figure: Path | None = option(None, "Where a picture of the Floquet multipliers goes."),
    units: dict[str, float] = UNITS,
    overwrite: bool = OVERWRITE,
):
    """Find the gaits of a walker: cycles of strides, and their stability."""
    begin = [*start_on(walker, start).values()] or None
    chosen = chosen_units(units, walker)
    request = request_for("gait", walker, period=period, guess=begin, all=all)
    check_picture(figure, request, overwrite=overwrite)
    cycle = terms_of(walker).cycle
    with lib.bar(f"search for {cycle}s", True):
        way = "another start" if start else "--start NAME=VALUE"
        how: Any = {"every": all, "instead": f"try {way}"}
        found = lib.selection.select_gaits(walker, period, begin, **how)
    if figure is not None:
        title = f"{lib.describe_briefly(walker)}: Floquet multipliers"
        draw(wj.figures.multipliers(found, title=title), figure, request)
    about, stable = request["walker"], sum(bool(one.stable) for one in found)
    for i, one in enumerate(found):
        states = one.states * [*map(chosen.size, lib.units_of_section(walker.section))]
        found[i] = one._replace(states=states, step_times=one.step_times * chosen.size(lib.TIME))
    gaits = [*map(lib.summarise_gait, found)]
    yield slope_of(about) | {"gaits": gaits, "walker": about, **units_named(units)}
    where = f"at slope {about['slope']:g} rad" if "slope" in about else f"of {about['name']}"
    of_section = [
        f" {lib.si_unit(one)}" * bool(units) for one in lib.units_of_section(walker.section)
    ]
    for one in found:
        kind, period = "stable" if one.stable else "unstable", len(one.states)
        multipliers = listed(one.multipliers, ".8g")
        yield f"{kind} {cycle} of period {period} {where}, multipliers {multipliers}"
        timeless = is_map(walker, one.step_times)
        for state, duration in zip(one.states, one.step_times, strict=True):
            named = zip(walker.section, state, of_section, strict=True)
            placed = "  ".join(f"{name} {value:.13f}{unit}" for name, value, unit in named)
            time = f"  step time {duration:.10f}{' s' if units else ''}"
            yield f"  {placed}" + ("" if timeless else time)
    if stable:
        which = "it" if len(found) == 1 else f"{stable} of these {len(found)}"
        yield f"Nearby starts converge to {which}: walker-jax basin shows from where."
    else:
        yield "None is stable: walker-jax bifurcation shows where one is."
    if figure is not None:
        yield f"picture {figure}"

"""`walker-jax gait`."""

from pathlib import Path
from typing import Annotated

import typer

from walker_jax import storage
from walker_jax.checks import WrongUse
from walker_jax.cli.answers import check_suffix, draw, listed, print_json, request_for
from walker_jax.cli.options import (
    PHIDOT_HELP,
    Json,
    Overwrite,
    StartAt,
    check_finite,
    start_from,
    state_from,
)
from walker_jax.cli.walker_options import takes_walker
from walker_jax.execution.progress import bar
from walker_jax.gaits import selection
from walker_jax.gaits.cycles import Gait
from walker_jax.gaits.summary import summarise_gait
from walker_jax.systems.system import System
from walker_jax.walkers.parameters import describe_walker


@takes_walker(systems=True)
def gait(
    walker: System,
    period: Annotated[int, typer.Option(min=1, help="Strides in a cycle.")] = 1,
    all_: Annotated[
        bool, typer.Option("--all", help="All gaits of the period, stable or not.")
    ] = False,
    guess: Annotated[
        tuple[float, float] | None,
        typer.Option(metavar="THETA THETADOT", help="Where the search begins."),
    ] = None,
    phidot: Annotated[float | None, typer.Option(help=f"{PHIDOT_HELP}: with --guess.")] = None,
    start: StartAt = None,
    figure: Annotated[
        Path | None, typer.Option(help="Where a picture of the Floquet multipliers goes.")
    ] = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Find the gaits of a walker: cycles of strides, and their stability."""
    if phidot is not None and guess is None:
        raise WrongUse("--phidot is for --guess alone: give it too")
    given: dict[str, float] = {}
    if guess is not None:
        if start:
            raise WrongUse("--guess and --start exclude each other: give one of them")
        given = {"theta": guess[0], "thetadot": guess[1]}
        given |= {} if phidot is None else {"phidot": phidot}
        for value in guess:
            check_finite(guess=value)
        check_finite(phidot=0.0 if phidot is None else phidot)
    given = given or start_from(walker, start, {})
    begin = state_from(walker, given) if given else None
    if begin is not None and all_:
        option = "start" if start else "guess"
        raise WrongUse(f"--{option} and --all exclude each other: give one of them")
    about = describe_walker(walker)
    asked = {"period": period, "guess": None if begin is None else begin.tolist(), "all": all_}
    request = request_for("gait", walker, walker=about, **asked)
    if figure is not None:
        check_suffix(figure)
        storage.check_picture(figure, request, overwrite=overwrite)
    with bar("search for gaits", True):
        found = selection.select_gaits(walker, period, begin, every=all_)
    if figure is not None:
        from walker_jax import figures

        draw(figures.multipliers(found), figure, request)
    if as_json:
        gaits = [summarise_gait(one) for one in found]
        slope = {"slope": about["slope"]} if "slope" in about else {}
        print_json(slope | {"gaits": gaits, "walker": about})
        return
    for one in found:
        print_gait(walker, one)
    if figure is not None:
        print(f"picture {figure}")


def print_gait(walker: System, gait: Gait) -> None:
    """A gait in words: its stability, and a line for each stride."""
    kind, period = "stable" if gait.stable else "unstable", len(gait.states)
    about, values = describe_walker(walker), listed(gait.multipliers, ".8g")
    where = f"at slope {about['slope']:g} rad" if "slope" in about else f"of {about['name']}"
    print(f"{kind} gait of period {period} {where}, multipliers {values}")
    for state, duration in zip(gait.states, gait.step_times, strict=True):
        named = zip(walker.section, state, strict=True)
        coordinates = "  ".join(f"{name} {value:.13f}" for name, value in named)
        print(f"  {coordinates}  step time {duration:.10f}")

"""`walker-jax gait`."""

from importlib.metadata import version
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

import walker_jax as wj
from walker_jax import storage
from walker_jax.checks import ComputationFailed, WrongUse
from walker_jax.cli.answers import check_suffix, description, draw, no_gait, print_json
from walker_jax.cli.app import app
from walker_jax.cli.options import PHIDOT_HELP, Json, Overwrite, finite, start_of, takes_walker
from walker_jax.walkers.model import Walker


@app.command()
@takes_walker
def gait(
    walker: Walker,
    period: Annotated[int, typer.Option(min=1, help="Strides in a cycle.")] = 1,
    all_: Annotated[
        bool, typer.Option("--all", help="All gaits of the period, stable or not.")
    ] = False,
    guess: Annotated[
        tuple[float, float] | None,
        typer.Option(metavar="THETA THETADOT", help="Where the search begins."),
    ] = None,
    phidot: Annotated[float | None, typer.Option(help=f"{PHIDOT_HELP}: with --guess.")] = None,
    figure: Annotated[
        Path | None, typer.Option(help="Where a picture of the multipliers goes.")
    ] = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Find the gaits of a walker: cycles of strides, and their stability."""
    if phidot is not None and guess is None:
        raise WrongUse("--phidot is for --guess alone")
    start = None
    if guess is not None:
        given = {"theta": guess[0], "thetadot": guess[1]}
        given |= {} if phidot is None else {"phidot": phidot}
        finite(**given)
        start = start_of(walker, given)
    if guess is not None and all_:
        raise WrongUse("--guess and --all exclude each other: give one of them")
    request = {
        "command": "gait",
        "walker": description(walker),
        "period": period,
        "guess": None if start is None else start.tolist(),
        "all": all_,
        "version": version("walker-jax"),
    }
    if figure is not None:
        check_suffix(figure)
        storage.check_picture(figure, request, overwrite=overwrite)

    slope = request["walker"]["slope"]
    found, first = [], None
    if all_ or (period > 1 and guess is None):
        found = wj.find_gaits(walker, period)
        found.sort(key=lambda gait: np.abs(gait.multipliers[0]))
        found = found if all_ else found[:1]
    # the long gait of period one is not the most stable one on every slope
    if period == 1 or guess is not None:
        first = wj.find_gait(walker, start, period)
        same = lambda gait: np.allclose(gait.states, first.states, rtol=0, atol=1e-8)
        found = [first] * bool(first.found) + [gait for gait in found if not same(gait)]
    if not found:
        raise ComputationFailed(no_gait(walker, period, None if all_ else first, guess is not None))
    if figure is not None:
        from walker_jax import figures

        draw(figures.multipliers(found), figure, request)
    if as_json:
        gaits = [
            {
                "period": period,
                "states": one.states,
                "multipliers": [[value.real, value.imag] for value in one.multipliers.tolist()],
                "step_times": one.step_times,
                "stable": bool(one.stable),
                "residual": float(one.residual),
            }
            for one in found
        ]
        print_json({"slope": slope, "gaits": gaits, "walker": request["walker"]})
        return
    for one in found:
        kind = "stable" if one.stable else "unstable"
        values = ", ".join(f"{value:.8g}" for value in one.multipliers)
        print(f"{kind} gait of period {period} at slope {slope:g} rad, multipliers {values}")
        for state, duration in zip(one.states, one.step_times, strict=True):
            named = zip(walker.section, state, strict=True)
            shown = "  ".join(f"{name} {value:.13f}" for name, value in named)
            print(f"  {shown}  step time {duration:.10f}")
    if figure is not None:
        print(f"picture {figure}")

"""`walker-jax bifurcation`."""

import math
from pathlib import Path
from typing import Annotated

import typer

import walker_jax as wj
from walker_jax import storage
from walker_jax.cli.answers import draw, find_earlier, listed, print_json, request_for
from walker_jax.cli.options import Json, Out, Overwrite, PictureOfData, check_slopes
from walker_jax.cli.walker_options import takes_walker
from walker_jax.execution.progress import bar
from walker_jax.gaits.summary import summarise_bifurcations
from walker_jax.walkers.family import WALKERS
from walker_jax.walkers.model import Walker
from walker_jax.walkers.parameters import (
    SLOPE,
    describe_walker,
    slopes_of,
    with_parameter,
)


def help_of_end(which: str, end: int) -> str:
    """The help of an option for one end of the slopes, with its default values."""
    usual = SLOPE.span[end]
    own = {name: slopes_of(kind)[end] for name, kind in WALKERS.items()}
    others = [f", {name}: {value:g}" for name, value in own.items() if value != usual]
    return f"{which} slope, rad (default: {usual:g}{''.join(others)})."


@takes_walker(without={"slope": "--from and --to"})
def bifurcation(
    walker: Walker,
    low: Annotated[float | None, typer.Option("--from", help=help_of_end("Lowest", 0))] = None,
    high: Annotated[float | None, typer.Option("--to", help=help_of_end("Highest", 1))] = None,
    period_max: Annotated[
        int, typer.Option(min=1, max=64, help="Longest period of the gaits that are followed.")
    ] = 8,
    strides: Annotated[
        int, typer.Option(min=1, help="Strides after which a walker counts as walking for ever.")
    ] = 3000,
    out: Out = Path("bifurcation.zarr"),
    figure: PictureOfData = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Follow the gaits over the slope: how each is born, doubles and ends."""
    from walker_jax import figures

    low, high = (
        end if given is None else given
        for given, end in zip((low, high), slopes_of(type(walker)), strict=True)
    )
    check_slopes(walker, low, high)
    walker = with_parameter(walker, "slope", low)
    about = {name: value for name, value in describe_walker(walker).items() if name != "slope"}
    asked = {"slope": [low, high], "period_max": period_max, "strides": strides}
    request = request_for("bifurcation", walker, walker=about, **asked)
    figure, data = find_earlier(out, figure, request, overwrite=overwrite)
    if data is None:
        with bar("bifurcations", True):
            data = wj.bifurcation_diagram(
                walker, "slope", (low, high), period_max=period_max, strides=strides, progress=True
            )
        data = storage.save(data, out, request)
    draw(figures.bifurcations(data), figure, request)
    answer = summarise_bifurcations(data)
    if as_json:
        print_json(answer)
        return
    name, *values = about.items()
    others = [f"{key} {value}" for key, value in values]
    print(f"Gaits of {', '.join([name[1], *others])}, from slope {low:g} to {high:g} rad")
    print_bifurcations(answer, strides)
    print(f"  data set {out}, picture {figure}")


def print_bifurcations(answer: dict, strides: int) -> None:
    """The answer of `bifurcation`, in words."""
    for title, key in (
        ("doublings of the most stable gait", "doublings"),
        ("doublings of other gaits", "other_doublings"),
        ("folds", "folds"),
        ("Neimark-Sacker points", "neimark_sackers"),
    ):
        if key == "neimark_sackers" and not answer[key]:
            continue
        print(f"  {title}:{'' if answer[key] else ' none'}")
        for event in answer[key]:
            periods = f"{event['from']} to {event['to']}" if "to" in event else event["period"]
            print(f"    period {periods} at {event['slope']:.12f}, ({listed(event['state'])})")
    below, above = answer["lost"]["below"], answer["lost"]["above"]
    if math.isnan(below):
        print("  no walker that starts close to a gait walks on, on any slope")
    elif math.isnan(above):
        print("  walkers that start close to a gait walk on up to the highest slope")
    else:
        print(f"  walking is lost between {below:.8f}, where a walker makes {strides} strides,")
        print(f"  and {above:.8f}, where none does")
    for interval in answer["stable_beyond"]:
        ends = f"from {interval['from']:.9f} to {interval['to']:.9f}"
        print(f"  a gait of period {interval['period']} is stable beyond that, {ends}")

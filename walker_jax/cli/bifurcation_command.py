"""`walker-jax bifurcation`."""

import math
from pathlib import Path
from typing import Annotated

import typer

import walker_jax as wj
from walker_jax import storage
from walker_jax.checks import WrongUse
from walker_jax.cli.answers import draw, find_earlier, listed, print_json, request_for
from walker_jax.cli.options import (
    Json,
    Out,
    Overwrite,
    PictureOfData,
    check_range,
    hyphenated,
)
from walker_jax.cli.walker_options import takes_walker
from walker_jax.execution.progress import bar
from walker_jax.gaits.summary import summarise_bifurcations, value_key
from walker_jax.systems.system import System
from walker_jax.walkers.family import WALKERS
from walker_jax.walkers.model import Walker
from walker_jax.walkers.parameters import (
    SLOPE,
    Parameter,
    check_parameter,
    describe_walker,
    described_by,
    slopes_of,
    with_parameter,
)


def help_of_end(which: str, end: int) -> str:
    """The help of an option for one end of the slopes, with its default values."""
    usual = SLOPE.span[end]
    own = {name: slopes_of(kind)[end] for name, kind in WALKERS.items()}
    others = [f", {name}: {value:g}" for name, value in own.items() if value != usual]
    return f"{which} value (default, of the slope: {usual:g}{''.join(others)})."


@takes_walker(systems=True, ranges_over="over")
def bifurcation(
    walker: System,
    over: Annotated[
        str, typer.Option(metavar="NAME", help="The parameter that changes, from --from to --to.")
    ] = "slope",
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
    """Follow the gaits over the slope, or another parameter: how each is born, doubles and ends."""
    from walker_jax import figures

    over = over.replace("-", "_")
    check_parameter(walker, over)
    if over == "slope" and isinstance(walker, Walker):
        usual = slopes_of(type(walker))
        low, high = (usual[i] if end is None else end for i, end in enumerate((low, high)))
    if low is None or high is None:
        missing = "--from" if low is None else "--to"
        raise WrongUse(f"{missing} is required: the range of {hyphenated(over)}")
    check_range(walker, over, low, high)
    walker = with_parameter(walker, over, low)
    about = {name: value for name, value in describe_walker(walker).items() if name != over}
    asked = {"over": over, "range": [low, high], "period_max": period_max, "strides": strides}
    request = request_for("bifurcation", walker, walker=about, **asked)
    figure, data = find_earlier(out, figure, request, overwrite=overwrite)
    if data is None:
        with bar("bifurcations", True):
            data = wj.bifurcation_diagram(
                walker, over, (low, high), period_max=period_max, strides=strides, progress=True
            )
        data = storage.save(data, out, request)
    draw(figures.bifurcations(data), figure, request)
    answer = summarise_bifurcations(data)
    if as_json:
        print_json(answer)
        return
    name, *values = about.items()
    others = [f"{key} {value}" for key, value in values]
    units = {one.name: f" {one.unit}".rstrip() for one in described_by(walker, Parameter)}
    unit = units.get(over, "")
    span = f"from {hyphenated(over)} {low:g} to {high:g}{unit}"
    print(f"Gaits of {', '.join([name[1], *others])}, {span}")
    print_bifurcations(answer, over, strides)
    print(f"  data set {out}, picture {figure}")


def print_bifurcations(answer: dict, over: str, strides: int) -> None:
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
            at = event[value_key(over)]
            periods = f"{event['from']} to {event['to']}" if "to" in event else event["period"]
            print(f"    period {periods} at {at:.12f}, ({listed(event['state'])})")
    below, above = answer["lost"]["below"], answer["lost"]["above"]
    if math.isnan(below):
        print(f"  no walker that starts close to a gait walks on, at any {hyphenated(over)}")
    elif math.isnan(above):
        print(f"  walkers that start close to a gait walk on up to the highest {hyphenated(over)}")
    else:
        print(f"  walking is lost between {below:.8f}, where a walker makes {strides} strides,")
        print(f"  and {above:.8f}, where none does")
    for interval in answer["stable_beyond"]:
        ends = f"from {interval['from']:.9f} to {interval['to']:.9f}"
        print(f"  a gait of period {interval['period']} is stable beyond that, {ends}")

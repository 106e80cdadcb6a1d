"""`walker-jax bifurcation`."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import walker_jax as wj
from walker_jax.checks import WrongUse
from walker_jax.cli.answers import Output, listed, request_for
from walker_jax.cli.conclusions import conclude_bifurcations
from walker_jax.cli.groups import option
from walker_jax.cli.options import check_range, hyphenated, underscored
from walker_jax.cli.walker_options import takes_walker
from walker_jax.gaits.gait_summary import summarise_bifurcations, value_key
from walker_jax.systems.system import System
from walker_jax.walkers.family import WALKERS
from walker_jax.walkers.parameters import (
    SLOPE,
    Parameter,
    check_parameter,
    described_by,
    span_of,
    with_parameter,
    write_description,
)

TITLES = {
    "doublings": "doublings of the most stable gait",
    "other_doublings": "doublings of other gaits",
    "folds": "folds",
    "neimark_sackers": "Neimark-Sacker points",
}


def help_of_end(which: str, end: int) -> str:
    """Write the help of an option for one end of the slopes, with its default values."""
    usual = SLOPE.span[end]
    own = {name: (span_of(kind, "slope") or SLOPE.span)[end] for name, kind in WALKERS.items()}
    others = [f", {name}: {value:g}" for name, value in own.items() if value != usual]
    return f"{which} value (default, of the slope: {usual:g}{''.join(others)})."


@dataclass(frozen=True)
class Options:
    theme = "Branches"
    over: str = option("slope", "The parameter that changes, from --from to --to.", metavar="NAME")
    low: float | None = option(None, help_of_end("Lowest", 0), "--from")
    high: float | None = option(None, help_of_end("Highest", 1), "--to")
    period_max: int = option(8, "Longest period of the gaits that are followed.", min=1, max=64)
    strides: int = option(3000, "Strides after which a walker counts as walking for ever.", min=1)
    normal_forms: bool = option(False, "Tell which are supercritical; takes ten seconds more.")

    def range(self, walker: System) -> tuple[str, float, float]:
        """Return the parameter that changes, and its lowest and highest values."""
        over, low, high = underscored(self.over), self.low, self.high
        check_parameter(walker, over)
        if usual := span_of(type(walker), over):
            low, high = (usual[i] if end is None else end for i, end in enumerate((low, high)))
        if low is None or high is None:
            missing = "--from" if low is None else "--to"
            raise WrongUse(f"{missing} is required: the range of {hyphenated(over)}")
        check_range(walker, over, low, high)
        return over, low, high


@takes_walker(systems=True, ranges_over="over")
def bifurcation(
    walker: System, options: Options, output: Output = Output(Path("bifurcation.zarr"))
) -> None:
    """Follow the gaits over the slope, or another parameter: how each is born, doubles and ends."""
    over, low, high = options.range(walker)
    how: dict[str, Any] = {"period_max": options.period_max, "strides": options.strides}
    if options.normal_forms:
        how["normal_forms"] = True
    walker = with_parameter(walker, over, low)
    request = request_for(
        "bifurcation", walker, without=[over], over=over, range=[low, high], **how
    )
    data = output.produce(
        request,
        lambda: wj.bifurcation_diagram(walker, over, (low, high), progress=True, **how),
        "bifurcations",
    )
    answer = summarise_bifurcations(data)
    units = {one.name: f" {one.unit}".rstrip() for one in described_by(walker, Parameter)}
    span = f"from {hyphenated(over)} {low:g} to {high:g}{units.get(over, '')}"
    title = f"Gaits of {write_description(request['walker'], '')}, {span}"
    found = bool(data["on_cascade"].any())
    lines = bifurcations_in_words(answer, over, options.strides, found=found)
    output.tell(answer, [title, *lines])


def bifurcations_in_words(answer: dict, over: str, strides: int, *, found: bool) -> Iterator[str]:
    """Write the answer of `bifurcation`; whether a gait of period one was found."""
    for key, title in TITLES.items():
        if key == "neimark_sackers" and not answer[key]:
            continue
        yield f"  {title}:{'' if answer[key] else ' none'}"
        for event in answer[key]:
            at = event[value_key(over)]
            periods = f"{event['from']} to {event['to']}" if "to" in event else event["period"]
            told = f", {event['criticality']}" if "criticality" in event else ""
            yield f"    period {periods} at {at:.12f}, ({listed(event['state'])}){told}"
    below, above = answer["lost"]["below"], answer["lost"]["above"]
    if math.isnan(below):
        yield f"  no walker that starts close to a gait walks on, at any {hyphenated(over)}"
    elif math.isnan(above):
        yield f"  walkers that start close to a gait walk on up to the highest {hyphenated(over)}"
    else:
        yield f"  walking is lost between {below:.8f}, where a walker makes {strides} strides,"
        yield f"  and {above:.8f}, where none does"
    for interval in answer["stable_beyond"]:
        ends = f"from {interval['from']:.9f} to {interval['to']:.9f}"
        yield f"  a gait of period {interval['period']} is stable beyond that, {ends}"
    doublings = [(event[value_key(over)], event["to"]) for event in answer["doublings"]]
    yield f"  {conclude_bifurcations(doublings, hyphenated(over), found=found)}"

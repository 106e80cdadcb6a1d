"""`walker-jax bifurcation`."""

import math
from collections.abc import Iterator
from typing import Any

import walker_jax as wj
from walker_jax.cli import library as lib
from walker_jax.cli.answers import Output, Terms, listed, request_for, terms_of
from walker_jax.cli.commands import command
from walker_jax.cli.options import hyphenated, option, underscored
from walker_jax.cli.walker_options import check_range
from walker_jax.refusals import WrongUse
from walker_jax.walkers.parameter_table import KNEED_SLOPE, SLOPE

TITLES = {
    "doublings": "doublings of the most stable {}",
    "other_doublings": "doublings of other {}s",
    "folds": "folds",
    "neimark_sackers": "Neimark-Sacker points",
}


def help_of_end(which: str, end: int) -> str:
    """Write the help of an option for one end of the range."""
    slopes = f"{SLOPE.span[end]:g}, kneed: {KNEED_SLOPE.span[end]:g}"
    return f"{which} value (default, of the slope: {slopes})."


@command(
    examples=(
        "bifurcation --from 0.001 --to 0.022",
        "bifurcation --walker spring --hip-stiffness 1 --to 0.02 --out spring.zarr",
        "bifurcation --system henon --over a --from 0 --to 1.2 --out henon.zarr",
    ),
    time="Half a minute.",
    out="bifurcation.zarr",
    ranged=True,
)
def bifurcation(
    walker: "wj.System",
    output: Output,
    parameter: str = option("slope", "The parameter that changes, from --from to --to.", "--over"),
    low: float | None = option(None, help_of_end("Lowest", 0), "--from"),
    high: float | None = option(None, help_of_end("Highest", 1), "--to"),
    period_max: int = option(8, "Longest period of the gaits that are followed.", most=64),
    strides: int = option(3000, "Strides after which a walker counts as walking for ever."),
    normal_forms: bool = option(False, "Tell which are supercritical; takes ten seconds more."),
):
    """Follow the gaits over the slope, or another parameter: how each is born, doubles and ends."""
    over = underscored(parameter)
    lib.check_parameter(walker, over)
    if usual := lib.span_of(type(walker), over):
        low, high = (usual[i] if end is None else end for i, end in enumerate((low, high)))
    if low is None or high is None:
        missing = "--from" if low is None else "--to"
        raise WrongUse(f"{missing} is required: the range of {hyphenated(over)}")
    check_range(walker, over, low, high)
    how: Any = {"period_max": period_max, "strides": strides}
    how |= {"normal_forms": True} if normal_forms else {}
    walker = lib.with_parameter(walker, over, low)
    asked_for = {"over": over, "range": [low, high], **how}
    request = request_for("bifurcation", walker, without=[over], **asked_for)
    compute = lambda: wj.bifurcation_diagram(walker, over, (low, high), progress=True, **how)
    data = output.produce(request, compute, "bifurcations")
    answer = lib.summarise_bifurcations(data)
    units = {one.name: f" {one.unit}".rstrip() for one in lib.described_by(walker, lib.Parameter)}
    span = f"from {hyphenated(over)} {low:g} to {high:g}{units.get(over, '')}"
    terms = terms_of(walker)
    yield answer
    yield f"{terms.cycle.title()}s of {lib.write_description(request['walker'], '')}, {span}"
    yield from bifurcations_in_words(answer, over, strides, terms)
    yield output.places()


def bifurcations_in_words(answer: dict, over: str, strides: int, terms: Terms) -> Iterator[str]:
    """Write the answer of `bifurcation`."""
    for key, title in TITLES.items():
        if key == "neimark_sackers" and not answer[key]:
            continue
        yield f"  {title.format(terms.cycle)}:{'' if answer[key] else ' none'}"
        for event in answer[key]:
            at = event[lib.value_key(over)]
            periods = f"{event['from']} to {event['to']}" if "to" in event else event["period"]
            told = f", {event['criticality']}" if "criticality" in event else ""
            yield f"    period {periods} at {at:.12f}, ({listed(event['state'])}){told}"
    near = f"{terms.start} close to a {terms.cycle}"
    below, above = answer["lost"]["below"], answer["lost"]["above"]
    if math.isnan(below):
        yield f"  no {near} {terms.goes} on, at any {hyphenated(over)}"
    elif math.isnan(above):
        yield f"  each {near} {terms.goes} on up to the highest {hyphenated(over)}"
    else:
        until = f"where a {terms.start} makes {strides} {terms.step}s"
        yield f"  {terms.motion} is lost between {below:.8f}, {until},"
        yield f"  and {above:.8f}, where none does"
    for interval in answer["stable_beyond"]:
        ends = f"from {interval['from']:.9f} to {interval['to']:.9f}"
        yield f"  a {terms.cycle} of period {interval['period']} is stable beyond that, {ends}"
    yield "  walker-jax chart follows such points over a second parameter."

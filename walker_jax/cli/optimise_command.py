"""`walker-jax optimise`."""

import math
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any, TypeGuard

import click

import walker_jax as wj
from walker_jax.cli import library as lib
from walker_jax.cli.answers import Output, request_for
from walker_jax.cli.commands import command
from walker_jax.cli.options import Number, hyphenated, named, option, underscored
from walker_jax.cli.section import asked_of, axes_option, region_on
from walker_jax.refusals import ComputationFailed, WrongUse

SAVED_EVERY = 2.0
"""Seconds between saves of the trace; a save takes a tenth of a second. The end is saved too."""
LIMIT: Any = {"type": click.Tuple([str, Number()]), "metavar": "NAME X"}


def bounds_of(
    walker: "wj.System", over: Sequence[str], bounds: dict[str, tuple[float, float]]
) -> dict[str, tuple[float, float]]:
    """Return the bounds of the free parameters, in the order in which these are named."""
    names = [*map(underscored, over)]
    if not names:
        raise WrongUse("--over is required: a parameter that is free, such as slope")
    for name in names:
        lib.check_parameter(walker, name)
        if name not in bounds:
            typed = hyphenated(name)
            raise WrongUse(f"--bound is required for {typed}: {typed}=LO:HI")
    for name in bounds:
        if name not in names:
            typed = hyphenated(name)
            raise WrongUse(f"--bound is of {typed}, which is not free: add --over {typed}")
    return {name: bounds[name] for name in names}


@command(
    examples=(
        "optimise --over slope --bound slope=0.001:0.02",
        "optimise --walker spring --over hip-stiffness --bound hip-stiffness=0:20",
    ),
    time="Half a minute for the area over a slope, an hour for more parameters; fewer --starts and "
    "--scan 0 shorten it.",
    out="optimum.zarr",
)
def optimise(
    walker: "wj.System",
    output: Output,
    over: Sequence[str] = option(
        (),
        "A parameter that is free; may be repeated.",
        multiple=True,
        sets={"parameter": "--over"},
    ),
    bounds: dict[str, tuple[float, float]] = named(
        "Bounds of such a parameter; one for each.", "LO:HI", flags=["--bound"]
    ),
    objective: Sequence[str] = option(
        (),
        # In this order no line of 80 columns breaks within a name.
        "area (default), volume, basin-stability, fall-action, least-disturbance, "
        "cost-of-transport, spectral-radius, sensitivity-norm, step-length or speed; NAME=WEIGHT, "
        "repeated, for a sum.",
        multiple=True,
    ),
    at_least: tuple[str, float] | None = option(
        None, "Least speed, step-length, ...; one limit.", **LIMIT
    ),
    at_most: tuple[str, float] | None = option(
        None, "Greatest value of one of them; one limit.", **LIMIT
    ),
    axes: dict[str, Any] = axes_option("Region"),
    starts: int = option(3, "Walkers to start from: the one given, and others."),
    levels: int | None = option(
        None, "Refinement at both ends (default: 4; of volumes 2).", least=0, most=8
    ),
    strides: int = option(200, "Strides a walker is followed for."),
    scan: int = option(15, "Values of each parameter at which the objective is drawn.", least=0),
    seed: int = option(0, "Seed of the random starts.", least=0),
    seconds: float | None = option(
        None, "End with the best after these; run again to go on.", above=0
    ),
):
    """Design a walker: the parameters with the largest basin, or another objective, by gradient.

    Measurements are saved as they are made: the same command resumes an interrupted run. The
    picture shows the ascent, and the basins before and after. The default region is all of the
    section.
    """
    names = objective or ("area",)
    bounds, weights, limits = bounds_of(walker, over, bounds), objective_of(names), {}
    for side, limit in {"at_least": at_least, "at_most": at_most}.items():
        limits[side] = {} if limit is None else {hyphenated(limit[0]): limit[1]}
    how: Any = {"starts": starts, "strides": strides, "scan": scan, "seed": seed}
    how["levels"] = lib.default_levels(weights) if levels is None else levels
    grid = region_on(walker, axes)
    asked: Any = {"bounds": bounds, "objective": weights, "axes": asked_of(grid), **limits, **how}
    request = request_for("optimise", walker, **asked)
    data = output.find(request)
    if not is_done(data):
        how |= {"grid": grid, "progress": True, "seconds": seconds, **limits}
        data = computed(partial(wj.optimise, walker, bounds, weights, **how), output, request)
    notes = data["note"].values.tolist()
    if not data["found"]:
        raise ComputationFailed(f"no start leads anywhere: {'; '.join(dict.fromkeys(notes))}")
    output.draw(wj.figures.optimum(data), request)
    answer = lib.summarise_optimum(data)
    yield answer | {"walker": request["walker"]}
    yield from optimum_in_words(walker, answer, " + ".join(names))
    yield from (f"  a start led nowhere: {note}" for note in notes if note)
    yield output.places()


def is_done(data: "lib.xarray.Dataset | None") -> "TypeGuard[lib.xarray.Dataset]":
    """Return whether there is an optimum of a complete run, not interrupted and not out of time."""
    return data is not None and "found" in data and not data.get("out_of_time", False)


def computed(
    compute: "Callable[..., lib.xarray.Dataset]", output: Output, request: dict
) -> "lib.xarray.Dataset":
    """Compute the optimum and save its trace as it grows; no other process may write there."""
    with lib.storage.rewritable(output.out, request) as save:
        # Another run may just have ended.
        known = lib.storage.find(output.out, request, overwrite=output.overwrite)
        if is_done(known):
            return known
        begun, unsaved, saved_at = known is not None, None, -math.inf

        def keep(trace: "lib.xarray.Dataset", every: float = SAVED_EVERY) -> None:
            nonlocal begun, unsaved, saved_at
            unsaved = trace
            if time.monotonic() - saved_at > every:
                save(trace)
                begun, unsaved, saved_at = True, None, time.monotonic()

        resumable = lib.storage.resumable(output.out, lambda: begun, overwrite=output.overwrite)
        with resumable, lib.bar("optimise", True):
            try:
                return save(compute(known=known, keep=keep))
            except BaseException:
                if unsaved is not None:
                    keep(unsaved, every=0.0)
                raise


def objective_of(texts: Sequence[str]) -> str | dict[str, float]:
    """Read one objective by name, or the weights of several."""
    if len(texts) == 1 and "=" not in texts[0]:
        return hyphenated(texts[0])
    weights: dict[str, float] = {}
    for text in texts:
        name, _, weight = text.partition("=")
        name = hyphenated(name)
        try:
            value = float(weight)
        except ValueError:
            raise WrongUse(f"--objective must be one NAME, or NAME=WEIGHT, not {text}") from None
        if name in weights:
            raise WrongUse(f"--objective is given twice for {name}")
        weights[name] = value
    return weights


def optimum_in_words(walker: "wj.System", answer: dict, objective: str) -> Iterator[str]:
    """Write the answer of `optimise`."""
    yield f"{objective}, {lib.describe_in_words(walker)}"
    for end in lib.ENDS:
        values = ", ".join(f"{name} {value:.8g}" for name, value in answer[end].items())
        exact, error = answer["exact"][end], answer["exact_error"][end]
        yield f"  {end:8} {values}: {exact:.7g}" + (f" +- {error:.1g}" if error > 0 else "")
    yield from (f"  {end}: {answer['note'][end]}" for end in lib.ENDS if answer["note"][end])
    before, after = (answer["exact"][end] for end in lib.ENDS)
    factor = f", by a factor of {after / before:.3f}" if before > 0 else ""
    yield f"  a change of {after - before:+.4g}{factor}"
    bounded = ", ".join(answer["at_bound"])
    place = f"at a bound of {bounded}" if bounded else "inside the bounds"
    if answer["binding"]:
        place += f", held by the limit of {', '.join(answer['binding'])}"
    end = "converged" if answer["converged"] else "not converged"
    if answer["out_of_time"]:
        first = answer["first_seconds"]
        end = f"out of time after a first measurement of {first:.3g} s: the same command goes on"
    yield f"  {place}; {end}, {answer['evaluations']} evaluations"
    yield "  A wider --bound, more --starts or another --seed may find a better one."

"""`walker-jax optimise`."""

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeGuard

import walker_jax as wj
from walker_jax import storage
from walker_jax.checks import ComputationFailed, WrongUse
from walker_jax.cli.answers import Output, request_for
from walker_jax.cli.conclusions import conclude_optimum
from walker_jax.cli.groups import option
from walker_jax.cli.options import (
    hyphenated,
    read_numbers,
    refuse_again,
    underscored,
)
from walker_jax.cli.section import AXIS, Axis, Volume, asked_of
from walker_jax.cli.walker_options import takes_walker
from walker_jax.design.problem import default_levels
from walker_jax.design.results import ENDS, summarise_optimum
from walker_jax.execution.progress import bar
from walker_jax.systems.system import System
from walker_jax.walkers.parameters import check_parameter, describe_in_words

if TYPE_CHECKING:
    import xarray

SAVED_EVERY = 2.0
"""Seconds between saves of the trace; a save takes a tenth of a second. The end is saved too."""


@dataclass(frozen=True)
class Problem:
    """The free parameters and the objective."""

    theme = "Problem"
    over: list[str] | None = option(None, "A parameter that is free; may be repeated.")
    bound: list[str] | None = option(
        None, "Bounds of such a parameter; one for each.", metavar="NAME=LO:HI"
    )
    objective: list[str] | None = option(
        None,
        "area (default), volume, least-disturbance, speed, step-length, spectral-radius, "
        "sensitivity-norm or cost-of-transport; NAME=WEIGHT, repeated, for a sum.",
        metavar="NAME",
    )
    at_least: tuple[str, float] | None = option(
        None, "Least speed, step-length, ...; one limit.", metavar="NAME X"
    )
    at_most: tuple[str, float] | None = option(
        None, "Greatest value of one of them; one limit.", metavar="NAME X"
    )

    def limits(self) -> dict[str, dict[str, float]]:
        """Return the limits, by the arguments of `optimise`."""
        given = {"at_least": self.at_least, "at_most": self.at_most}
        return {
            side: {} if limit is None else {hyphenated(limit[0]): limit[1]}
            for side, limit in given.items()
        }


@dataclass(frozen=True)
class OptimumRegion(Volume):
    theta: Axis | None = option(None, "Where the area is measured, as for robustness.", **AXIS)
    phidot: Axis | None = option(
        None, "The rate between the legs, for a volume (default: all).", **AXIS
    )


@dataclass(frozen=True)
class Options:
    theme = "Search"
    starts: int = option(3, "Walkers to start from: the one given, and others.", min=1)
    levels: int | None = option(
        None, "Refinement at both ends (default: 4; of volumes 2).", min=0, max=8
    )
    strides: int = option(200, "Strides a walker is followed for.", min=1)
    scan: int = option(15, "Values of each parameter at which the objective is drawn.", min=0)
    seed: int = option(0, "Seed of the random starts.", min=0)


@dataclass(frozen=True)
class Budget:
    theme = "Search"
    seconds: float | None = option(None, "End with the best after these; run again to go on.")


@takes_walker(systems=True)
def optimise(
    walker: System,
    problem: Problem,
    region: OptimumRegion,
    options: Options,
    budget: Budget = Budget(),
    output: Output = Output(Path("optimum.zarr")),
) -> None:
    """Design a walker: the parameters with the largest basin, or another objective, by gradient.

    Measurements are saved as they are made: the same command resumes an interrupted run. The
    picture shows the ascent, and the basins before and after.
    """
    from walker_jax import figures

    names = problem.objective or ["area"]
    bounds = bounds_of(walker, problem.over or [], problem.bound or [])
    weights, limits = objective_of(names), problem.limits()
    how: Any = {**vars(options)}
    how |= {"levels": default_levels(weights)} if options.levels is None else {}
    grid = region.grid(walker)
    asked = {"bounds": bounds, "objective": weights, "axes": asked_of(grid), **limits, **how}
    request = request_for("optimise", walker, **asked)
    data = output.find(request)
    if not is_done(data):
        how |= {"grid": grid, "progress": True, "seconds": budget.seconds, **limits}
        data = computed(partial(wj.optimise, walker, bounds, weights, **how), output, request)
    if not data["found"]:
        reasons = "; ".join(dict.fromkeys(data["note"].values.tolist()))
        raise ComputationFailed(f"no start leads anywhere: {reasons}")
    output.draw(figures.optimum(data), request)
    answer = summarise_optimum(data)
    lines = [*optimum_in_words(walker, answer, " + ".join(names))]
    lines += [f"  a start led nowhere: {note}" for note in data["note"].values.tolist() if note]
    output.tell(answer | {"walker": request["walker"]}, lines)


def is_done(data: "xarray.Dataset | None") -> "TypeGuard[xarray.Dataset]":
    """Return whether there is an optimum of a complete run, not interrupted and not out of time."""
    return data is not None and "found" in data and not data.get("out_of_time", False)


def computed(
    compute: "Callable[..., xarray.Dataset]", output: Output, request: dict
) -> "xarray.Dataset":
    """Compute the optimum and save its trace as it grows; no other process may write there."""
    out, overwrite = output.out, output.overwrite
    with storage.rewritable(out, request) as save:
        known = storage.find(out, request, overwrite=overwrite)  # another run may just have ended
        if known is not None and is_done(known):
            return known
        kept, latest, saved = known is not None, None, -math.inf

        def keep(trace: "xarray.Dataset") -> None:
            nonlocal latest
            latest = trace
            if time.monotonic() - saved > SAVED_EVERY:
                save_latest()

        def save_latest() -> None:
            nonlocal kept, latest, saved
            if latest is not None:
                save(latest)
                kept, latest, saved = True, None, time.monotonic()

        with storage.resumable(out, lambda: kept, overwrite=overwrite):
            with bar("optimise", True):
                try:
                    return save(compute(known=known, keep=keep))
                except BaseException:
                    save_latest()
                    raise


def bounds_of(walker: System, over: list[str], bound: list[str]) -> dict[str, tuple[float, float]]:
    """Read the bounds of the free parameters."""
    names = [*map(underscored, over)]
    bounds: dict[str, tuple[float, float]] = {}
    for text in bound:
        name, (low, high) = read_numbers("--bound", "NAME=LO:HI", (float, float), text)
        refuse_again("--bound", name, bounds)
        bounds[name] = low, high
    if not names:
        raise WrongUse("--over is required: a parameter that is free, such as slope")
    for name in names:
        check_parameter(walker, name)
        if name not in bounds:
            typed = hyphenated(name)
            raise WrongUse(f"--bound is required for {typed}: {typed}=LO:HI")
    for name in bounds:
        if name not in names:
            typed = hyphenated(name)
            raise WrongUse(f"--bound is of {typed}, which is not free: add --over {typed}")
    return {name: bounds[name] for name in names}


def objective_of(texts: list[str]) -> str | dict[str, float]:
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
        refuse_again("--objective", name, weights)
        weights[name] = value
    return weights


def optimum_in_words(walker: System, answer: dict, objective: str) -> Iterator[str]:
    """Write the answer of `optimise`."""
    yield f"{objective}, {describe_in_words(walker)}"
    for end in ENDS:
        values = ", ".join(f"{name} {value:.8g}" for name, value in answer[end].items())
        exact, error = answer["exact"][end], answer["exact_error"][end]
        yield f"  {end:8} {values}: {exact:.7g}" + (f" +- {error:.1g}" if error > 0 else "")
    before, after = (answer["exact"][end] for end in ENDS)
    factor = f", by a factor of {after / before:.3f}" if before > 0 else ""
    for end in ENDS:
        if answer["note"][end]:
            yield f"  {end}: {answer['note'][end]}"
    yield f"  a change of {after - before:+.4g}{factor}"
    place = "inside the bounds"
    if answer["at_bound"]:
        place = f"at a bound of {', '.join(answer['at_bound'])}"
    if answer["binding"]:
        place += f", held by the limit of {', '.join(answer['binding'])}"
    end = "converged" if answer["converged"] else "not converged"
    if answer["out_of_time"]:
        end = "out of time: the same command goes on"
    yield f"  {place}; {end}, {answer['evaluations']} evaluations"
    yield f"  {conclude_optimum(answer)}"

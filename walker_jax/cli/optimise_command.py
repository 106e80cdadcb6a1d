"""`walker-jax optimise`."""

import math
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import walker_jax as wj
from walker_jax import storage
from walker_jax.checks import ComputationFailed, WrongUse
from walker_jax.cli.answers import draw, find_earlier, print_json, request_for
from walker_jax.cli.options import (
    PHIDOT_HELP,
    Axes,
    AxisOption,
    Json,
    Out,
    Overwrite,
    PictureOfData,
    RegionSum,
    asked_of,
    grid_from,
    hyphenated,
    read_numbers,
)
from walker_jax.cli.walker_options import takes_walker
from walker_jax.design.problem import default_levels
from walker_jax.design.summary import ENDS, summarise_optimum
from walker_jax.execution.progress import bar
from walker_jax.systems.system import System
from walker_jax.walkers.parameters import check_parameter, describe_in_words, describe_walker

if TYPE_CHECKING:
    import xarray

SAVED_EVERY = 2.0
"""Seconds after which the trace is saved again, at a tenth of a second each; also at the end."""


@takes_walker(systems=True)
def optimise(
    walker: System,
    over: Annotated[
        list[str] | None, typer.Option(help="A parameter that is free; may be repeated.")
    ] = None,
    bound: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=LO:HI", help="Its bounds; one for each of them."),
    ] = None,
    objective: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="area (default), volume, least-disturbance, speed, step-length, spectral-radius, "
            "sensitivity-norm or cost-of-transport; NAME=WEIGHT, repeated, for a weighted sum.",
        ),
    ] = None,
    at_least: Annotated[
        tuple[str, float] | None,
        typer.Option(metavar="NAME VALUE", help="Least speed, step-length, ...; one limit."),
    ] = None,
    at_most: Annotated[
        tuple[str, float] | None,
        typer.Option(metavar="NAME VALUE", help="Greatest value of one of them; one limit."),
    ] = None,
    theta: Annotated[
        AxisOption | None,
        typer.Option(metavar="LO HI N", help="Where the area is measured, as for robustness."),
    ] = None,
    sum_: RegionSum = None,
    at_phidot: Annotated[
        float | None, typer.Option(help=f"{PHIDOT_HELP}: a slice there (else at the gait).")
    ] = None,
    phidot: Annotated[
        AxisOption | None,
        typer.Option(metavar="LO HI N", help="The same for a volume (default: the whole section)."),
    ] = None,
    axis: Axes = None,
    starts: Annotated[
        int, typer.Option(min=1, help="Starts: the walker given, and others within the bounds.")
    ] = 3,
    levels: Annotated[
        int | None,
        typer.Option(
            min=0, max=8, help="Refinement of areas at both ends (default: 4; of volumes 2)."
        ),
    ] = None,
    strides: Annotated[int, typer.Option(min=1, help="Strides a walker is followed for.")] = 200,
    scan: Annotated[
        int, typer.Option(min=0, help="Values of each parameter at which the objective is drawn.")
    ] = 15,
    seed: Annotated[int, typer.Option(min=0, help="Of the starts.")] = 0,
    out: Out = Path("optimum.zarr"),
    figure: PictureOfData = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Design a walker: the parameters with the largest basin, or another objective, by gradient.

    For example: walker-jax optimise --over slope --bound slope=0.001:0.02 --at-least speed 0.06

    Measurements are saved as they are made: the same command resumes an interrupted run. The
    picture shows the ascent over a scan of the objective, and the basins before and after.
    """
    from walker_jax import figures

    bounds = bounds_of(walker, over or [], bound or [])
    weights = objective_of(objective or ["area"])
    lowest, highest = (
        {hyphenated(one[0]): one[1]} if one is not None else {} for one in (at_least, at_most)
    )
    levels = default_levels(weights) if levels is None else levels
    grid = grid_from(walker, theta, sum_, at_phidot, phidot, axis)
    about, limits = describe_walker(walker), {"at_least": lowest, "at_most": highest}
    options: Any = {"starts": starts, "levels": levels, "strides": strides}
    options |= {"scan": scan, "seed": seed}
    asked = {"bounds": bounds, "objective": weights, "axes": asked_of(grid)}
    request = request_for("optimise", walker, walker=about, **asked, **limits, **options)
    figure, data = find_earlier(out, figure, request, overwrite=overwrite)
    if data is None or "found" not in data:  # not begun, or interrupted
        compute = partial(
            wj.optimise, walker, bounds, weights, grid=grid, progress=True, **limits, **options
        )
        data = computed(compute, out, request, overwrite=overwrite)
    if not data["found"]:
        reasons = "; ".join(dict.fromkeys(data["note"].values.tolist()))
        raise ComputationFailed(f"no start leads anywhere: {reasons}")
    draw(figures.optimum(data), figure, request)
    answer = summarise_optimum(data)
    if as_json:
        print_json(answer | {"walker": about})
        return
    print_optimum(walker, answer, " + ".join(objective or ["area"]))
    for note in data["note"].values.tolist():
        if note:
            print(f"  a start led nowhere: {note}")
    print(f"  data set {out}, picture {figure}")


def computed(
    compute: "Callable[..., xarray.Dataset]", out: Path, request: dict, *, overwrite: bool
) -> "xarray.Dataset":
    """The optimum, its trace saved at `out` as it grows; nobody else writes there meanwhile."""
    with storage.rewritable(out, request) as save:
        known = storage.find(out, request, overwrite=overwrite)  # another run may just have ended
        if known is not None and "found" in known:
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
    """The bounds of the parameters that are free."""
    names = [name.replace("-", "_") for name in over]
    bounds: dict[str, tuple[float, float]] = {}
    for text in bound:
        name, (low, high) = read_numbers("--bound", "NAME=LO:HI", (float, float), text)
        if name in bounds:
            raise WrongUse(f"--bound is given twice for {hyphenated(name)}")
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
    """One objective by name, or the weights of several."""
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


def print_optimum(walker: System, answer: dict, objective: str) -> None:
    """The answer of `optimise`, in words."""
    print(f"{objective}, {describe_in_words(walker)}")
    for end in ENDS:
        values = ", ".join(f"{name} {value:.8g}" for name, value in answer[end].items())
        exact, error = answer["exact"][end], answer["exact_error"][end]
        print(f"  {end:8} {values}: {exact:.7g}" + (f" +- {error:.1g}" if error > 0 else ""))
    before, after = (answer["exact"][end] for end in ENDS)
    factor = f", by a factor of {after / before:.3f}" if before > 0 else ""
    for end in ENDS:
        if answer["note"][end]:
            print(f"  {end}: {answer['note'][end]}")
    print(f"  a change of {after - before:+.4g}{factor}")
    place = "inside the bounds"
    if answer["at_bound"]:
        place = f"at a bound of {', '.join(answer['at_bound'])}"
    if answer["binding"]:
        place += f", held by the limit of {', '.join(answer['binding'])}"
    end = "converged" if answer["converged"] else "not converged"
    print(f"  {place}; {end}, {answer['evaluations']} evaluations")

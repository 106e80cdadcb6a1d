"""`walker-jax optimise`."""

from collections.abc import Callable
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import walker_jax as wj
from walker_jax import storage
from walker_jax.checks import ComputationFailed, WrongUse
from walker_jax.cli.answers import description, draw, made_before, print_json, said
from walker_jax.cli.app import app
from walker_jax.cli.options import (
    PHIDOT_HELP,
    Axis,
    Json,
    Out,
    Overwrite,
    PictureOfData,
    region_of,
    takes_walker,
)
from walker_jax.walkers.model import Walker

if TYPE_CHECKING:
    import xarray


@app.command()
@takes_walker
def optimise(
    walker: Walker,
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
            help="area (default), least-disturbance, speed, step-length, spectral-radius or "
            "cost-of-transport; NAME=WEIGHT, repeated, for a weighted sum, to be large.",
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
        Axis | None,
        typer.Option(metavar="LO HI N", help="Where the area is measured, as for robustness."),
    ] = None,
    sum_: Annotated[
        Axis | None, typer.Option("--sum", metavar="LO HI N", help="theta + thetadot.")
    ] = None,
    at_phidot: Annotated[
        float | None, typer.Option(help=f"{PHIDOT_HELP}: a slice there (default: at the gait).")
    ] = None,
    starts: Annotated[
        int, typer.Option(min=1, help="Starts: the walker given, and others within the bounds.")
    ] = 3,
    levels: Annotated[
        int, typer.Option(min=0, max=8, help="Refinement of the areas at both ends.")
    ] = 4,
    strides: Annotated[int, typer.Option(min=1, help="Strides a walker is followed for.")] = 200,
    scan: Annotated[
        int, typer.Option(min=0, help="Values of each parameter at which the objective is drawn.")
    ] = 25,
    seed: Annotated[int, typer.Option(min=0, help="Of the starts.")] = 0,
    out: Out = Path("optimum.zarr"),
    figure: PictureOfData = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Design a walker: the parameters with the largest basin, or another objective, by gradient.

    For example: walker-jax optimise --over slope --bound slope=0.001:0.02 --at-least speed 0.06

    What has been measured is kept as it goes: after an interruption the same command goes on. The
    picture shows the climb over a scan of the objective, and the basins before and after.
    """
    from walker_jax import figures

    bounds = bounds_of(walker, over or [], bound or [])
    wanted = objective_of(objective or ["area"])
    least, most = (dict([one]) if one else {} for one in (at_least, at_most))
    grid = region_of(walker, theta, sum_, at_phidot)
    request = {
        "command": "optimise",
        "walker": description(walker),
        "bounds": bounds,
        "objective": wanted,
        "at_least": least,
        "at_most": most,
        "axes": {} if grid is None else grid.box,
        "starts": starts,
        "levels": levels,
        "strides": strides,
        "scan": scan,
        "seed": seed,
        "version": version("walker-jax"),
    }
    figure, data = made_before(out, figure, request, overwrite=overwrite)
    if data is None or "found" not in data:  # not begun, or interrupted
        options: dict[str, Any] = {"at_least": least, "at_most": most, "grid": grid}
        options |= {"starts": starts, "levels": levels, "strides": strides, "scan": scan}
        compute = partial(wj.optimise, walker, bounds, wanted, seed=seed, progress=True, **options)
        data = computed(compute, out, request, overwrite=overwrite)
    if not data["found"]:
        reasons = "; ".join(dict.fromkeys(data["note"].values.tolist()))
        raise ComputationFailed(f"no start leads anywhere: {reasons}")
    draw(figures.optimised(data), figure, request)
    answer = optimum(data)
    if as_json:
        print_json(answer | {"walker": request["walker"]})
        return
    print_optimum(walker, answer, " + ".join(objective or ["area"]))
    for note in data["note"].values.tolist():
        if note:
            print(f"  a start led nowhere: {note}")
    print(f"  data set {out}, picture {figure}")


def computed(
    compute: "Callable[..., xarray.Dataset]", out: Path, request: dict, *, overwrite: bool
) -> "xarray.Dataset":
    """The optimum, its trace kept at `out` as it grows; nobody else writes there meanwhile."""
    with storage.rewritable(out, request) as save:
        known = storage.find(out, request, overwrite=overwrite)  # another run may just have ended
        if known is not None and "found" in known:
            return known
        kept = known is not None

        def keep(trace: "xarray.Dataset") -> None:
            nonlocal kept
            save(trace)
            kept = True

        try:
            with storage.resumable(out, lambda: kept, overwrite=overwrite):
                return save(compute(known=known, keep=keep))
        except storage.StoreConflict:
            raise
        except WrongUse as error:
            message = str(error)
            for word, options in NAMED.items():
                message = message.replace(f"{word} ", f"{options} ", 1)
            raise WrongUse(message) from error


NAMED = {
    "limits of": "--at-least and --at-most of",
    "limits must be": "--at-least and --at-most must be",
    "bounds of": "--bound of",
    "objective must": "--objective must",
    "grid is": "--theta, --sum and --at-phidot are",
}
"""What the library calls arguments of `optimise`, and the options that set them."""


def bounds_of(walker: Walker, over: list[str], bound: list[str]) -> dict[str, tuple[float, float]]:
    """The bounds of the parameters that are free."""
    from walker_jax.walkers.parameters import check_parameter

    names = [name.replace("-", "_") for name in over]
    bounds: dict[str, tuple[float, float]] = {}
    for text in bound:
        name, _, ends = text.partition("=")
        low, _, high = ends.partition(":")
        try:
            pair = float(low), float(high)
        except ValueError:
            raise WrongUse(f"--bound must be NAME=LO:HI, not {text}") from None
        name = name.replace("-", "_")
        if name in bounds:
            raise WrongUse(f"--bound is given twice for {name}")
        bounds[name] = pair
    if not names:
        raise WrongUse("--over is required: a parameter that is free, such as slope")
    for name in names:
        check_parameter(walker, name)
        if name not in bounds:
            raise WrongUse(f"--bound is required for {name}: {name}=LO:HI")
    for name in bounds:
        if name not in names:
            raise WrongUse(f"--bound is of {name}, which is not free: add --over {name}")
    return {name: bounds[name] for name in names}


def objective_of(texts: list[str]) -> str | dict[str, float]:
    """One objective by name, or the weights of several."""
    if len(texts) == 1 and "=" not in texts[0]:
        return texts[0]
    weights: dict[str, float] = {}
    for text in texts:
        name, _, weight = text.partition("=")
        try:
            value = float(weight)
        except ValueError:
            raise WrongUse(f"--objective must be one NAME, or NAME=WEIGHT, not {text}") from None
        if name in weights:
            raise WrongUse(f"--objective is given twice for {name}")
        weights[name] = value
    return weights


def optimum(data) -> dict:
    """The answer of `optimise`."""
    names = data["parameter"].values.tolist()
    named = lambda key: dict(zip(names, data[key].values.tolist(), strict=True))
    both = lambda key: {end: float(data[f"{key}_{end}"]) for end in ("start", "optimum")}
    held = data["measure"].values[data["binding"].values]
    return {
        "start": named("start"),
        "optimum": named("optimum"),
        "objective": both("objective"),
        "exact": both("exact"),
        "exact_error": {end: float(data[f"exact_{end}_error"]) for end in ("start", "optimum")},
        "at_bound": [name for name, side in named("at_bound").items() if side],
        "binding": held.tolist(),
        "evaluations": data.sizes["evaluation"],
        "converged": bool(data["converged"]),
    }


def print_optimum(walker: Walker, answer: dict, objective: str) -> None:
    """The answer of `optimise`, in words."""
    print(f"{objective}, {said(walker)}")
    for end in ("start", "optimum"):
        values = ", ".join(f"{name} {value:.8g}" for name, value in answer[end].items())
        exact, error = answer["exact"][end], answer["exact_error"][end]
        print(f"  {end:8} {values}: {exact:.7g}" + (f" +- {error:.1g}" if error else ""))
    before, after = answer["exact"]["start"], answer["exact"]["optimum"]
    factor = f", by a factor of {after / before:.3f}" if before > 0 else ""
    change = f"{after - before:+.4g}{factor}"
    print(f"  exactly, it changed by {change}")
    inside = "inside the bounds" if not answer["at_bound"] else ""
    place = inside or f"at a bound of {', '.join(answer['at_bound'])}"
    limit = f", held by the limit of {', '.join(answer['binding'])}" * bool(answer["binding"])
    end = "converged" if answer["converged"] else "not converged"
    print(f"  {place}{limit}; {end}, {answer['evaluations']} evaluations")

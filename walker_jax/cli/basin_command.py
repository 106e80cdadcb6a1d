"""`walker-jax basin`."""

from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
import typer

import walker_jax as wj
from walker_jax.checks import WrongUse
from walker_jax.cli.answers import Stopwatch, description, draw, made_before, print_json, said
from walker_jax.cli.app import app
from walker_jax.cli.options import (
    PHIDOT_HELP,
    WINDOW,
    Axis,
    Json,
    Out,
    Overwrite,
    PictureOfData,
    Scheduler,
    Workers,
    cluster_of,
    filled,
    finite,
    gait_of,
    takes_walker,
)
from walker_jax.walkers.model import Walker

if TYPE_CHECKING:
    import xarray


@app.command()
@takes_walker
def basin(
    walker: Walker,
    theta: Annotated[
        Axis | None,
        typer.Option(metavar="LO HI N", help="Stance angle, rad (default: 0 0.4 200)."),
    ] = None,
    sum_: Annotated[
        Axis | None,
        typer.Option(
            "--sum", metavar="LO HI N", help="theta + thetadot (default: -0.04 0.01 250)."
        ),
    ] = None,
    thetadot: Annotated[
        Axis | None,
        typer.Option(metavar="LO HI N", help="The plain section: thetadot in the place of --sum."),
    ] = None,
    phidot: Annotated[
        Axis | None,
        typer.Option(metavar="LO HI N", help=f"{PHIDOT_HELP}: a grid of three dimensions."),
    ] = None,
    at_phidot: Annotated[
        float | None,
        typer.Option(help="A slice of such a section, followed directly (default: at the gait)."),
    ] = None,
    method: Annotated[
        Literal["cell-map", "direct"] | None,
        typer.Option(
            help="Cell mapping (default), or direct iteration (of a slice always).",
        ),
    ] = None,
    strides: Annotated[
        int | None, typer.Option(min=1, help="Strides at most, direct only (default: 200).")
    ] = None,
    workers: Workers = None,
    scheduler: Scheduler = None,
    out: Out = Path("basin.zarr"),
    figure: PictureOfData = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Compute and draw the basin of attraction of a walker's gait.

    By default that of the simplest walker in the window of Schwab and Wisse (2001), Figure 4. For
    another walker the window is around its gait. The data set is written piece by piece: after an
    interruption the same command goes on.
    """
    from walker_jax import figures
    from walker_jax.basins.schema import artefacts
    from walker_jax.grids import axes_around

    has_phidot = "phidot" in walker.section
    if not has_phidot and (phidot is not None or at_phidot is not None):
        flag = "--phidot" if phidot is not None else "--at-phidot"
        raise WrongUse(
            f"{flag} is for walkers whose section has it, not {', '.join(walker.section)}"
        )
    if phidot is not None and at_phidot is not None:
        raise WrongUse("--phidot and --at-phidot exclude each other: give one of them")
    if thetadot is not None and sum_ is not None:
        raise WrongUse("--sum and --thetadot exclude each other: give one of them")
    cluster = cluster_of(workers, scheduler)
    sliced = has_phidot and phidot is None
    method = method or ("direct" if sliced else "cell-map")
    if sliced and method == "cell-map":
        raise WrongUse("--method cell-map is not for a slice, which walkers leave: give --phidot")
    if strides is not None and method != "direct":
        raise WrongUse("--strides is for --method direct alone")
    strides = strides or 200
    if at_phidot is not None:
        finite(**{"at-phidot": at_phidot})
    axes: dict[str, Axis | float | None] = {"theta": theta}
    axes |= {"sum": sum_} if thetadot is None else {"thetadot": thetadot}
    if has_phidot:
        axes["phidot"] = at_phidot if phidot is None else phidot
    if isinstance(walker, wj.SimplestWalker):
        axes = filled(axes, WINDOW)
    grid_of = wj.Grid.plain if thetadot is not None else wj.Grid.sheared
    # Where an axis is still to be found by a gait, another holds its place.
    shape = grid_of(**filled(axes, {"phidot": 0.0}, default=(0.0, 1.0, 2))).shape
    if min(shape) < 2:
        raise WrongUse(f"a picture needs 2 cells or more along each axis, not {shape}")
    request = {
        "command": "basin",
        "walker": description(walker),
        "axes": {
            name: list(axis) if isinstance(axis, tuple) else axis for name, axis in axes.items()
        },
        "method": method,
        **({"strides": strides} if method == "direct" else {}),
        "version": version("walker-jax"),
    }
    figure, data = made_before(out, figure, request, overwrite=overwrite)
    reused, begun = data is not None, out.exists() and not overwrite
    clock = Stopwatch()
    if data is None:
        if None in axes.values():
            needed = [name for name, axis in axes.items() if axis is None]
            axes = filled(axes, axes_around(gait_of(walker, needed).states[0], tuple(axes)))
        options: Any = {"out": out, "request": request, "overwrite": overwrite}
        options |= {"strides": strides, "cluster": cluster, "progress": True}
        data = wj.basin(walker, grid_of(**axes), method, **options)
    seconds = clock.seconds()
    flat = data["fate"].ndim == 2
    draw_basin = figures.basin if flat else figures.basin_slices
    draw(draw_basin(figures.thinned(data)), figure, request)

    counts, lost, made = tally(data)
    fates = dict(zip(wj.Outcome.__members__, counts.tolist(), strict=True))
    mapped = [name for name in ("cycles", "falling") if name in data]
    attractors = [
        {
            "period": int(data["period"][i]) or None,
            "states": data["states"].values[i][: max(1, int(data["period"][i]))],
            "cells": int(data["cells"][i]),
            "area": float(data["area"][i]),
            "artefact": bool(artefact),
            **{name: int(data[name][i]) for name in mapped},
        }
        for i, artefact in enumerate(artefacts(data))
    ]
    if as_json:
        print_json(
            {
                "slope": request["walker"]["slope"],
                "method": method,
                "cells": int(data["fate"].size),
                "area": float(data["area"].sum()),
                "attractors": attractors,
                "fates": fates,
                "seconds": seconds,
                "walker": request["walker"],
            }
        )
        return
    print(f"Basin of attraction, {said(walker)}, {method}")
    if sliced:
        print(f"  slice at phidot {float(data['phidot']):.10g}")
    measure = "area" if flat else "volume"
    for i, one in enumerate(attractors):
        numbers = [", ".join(f"{value:.6f}" for value in state) for state in one["states"][:4]]
        states = ", ".join(f"({state})" for state in numbers)
        more = ", ..." if len(one["states"]) > 4 else ""
        period = f"period {one['period']}" if one["period"] else "no period"
        size = f"{one['cells']} cell{'s' * (one['cells'] != 1)}, {measure} {one['area']:.6g}"
        kind = "artefact" if one["artefact"] else "attractor"
        print(f"  {kind} {i}: {period}, {size}, at {states}{more}{of_cells(one)}")
    print(f"  {measure} {float(data['area'].sum()):.6g} in all")
    print(
        "  cells: "
        + ", ".join(f"{n} {name}" for name, n in fates.items() if n or name == "UNDECIDED")
    )
    if lost:
        print(f"  {lost} cells walk on without coming near a known attractor")
    if reused:
        print(f"  taken from {out}, computed before")
    elif begun:
        print(f"  went on with {out}, begun before; {seconds['run']:.2f} s to run")
    else:
        made = data["fate"].size if method == "cell-map" else made
        print(
            f"  {made / max(seconds['run'], 1e-9):,.0f} strides per second; "
            f"{seconds['compile']:.1f} s to compile, {seconds['run']:.2f} s to run"
        )
    print(f"  data set {out}, picture {figure}")


def of_cells(attractor: dict) -> str:
    """What stands for an attractor in a cell map, where that is not one cycle that leads there."""
    cycles, falling = attractor.get("cycles", 1), attractor.get("falling", 0)
    if attractor["artefact"]:
        centres = len(attractor["states"])
        if falling == 0:
            return ": walkers from there do not come to one attractor"
        return f": a walker falls from {f'{falling} of {centres}' if centres > 1 else 'there'}"
    joined = [f"{cycles} cycles of cells"] * (cycles > 1)
    joined += [f"a walker falls from {falling} of their centres"] * (falling > 0)
    return f": {', '.join(joined)}" if joined else ""


def tally(data: "xarray.Dataset") -> tuple[np.ndarray, int, int]:
    """Cells of each outcome, those that walk on near no attractor, and the strides of all.

    Few rows at a time: a large data set is not in memory.
    """
    counts, lost, made = np.zeros(len(wj.Outcome), int), 0, 0
    row = data["fate"].dims[0]
    rows = max(1, 2**22 * data.sizes[row] // data["fate"].size)
    for first in range(0, data.sizes[row], rows):
        part = data[["fate", "attractor", "strides"]].isel({row: slice(first, first + rows)})
        fate, attractor, strides = (part[name].values.ravel() for name in part)
        counts += np.bincount(fate, minlength=len(counts))
        lost += int(((fate == wj.Outcome.STRIDE) & (attractor < 0)).sum())
        made += int(strides.sum(dtype=np.int64) + (fate != wj.Outcome.STRIDE).sum())
    return counts, lost, made

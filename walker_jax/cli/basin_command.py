"""`walker-jax basin`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
import typer
from jaxtyping import Float

import walker_jax as wj
from walker_jax import storage
from walker_jax.basins.cell_classes import has_known_units
from walker_jax.basins.summary import summarise_basin, tally
from walker_jax.basins.windows import (
    fill_around_gait,
    grid_along,
    outline,
    whole_section,
)
from walker_jax.checks import WrongUse, is_number
from walker_jax.cli.answers import (
    Stopwatch,
    draw,
    find_earlier,
    listed,
    print_json,
    request_for,
)
from walker_jax.cli.options import (
    PHIDOT_HELP,
    Axes,
    AxisOption,
    Json,
    Out,
    Overwrite,
    PictureOfData,
    Scheduler,
    WindowSum,
    WindowTheta,
    Workers,
    check_drawable,
    check_finite,
    check_phidot,
    check_ranges,
    check_section,
    cluster_from,
    window_from,
)
from walker_jax.cli.walker_options import takes_walker
from walker_jax.execution.progress import bar
from walker_jax.grids import Grid
from walker_jax.systems.system import System
from walker_jax.walkers.model import Walker
from walker_jax.walkers.parameters import describe_in_words, describe_walker

if TYPE_CHECKING:
    import xarray

UNITS = {"area": "rad^2/sqrt(l/g)", "volume": "rad^3 g/l"}
"""Of the sizes of basins."""


@takes_walker(systems=True)
def basin(
    walker: System,
    theta: WindowTheta = None,
    sum_: WindowSum = None,
    thetadot: Annotated[
        AxisOption | None,
        typer.Option(metavar="LO HI N", help="The plain section: thetadot in the place of --sum."),
    ] = None,
    phidot: Annotated[
        AxisOption | None,
        typer.Option(metavar="LO HI N", help=f"{PHIDOT_HELP}: a grid of three dimensions."),
    ] = None,
    at_phidot: Annotated[
        float | None,
        typer.Option(help="A slice of such a section, followed directly (default: at the gait)."),
    ] = None,
    axis: Axes = None,
    method: Annotated[
        Literal["cell-map", "direct"] | None,
        typer.Option(
            help="Cell mapping (default), or direct iteration (always for a slice).",
        ),
    ] = None,
    strides: Annotated[
        int | None, typer.Option(min=1, help="Strides at most, direct only (default: 200).")
    ] = None,
    levels: Annotated[
        int | None,
        typer.Option(
            min=0,
            max=8,
            help="Cut cells on a boundary in two so many times: the area, or volume, with its "
            "error. A section of three dimensions is then taken whole, without --at-phidot.",
        ),
    ] = None,
    seed: Annotated[
        int | None, typer.Option(min=0, help="Seed of random numbers, --levels only (default: 0).")
    ] = None,
    zoom: Annotated[
        float | None,
        typer.Option(
            min=1,
            help="Zoom in on the boundary between fates: a window so many times as narrow, around "
            "a point of it (direct; up to about 1e14).",
        ),
    ] = None,
    near: Annotated[
        tuple[float, float] | None,
        typer.Option(
            metavar="X Y",
            help="Of the boundary, the point nearest to this one, along the first two axes "
            "(default: their middle).",
        ),
    ] = None,
    animate: Annotated[
        Path | None, typer.Option(help="Where a film of the zoom goes, .gif or .mp4.")
    ] = None,
    frames: Annotated[int, typer.Option(min=2, help="Pictures of the film.")] = 120,
    workers: Workers = None,
    scheduler: Scheduler = None,
    out: Out = Path("basin.zarr"),
    figure: PictureOfData = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Compute and draw the basin of attraction of a walker's gait.

    The default is the basin of the simplest walker in the window of Schwab and Wisse (2001), Figure
    4. For another walker the window is around its gait. The data set is written piece by piece: the
    same command resumes an interrupted run. With --zoom 1e12 the window is one in which float64
    hardly tells starts apart; its digits are kept.
    """
    check_section(walker, axis)
    has_phidot = isinstance(walker, Walker) and "phidot" in walker.section
    check_phidot(walker, at_phidot, phidot)
    if thetadot is not None and sum_ is not None:
        raise WrongUse("--sum and --thetadot exclude each other: give one of them")
    cluster = cluster_from(workers, scheduler)
    if levels is not None and cluster is not None:
        raise WrongUse("--workers and --scheduler are for pieces, not for --levels: leave them out")
    if levels is not None and method == "cell-map":
        raise WrongUse("--method must be direct with --levels, not cell-map")
    if levels is not None and zoom is not None:
        raise WrongUse("--zoom and --levels exclude each other: give one of them")
    axes: dict[str, Any] = {"theta": theta}
    axes |= {"sum": sum_} if thetadot is None else {"thetadot": thetadot}
    if has_phidot:
        axes["phidot"] = at_phidot if phidot is None else phidot
    axes = window_from(walker, axis, axes)
    whole = has_phidot and levels is not None and at_phidot is None and not axis
    sliced = has_phidot and phidot is None and not whole
    if axis:
        check_ranges(axes, 3 if zoom is None else 2)
        sliced = any(map(is_number, axes.values()))
    if zoom is None and (near is not None or animate is not None):
        raise WrongUse(
            f"{'--near' if near is not None else '--animate'} is for a --zoom: give it too"
        )
    if zoom is not None and method == "cell-map":
        raise WrongUse(
            "--method must be direct with --zoom, whose window walkers leave: leave it out"
        )
    if phidot is not None and (near is not None or animate is not None):
        raise WrongUse(
            "--near and --animate are for a window of two dimensions: leave out --phidot"
        )
    method = "direct" if levels is not None or zoom is not None else method
    method = method or ("direct" if sliced else "cell-map")
    if sliced and method == "cell-map":
        raise WrongUse(
            "--method must be direct for a slice, which walkers leave: drop it, or give "
            + ("a range for each --axis" if axis else "--phidot")
        )
    if strides is not None and method != "direct":
        raise WrongUse("--strides is for --method direct alone: give it too")
    if seed is not None and levels is None:
        raise WrongUse("--seed is for --levels alone: give it too")
    strides, seed = strides or 200, seed or 0
    if at_phidot is not None:
        check_finite(**{"at-phidot": at_phidot})
    if whole and isinstance(walker, Walker):  # the latter for the type checker alone
        known = whole_section(walker)
        axes = {name: known[name] if axis is None else axis for name, axis in axes.items()}
    check_drawable(outline(axes))
    asked = {
        "axes": {
            name: list(axis) if isinstance(axis, tuple) else axis for name, axis in axes.items()
        },
        "method": method,
        **({"strides": strides} if method == "direct" else {}),
        **({} if levels is None else {"levels": levels, "seed": seed}),
        **({} if zoom is None else {"zoom": zoom, "near": near and list(near)}),
    }
    request = request_for("basin", walker, walker=describe_walker(walker), **asked)
    shots = request | {"frames": frames}
    if animate is not None:
        from walker_jax import figures

        figures.check_film(animate)
        storage.check_picture(animate, shots, overwrite=overwrite, argument="animate")
    figure, data = find_earlier(out, figure, request, overwrite=overwrite)
    reused, resumed = data is not None, out.exists() and not overwrite
    clock = Stopwatch()
    if data is None:
        with bar("search for a gait", True):
            grid = grid_along(fill_around_gait(walker, axes))
        if levels is None:
            if zoom is not None:
                grid = grid.zoom(zoom_centre(walker, grid, near, strides), zoom)
            options: Any = {"out": out, "request": request, "overwrite": overwrite}
            options |= {"strides": strides, "cluster": cluster, "progress": True}
            with bar("basin", True):
                data = wj.basin(walker, grid, method, **options)
        else:
            with storage.rewritable(out, request) as save, bar("basin", True):
                refined = wj.refine(walker, grid, levels, strides=strides, seed=seed, progress=True)
                data = save(refined)
    seconds = clock.seconds()
    draw(draw_basin(data), figure, request)
    if animate is not None and zoom is not None:
        from walker_jax import figures

        first, centre = grid_along(fill_around_gait(walker, axes)), data.attrs["origin"]
        shown = wj.zoom(walker, first, zoom, centre, frames=frames, strides=strides, progress=True)
        figures.zoom_film(shown, animate, signature=storage.signature(shots), progress=True)

    # The data set has no coordinate for a slice through one that is not the last of the section.
    fixed = {name: at for name, at in axes.items() if is_number(at)}
    fixed |= {
        name: float(data[name]) for name in walker.section if name in data and not data[name].ndim
    }
    counts = tally(data)
    answer = summarise_basin(data, counts)
    if as_json:
        about = request["walker"]
        slope = {"slope": about["slope"]} if "slope" in about else {}
        answer = slope | {"method": data.attrs["method"]} | answer
        print_json(answer | {"seconds": seconds, "walker": about})
        return
    print(f"Basin of attraction, {describe_in_words(walker)}, {data.attrs['method']}")
    if zoom is not None:
        print(f"  window {zoom:g} times as narrow, around ({listed(data.attrs['origin'], '.17g')})")
    if fixed:
        print(f"  slice at {', '.join(f'{name} {value:.10g}' for name, value in fixed.items())}")
    measure = "volume" if "run_fate" in data or data["fate"].ndim == 3 else "area"
    unit = UNITS[measure] if has_known_units(data) else ""
    print_basin(answer, measure, unit, zoomed=zoom is not None)
    if counts.unmatched:
        print(f"  {counts.unmatched} cells walk on without coming near a known attractor")
    if reused:
        print(f"  taken from {out}, computed before")
    elif resumed:
        print(f"  resumed {out}; {seconds['run']:.2f} s to run")
    else:
        made = answer["cells"] if method == "cell-map" else counts.strides
        made = made if levels is None else int(data["strides_made"])
        print(
            f"  {made:,} strides; {seconds['compile']:.1f} s to compile, "
            f"{seconds['run']:.2f} s to run and to store"
        )
    film = f", film {animate}" if animate is not None else ""
    print(f"  data set {out}, picture {figure}{film}")


def zoom_centre(
    walker: System, grid: Grid, near: tuple[float, float] | None, strides: int
) -> Float[np.ndarray, " section"]:
    """The point of the boundary to zoom in on."""
    point = None
    if near is not None:
        check_finite(near=near[0])
        check_finite(near=near[1])
        point = np.asarray(grid.origin) + np.asarray(grid.shear) @ np.array(near)
    return wj.boundary_point(walker, grid, point, strides=strides)


def draw_basin(data: "xarray.Dataset"):
    """The picture of a basin, in two dimensions or three."""
    from walker_jax import figures

    if "run_fate" in data:
        return figures.volume(data)
    draw_cells = figures.basin if data["fate"].ndim == 2 else figures.basin_slices
    return draw_cells(figures.thin(data))


def print_basin(answer: dict, measure: str, unit: str, *, zoomed: bool) -> None:
    """The attractors and fates of a basin, in words; `measure` is the kind of its size.

    That a basin goes on beyond the grid is not said of a window within it.
    """
    for i, one in enumerate(answer["attractors"]):
        states = ", ".join(f"({listed(state)})" for state in one["states"][:4])
        more = ", ..." if len(one["states"]) > 4 else ""
        period = f"period {one['period']}" if one["period"] else "no period"
        size = f"{one['cells']} cell{'s' * (one['cells'] != 1)}, {measure} {one['area']:.6g}"
        kind = "artefact" if one["artefact"] else "attractor"
        print(f"  {kind} {i}: {period}, {size}, at {states}{more}{cycles_in_words(one)}")
    if f"{measure}_error" in answer:
        size, error = answer[measure], answer[f"{measure}_error"]
        print(f"  {measure} {size:.7g} +- {error:.1g} {unit}".rstrip() + " in all")
    else:
        print(f"  {measure} {answer['area']:.6g} in all")
    if answer.get("at_border") and not zoomed:
        print(f"  the basin reaches the border of the grid, in {answer['at_border']} cells")
    fates = [f"{n} {name}" for name, n in answer["fates"].items() if n or name == "UNDECIDED"]
    print(f"  cells: {', '.join(fates)}")


def cycles_in_words(attractor: dict) -> str:
    """Describes the cycles of a cell map that belong to an attractor; empty for a single one."""
    cycles, falling = attractor.get("cycles", 1), attractor.get("falling", 0)
    if attractor["artefact"]:
        centres = len(attractor["states"])
        if falling == 0:
            return ": walkers from there do not converge to one attractor"
        return f": a walker falls from {f'{falling} of {centres}' if centres > 1 else 'there'}"
    parts = [f"{cycles} cycles of cells"] * (cycles > 1)
    parts += [f"a walker falls from {falling} of their centres"] * (falling > 0)
    return f": {', '.join(parts)}" if parts else ""

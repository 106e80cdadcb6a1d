"""`walker-jax basin`."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from jaxtyping import Float

import walker_jax as wj
from walker_jax import storage
from walker_jax.basins.cell_classes import has_known_units
from walker_jax.basins.summary import Tally, summarise_basin, tally
from walker_jax.basins.windows import fill_around_gait, grid_along, whole_section
from walker_jax.checks import WrongUse, is_number
from walker_jax.cli.answers import (
    Output,
    Stopwatch,
    check_film,
    listed,
    points_listed,
    request_for,
    slope_of,
)
from walker_jax.cli.groups import option
from walker_jax.cli.options import PHIDOT_HELP, Pieces, check_finite, exclude, refuse
from walker_jax.cli.section import AXIS, Axis, Window, check_section
from walker_jax.cli.walker_options import takes_walker
from walker_jax.execution.progress import bar
from walker_jax.grids import Grid
from walker_jax.systems.system import System
from walker_jax.walkers.model import Walker
from walker_jax.walkers.parameters import describe_in_words

if TYPE_CHECKING:
    import xarray

UNITS = {"area": "rad^2/sqrt(l/g)", "volume": "rad^3 g/l"}
"""Of the sizes of basins."""


@dataclass(frozen=True)
class BasinWindow(Window):
    """A window of two dimensions or three, sheared or plain."""

    at_phidot: float | None = option(
        None, "A slice of such a section, followed directly (default: at the gait)."
    )
    thetadot: Axis | None = option(
        None, "The plain section: thetadot in the place of --sum.", **AXIS
    )
    phidot: Axis | None = option(None, f"{PHIDOT_HELP}: a grid of three dimensions.", **AXIS)

    def check(self, walker: System) -> None:
        check_section(walker, self.axis)
        super().check(walker)
        exclude(sum=self.sum, thetadot=self.thetadot)

    def own_axes(self, walker: Walker) -> dict[str, Any]:
        axes: dict[str, Any] = {"theta": self.theta}
        axes |= {"sum": self.sum} if self.thetadot is None else {"thetadot": self.thetadot}
        if "phidot" in walker.section:
            axes["phidot"] = self.at_phidot if self.phidot is None else self.phidot
        return axes


@dataclass(frozen=True)
class How:
    """How the cells of a basin are labelled."""

    method: Literal["cell-map", "direct"] | None = option(
        None, "Cell mapping (default), or direct iteration (always for a slice)."
    )
    strides: int | None = option(None, "Strides at most, direct only (default: 200).", min=1)
    levels: int | None = option(
        None,
        "Cut cells on a boundary in two so many times: the area, or volume, with its error. A "
        "section of three dimensions is then taken whole, without --at-phidot.",
        min=0,
        max=8,
    )
    seed: int | None = option(None, "Seed of random numbers, --levels only (default: 0).", min=0)

    def settings(self, *, sliced: bool, zoomed: bool, drop: str) -> dict[str, Any]:
        """The method and what it takes; `drop` is what else a slice by cell mapping may be."""
        direct = sliced or zoomed or self.levels is not None
        if self.method == "cell-map" and self.levels is not None:
            raise WrongUse("--method must be direct with --levels, not cell-map")
        if self.method == "cell-map" and zoomed:
            raise WrongUse(
                "--method must be direct with --zoom, whose window walkers leave: leave it out"
            )
        if self.method == "cell-map" and sliced:
            raise WrongUse(
                f"--method must be direct for a slice, which walkers leave: drop it, or give {drop}"
            )
        method = self.method or ("direct" if direct else "cell-map")
        if method == "cell-map":
            refuse("is for --method direct alone: give it too", strides=self.strides)
        if self.levels is None:
            refuse("is for --levels alone: give it too", seed=self.seed)
            refined = {}
        else:
            refined = {"levels": self.levels, "seed": self.seed or 0}
        limit = {"strides": self.strides or 200} if method == "direct" else {}
        return {"method": method, **limit, **refined}


@dataclass(frozen=True)
class Zoom:
    """A narrow window on the boundary between fates."""

    zoom: float | None = option(
        None,
        "Zoom in on the boundary between fates: a window so many times as narrow, around a point "
        "of it (direct; up to about 1e14).",
        min=1,
    )
    near: tuple[float, float] | None = option(
        None,
        "Of the boundary, the point nearest to this one, along the first two axes (default: their "
        "middle).",
        metavar="X Y",
    )
    animate: Path | None = option(None, "Where a film of the zoom goes, .gif or .mp4.")
    frames: int = option(120, "Pictures of the film.", min=2)

    def check(self, window: BasinWindow, how: How) -> None:
        """Refuse what a zoom excludes, and what is for one alone."""
        exclude(zoom=self.zoom, levels=how.levels)
        if self.zoom is None:
            refuse("is for a --zoom: give it too", near=self.near, animate=self.animate)
        elif window.phidot is not None and (self.near is not None or self.animate is not None):
            raise WrongUse(
                "--near and --animate are for a window of two dimensions: leave out --phidot"
            )
        for value in self.near or ():
            check_finite(near=value)

    def settings(self) -> dict[str, Any]:
        """What is asked for, if anything is."""
        return {} if self.zoom is None else {"zoom": self.zoom, "near": self.near}

    def grid(self, walker: System, grid: Grid, strides: int = 200) -> Grid:
        """The grid, or the narrow window in it."""
        if self.zoom is None:
            return grid
        point: Float[np.ndarray, " section"] | None = None
        if self.near is not None:
            point = np.asarray(grid.origin) + np.asarray(grid.shear) @ np.array(self.near)
        return grid.zoom(wj.boundary_point(walker, grid, point, strides=strides), self.zoom)


@takes_walker(systems=True)
def basin(
    walker: System,
    window: BasinWindow,
    how: How,
    zoom: Zoom,
    pieces: Pieces,
    output: Output = Output(Path("basin.zarr")),
) -> None:
    """Compute and draw the basin of attraction of a walker's gait.

    The default is the basin of the simplest walker in the window of Schwab and Wisse (2001), Figure
    4. For another walker the window is around its gait. The data set is written piece by piece: the
    same command resumes an interrupted run. With --zoom 1e12 the window is one in which float64
    hardly tells starts apart; its digits are kept.
    """
    axes, settings = ask(walker, window, how, zoom, pieces)
    request = request_for("basin", walker, axes=axes, **settings, **zoom.settings())
    shots = request | {"frames": zoom.frames}
    if zoom.animate is not None:
        check_film(zoom.animate, shots, overwrite=output.overwrite)
    data = output.find(request)
    kept = f"taken from {output.out}, computed before" if data is not None else ""
    if not kept and output.out.exists() and not output.overwrite:
        kept = f"resumed {output.out}"
    clock = Stopwatch()
    if data is None:
        data = compute(walker, zoom, pieces, output, request)
    seconds = clock.seconds()
    output.draw(draw_basin(data), request)
    if zoom.animate is not None:
        draw_film(walker, zoom, data, shots)
    counts = tally(data)
    answer = summarise_basin(data, counts)
    about = {"seconds": seconds, "walker": request["walker"]}
    answer = slope_of(request["walker"]) | {"method": data.attrs["method"]} | answer | about
    lines = basin_in_words(walker, data, answer, counts, request, kept)
    output.tell(answer, lines, film=zoom.animate)


def ask(
    walker: System, window: BasinWindow, how: How, zoom: Zoom, pieces: Pieces
) -> tuple[dict[str, Any], dict[str, Any]]:
    """The axes and the settings that the options ask for; refuses what excludes another."""
    zoom.check(window, how)
    axes = window.axes(walker, 3 if zoom.zoom is None else 2)
    turned = isinstance(walker, Walker) and "phidot" in walker.section and not window.axis
    whole = turned and how.levels is not None and window.at_phidot is None
    if window.axis:
        sliced = any(map(is_number, axes.values()))
    else:
        sliced = turned and window.phidot is None and not whole
    drop = "a range for each --axis" if window.axis else "--phidot"
    settings = how.settings(sliced=sliced, zoomed=zoom.zoom is not None, drop=drop)
    if pieces.cluster() is not None and how.levels is not None:
        raise WrongUse("--workers and --scheduler are for pieces, not for --levels: leave them out")
    if whole and isinstance(walker, Walker):  # the latter for the type checker alone
        known = whole_section(walker)
        axes = {name: known[name] if axis is None else axis for name, axis in axes.items()}
    return axes, settings


def compute(
    walker: System, zoom: Zoom, pieces: Pieces, output: Output, request: dict
) -> "xarray.Dataset":
    """The data set of a request, which goes on where an interrupted run has ended."""
    with bar("search for a gait", True):
        grid = grid_along(fill_around_gait(walker, request["axes"]))
    strides = {name: request[name] for name in ("strides",) if name in request}
    if "levels" in request:
        refined = {name: request[name] for name in ("levels", "seed")}
        with storage.rewritable(output.out, request) as save, bar("basin", True):
            return save(wj.refine(walker, grid, progress=True, **refined, **strides))
    grid = zoom.grid(walker, grid, **strides)
    with bar("basin", True):
        return wj.basin(
            walker,
            grid,
            request["method"],
            cluster=pieces.cluster(),
            progress=True,
            **strides,
            **output.place(request),
        )


def draw_basin(data: "xarray.Dataset"):
    """The picture of a basin, in two dimensions or three."""
    from walker_jax import figures

    if "run_fate" in data:
        return figures.volume(data)
    draw_cells = figures.basin if data["fate"].ndim == 2 else figures.basin_slices
    return draw_cells(figures.thin(data))


def draw_film(walker: System, zoom: Zoom, data: "xarray.Dataset", shots: dict) -> None:
    """Save the film of a zoom into the middle of a basin's data set."""
    from walker_jax import figures

    grid, centre = grid_along(fill_around_gait(walker, shots["axes"])), data.attrs["origin"]
    how: Any = {"frames": zoom.frames, "strides": shots["strides"], "progress": True}
    shown = wj.zoom(walker, grid, shots["zoom"], centre, **how)
    signature = storage.signature(shots)
    figures.zoom_film(shown, zoom.animate, signature=signature, progress=True)


def basin_in_words(
    walker: System, data: "xarray.Dataset", answer: dict, counts: Tally, request: dict, kept: str
) -> Iterator[str]:
    """The answer of `basin`; `kept` is what of it stood there before."""
    yield f"Basin of attraction, {describe_in_words(walker)}, {answer['method']}"
    if "zoom" in request:
        centre = listed(data.attrs["origin"], ".17g")
        yield f"  window {request['zoom']:g} times as narrow, around ({centre})"
    # The data set has no coordinate for a slice through one that is not the last of the section.
    fixed = {name: at for name, at in request["axes"].items() if is_number(at)}
    fixed |= {
        name: float(data[name]) for name in walker.section if name in data and not data[name].ndim
    }
    if fixed:
        yield f"  slice at {', '.join(f'{name} {value:.10g}' for name, value in fixed.items())}"
    measure = "volume" if "run_fate" in data or data["fate"].ndim == 3 else "area"
    unit = UNITS[measure] if has_known_units(data) else ""
    yield from sizes_in_words(answer, measure, unit, zoomed="zoom" in request)
    if counts.unmatched:
        yield f"  {counts.unmatched} cells walk on without coming near a known attractor"
    seconds = answer["seconds"]
    if kept:
        yield f"  {kept}" + f"; {seconds['run']:.2f} s to run" * kept.startswith("resumed")
        return
    made = answer["cells"] if answer["method"] == "cell-map" else counts.strides
    made = int(data["strides_made"]) if "strides_made" in data else made
    yield (
        f"  {made:,} strides; {seconds['compile']:.1f} s to compile, "
        f"{seconds['run']:.2f} s to run and to store"
    )


def sizes_in_words(answer: dict, measure: str, unit: str, *, zoomed: bool) -> Iterator[str]:
    """The attractors and fates of a basin; `measure` is the kind of its size.

    That a basin goes on beyond the grid is not said of a window within it.
    """
    for i, one in enumerate(answer["attractors"]):
        period = f"period {one['period']}" if one["period"] else "no period"
        size = f"{one['cells']} cell{'s' * (one['cells'] != 1)}, {measure} {one['area']:.6g}"
        kind = "artefact" if one["artefact"] else "attractor"
        states = points_listed(one["states"])
        yield f"  {kind} {i}: {period}, {size}, at {states}{cycles_in_words(one)}"
    if f"{measure}_error" in answer:
        size, error = answer[measure], answer[f"{measure}_error"]
        yield f"  {measure} {size:.7g} +- {error:.1g} {unit}".rstrip() + " in all"
    else:
        yield f"  {measure} {answer['area']:.6g} in all"
    if answer.get("at_border") and not zoomed:
        yield f"  the basin reaches the border of the grid, in {answer['at_border']} cells"
    fates = [f"{n} {name}" for name, n in answer["fates"].items() if n or name == "UNDECIDED"]
    yield f"  cells: {', '.join(fates)}"


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

"""`walker-jax basin`."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import walker_jax as wj
from walker_jax.cli import library as lib
from walker_jax.cli.answers import (
    WALKING,
    Output,
    Pieces,
    Stopwatch,
    Terms,
    check_picture,
    in_words,
    listed,
    points_listed,
    request_for,
    slope_of,
    terms_of,
)
from walker_jax.cli.commands import command
from walker_jax.cli.options import Choice, option, refuse
from walker_jax.cli.section import axes_option, check_section, grid_of, window_on
from walker_jax.refusals import WrongUse

UNITS = {"area": "rad^2/sqrt(l/g)", "volume": "rad^3 g/l"}
"""Units of the sizes of basins."""


def settings_of(
    walker: "wj.System",
    axes: dict[str, Any],
    method: str | None,
    strides: int | None,
    levels: int | None,
    zoom: float | None,
) -> dict[str, Any]:
    """Return the method, and its strides at most."""
    direct = ""  # the reason why the method must be direct
    if levels is not None:
        direct = "with --levels, not cell-map"
    elif zoom is not None:
        direct = "with --zoom, as walkers leave its window: leave out --method"
    elif axes.get("phidot", ()) is None or any(isinstance(one, float) for one in axes.values()):
        whole = "a range for each --axis"
        direct = f"for a slice, as walkers leave it: leave out --method, or give {whole}"
    if direct and method == "cell-map":
        raise WrongUse(f"--method must be direct {direct}")
    if method is None:
        method = "direct" if direct or not isinstance(walker, wj.Walker) else "cell-map"
    if method == "cell-map":
        refuse("is for --method direct alone: give it too", strides=strides)
        return {"method": method}
    return {"method": method, "strides": strides or 200}


@command(
    examples=(
        "basin",
        "basin --method direct --slope 0.009 --out steep.zarr",
        "basin --walker round-foot --foot-radius 0.3",
        "basin --system henon --a 1.02 --method direct",
    ),
    time="Five seconds for the paper's grid, and a second for each further million cells.",
    out="basin.zarr",
)
def basin(
    walker: "wj.System",
    pieces: Pieces,
    output: Output,
    axes: dict[str, Any] = axes_option("Window"),
    method: str | None = option(
        None,
        "How (default: cell-map for walkers, direct for other systems and for slices).",
        type=Choice("cell-map", "direct"),
    ),
    strides: int | None = option(None, "Strides at most, direct only (default: 200)."),
    levels: int | None = option(
        None,
        "Halve boundary cells this many times: area or volume with its error.",
        excludes=["workers", "scheduler"],
        least=0,
        most=8,
    ),
    seed: int = option(0, "Seed of random numbers, --levels only.", least=0, needs="levels"),
    zoom: float | None = option(
        None, "A window on the boundary, narrowed by this factor, up to 1e14.", excludes=["levels"]
    ),
    near: tuple[float, float] | None = option(
        None, "Zoom to the boundary's point nearest to this one.", needs="zoom"
    ),
    animate: Path | None = option(
        None, "Where a film of the zoom goes, .gif or .mp4.", needs="zoom"
    ),
    frames: int = option(120, "Pictures of the film.", least=2, needs="animate"),
):
    """Compute and draw the basin of attraction of a walker's gait.

    The default window is that of Schwab and Wisse (2001), Figure 4, --theta 0 0.4 200 --sum -0.04
    0.01 250; for another walker it is around its gait. With --levels a section of three dimensions
    is taken whole. The same command resumes an interrupted run.
    """
    check_section(walker, axes)
    axes = window_on(walker, axes, 2 if near or animate else 3)
    if levels is not None:
        known = lib.whole_section(walker)
        if known is not None and not isinstance(axes["phidot"], float):
            axes = {name: known[name] if axis is None else axis for name, axis in axes.items()}
    settings = settings_of(walker, axes, method, strides, levels, zoom)
    if levels is not None:
        settings |= {"levels": levels, "seed": seed}
    if zoom is not None:
        settings |= {"zoom": zoom, "near": near}
    request = request_for("basin", walker, axes=axes, **settings)
    shots = request | {"frames": frames}
    check_picture(animate, shots, overwrite=output.overwrite, film=True)
    data = output.find(request)
    kept = f"taken from {output.out}, computed before" if data is not None else ""
    resumed = not kept and output.out.exists() and not output.overwrite
    clock = Stopwatch()
    if data is None:
        data = compute(walker, request, output, pieces.cluster)
    seconds = clock.seconds()
    output.draw(draw_basin(walker, data, request), request)
    if animate is not None:
        draw_film(walker, data, shots, animate)
    counts, terms = lib.tally(data), terms_of(walker)
    answer: dict[str, Any] = slope_of(request["walker"]) | {"method": data.attrs["method"]}
    answer |= lib.summarise_basin(data, counts)
    answer |= {"seconds": seconds, "walker": request["walker"]}
    if resumed:
        kept = f"resumed {output.out}; {seconds['run']:.2f} s to run"
    yield answer
    yield f"Basin of attraction, {lib.write_description(request['walker'])}, {answer['method']}"
    if "zoom" in request:
        centre = listed(data.attrs["origin"], ".17g")
        yield f"  window {request['zoom']:g} times as narrow, around ({centre})"
    fixed = lib.fixed_coordinates(data)
    if fixed:
        yield f"  slice at {', '.join(f'{name} {value:.10g}' for name, value in fixed.items())}"
    measure = "volume" if "run_fate" in data or data["fate"].ndim == 3 else "area"
    unit = UNITS[measure] if lib.has_known_units(data) else ""
    yield from sizes_in_words(answer, measure, unit, terms, zoomed="zoom" in request)
    yield from fates_in_words(answer["fates"], walker)
    if counts.unmatched:
        cells = f"{counts.unmatched} cells whose {terms.start} {terms.goes} on"
        yield f"  {cells} come near no known attractor"
    yield f"  {kept or effort(data, answer, counts, terms)}"
    yield f"  {next_step(answer, request, terms)}"
    yield output.places(animate)


def compute(
    walker: "wj.System", request: dict, output: Output, cluster: int | str | None
) -> "lib.xarray.Dataset":
    """Compute the data set of a request, resuming an interrupted run."""
    with lib.bar(f"search for a {terms_of(walker).cycle}", True):
        grid = grid_of(walker, request["axes"])
    strides = {name: request[name] for name in ("strides",) if name in request}
    if "levels" in request:
        how = {"seed": request["seed"], "progress": True, **strides}
        with lib.storage.rewritable(output.out, request) as save, lib.bar("basin", True):
            return save(wj.refine(walker, grid, request["levels"], **how))
    if "zoom" in request:
        near: Any = request["near"]
        if near is not None:
            near = lib.numpy.asarray(grid.origin) + lib.numpy.asarray(grid.shear) @ near
        grid = grid.zoom(wj.boundary_point(walker, grid, near, **strides), request["zoom"])
    how = {"cluster": cluster, **strides, **output.place(request)}
    with lib.bar("basin", True):
        return wj.basin(walker, grid, request["method"], **how)


def draw_basin(walker: "wj.System", data: "lib.xarray.Dataset", request: dict):
    """Draw a basin in two or three dimensions, a zoom together with its surroundings."""
    figures = wj.figures
    if "zoom" in request and data["fate"].ndim == 2:
        axes = lib.fill_around_gait(walker, request["axes"])
        for name, axis in axes.items():
            if not isinstance(axis, float):
                low, high, count = axis
                axes[name] = low, high, max(2, count // 2)
        around = wj.basin(walker, lib.grid_along(axes), "direct", strides=request["strides"])
        return figures.zoomed_basin(figures.thin(data), around)
    if "run_fate" in data:
        return figures.volume(data)
    draw_cells = figures.basin if data["fate"].ndim == 2 else figures.basin_slices
    return draw_cells(figures.thin(data))


def draw_film(walker: "wj.System", data: "lib.xarray.Dataset", shots: dict, film: Path) -> None:
    """Save the film of a zoom to the middle of a basin's data set."""
    grid, centre = grid_of(walker, shots["axes"]), data.attrs["origin"]
    how: Any = {"frames": shots["frames"], "strides": shots["strides"], "progress": True}
    shown = wj.zoom(walker, grid, shots["zoom"], centre, **how)
    wj.figures.zoom_film(shown, film, signature=lib.storage.signature(shots), progress=True)


def next_step(answer: dict, request: dict, terms: Terms = WALKING) -> str:
    """Write the share of starts that converge, and what to do next."""
    cells = sum(one["cells"] for one in answer["attractors"] if not one["artefact"])
    if not cells:
        where = f"walker-jax gait tells where a {terms.cycle} is"
        return f"No start in this window converges: {where}."
    then = "--levels 2 gives the size of the basin with its error"
    if "zoom" in request:
        then = "a larger --zoom goes deeper into the boundary"
    elif "levels" in request:
        then = f"walker-jax robustness tells how large a disturbance the {terms.cycle} survives"
    share = cells / sum(answer["fates"].values())
    return f"{share:.2%} of these starts converge to an attractor: {then}."


def effort(data: "lib.xarray.Dataset", answer: dict, counts: "lib.Tally", terms: Terms) -> str:
    """Write the number of strides and the time they took."""
    made = answer["cells"] if answer["method"] == "cell-map" else counts.strides
    made = int(data["strides_made"]) if "strides_made" in data else made
    compiling, running = answer["seconds"]["compile"], answer["seconds"]["run"]
    times = f"{compiling:.1f} s to compile, {running:.2f} s to run and to store"
    return f"{made:,} {terms.step}s; {times}"


def sizes_in_words(
    answer: dict, measure: str, unit: str, terms: Terms = WALKING, *, zoomed: bool
) -> Iterator[str]:
    """Write the attractors of a basin; `measure` is "area" or "volume".

    A zoomed window lies within the basin's surroundings, so its border is not mentioned, and the
    border means nothing for artefacts alone.
    """
    for i, one in enumerate(answer["attractors"]):
        period = f"period {one['period']}" if one["period"] else "no period"
        size = f"{one['cells']} cell{'s' * (one['cells'] != 1)}, {measure} {one['area']:.6g}"
        kind = "artefact" if one["artefact"] else "attractor"
        states = points_listed(one["states"])
        yield f"  {kind} {i}: {period}, {size}, at {states}{cycles_in_words(one, terms)}"
    if f"{measure}_error" in answer:
        size, error = answer[measure], answer[f"{measure}_error"]
        yield f"  {measure} {size:.7g} +- {error:.1g} {unit}".rstrip() + " in all"
    else:
        yield f"  {measure} {answer['area']:.6g} in all"
    made_up = [one["artefact"] for one in answer["attractors"]]
    only_artefacts = bool(made_up) and all(made_up)
    if answer.get("at_border") and not zoomed and not only_artefacts:
        yield f"  the basin reaches the border of the grid, in {answer['at_border']} cells"


def fates_in_words(fates: dict[str, int], walker: "wj.System") -> Iterator[str]:
    """Write a line for each fate: its share and number of cells."""
    whole = max(1, sum(fates.values()))
    for name, count in fates.items():
        if count:
            yield f"  {count / whole:7.2%}  {in_words(name, walker)}, {count:,} cells"


def cycles_in_words(attractor: dict, terms: Terms = WALKING) -> str:
    """Describe the cycles of a cell map that belong to an attractor; empty for a single one."""
    cycles, falling = attractor.get("cycles", 1), attractor.get("falling", 0)
    one = f"a {terms.start} {terms.fails} from"
    if attractor["artefact"]:
        centres = len(attractor["states"])
        if falling == 0:
            return f": {terms.start}s from there do not converge to one attractor"
        return f": {one} {f'{falling} of {centres}' if centres > 1 else 'there'}"
    parts = [f"{cycles} cycles of cells"] * (cycles > 1)
    parts += [f"{one} {falling} of their centres"] * (falling > 0)
    return f": {', '.join(parts)}" if parts else ""

"""Pictures of an optimisation."""

import json
from collections.abc import Sequence
from typing import Any, cast

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from walker_jax.checks import WrongUse
from walker_jax.design.evaluation import ENDS_STAGE
from walker_jax.design.optimisation import ATTRACTED
from walker_jax.figures.labels import free
from walker_jax.figures.regions import Region, failures, painted, show
from walker_jax.figures.style import (
    ASTRAY,
    AXIS_LABELS,
    BASINS,
    BELOW,
    FAINT,
    INK,
    LINE,
    OBJECTIVES,
    WHOLE,
    WORDS,
    area_of_basin,
    ends,
    in_slice,
    listed,
    named,
    place_legend,
    title,
    valued,
    write_title,
)
from walker_jax.walking.outcomes import Outcome

STAGES = (
    ("#a9bfe3", 8.5, "long steps"),
    ("#7391c9", 7, "medium"),
    ("#3f5f9f", 5.5, "short"),
    (BASINS[0], 4, "very short"),
)
"""Colour, size and words of the evaluations in each stage of an optimisation."""
SCAN, BARRED = "#9b9b9b", "#ebebeb"
"""Colours of the scan, and behind what limits do not allow."""


def optimisation(data: xr.Dataset, parameter: str | None = None, ax: Axes | None = None) -> Axes:
    """What an optimisation tried of a parameter, over the objective between the bounds.

    Dots are evaluations, from light and large to dark and small as the steps become shorter, joined
    in their order; those of runs that did not lead to the optimum are faint. The broad line is the
    scan, other parameters as in the optimum, which is a point of it. It is dashed, on a shaded
    ground, from where limits allow nothing to the next point that they allow.

    **Arguments:**

    - `data`: what `walker_jax.optimise` returns.
    - `parameter`: one of those that were free; by default, the first.
    - `ax`: where to draw; by default, on a new figure of 7 by 5.6 inches.

    **Returns** the axes. Raises `ValueError` for a data set without an optimum, and for a parameter
    that was not free.
    """
    check_optimum(data)
    names = free(data)
    parameter = names[0] if parameter is None else parameter
    if parameter not in names:
        raise WrongUse(f"parameter must be one of {', '.join(names)}, not {parameter!r}")
    if ax is None:
        ax = Figure(figsize=(7, 5.6), layout="constrained").add_subplot()
    draw_optimisation(ax, data, parameter, aim(data, 60))
    return ax


def basins_compared(data: xr.Dataset) -> Figure:
    """The basins before and after an optimisation, side by side, with colours as in `basin`.

    **Arguments:**

    - `data`: what `walker_jax.optimise` returns.

    **Returns** the figure, of 11 by 5.2 inches. Raises `ValueError` for a data set without basins.
    """
    figure = Figure(figsize=(11, 5.2), layout="constrained")
    draw_basins([*figure.subplots(1, 2)], data)
    figure.suptitle(title(fixed(data), 80), x=0.01, ha="left", fontsize=14, fontweight="bold")
    return figure


def optimised(data: xr.Dataset) -> Figure:
    """An optimisation: the way to the optimum, and the basins before and after, if there are any.

    The pictures `optimisation`, of each parameter, above that of `basins_compared`.

    **Arguments:**

    - `data`: what `walker_jax.optimise` returns.

    **Returns** the figure. Raises `ValueError` for a data set without an optimum.
    """
    check_optimum(data)
    names, compared = free(data), "fate_start" in data
    columns = min(3, len(names))
    rows = -(-len(names) // columns)
    size = max(5.6 * columns, 11 if compared else 7), 5.2 * (rows + compared) + 0.4
    figure = Figure(figsize=size, layout="constrained")
    # Six columns can be shared by one panel, by two, and by three.
    grid, wide = figure.add_gridspec(rows + compared, 6), 6 // columns
    for k, name in enumerate(names):
        row, column = divmod(k, columns)
        ax = figure.add_subplot(grid[row, column * wide : (column + 1) * wide])
        draw_optimisation(ax, data, name, name.replace("_", " ").capitalize())
    if compared:
        halves = [figure.add_subplot(grid[-1, half]) for half in (slice(3), slice(3, 6))]
        draw_basins(halves, data)
    above = aim(data, int(8 * size[0]))
    figure.suptitle(above, x=0.01, ha="left", fontsize=14, fontweight="bold")
    return figure


def check_optimum(data: xr.Dataset) -> None:
    """Raise `ValueError` where no optimum was found."""
    if "found" not in data or not data["found"]:
        raise WrongUse("data must be of an optimisation that found an optimum")


def fixed(data: xr.Dataset) -> xr.Dataset:
    """Only the attributes of an optimisation, without the parameters that were free."""
    changed = {f"walker_{name}" for name in free(data)}
    return xr.Dataset(attrs={key: data.attrs[key] for key in data.attrs if key not in changed})


def draw_optimisation(ax: Axes, data: xr.Dataset, parameter: str, subject: str) -> None:
    """The picture `optimisation`."""
    own = data.sel(parameter=parameter)
    scan, barred = draw_scan(ax, own, others=data.sizes["parameter"] > 1)
    stages, others = draw_runs(ax, own)
    marks = [*draw_ends(ax, own), *scan, *others]
    ax.set_xlim(*json.loads(data.attrs["bounds"])[parameter])
    ax.locator_params(axis="x", nbins=6)
    ax.set_xlabel(named(parameter), fontsize=11)
    ax.set_ylabel(objective(data), fontsize=11)
    write_title(ax, subject, listed([gain(data), *ending(own)], 60))
    rows = -(-len(marks) // 2)
    place_legend(ax, marks, BELOW, columns=2)
    place_legend(ax, stages, BELOW + LINE * rows, columns=len(STAGES))
    place_legend(ax, barred, BELOW + LINE * (rows + bool(stages)), columns=1)


def draw_ends(ax: Axes, own: xr.Dataset) -> list[Line2D]:
    """Start and optimum, whole even at a bound. Returns what the legend tells of."""
    marks = []
    for side, style in (
        ("start", {"marker": "o", "mfc": "none", "mec": INK, "mew": 1.4, "ms": 12}),
        ("optimum", {"marker": "*", "mfc": BASINS[1], "mec": "white", "ms": 17}),
    ):
        at = float(own[side])
        place = [at], [float(own[f"exact_{side}"])]
        label = f"{side}, at {at:.4g}"
        marks += ax.plot(*place, ls="", label=label, zorder=6, **WHOLE, **style)
    return marks


def draw_scan(ax: Axes, own: xr.Dataset, *, others: bool) -> tuple[list[Line2D], list[Patch]]:
    """The scan, if there is one, and what limits do not allow. Returns what legends tell of."""
    if "scan_value" not in own:
        return [], []
    at, value, allowed = (own[f"scan_{name}"].values for name in ("parameters", "value", "allowed"))
    optimum = float(own["optimum"])
    if optimum not in at:  # where a limit holds it, what that does not allow begins there
        place = np.searchsorted(at, optimum)
        at = np.insert(at, place, optimum)
        value = np.insert(value, place, float(own["objective_optimum"]))
        allowed = np.insert(allowed, place, True)
    words = "scan, others as in the optimum" if others else "scan"
    solid = np.where(allowed, value, np.nan)
    scan = ax.plot(at, solid, color=SCAN, lw=2.5, label=words, zorder=2)
    barred = ~(allowed[:-1] & allowed[1:])
    if not barred.any():
        return scan, []
    ax.plot(at, value, color=SCAN, lw=1, ls=(0, (4, 3)), zorder=1)
    turns = np.flatnonzero(np.diff(barred, prepend=False, append=False))
    for left, right in at[turns].reshape(-1, 2).tolist():
        ax.axvspan(left, right, color=BARRED, lw=0, zorder=0)
    return scan, [Patch(fc=BARRED, ec=SCAN, lw=0.5, label=beyond_limits(own))]


def draw_runs(ax: Axes, own: xr.Dataset) -> tuple[list[Line2D], list[Line2D]]:
    """The steps of all runs. Returns what legends tell of: stages, and other runs."""
    run, stage, at, value = (own[name].values for name in ("run", "stage", "parameters", "value"))
    best = run[stage == ENDS_STAGE][0]
    numbers = np.unique(run[stage >= 0]).tolist()
    for number in numbers:
        order, opacity = (4, 1) if number == best else (3, FAINT)
        style: dict[str, Any] = {"zorder": order, "alpha": opacity, **WHOLE}
        ours = (stage >= 0) & (run == number)
        ax.plot(at[ours], value[ours], color=BASINS[0], lw=0.8, **style)
        for k, (colour, size, _) in enumerate(STAGES):
            dots = at[ours & (stage == k)], value[ours & (stage == k)]
            ax.plot(*dots, "o", color=colour, ms=size, mec="white", **style)
    stages = [
        Line2D([], [], marker="o", ls="", color=colour, ms=size, label=words)
        for k, (colour, size, words) in enumerate(STAGES)
        if (stage == k).any()
    ]
    faint = {"marker": "o", "mec": "white", "ms": 7, "lw": 0.8, "color": STAGES[0][0]}
    others = [Line2D([], [], alpha=FAINT, label="other runs", **faint)]
    return stages, others if numbers != [best] else []


def draw_basins(panels: Sequence[Axes], data: xr.Dataset) -> None:
    """The basins at start and optimum, on two axes of a figure, whose legend is for both."""
    if "fate_start" not in data or "fate_optimum" not in data:
        raise WrongUse("data must hold the basins at start and optimum of an optimisation")
    x, y = map(str, data["fate_start"].dims)
    fate = np.stack([data["fate_start"].values, data["fate_optimum"].values])
    found = [
        Region(fate == ATTRACTED, BASINS[0], "A", "basin of attraction"),
        Region(fate == Outcome.STRIDE, ASTRAY, "", "walks on, near no attractor"),
        *failures(fate),
    ]
    regions = [region for region in found if region.cells.any()]
    extent = (*ends(data[x].values), *ends(data[y].values))
    for ax, side, image in zip(
        panels, ("start", "optimum"), painted(regions, fate.shape), strict=True
    ):
        show(ax, image, extent)
        values = dict(zip(free(data), data[side].values.tolist(), strict=True))
        words = f"{side.capitalize()}: {listed(valued(values), 42)}"
        write_title(ax, words, about_basin(data, side))
        ax.set_xlabel(AXIS_LABELS.get(x, x), fontsize=11)
    panels[0].set_ylabel(AXIS_LABELS.get(y, y), fontsize=11)
    panels[1].sharex(panels[0])
    panels[1].sharey(panels[0])
    panels[1].tick_params(labelleft=False)
    patches = [Patch(fc=region.colour, ec=INK, lw=0.5, label=region.words) for region in regions]
    figure = cast(Figure, panels[0].get_figure(root=True))
    figure.legend(handles=patches, loc="outside lower left", ncols=5, frameon=False, fontsize=WORDS)


def about_basin(data: xr.Dataset, side: str) -> str:
    """Its area, where nothing else was optimised, and what slice it is in, if it is in one."""
    weights, region = json.loads(data.attrs["objective"]), json.loads(data.attrs["region"])
    area = float(data[f"exact_{side}"]) / weights["area"] if [*weights] == ["area"] else 0.0
    slices = [in_slice(name, at) for name, at in region.items() if not isinstance(at, list)]
    return "; ".join([*([area_of_basin(area)] if area else []), *slices])


def aim(data: xr.Dataset, width: int) -> str:
    """The walker, what is fixed of it, and what was optimised, in lines of some width."""
    walker, words = title(fixed(data), width), objective(data)
    fits = len(walker.splitlines()[-1]) + len(words) < width
    return f"{walker}: {words}" if fits else f"{walker}:\n{words}"


def objective(data: xr.Dataset) -> str:
    """What was optimised, in words."""
    weights = json.loads(data.attrs["objective"])
    if [*weights.values()] == [1]:
        return measure(*weights)
    terms = (
        f"{'−' if weight < 0 else '+'} {abs(weight):g} {name.replace('-', ' ')}"
        for name, weight in weights.items()
    )
    return " ".join(terms).removeprefix("+ ")


def measure(name: str) -> str:
    """What is optimised or has limits, in words."""
    return OBJECTIVES.get(name, name.replace("-", " "))


def beyond_limits(data: xr.Dataset) -> str:
    """What limits do not allow; without any, a walker is only missed where it has no gait."""
    sides = [
        f"{measure(name)} {side} {limit:g}"
        for name, pair in json.loads(data.attrs["limits"]).items()
        for side, limit in zip(("below", "above"), pair, strict=True)
        if limit is not None
    ]
    return " or ".join(sides) or "no gait"


def gain(data: xr.Dataset) -> str:
    """From where the objective came, and to where."""
    start, optimum = float(data["exact_start"]), float(data["exact_optimum"])
    notes = [f"× {optimum / start:.3g}"] if start > 0 and optimum > 0 else []
    notes += ["small is better"] if data.attrs["sign"] < 0 else []
    return f"{start:.4g} to {optimum:.4g}" + (f" ({'; '.join(notes)})" if notes else "")


def ending(own: xr.Dataset) -> list[str]:
    """Where the way of one parameter ended, and whether too early."""
    side, binding = int(own["at_bound"]), own["measure"].values[own["binding"].values]
    where = f"at the {'upper' if side > 0 else 'lower'} bound"
    if not side:
        limits = " and ".join(map(measure, binding.tolist()))
        where = f"held by a limit of {limits}" if limits else "inside the bounds"
    return [where] if own["converged"] else [where, "not converged"]

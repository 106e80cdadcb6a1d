"""Pictures of an optimisation."""

from collections.abc import Sequence
from typing import Any, Unpack

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from walker_jax.checks import WrongUse
from walker_jax.design import results
from walker_jax.design.optimisation import ATTRACTED
from walker_jax.figures import layout, regions, text
from walker_jax.figures.layout import DrawnAxes, Style, axes_for, finish
from walker_jax.figures.style import BASINS, INK
from walker_jax.storage.schema import check_dataset

STAGES = (
    ("#a9bfe3", 8.5, "long steps"),
    ("#7391c9", 7, "medium"),
    ("#3f5f9f", 5.5, "short"),
    (BASINS[0], 4, "very short"),
)
"""Colour, size and words of the evaluations in each stage of an optimisation."""
SCAN, FORBIDDEN = "#9b9b9b", "#ebebeb"
"""Colours of the scan, and of the background where limits forbid it."""
FAINT = 0.45
"""Opacity of the runs that did not lead to the optimum."""
UNCLIPPED: dict[str, Any] = {"clip_on": False, "in_layout": False}
"""Signs that bounds do not cut; the layout must not count them, as it puts an empty line at 0."""
MEASURE_WORDS = {
    "area": "area of the basin",
    "volume": "volume of the basin",
    "spectral-radius": text.RADIUS,
}
"""Words of measures with an unclear name."""


def optimisation(
    data: xr.Dataset, parameter: str | None = None, ax: Axes | None = None, **style: Unpack[Style]
) -> DrawnAxes:
    """Draw the values of a parameter that `walker_jax.optimise` tried, and the objective.

    `parameter` is one of the free parameters; by default, the first. Dots are evaluations, joined
    in their order, from light and large to dark and small as the steps become shorter. Runs that
    did not lead to the optimum are faint. The broad line is the scan through the optimum, with the
    other parameters as there. Between points that the limits forbid it is dashed, on a shaded
    background.
    """
    check_optimum(data)
    names = results.free_parameters(data)
    parameter = names[0] if parameter is None else parameter
    if parameter not in names:
        raise WrongUse(f"parameter must be one of {', '.join(names)}, not {parameter!r}")
    return draw_optimisation(axes_for(ax, style, 7, 5.6), data, parameter, headline(data), style)


def basins_before_and_after(data: xr.Dataset) -> Figure:
    """Draw the basins before and after `walker_jax.optimise`, with colours as in `basin`."""
    check_optimum(data)
    figure, panels = layout.new_panels(11, 5.2, 1, 2)
    draw_basins(panels, data)
    layout.figure_title(figure, fixed_title(data))
    return figure


def optimum(data: xr.Dataset) -> Figure:
    """Draw what `walker_jax.optimise` returns: the steps to the optimum, and the basins, if known.

    The pictures are `optimisation` of each parameter, above `basins_before_and_after`.
    """
    check_optimum(data)
    names, basins = results.free_parameters(data), "fate_start" in data
    columns = min(3, len(names))
    rows = -(-len(names) // columns)
    figure = layout.new_figure(max(5.6 * columns, 11 if basins else 7), 5.2 * (rows + basins) + 0.4)
    # Six columns can be shared by one panel, by two, and by three.
    grid, wide = figure.add_gridspec(rows + basins, 6), 6 // columns
    for k, name in enumerate(names):
        row, column = divmod(k, columns)
        ax = figure.add_subplot(grid[row, column * wide : (column + 1) * wide])
        words = name.replace("_", " ")
        title = words.capitalize() if len(name) > 1 else name  # a letter is a symbol
        draw_optimisation(ax, data, name, title, {})
    if basins:
        halves = [figure.add_subplot(grid[-1, half]) for half in (slice(3), slice(3, 6))]
        draw_basins(halves, data)
    layout.figure_title(figure, headline(data))
    return figure


def check_optimum(data: xr.Dataset) -> None:
    """Raise `WrongUse` where no optimum was found."""
    check_dataset(data, "optimisation")
    if not results.is_optimum(data):
        raise WrongUse("data must be of an optimisation that found an optimum")
    check_dataset(data, "optimum")


def fixed_title(data: xr.Dataset) -> str:
    """Return the walker and its fixed parameters."""
    changed = {f"walker_{name}" for name in results.free_parameters(data)}
    fixed = {key: data.attrs[key] for key in data.attrs if key not in changed}
    return text.walker_title(xr.Dataset(attrs=fixed))


def draw_optimisation(
    ax: Axes, data: xr.Dataset, parameter: str, title: str, style: Style
) -> DrawnAxes:
    """Draw the picture `optimisation` under a title."""
    own = data.sel(parameter=parameter)
    draw_end(ax, own, "start", marker="o", mfc="none", mec=INK, mew=1.4, ms=12)
    draw_end(ax, own, "optimum", marker="*", mfc=BASINS[1], mec="white", ms=17)
    ground = draw_scan(ax, data, parameter)
    draw_runs(ax, data, parameter)
    ax.set_xlim(*results.bounds(data, parameter))
    ax.locator_params(axis="x", nbins=6)
    note, y = text.join_phrases([gain(data), *ending(data, parameter)]), objective_words(data)
    return finish(ax, style, title, note, x=parameter, y=y, legend=ground)


def draw_end(ax: Axes, own: xr.Dataset, side: str, **look: Any) -> None:
    """Draw start or optimum, uncut even at a bound."""
    at = float(own[side])
    look |= {"label": f"{side}, at {at:.4g}", "ls": "", "zorder": 6} | UNCLIPPED
    ax.plot([at], [float(own[f"exact_{side}"])], **look)


def draw_scan(ax: Axes, data: xr.Dataset, parameter: str) -> list[Patch]:
    """Draw the scan, if there is one, and the background where limits forbid it, if they do.

    Returns the sign of that background in the legend.
    """
    scan = results.scan_of(data, parameter)
    if scan is None:
        return []
    words = "scan" + ", others as in the optimum" * (data.sizes["parameter"] > 1)
    allowed = np.where(scan.allowed, scan.value, np.nan)
    ax.plot(scan.parameter, allowed, color=SCAN, lw=2.5, label=words, zorder=2)
    if not scan.forbidden:
        return []
    ax.plot(scan.parameter, scan.value, color=SCAN, lw=1, ls=(0, (4, 3)), zorder=1)
    for low, high in scan.forbidden:
        ax.axvspan(low, high, color=FORBIDDEN, lw=0, zorder=0)
    return [Patch(fc=FORBIDDEN, ec=SCAN, lw=0.5, label=limit_words(data))]


def draw_runs(ax: Axes, data: xr.Dataset, parameter: str) -> None:
    """Draw the steps of all runs, with other runs and stages for the legend."""
    found = results.runs(data, parameter)
    for run in found:
        style: dict[str, Any] = {"zorder": 3 + run.best, "alpha": 1 if run.best else FAINT}
        style |= UNCLIPPED
        ax.plot(run.parameter, run.value, color=BASINS[0], lw=0.8, **style)
        for k, (colour, size, _) in enumerate(STAGES):
            dots = run.parameter[run.stage == k], run.value[run.stage == k]
            ax.plot(*dots, "o", color=colour, ms=size, mec="white", **style)
    if not all(run.best for run in found):
        faint: Any = {"color": (STAGES[0][0], FAINT), "mec": "white"}
        ax.plot([], [], "o-", ms=7, lw=0.8, label="other runs", **faint)
    for k, (colour, size, words) in enumerate(STAGES):
        if any(k in run.stage for run in found):
            ax.plot([], [], "o", color=colour, ms=size, label=words)


def draw_basins(panels: Sequence[Axes], data: xr.Dataset) -> None:
    """Draw the basins at start and optimum on two axes of a figure, with one legend for both."""
    if "fate_start" not in data or "fate_optimum" not in data:
        raise WrongUse(
            "data must hold fate_start and fate_optimum, the basins of an optimisation in a plane"
        )
    x, y = map(str, data["fate_start"].dims)
    fate = np.stack([data["fate_start"].values, data["fate_optimum"].values])
    found, images = regions.paint_one_basin(data, fate, fate == ATTRACTED)
    names = results.free_parameters(data)
    for ax, side, image in zip(panels, ("start", "optimum"), images, strict=True):
        regions.show_image(ax, image, data["fate_start"])
        values = text.parameter_values(dict(zip(names, data[side].values.tolist(), strict=True)))
        area, fixed = results.area_at(data, side), results.slice_coordinates(data)
        words = [text.area_phrase(data, area)] if area is not None and area > 0 else []
        words += [text.slice_phrase(fixed)] if fixed else []
        title, note = f"{side.capitalize()}: {text.join_phrases(values)}", "; ".join(words)
        finish(ax, {}, title, note, x=x, y=y if side == "start" else "")
    panels[1].sharex(panels[0])
    panels[1].sharey(panels[0])
    panels[1].tick_params(labelleft=False)
    layout.figure_legend(panels, map(regions.patch_of, found))


def headline(data: xr.Dataset) -> str:
    """Return the walker, its fixed parameters, and the objective."""
    return f"{fixed_title(data)}: {objective_words(data)}"


def objective_words(data: xr.Dataset) -> str:
    """Return the objective in words."""
    given = results.weights(data)
    if [*given.values()] == [1]:
        return measure_words(*given)
    terms = (
        f"{'−' if weight < 0 else '+'} {abs(weight):g} {name.replace('-', ' ')}"
        for name, weight in given.items()
    )
    return " ".join(terms).removeprefix("+ ")


def measure_words(name: str) -> str:
    """Return a measure in words."""
    return MEASURE_WORDS.get(name, name.replace("-", " "))


def limit_words(data: xr.Dataset) -> str:
    """Describe what limits forbid; without limits, a scan has gaps only where there is no gait."""
    sides = [
        f"{measure_words(name)} {side} {limit:g}"
        for name, pair in results.limits(data).items()
        for side, limit in zip(("below", "above"), pair, strict=True)
        if limit is not None
    ]
    return " or ".join(sides) or "no gait"


def gain(data: xr.Dataset) -> str:
    """Return the objective at the start and at the optimum, in words."""
    factor = results.improvement(data)
    notes = [f"× {factor:.3g}"] if factor is not None else []
    notes += ["small is better"] if data.attrs["sign"] < 0 else []
    ends = f"{float(data['exact_start']):.4g} to {float(data['exact_optimum']):.4g}"
    return ends + (f" ({'; '.join(notes)})" if notes else "")


def ending(data: xr.Dataset, parameter: str) -> list[str]:
    """Say where the optimum lies along a parameter, and whether the run converged."""
    side = int(data["at_bound"].sel(parameter=parameter))
    where = f"at the {'upper' if side > 0 else 'lower'} bound"
    if not side:
        binding = " and ".join(map(measure_words, results.binding_limits(data)))
        where = f"held by a limit of {binding}" if binding else "inside the bounds"
    return [where] if data["converged"] else [where, "not converged"]

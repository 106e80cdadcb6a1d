"""Pictures of gaits over a parameter: branches, multipliers, attractors and their exponents."""

import math
from itertools import pairwise
from typing import Any, Unpack

import numpy as np
import xarray as xr
from jaxtyping import Bool, Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from walker_jax.basins.cell_classes import has_known_units
from walker_jax.checks import WrongUse
from walker_jax.figures import layout
from walker_jax.figures.layout import DrawnAxes, Style, begin, finish, write_beside
from walker_jax.figures.style import BASINS, DASHED, INK, LEVEL, SMALL, SOLID, period_style
from walker_jax.figures.text import AREA_LABEL, RADIUS, count_noun, walker_title
from walker_jax.gaits import curves
from walker_jax.gaits.curves import Curve
from walker_jax.storage.schema import check_dataset
from walker_jax.systems.outcomes import names_in

OPEN: dict[str, Any] = {"marker": "o", "ms": 4.5, "mfc": "white", "mew": 1.2, "ls": ""}
FILLED: dict[str, Any] = {"marker": "o", "ms": 4.5, "mec": "white", "mew": 0.5, "ls": ""}
SIGNS = {
    "fold": OPEN | {"marker": "<", "ms": 6, "mew": 1},
    "period doubling": FILLED,
    "subcritical doubling": OPEN,
    "Neimark-Sacker": OPEN | {"marker": "s", "ms": 5},
    "supercritical Neimark-Sacker": FILLED | {"marker": "s", "ms": 5},
}
"""Signs of bifurcations; those of Neimark-Sacker points are open unless they are known to be
supercritical."""
LOSS = "#b3261e"
"""Colour of the value at which walking is lost."""
DOTS = 90
"""Size of the dots of attractors (points), in its limits, over the largest distance between values
of the parameter as a share of their range: a quarter of that distance on the picture."""
HIGHEST = 2
"""Largest modulus of a multiplier that is drawn against a parameter."""
FAINTER: dict[str, Any] = DASHED | {"lw": 0.4}
"""Lines of unstable gaits of long periods, of which there are many."""
LEAST = 1e-3
"""Least margin around the states of a cascade, which may be one state alone."""
DEEPEST = 4.0
"""Depth below zero of the lowest exponent that is drawn, in units of the highest, or of a half if
that is larger: at a superstable gait the lowest exponents have no bound."""


def gait_branches(data: xr.Dataset, ax: Axes | None = None, **style: Unpack[Style]) -> DrawnAxes:
    """Draw all gaits of `walker_jax.bifurcation_diagram`: the first coordinate over the parameter.

    Figure 3 of Schwab and Wisse (2001), for gaits of every period, at the start of each stride.
    Colours show periods. Lines are solid where a gait is stable and dashed where it is not.
    Triangles are folds, where two gaits are born. Dots are period doublings, and circles
    subcritical ones. Squares are Neimark-Sacker points, filled where they are supercritical. At the
    right are the step times of the gaits of period one at the end of the range.
    """
    ax = begin(ax, style, data, "gait branches", 7, 5.6)
    drawn = curves.read_curves(data)
    for curve in drawn:
        draw_curve(ax, curve, curve.states)
    stable, folds = data["stable"].values, data["event_fold"].values
    subcritical = ~folds & has_negative_form(data, "event")
    supercritical = has_negative_form(data, "torus")
    events = {"fold": folds, "period doubling": ~folds & ~subcritical}
    events["subcritical doubling"] = subcritical
    tori = {"Neimark-Sacker": ~supercritical, "supercritical Neimark-Sacker": supercritical}
    draw_events(ax, data, "event", events)
    draw_events(ax, data, "torus", tori)
    looks = {"stable": (stable, SOLID), "unstable": (~stable, DASHED)}
    looks |= {kind: (some, SIGNS[kind]) for kind, some in (events | tori).items()}
    signs = [
        Line2D([], [], color=INK, label=kind, **look)
        for kind, (some, look) in looks.items()
        if some.any()
    ]
    counts = {"branch": len(drawn), "fold": folds.sum(), "period doubling": (~folds).sum()}
    counts["Neimark-Sacker point"] = len(supercritical)
    if style.get("labels", True):
        write_step_times(ax, data)
    note = ", ".join(count_noun(int(n), noun) for noun, n in counts.items() if n)
    y, handles = names_in(data, "section")[0], [*signs, *period_lines(drawn).values()]
    return over_parameter(ax, style, data, "gaits", note, y=y, legend=handles)


def over_parameter(
    ax: Axes, style: Style, data: xr.Dataset, subject: str, note: str, **words: Any
) -> DrawnAxes:
    """Finish a picture over the range of a parameter, under the walker's name and a subject."""
    samples = data["sample_value"].values if "sample_value" in data else []
    values = np.concatenate([data["value"].values, samples])
    if len(values) and np.ptp(values) > 0:
        ax.set_xlim(values.min(), values.max())
    title = f"{walker_title(data)}: {subject}"
    ax.locator_params(axis="x", nbins=6)
    return finish(ax, style, title, note, x=str(data.attrs["parameter"]), **words)


def largest_multiplier(
    data: xr.Dataset, ax: Axes | None = None, **style: Unpack[Style]
) -> DrawnAxes:
    """Draw the largest Floquet multiplier of `walker_jax.bifurcation_diagram`, over its parameter.

    The left axis of Figure 8 of Schwab and Wisse (2001), for the most stable gait of period one,
    the gaits of period two that branch off it, and so on. A gait is stable, and its line solid,
    where the modulus is below one.
    """
    ax = begin(ax, style, data, "gait branches", 7, 4.6)
    ax.axhline(1, **LEVEL)
    family = curves.cascade_curves(data)
    for curve in family:
        draw_multiplier(ax, curve)
    handles = period_lines(family)
    for period, handle in handles.items():
        values = np.concatenate([one.doublings for one in family if one.period == period])
        draw_event(ax, values, np.ones(len(values)), period, "period doubling")
        if len(values):
            where = " and ".join(f"{value:.5f}" for value in values)
            handle.set_label(f"{handle.get_label()}, doubles at {where}")
    ax.set_ylim(0, HIGHEST)
    at = ax.get_yaxis_transform()
    for words, rise, side in (("unstable", 3, "bottom"), ("stable", -4, "top")):
        if style.get("labels", True):
            write_beside(ax, words, (0, 1), (5, rise), xycoords=at, va=side)
    subject = "largest Floquet multiplier"
    note = "of the most stable gait of period one and the gaits that double from it"
    return over_parameter(ax, style, data, subject, note, y=RADIUS, legend=handles.values())


def bifurcation_diagram(
    data: xr.Dataset, ax: Axes | None = None, **style: Unpack[Style]
) -> DrawnAxes:
    """Draw the attractors of `walker_jax.bifurcation_diagram`, over its parameter.

    A dot is a recorded state of a walker that does not fall: the first coordinate at the start of a
    stride. Dashed lines are unstable parts of the gait of period one from which the cascade of
    period doublings starts. A vertical line marks the middle of the interval in which walking is
    lost.
    """
    ax = begin(ax, style, data, "bifurcation diagram", 7, 5)
    value, state = curves.attractor_states(data)
    gaps = np.diff(np.unique(data["sample_value"].values))
    size = np.clip(DOTS * gaps.max() / gaps.sum(), 1, 3) if len(gaps) else 3
    ax.plot(value, state, "o", color=BASINS[0], ms=size, mew=0, rasterized=True, zorder=4)
    ax.plot([], [], "o", color=BASINS[0], ms=3, label="attractor")
    for curve in curves.cascade_curves(data)[:1]:
        draw_curve(ax, curve, curve.states, stable=False, label="unstable gait")
    lost, note = curves.loss_of_attractor(data), ""
    if np.isfinite(lost):
        ax.axvline(lost, color=LOSS, lw=1, zorder=3, label="walking is lost")
        low, high = data["lost"].values.tolist()
        digits = max(5, 1 - math.floor(math.log10(high - low)))  # enough to tell the two apart
        note = f"walking is lost between {low:.{digits}f} and {high:.{digits}f}"
    return over_parameter(ax, style, data, "attractors", note, y=names_in(data, "section")[0])


def lyapunov_exponents(
    data: xr.Dataset, ax: Axes | None = None, **style: Unpack[Style]
) -> DrawnAxes:
    """Draw Lyapunov exponents of `walker_jax.bifurcation_diagram`, with their error bands.

    Bands are twice the standard error on each side. Walking is chaotic where the first exponent is
    above zero. Nothing is drawn where no walker walks.
    """
    ax = begin(ax, style, data, "bifurcation diagram", 7, 4.6)
    if "exponents" not in data:
        raise WrongUse("data must have exponents: give bifurcation_diagram a number of strides")
    value = data["sample_value"].values
    found, errors = data["exponents"].values, data["exponent_errors"].values
    ax.axhline(0, **LEVEL)
    for i, (middle, error) in enumerate(zip(found.T, 2 * errors.T, strict=True)):
        colour = BASINS[i % len(BASINS)]
        ax.fill_between(value, middle - error, middle + error, color=colour, alpha=0.3, lw=0)
        place = ("first", "second", "third")[i] if i < 3 else f"{i + 1}th"
        ax.plot(value, middle, color=colour, lw=1, label=place, zorder=3)
    known = found[np.isfinite(found)]
    if len(known):
        top = max(float(known.max()), 0.05)
        deepest = min(float(known.min()), 0.0)
        ax.set_ylim(max(deepest, -DEEPEST * max(top, 0.5)) * 1.05, 1.25 * top)
    note = "none is above zero"
    if len(positive := value[found[:, 0] > 2 * errors[:, 0]]):
        note = f"the first is above zero from {positive[0]:.5f}"
    return over_parameter(ax, style, data, "Lyapunov exponents", note, y="exponent (1/stride)")


def bifurcations(data: xr.Dataset) -> Figure:
    """Draw all of `walker_jax.bifurcation_diagram`: gaits, their multiplier, and the attractors.

    The pictures are `gait_branches` above `largest_multiplier`, and `bifurcation_diagram` above
    `lyapunov_exponents`, if the data set has exponents. At the bottom is the part of these between
    the first period doubling of the cascade and the loss of walking, if any.
    """
    check_dataset(data, "bifurcation diagram")
    window, exponents = cascade_window(data), "exponents" in data
    panels = [(gait_branches, "Gaits"), (bifurcation_diagram, "Attractors")]
    panels.append((largest_multiplier, "Largest Floquet multiplier"))
    panels += [(lyapunov_exponents, "Lyapunov exponents")] * exponents
    if window is not None:
        panels.append((bifurcation_diagram, "Attractors of the cascade"))
        panels += [(lyapunov_exponents, "Exponents of the cascade")] * exponents
    rows = -(-len(panels) // 2)
    figure, axes = layout.new_panels(10.4, 4.5 * rows, rows, 2)
    for ax, letter, (draw, title) in zip(axes, "abcdef", panels, strict=False):
        draw(data, ax, title=f"{letter}  {title}")
        if window is not None and title.endswith("of the cascade"):
            ax.set(xlim=window[0])
            if draw is bifurcation_diagram:
                ax.set(ylim=window[1])
                ax.lines[0].set(markersize=0.8 * ax.lines[0].get_markersize(), alpha=0.5)
    for ax in axes[len(panels) :]:
        ax.remove()
    layout.figure_title(figure, walker_title(data))
    return figure


def stability_and_area(
    gaits: xr.Dataset, areas: xr.Dataset, ax: Axes | None = None, **style: Unpack[Style]
) -> DrawnAxes:
    """Draw the gait's largest multiplier and the area of the basin against the slope.

    Figure 8 of Schwab and Wisse (2001).

    **Arguments:**

    - `gaits`: what `walker_jax.bifurcation_diagram` returns, over the slope.
    - `areas`: of the kind "areas over slopes".

    **Returns** the axes of the multiplier, which share their place with those of the area.
    """
    ax = begin(ax, style, gaits, "gait branches", 8, 4.8)
    check_dataset(areas, "areas over slopes")
    ax.axhline(1, **LEVEL)
    slopes, known = areas["slope"].values, np.isfinite(areas["area"].values)
    for curve in curves.cascade_curves(gaits)[:1]:
        draw_multiplier(ax, curve)
    ax.plot([], [], color=INK, **SOLID, label=f"{RADIUS}; dashed: unstable")
    ax.set(xlim=(0, 1.02 * slopes.max()), ylim=(0, HIGHEST))
    other = ax.twinx()
    look: Any = {"color": BASINS[1], "ms": 5, "mfc": "none", "label": "area, cell mapping"}
    other.plot(slopes, areas["mapped_area"], "s", **look)
    if known.any():
        label = "area, refined (error below the width of the line)"
        refined = slopes[known], areas["area"].values[known]
        other.plot(*refined, "-o", color=BASINS[0], ms=3, label=label)
    other.set_ylim(0)
    other.set_ylabel(AREA_LABEL * style.get("labels", True), color=BASINS[0])
    signs, _ = other.get_legend_handles_labels()
    title, x = "Stability of the gait, and area of its basin", "slope"
    return finish(ax, style, title, "SimplestWalker", x=x, y=RADIUS, legend=signs)


def has_negative_form(data: xr.Dataset, name: str) -> Bool[np.ndarray, " n"]:
    """Return where coefficients of normal forms are negative; older data sets have none."""
    return (data.get(f"{name}_coefficient", np.nan) + 0 * data[f"{name}_value"] < 0).values


def draw_curve(
    ax: Axes, curve: Curve, heights: np.ndarray, *, stable: bool = True, label: str = ""
) -> None:
    """Draw lines along a curve: dashed where it is unstable, and solid where it is `stable`.

    The first of them has the label.
    """
    solid = curve.stable_intervals
    changes = np.flatnonzero(solid[1:] != solid[:-1]) + 1
    colour, _ = period_style(curve.period)
    for start, stop in pairwise([0, *changes.tolist(), len(solid)]):
        if start < stop and (stable or not solid[start]):
            run = slice(start, stop + 1)
            order = 3 * solid[start] + 1 / curve.period
            style = SOLID if solid[start] else DASHED if curve.period < 3 else FAINTER
            look = style | {"color": colour, "zorder": 2 + order}
            (first, *_) = ax.plot(curve.value[run], heights[run], **look)
            first.set_label(label)
            label = ""


def draw_multiplier(ax: Axes, curve: Curve) -> None:
    """Draw the modulus of the largest multiplier along a curve."""
    fine = curves.interpolate_multipliers(curve)
    draw_curve(ax, fine, fine.spectral_radius[:, None])


def draw_event(ax: Axes, values: np.ndarray, heights: np.ndarray, period: int, kind: str) -> None:
    """Draw the signs of a bifurcation; for long periods, which are many, they are smaller."""
    (colour, _), sign = period_style(period), SIGNS[kind]
    smaller = {} if period < 3 else {"ms": 0.7 * sign["ms"], "mew": 0.7 * sign["mew"]}
    ax.plot(values, heights, color=colour, zorder=7 - period / 100, **sign | smaller)


def draw_events(ax: Axes, data: xr.Dataset, name: str, kinds: dict[str, np.ndarray]) -> None:
    """Draw bifurcations, at each phase of their gaits, by the marks of each kind."""
    heights = curves.first_coordinate(data[f"{name}_states"])
    values, periods = (data[f"{name}_{one}"].values for one in ("value", "period"))
    for kind, some in kinds.items():
        for i in np.flatnonzero(some):
            phases = np.full(periods[i], values[i]), heights[i, : periods[i]]
            draw_event(ax, *phases, int(periods[i]), kind)


def cascade_window(data: xr.Dataset) -> tuple[np.ndarray, np.ndarray] | None:
    """Return limits of both axes around the states of the cascade; None without a cascade."""
    interval = curves.cascade_interval(data)
    if interval is None:
        return None
    low, high = across = layout.widened(np.array(interval), 0.05)
    value, state = curves.attractor_states(data)
    inside = state[(value >= low) & (value <= high)]
    if len(inside) == 0:
        return None
    return across, layout.widened(np.array([inside.min(), inside.max()]), 0.05, LEAST)


def write_step_times(ax: Axes, data: xr.Dataset) -> None:
    """Write the step times of the gaits of period one at the end of the range beside the axes."""
    heights, times = curves.final_gaits(data)
    order, at = np.argsort(heights), ax.get_yaxis_transform()
    look: Any = {"va": "center", "fontsize": SMALL, "arrowprops": {"arrowstyle": "-", "lw": 0.5}}
    for i, place in zip(order, places_near(heights[order], *ax.get_ylim()), strict=True):
        ax.annotate(f"{times[i]:.2f}", (1, heights[i]), (1.05, place), at, at, **look)
    if len(heights):
        words = "step time\n(√(l/g))" if has_known_units(data) else "time"
        write_beside(ax, words, (1.03, 1), (0, 6), xycoords="axes fraction")


def places_near(
    heights: Float[np.ndarray, " n"], low: float, high: float
) -> Float[np.ndarray, " n"]:
    """Return places in a range, 0.09 of it apart, as near as may be to ascending heights."""
    from scipy.optimize import isotonic_regression

    if not len(heights):
        return heights
    gap = 0.09 * (high - low)
    away = gap * np.arange(len(heights))
    nearest = isotonic_regression(heights - away).x
    return np.clip(nearest, low + gap / 2, high - gap / 2 - away.max()) + away


def period_lines(drawn: list[Curve]) -> dict[int, Line2D]:
    """Return the signs of periods in a legend, the shortest first."""
    return {
        period: Line2D([], [], color=period_style(period)[0], lw=3, label=f"period {period}")
        for period in sorted({curve.period for curve in drawn})
    }

"""Pictures of gaits over a parameter: branches, multipliers, bifurcation diagrams."""

import math
from itertools import pairwise
from typing import Any, Unpack

import numpy as np
import xarray as xr
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from walker_jax.basins.cell_classes import has_known_units
from walker_jax.figures.exponent_plots import lyapunov_exponents
from walker_jax.figures.layout import (
    DrawnAxes,
    Style,
    axes_for,
    figure_of,
    figure_title,
    finish,
    new_figure,
)
from walker_jax.figures.style import BASINS, DASHED, INK, SMALL, SOLID, period_style, points_of
from walker_jax.figures.text import RADIUS, count_noun, walker_title
from walker_jax.gaits.curves import (
    Curve,
    attractor_states,
    cascade_curves,
    cascade_interval,
    final_gaits,
    first_coordinate,
    interpolate_multipliers,
    loss_of_attractor,
    read_curves,
)
from walker_jax.storage.schema import check_dataset
from walker_jax.systems.outcomes import names_in

FOLD: dict[str, Any] = {"marker": "<", "ms": 6, "mfc": "white", "mew": 1, "ls": ""}
TORUS: dict[str, Any] = {"marker": "s", "ms": 5, "mfc": "white", "mew": 1.2, "ls": ""}
DOUBLING: dict[str, Any] = {"marker": "o", "ms": 4.5, "mec": "white", "mew": 0.5, "ls": ""}
OPEN: dict[str, Any] = {"marker": "o", "ms": 4.5, "mfc": "white", "mew": 1.2, "ls": ""}
CLOSED_TORUS: dict[str, Any] = {"marker": "s", "ms": 5, "mec": "white", "mew": 0.5, "ls": ""}
"""Signs of bifurcations: `OPEN` for subcritical doublings, `CLOSED_TORUS` for Neimark-Sacker points
known to be supercritical."""
LOSS = "#b3261e"
"""Colour of the value at which walking is lost."""
HIGHEST = 2
"""Largest modulus of a multiplier that is drawn against a parameter."""
FAINTER: dict[str, Any] = DASHED | {"lw": 0.4}
"""Lines of unstable gaits of long periods, of which there are many."""


def gait_branches(data: xr.Dataset, ax: Axes | None = None, **style: Unpack[Style]) -> DrawnAxes:
    """Draw all gaits against a parameter: the first coordinate at the start of each stride.

    Figure 3 of Schwab and Wisse (2001), for gaits of every period. Colours show periods. Lines are
    solid where a gait is stable and dashed where it is not. Triangles are folds, where two gaits
    are born. Dots are period doublings, and circles subcritical ones. Squares are Neimark-Sacker
    points, filled where they are supercritical. At the right are the step times of the gaits of
    period one at the end of the range.

    **Arguments:**

    - `data`: what `walker_jax.bifurcation_diagram` returns.
    - `ax`: where to draw; by default, on a new figure of 7 by 5.6 inches.
    - `style`: which words to draw, as in `Style`.

    **Returns** the axes. Raises `ValueError` for a data set without branches of gaits.
    """
    check_dataset(data, "gait branches")
    ax = axes_for(ax, style, 7, 5.6)
    drawn = read_curves(data)
    for curve in drawn:
        draw_curve(ax, curve, curve.states)
    folds, values = data["event_fold"].values, data["event_value"].values
    periods, states = data["event_period"].values.tolist(), first_coordinate(data["event_states"])
    subcritical = ~folds & (coefficients(data, "event") < 0)
    for i, (period, cycle) in enumerate(zip(periods, states, strict=True)):
        sign = FOLD if folds[i] else OPEN if subcritical[i] else DOUBLING
        draw_event(ax, np.full(period, values[i]), cycle[:period], period, sign)
    tori, closed = data["torus_value"].values, coefficients(data, "torus") < 0
    for i, value in enumerate(tori):
        period = int(data["torus_period"][i])
        cycle = first_coordinate(data["torus_states"])[i]
        sign = CLOSED_TORUS if closed[i] else TORUS
        draw_event(ax, np.full(period, value), cycle[:period], period, sign)
    counts = {"branch": len(drawn), "fold": folds.sum(), "period doubling": (~folds).sum()}
    counts["Neimark-Sacker point"] = len(tori)
    set_range(ax, data)
    if style.get("labels", True):
        write_step_times(ax, data)
    kinds = []
    for name, found, look in (
        ("stable", data["stable"].values, SOLID),
        ("unstable", ~data["stable"].values, DASHED),
        ("fold", folds, FOLD),
        ("period doubling", ~folds & ~subcritical, DOUBLING),
        ("subcritical doubling", subcritical, OPEN),
        ("Neimark-Sacker", ~closed, TORUS),
        ("supercritical Neimark-Sacker", closed, CLOSED_TORUS),
    ):
        if found.any():
            kinds.append(Line2D([], [], color=INK, label=name, **look))
    return finish(
        ax,
        style,
        title=f"{walker_title(data)}: gaits",
        note=", ".join(count_noun(int(n), noun) for noun, n in counts.items() if n),
        x=str(data.attrs["parameter"]),
        y=first_name(data),
        legend=[*kinds, *period_lines(drawn)],
    )


def largest_multiplier(
    data: xr.Dataset, ax: Axes | None = None, **style: Unpack[Style]
) -> DrawnAxes:
    """Draw the largest Floquet multiplier's modulus against a parameter, along the main cascade.

    The left axis of Figure 8 of Schwab and Wisse (2001), for the most stable gait of period one,
    the gaits of period two that branch off it, and so on. A gait is stable, and its line solid,
    where the modulus is below one.

    **Arguments:**

    - `data`: what `walker_jax.bifurcation_diagram` returns.
    - `ax`: where to draw; by default, on a new figure of 7 by 4.6 inches.
    - `style`: which words to draw, as in `Style`.

    **Returns** the axes. Raises `ValueError` for a data set without branches of gaits.
    """
    check_dataset(data, "gait branches")
    ax = axes_for(ax, style, 7, 4.6)
    ax.axhline(1, color=INK, lw=0.8, zorder=1)
    family = cascade_curves(data)
    handles = period_lines(family)
    for handle, period in zip(handles, sorted({c.period for c in family}), strict=True):
        own = [curve for curve in family if curve.period == period]
        for curve in own:
            draw_multiplier(ax, curve)
        values = np.concatenate([curve.doublings for curve in own])
        draw_event(ax, values, np.ones(len(values)), period, DOUBLING)
        if len(values):
            where = " and ".join(f"{value:.5f}" for value in values)
            handle.set_label(f"{handle.get_label()}, doubles at {where}")
    set_range(ax, data)
    ax.set_ylim(0, HIGHEST)
    sides = (("unstable", 3, "bottom"), ("stable", -4, "top"))
    for words, rise, side in sides * style.get("labels", True):
        place = ax.get_yaxis_transform()
        ax.annotate(words, (0, 1), (5, rise), place, "offset points", va=side, fontsize=SMALL)
    return finish(
        ax,
        style,
        title=f"{walker_title(data)}: largest Floquet multiplier",
        note="of the most stable gait of period one and the gaits that double from it",
        x=str(data.attrs["parameter"]),
        y=RADIUS,
        legend=handles,
    )


def bifurcation_diagram(
    data: xr.Dataset, ax: Axes | None = None, **style: Unpack[Style]
) -> DrawnAxes:
    """Draw the attractors against a parameter: the first coordinate at the start of each stride.

    A dot is a recorded state of a walker that does not fall. Dashed lines are unstable parts of the
    gait of period one from which the cascade of period doublings starts. A vertical line marks the
    middle of the interval in which walking is lost.

    **Arguments:**

    - `data`: what `walker_jax.bifurcation_diagram` returns.
    - `ax`: where to draw; by default, on a new figure of 7 by 5 inches.
    - `style`: which words to draw, as in `Style`.

    **Returns** the axes. Raises `ValueError` for a data set without gaits and attractors.
    """
    check_dataset(data, "bifurcation diagram")
    ax = axes_for(ax, style, 7, 5)
    value, state = attractor_states(data)
    ax.plot(value, state, "o", color=BASINS[0], ms=1, mew=0, rasterized=True, zorder=4)
    handles = [Line2D([], [], color=BASINS[0], marker="o", ms=3, ls="", label="attractor")]
    for curve in cascade_curves(data)[:1]:
        draw_curve(ax, curve, curve.states, stable=False)
        handles.append(Line2D([], [], color=INK, label="unstable gait", **DASHED))
    set_range(ax, data)
    lost, note = loss_of_attractor(data), ""
    if np.isfinite(lost):
        handles.append(ax.axvline(lost, color=LOSS, lw=1, zorder=3, label="walking is lost"))
        low, high = data["lost"].values.tolist()
        digits = max(5, 1 - math.floor(math.log10(high - low)))  # enough to tell the two apart
        note = f"walking is lost between {low:.{digits}f} and {high:.{digits}f}"
    return finish(
        ax,
        style,
        title=f"{walker_title(data)}: attractors",
        note=note,
        legend=handles,
        x=str(data.attrs["parameter"]),
        y=first_name(data),
    )


def bifurcations(data: xr.Dataset) -> Figure:
    """Draw gaits, their largest multiplier and the attractors, over a range of a parameter.

    The pictures are `gait_branches` above `largest_multiplier`, and `bifurcation_diagram` above
    `lyapunov_exponents`, if the data set has exponents. At the bottom is the part of these between
    the first period doubling of the cascade and the loss of walking, if any.

    **Arguments:**

    - `data`: what `walker_jax.bifurcation_diagram` returns.

    **Returns** the figure, of 10.4 by 9 inches or, with exponents, by 13.5:
    `figures.bifurcations(data).savefig("slope.png")`. Raises `ValueError` as these do.
    """
    check_dataset(data, "bifurcation diagram")
    rows = 3 if "exponents" in data else 2
    figure = new_figure(10.4, 4.5 * rows)
    axes = figure.subplots(rows, 2)
    gait_branches(data, axes[0, 0], title="a  Gaits")
    bifurcation_diagram(data, axes[0, 1], title="b  Attractors")
    largest_multiplier(data, axes[1, 0], title="c  Largest Floquet multiplier")
    close, letter = axes[1, 1], "d"
    if rows == 3:
        lyapunov_exponents(data, axes[1, 1], title="d  Lyapunov exponents")
        (close, below), letter = axes[2], "e"
    window = cascade_window(data)
    if window is None:
        for ax in axes[-1, 3 - rows :]:
            ax.remove()
    else:
        zoom = bifurcation_diagram(data, close, title=f"{letter}  Attractors of the cascade")
        zoom.lines[0].set(markersize=0.8, alpha=0.5)
        zoom.set(xlim=window[:2], ylim=window[2:])
        if rows == 3:
            zoom = lyapunov_exponents(data, below, title="f  Exponents of the cascade")
            zoom.set_xlim(window[:2])
    for ax in figure.axes:
        ax.locator_params(axis="x", nbins=6)
    figure_title(figure, walker_title(data))
    return figure


def coefficients(data: xr.Dataset, name: str) -> Float[np.ndarray, " n"]:
    """Return coefficients of normal forms; NaN in older data sets without them."""
    if f"{name}_coefficient" in data:
        return data[f"{name}_coefficient"].values
    return np.full(len(data[f"{name}_value"]), np.nan)


def draw_curve(
    ax: Axes, curve: Curve, heights: Float[np.ndarray, "n k"], *, stable: bool = True
) -> None:
    """Draw lines along a curve: dashed where it is unstable, and solid where it is `stable`."""
    solid = curve.stable_intervals
    changes = np.flatnonzero(solid[1:] != solid[:-1]) + 1
    colour, _ = period_style(curve.period)
    for start, stop in pairwise([0, *changes.tolist(), len(solid)]):
        if start < stop and (stable or not solid[start]):
            run = slice(start, stop + 1)
            order = 3 * solid[start] + 1 / curve.period
            style = SOLID if solid[start] else DASHED if curve.period < 3 else FAINTER
            ax.plot(curve.value[run], heights[run], color=colour, zorder=2 + order, **style)


def draw_multiplier(ax: Axes, curve: Curve) -> None:
    """Draw the modulus of the largest multiplier along a curve."""
    fine = interpolate_multipliers(curve)
    draw_curve(ax, fine, fine.spectral_radius[:, None])


def draw_event(
    ax: Axes,
    values: Float[np.ndarray, " n"],
    heights: Float[np.ndarray, " n"],
    period: int,
    sign: dict[str, Any],
) -> None:
    """Draw the signs of a bifurcation; for long periods, which are many, they are smaller."""
    colour, _ = period_style(period)
    smaller = {} if period < 3 else {"ms": 0.7 * sign["ms"], "mew": 0.7 * sign["mew"]}
    ax.plot(values, heights, color=colour, zorder=7 - period / 100, **sign | smaller)


def cascade_window(data: xr.Dataset) -> tuple[float, float, float, float] | None:
    """Return limits of the picture around the states of the cascade; None without a cascade."""
    interval = cascade_interval(data)
    if interval is None:
        return None
    low, high = interval
    low, high = low - 0.05 * (high - low), high + 0.05 * (high - low)
    value, state = attractor_states(data)
    inside = state[(value >= low) & (value <= high)]
    if len(inside) == 0:
        return None
    room = 0.05 * float(np.ptp(inside)) or 0.05
    return low, high, float(inside.min()) - room, float(inside.max()) + room


def write_step_times(ax: Axes, data: xr.Dataset) -> None:
    """Write the step times of the gaits of period one at the end of the range beside the axes."""
    heights, times = final_gaits(data)
    high = 0.6 * ax.bbox.height * 72 / figure_of(ax).dpi  # between the title and the legend
    line = 1.4 * points_of(SMALL) / high * np.ptp(ax.get_ylim())
    at = ax.get_yaxis_transform()
    order = np.argsort(heights)
    places = spread_apart(heights[order], line, ax.get_ylim()[1] - line / 2)
    for i, place in zip(order.tolist(), places.tolist(), strict=True):
        arrow = {"arrowstyle": "-", "lw": 0.5, "shrinkA": 0, "shrinkB": 0}
        ax.annotate(
            f"{times[i]:.2f}",
            (1, heights[i]),
            (1.03, place),
            at,
            at,
            va="center",
            fontsize=SMALL,
            arrowprops=arrow,
        )
    if len(heights):
        ax.annotate(
            "step time\n(√(l/g))" if has_known_units(data) else "time",
            (1.03, 1),
            (0, 6),
            "axes fraction",
            "offset points",
            fontsize=SMALL,
        )


def spread_apart(
    heights: Float[np.ndarray, " n"], gap: float, top: float
) -> Float[np.ndarray, " n"]:
    """Move ascending heights apart by a gap: upwards, as far as they stay below a top."""
    places, steps = heights.copy(), gap * np.arange(len(heights))
    places = np.maximum.accumulate(places - steps) + steps
    return np.minimum(places, top - steps[::-1])


def set_range(ax: Axes, data: xr.Dataset) -> None:
    """Set the x limits to the range of the parameter."""
    samples = data["sample_value"].values if "sample_value" in data else []
    values = np.concatenate([data["value"].values, samples])
    if len(values) and np.ptp(values) > 0:
        ax.set_xlim(values.min(), values.max())


def first_name(data: xr.Dataset) -> str:
    """Return the name of the first coordinate of the section."""
    return names_in(data, "section")[0]


def period_lines(drawn: list[Curve]) -> list[Line2D]:
    """Return the signs of periods in a legend, the shortest first."""
    return [
        Line2D([], [], color=period_style(period)[0], lw=3, label=f"period {period}")
        for period in sorted({curve.period for curve in drawn})
    ]

"""Pictures of gaits over a parameter: branches, multipliers, bifurcation diagrams."""

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from walker_jax.figures.curves import (
    DOUBLING,
    FOLD,
    cascade,
    curves,
    draw_curve,
    draw_event,
    refined,
)
from walker_jax.figures.style import (
    BASINS,
    BELOW,
    DASHED,
    HIGHEST,
    INK,
    LINE,
    SOLID,
    TITLE,
    WORDS,
    check,
    counted,
    dots,
    dress,
    first,
    first_label,
    period_lines,
    place_legend,
    title,
)

GAITS = (
    *("branch", "period", "value", "states", "step_times", "multipliers", "stable", "on_cascade"),
    *("event_fold", "event_branch", "event_period", "event_value", "event_states"),
    *("event_multipliers", "cascade"),
)
ATTRACTORS = ("sample_value", "fate", "orbit", "lost")
"""What the pictures of bifurcations take from a data set."""
LOSS = "#b3261e"
"""Colour of the value at which walking is lost."""


def gait_branches(data: xr.Dataset, ax: Axes | None = None) -> Axes:
    """All gaits against a parameter: the first coordinate at the start of each of their strides.

    Figure 3 of Schwab and Wisse (2001), for gaits of every period. Colours tell periods. Lines are
    solid where a gait is stable and dashed where it is not. Triangles are folds, where two gaits
    are born, and dots are period doublings. At the right stand the step times, at the end of the
    range, of the gaits of period one.

    **Arguments:**

    - `data`: what `walker_jax.bifurcation_diagram` returns.
    - `ax`: where to draw; by default, on a new figure of 7 by 5.6 inches.

    **Returns** the axes. Raises `ValueError` for a data set without branches of gaits.
    """
    check(data, GAITS)
    if ax is None:
        ax = Figure(figsize=(7, 5.6), layout="constrained").add_subplot()
    drawn = curves(data)
    for curve in drawn:
        draw_curve(ax, curve, curve.states)
    folds, values = data["event_fold"].values, data["event_value"].values
    periods, states = data["event_period"].values.tolist(), first(data["event_states"])
    for period, fold, value, cycle in zip(periods, folds, values, states, strict=True):
        draw_event(ax, np.full(period, value), cycle[:period], period, fold=bool(fold))
    branches, fold, doubling = (
        counted(count, word)
        for count, word in (
            (len(drawn), "branch"),
            (int(folds.sum()), "fold"),
            (int((~folds).sum()), "period doubling"),
        )
    )
    dress(ax, data, "gaits", f"{branches} with {fold} and {doubling}")
    ax.set_ylabel(first_label(data), fontsize=11)
    write_step_times(ax, data)
    kinds = []
    for name, found, style in (
        ("stable", data["stable"].values, SOLID),
        ("unstable", ~data["stable"].values, DASHED),
        ("fold", folds, FOLD),
        ("period doubling", ~folds, DOUBLING),
    ):
        if found.any():
            kinds.append(Line2D([], [], color=INK, label=name, **style))
    periods = period_lines({curve.period for curve in drawn})
    place_legend(ax, kinds, BELOW, columns=4)
    place_legend(ax, periods, BELOW + LINE * bool(kinds), columns=4)
    return ax


def largest_multiplier(data: xr.Dataset, ax: Axes | None = None) -> Axes:
    """Modulus of the largest multiplier against a parameter, along a cascade of period doublings.

    The left axis of Figure 8 of Schwab and Wisse (2001), for the most stable gait of period one,
    the gaits of period two that leave it, and so on. A gait is stable, and its line solid, where
    the modulus is below one. Between two points of a branch, the coefficients of the polynomial
    whose roots the multipliers are change linearly.

    **Arguments:**

    - `data`: what `walker_jax.bifurcation_diagram` returns.
    - `ax`: where to draw; by default, on a new figure of 7 by 4.6 inches.

    **Returns** the axes. Raises `ValueError` for a data set without branches of gaits.
    """
    check(data, GAITS)
    if ax is None:
        ax = Figure(figsize=(7, 4.6), layout="constrained").add_subplot()
    ax.axhline(1, color=INK, lw=0.8, zorder=1)
    family = cascade(data)
    handles = period_lines({curve.period for curve in family})
    doublings = ~data["event_fold"].values
    for handle, period in zip(handles, sorted({c.period for c in family}), strict=True):
        of_period = [curve for curve in family if curve.period == period]
        for curve in map(refined, of_period):
            draw_curve(ax, curve, np.abs(curve.multipliers).max(axis=1, keepdims=True))
        ours = np.isin(data["event_branch"].values, [curve.number for curve in of_period])
        values = data["event_value"].values[ours & doublings]
        draw_event(ax, values, np.ones(len(values)), period, fold=False)
        if len(values):
            where = " and ".join(f"{value:.5f}" for value in values)
            handle.set_label(f"{handle.get_label()}, doubles at {where}")
    note = "of the most stable gait of period one and the gaits that double from it"
    dress(ax, data, "largest multiplier", note)
    ax.set_ylim(0, HIGHEST)
    ax.set_ylabel(r"modulus of the largest multiplier", fontsize=11)
    for words, rise, side in (("unstable", 3, "bottom"), ("stable", -4, "top")):
        place = ax.get_yaxis_transform()
        ax.annotate(words, (0, 1), (5, rise), place, "offset points", va=side, fontsize=WORDS)
    place_legend(ax, handles, BELOW, columns=2)
    return ax


def bifurcation_diagram(data: xr.Dataset, ax: Axes | None = None) -> Axes:
    """What walkers come to, against a parameter: the first coordinate at the start of each stride.

    A dot is a recorded state of a walker that walks on. For orientation, dashed lines show where
    the gait of period one is unstable from which the cascade of period doublings starts. A vertical
    line stands in the middle of the interval in which walking is lost.

    **Arguments:**

    - `data`: what `walker_jax.bifurcation_diagram` returns.
    - `ax`: where to draw; by default, on a new figure of 7 by 5 inches.

    **Returns** the axes. Raises `ValueError` for a data set without gaits and what walkers come to.
    """
    check(data, GAITS + ATTRACTORS)
    if ax is None:
        ax = Figure(figsize=(7, 5), layout="constrained").add_subplot()
    value, state = dots(data)
    ax.plot(value, state, "o", color=BASINS[0], ms=1, mew=0, rasterized=True, zorder=4)
    for curve in cascade(data)[:1]:
        draw_curve(ax, curve, curve.states, stable=False)
    dress(ax, data, "attractors", "")
    ax.set_ylabel(first_label(data), fontsize=11)
    lost = float(data["lost"].values.mean())
    if np.isfinite(lost):
        ax.axvline(lost, color=LOSS, lw=1, zorder=3)
        ax.annotate(
            f"walking is lost at {lost:.5f}",
            (lost, 1),
            (0, 3),
            ax.get_xaxis_transform(),
            "offset points",
            ha="center",
            color=LOSS,
            fontsize=WORDS,
        )
    return ax


def bifurcations(data: xr.Dataset) -> Figure:
    """Gaits, their largest multiplier and what walkers come to, over a range of a parameter.

    The pictures `gait_branches`, above `largest_multiplier`, and `bifurcation_diagram`, above the
    part of it between the first period doubling of the cascade and the loss of walking, if any.

    **Arguments:**

    - `data`: what `walker_jax.bifurcation_diagram` returns.

    **Returns** the figure, of 13 by 9.4 inches: `figures.bifurcations(data).savefig("slope.png")`.
    Raises `ValueError` as these do.
    """
    check(data, GAITS + ATTRACTORS)
    figure = Figure(figsize=(13, 9.4), layout="constrained")
    axes = figure.subplots(2, 2)
    gait_branches(data, axes[0, 0]).set_title("Gaits", **TITLE)
    bifurcation_diagram(data, axes[0, 1]).set_title("Attractors", **TITLE)
    largest_multiplier(data, axes[1, 0]).set_title("Largest multiplier", **TITLE)
    window = cascade_window(data)
    if window is None:
        axes[1, 1].remove()
    else:
        zoom = bifurcation_diagram(data, axes[1, 1])
        zoom.set_title("Attractors of the cascade", **TITLE)
        zoom.lines[0].set(markersize=0.8, alpha=0.5)
        zoom.set(xlim=window[:2], ylim=window[2:])
        zoom.locator_params(axis="x", nbins=6)
    figure.suptitle(title(data), x=0.01, ha="left", fontsize=14, fontweight="bold")
    return figure


def cascade_window(data: xr.Dataset) -> tuple[float, float, float, float] | None:
    """Limits of the picture from the first doubling of the cascade to the loss of walking.

    None where there is no such range, or no walker in it.
    """
    doublings = data["event_value"].values[data["cascade"].values & ~data["event_fold"].values]
    low, high = float(doublings.min(initial=np.inf)), float(data["lost"].values.mean())
    if not low < high:
        return None
    low, high = low - 0.05 * (high - low), high + 0.05 * (high - low)
    value, state = dots(data)
    inside = state[(value >= low) & (value <= high)]
    if len(inside) == 0:
        return None
    room = 0.05 * float(np.ptp(inside)) or 0.05
    return low, high, float(inside.min()) - room, float(inside.max()) + room


def write_step_times(ax: Axes, data: xr.Dataset) -> None:
    """Step times of the gaits of period one at the end of the range, beside the axes."""
    value, period = data["value"].values, data["period"].values
    last = np.flatnonzero((period == 1) & np.isclose(value, value.max(initial=-np.inf), rtol=1e-9))
    heights, times = first(data["states"])[last, 0], data["step_times"].values[last, 0]
    at, room, free = ax.get_yaxis_transform(), 0.05 * np.ptp(ax.get_ylim()), -np.inf
    for height, time in sorted(zip(heights.tolist(), times.tolist(), strict=True)):
        free = max(height, free + room)
        line = {"arrowstyle": "-", "lw": 0.5, "shrinkA": 0, "shrinkB": 0}
        ax.annotate(
            f"{time:.2f}",
            (1, height),
            (1.03, free),
            at,
            at,
            va="center",
            fontsize=WORDS,
            arrowprops=line,
        )
    if len(last):
        ax.annotate(
            "step time\n(√(l/g))",
            (1.03, 1),
            (0, 3),
            "axes fraction",
            "offset points",
            fontsize=WORDS,
        )

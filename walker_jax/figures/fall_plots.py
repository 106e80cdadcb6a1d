"""Pictures of the most probable fall."""

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from walker_jax.checks import check_kind
from walker_jax.figures.layout import figure_title, finish, new_figure
from walker_jax.figures.style import BASINS, INK, OTHERS, failure_words
from walker_jax.figures.text import walker_title
from walker_jax.stability.probable_falls import ProbableFall
from walker_jax.walkers.model import Walker
from walker_jax.walkers.parameters import attributes_of

KINDS = ("height of the step (l)", "change of the slope (rad)", "push (rad / √(l/g))")
"""Disturbances of a stride with their units, in the order of their columns."""
LONGEST = 1e12
"""Largest mean number of strides to a fall at which the law is drawn."""
ROUGHEST = 2.0
"""action / deviation^2 at the other end: strides are few there, and the law does not hold."""


def probable_fall(
    fall: ProbableFall, walker: Walker | None = None, *, title: bool | str = True
) -> Figure:
    """Draw the most probable fall: its disturbances, its path through the section, and its law.

    Above are the disturbances of each stride, and the least action for each number of disturbed
    strides. Below are the states just after each heel strike, theta and theta + thetadot, from the
    gait to the last one before the fall. Beside them is the mean number of strides to a fall, over
    action / scale^2, for deviations `scale` times the given ones.

    **Arguments:**

    - `fall`: what `walker_jax.most_probable_fall` returns.
    - `walker`: what falls, for the title.
    - `title`: whether to draw one; a string replaces it.

    **Returns** the figure, of 9 by 7.6 inches. Raises `ValueError` for anything else.
    """
    check_kind("fall", fall, ProbableFall)
    figure = new_figure(9, 7.6)
    (sequence, actions), (path, law) = figure.subplots(2, 2)
    draw_sequence(sequence, fall)
    draw_actions(actions, fall)
    draw_path(path, fall)
    draw_law(law, fall)
    words = f"{failure_words(fall.outcome)} after {fall.strides} strides"
    own = f"The most probable fall: {words}, action {fall.action:.6g}"
    if walker is not None:
        about = {"walker": type(walker).__name__} | attributes_of(walker)
        own = f"{walker_title(xr.Dataset(attrs=about))}\n{own}"
    if title:
        figure_title(figure, title if isinstance(title, str) else own, "large")
    return figure


def draw_sequence(ax: Axes, fall: ProbableFall) -> None:
    """Draw the disturbances of each stride as bars."""
    number = np.arange(1, len(fall.disturbances) + 1)
    kinds = np.flatnonzero(fall.disturbances.any(axis=0))
    width = 0.8 / len(kinds)
    bars: list[Any] = []
    for i, kind in enumerate(kinds):
        at = number + (i - (len(kinds) - 1) / 2) * width
        look: Any = {"color": BASINS[i], "label": KINDS[kind]}
        bars.append(ax.bar(at, fall.disturbances[:, kind], width, **look)[0])
        bars[-1].set_label(KINDS[kind])
    ax.axhline(0, color=INK, lw=0.8)
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    ax.ticklabel_format(axis="y", style="sci", scilimits=(-2, 3), useMathText=True)
    y = KINDS[kinds[0]] if len(kinds) == 1 else "disturbance"
    legend = bars if len(kinds) > 1 else []
    finish(ax, {}, title="Disturbances", x="stride", y=y, legend=legend)


def draw_actions(ax: Axes, fall: ProbableFall) -> None:
    """Draw the least action of each number of disturbed strides."""
    ax.plot(np.arange(1, len(fall.actions) + 1), fall.actions, "-o", color=BASINS[0], ms=4, lw=1)
    ax.axhline(fall.action, color=OTHERS, lw=0.8, ls=":")
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    ax.set(ylim=(0, 1.1 * np.nanmax(fall.actions[np.isfinite(fall.actions)])))
    ax.ticklabel_format(axis="y", style="sci", scilimits=(-2, 3), useMathText=True)
    finish(ax, {}, title="Action", x="disturbed strides", y="least action")


def draw_path(ax: Axes, fall: ProbableFall) -> None:
    """Draw states just after heel strike; open circles come after the last disturbance."""
    places = fall.states[:, 0], fall.states[:, 0] + fall.states[:, 2]
    disturbed = np.arange(len(fall.states)) <= len(fall.disturbances)
    first, last = np.arange(len(disturbed)) == 0, np.arange(len(disturbed)) == len(disturbed) - 1
    blue: dict[str, Any] = {"marker": "o", "ms": 5, "color": BASINS[0]}
    signs: list[tuple[str, np.ndarray, dict[str, Any]]] = [
        ("gait", first, {"marker": "o", "ms": 9, "color": INK}),
        ("disturbed", disturbed & ~first & ~last, blue),
        ("on even ground", ~disturbed & ~last, blue | {"mfc": "white"}),
        ("before the fall", last, {"marker": "X", "ms": 9, "color": BASINS[1]}),
    ]
    ax.plot(*places, color=BASINS[0], lw=0.8)
    marks = []
    for label, some, look in signs:
        if some.any():
            shown = places[0][some], places[1][some]
            marks += ax.plot(*shown, ls="", zorder=3, label=label, **look)
    ax.locator_params(axis="x", nbins=6)
    finish(ax, {}, title="States just after heel strike", x="theta", y="sum", legend=marks)


def draw_law(ax: Axes, fall: ProbableFall) -> None:
    """Draw mean strides to a fall over action / scale^2, and the law without its prefactor."""
    exponent = np.linspace(ROUGHEST, np.log(LONGEST), 60)
    scales = np.sqrt(fall.action / exponent)
    means = np.array([fall.mean_strides(one) for one in scales.tolist()])
    shown = means <= LONGEST
    rare, law = exponent[shown], np.exp(exponent[shown])
    lines = ax.semilogy(rare, means[shown], color=BASINS[0], label="mean strides to a fall")
    lines += ax.semilogy(rare, law, "--", lw=1, color=OTHERS, label="exp(action / scale$^2$)")
    above = ax.secondary_xaxis("top", functions=(lambda e: e, lambda e: e))
    ticks = exponent[:: len(exponent) // 4]
    above.set_xticks(ticks, [f"{np.sqrt(fall.action / one):.2g}" for one in ticks])
    above.set_xlabel("scale of the deviations")
    finish(ax, {}, title="Law", x="action / scale$^2$", y="mean strides to a fall", legend=lines)

"""Pictures of the most probable fall."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from walker_jax.checks import check_kind
from walker_jax.figures.layout import figure_title, name_axes, new_figure
from walker_jax.figures.style import BASINS, INK, OTHERS, TITLE, failure_words
from walker_jax.stability.probable_falls import ProbableFall

KINDS = ("height of the step", "change of the slope (rad)", "push")
"""Disturbances of a stride, in the order of their columns."""
LONGEST = 1e12
"""Largest mean number of strides to a fall at which the law is drawn."""
ROUGHEST = 2.0
"""action / deviation^2 at the other end: strides are few there, and the law does not hold."""


def probable_fall(fall: ProbableFall, *, title: bool | str = True) -> Figure:
    """Draw the most probable fall: its disturbances, its path through the section, and its law.

    Above are the disturbances of each stride, and the least action for each number of disturbed
    strides. Below are the states just after each heel strike, theta and theta + thetadot, from the
    gait (the disc) to the last one before the fall (the cross). Beside them is the mean number of
    strides to a fall, over action / scale^2, for deviations `scale` times the given ones.

    **Arguments:**

    - `fall`: what `walker_jax.most_probable_fall` returns.
    - `title`: whether to draw one; a string replaces it.

    **Returns** the figure, of 9 by 7 inches. Raises `ValueError` for anything else.
    """
    check_kind("fall", fall, ProbableFall)
    figure = new_figure(9, 7)
    (sequence, actions), (path, law) = figure.subplots(2, 2)
    draw_sequence(sequence, fall)
    draw_actions(actions, fall)
    draw_path(path, fall)
    draw_law(law, fall)
    if title:
        words = f"{failure_words(fall.outcome)} after {fall.strides} strides"
        own = f"The most probable fall: {words}, action {fall.action:.6g}"
        figure_title(figure, title if isinstance(title, str) else own, "large")
    return figure


def draw_sequence(ax: Axes, fall: ProbableFall) -> None:
    """Draw the disturbances of each stride as bars."""
    number = np.arange(1, len(fall.disturbances) + 1)
    kinds = np.flatnonzero(fall.disturbances.any(axis=0))
    width = 0.8 / len(kinds)
    for i, kind in enumerate(kinds):
        at = number + (i - (len(kinds) - 1) / 2) * width
        label = KINDS[kind]
        ax.bar(at, fall.disturbances[:, kind], width, color=BASINS[i], label=label)
    ax.axhline(0, color=INK, lw=0.8)
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    ax.set_xlabel("stride")
    if len(kinds) > 1:
        ax.legend()
    ax.set_ylabel(KINDS[kinds[0]] if len(kinds) == 1 else "disturbance")
    ax.ticklabel_format(axis="y", style="sci", scilimits=(-2, 3))
    ax.set_title("Disturbances", **TITLE)


def draw_actions(ax: Axes, fall: ProbableFall) -> None:
    """Draw the least action of each number of disturbed strides."""
    ax.plot(np.arange(1, len(fall.actions) + 1), fall.actions, "-o", color=BASINS[0], ms=4, lw=1)
    ax.axhline(fall.action, color=OTHERS, lw=0.8, ls=":")
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    ax.set(xlabel="disturbed strides", ylabel="least action", ylim=(0, None))
    ax.ticklabel_format(axis="y", style="sci", scilimits=(-2, 3))
    ax.set_title("Action", **TITLE)


def draw_path(ax: Axes, fall: ProbableFall) -> None:
    """Draw states just after heel strike; open circles come after the last disturbance."""
    theta, thetadot = fall.states[:, 0], fall.states[:, 2]
    disturbed = np.arange(len(theta)) <= len(fall.disturbances)
    for marked, face in ((disturbed, BASINS[0]), (~disturbed, "white")):
        points = theta[marked], (theta + thetadot)[marked]
        ax.plot(*points, "o", ms=4, color=BASINS[0], mfc=face, zorder=3)
    ax.plot(theta, theta + thetadot, color=BASINS[0], lw=0.8)
    ax.plot(theta[0], theta[0] + thetadot[0], "o", ms=9, color=INK, zorder=4)
    ax.plot(theta[-1], theta[-1] + thetadot[-1], "x", ms=9, mew=2, color=BASINS[1], zorder=4)
    name_axes(ax, "theta", "sum")
    ax.set_title("States just after heel strike", **TITLE)


def draw_law(ax: Axes, fall: ProbableFall) -> None:
    """Draw mean strides to a fall over action / scale^2, and the law without its prefactor."""
    exponent = np.linspace(ROUGHEST, np.log(LONGEST), 60)
    scales = np.sqrt(fall.action / exponent)
    means = np.array([fall.mean_strides(one) for one in scales.tolist()])
    shown = means <= LONGEST
    ax.semilogy(exponent[shown], means[shown], color=BASINS[0], label="mean strides to a fall")
    ax.semilogy(
        exponent[shown],
        np.exp(exponent[shown]),
        ls="--",
        lw=1,
        color=OTHERS,
        label="exp(action / scale$^2$)",
    )
    ax.set(xlabel="action / scale$^2$", ylabel="strides")
    above = ax.secondary_xaxis("top", functions=(lambda e: e, lambda e: e))
    ticks = exponent[:: len(exponent) // 4]
    above.set_xticks(ticks, [f"{np.sqrt(fall.action / one):.2g}" for one in ticks])
    above.set_xlabel("scale of the deviations")
    ax.legend()
    ax.set_title("Law", **TITLE)

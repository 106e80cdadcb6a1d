"""Floquet multipliers in the complex plane."""

from collections.abc import Sequence
from typing import NamedTuple, Unpack

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Circle
from matplotlib.transforms import offset_copy

from walker_jax.figures.layout import DrawnAxes, Style, axes_for, figure_of, finish
from walker_jax.figures.style import INK, SMALL, gait_marker
from walker_jax.figures.text import count_noun, short_number
from walker_jax.gaits.cycles import Gait

RIM = 2.5
"""Largest real and imaginary part of a multiplier in the picture of the complex plane."""
ROW, ROWS = 13, 8
"""Height (points) of a line on multipliers beyond the frame, and most lines at one place."""


def multipliers(gaits: Sequence[Gait], ax: Axes | None = None, **style: Unpack[Style]) -> DrawnAxes:
    """Draw the Floquet multipliers of gaits in the complex plane, with the unit circle.

    Colours and signs show periods; signs are filled for stable gaits and open for unstable ones. An
    arrow at the rim of the frame points to each multiplier beyond it, with its value.

    **Arguments:**

    - `gaits`: for example from `walker_jax.find_gaits`. Failed searches are left out.
    - `ax`: where to draw; by default, on a new figure of 6.2 by 7.2 inches.
    - `style`: which words to draw, as in `Style`.

    **Returns** the axes.
    """
    ax = axes_for(ax, style, 6.2, 7.2, "compressed")
    gaits = [gait for gait in gaits if gait.found]
    ax.add_patch(Circle((0, 0), 1, fc="#f2f2f2", ec=INK, lw=1, zorder=1))
    ax.axhline(0, color=INK, lw=0.4, zorder=1.5)
    ax.axvline(0, color=INK, lw=0.4, zorder=1.5)
    far: list[tuple[complex, Gait]] = []
    for gait in sorted(gaits, key=lambda gait: len(gait.states)):
        values = np.asarray(gait.multipliers)
        beyond = np.maximum(np.abs(np.real(values)), np.abs(np.imag(values))) > RIM
        x, y = np.real(values[~beyond]), np.imag(values[~beyond])
        ax.plot(x, y, zorder=3, **gait_marker(len(gait.states), bool(gait.stable)))
        far += [(complex(value), gait) for value in values[beyond]]
    for rim in group_at_rim(far):
        draw_rim(ax, rim, style.get("labels", True))
    ax.set(xlim=(-RIM, RIM), ylim=(-RIM, RIM), aspect="equal", anchor="W")
    stable = sum(bool(gait.stable) for gait in gaits)
    kinds = [
        Line2D([], [], label=name, **gait_marker(1, stable))
        for name, stable in (("stable", True), ("unstable", False))
        if any(bool(gait.stable) == stable for gait in gaits)
    ]
    periods = sorted({len(gait.states) for gait in gaits})
    signs = [
        Line2D([], [], label=f"period {period}", **gait_marker(period, True)) for period in periods
    ]
    of_period = f" of period {periods[0]}" if len(periods) == 1 else ""
    return finish(
        ax,
        style,
        title="Floquet multipliers",
        note=f"of {count_noun(len(gaits), 'gait')}{of_period}, {stable} of them stable",
        x="real part",
        y="imaginary part",
        legend=[*kinds, *([] if of_period else signs)],
    )


class Rim(NamedTuple):
    """Multipliers beyond the frame with close places at its rim."""

    x: float
    y: float
    members: list[tuple[complex, Gait]]
    """The multipliers with their gaits; the smallest first."""


def group_at_rim(far: list[tuple[complex, Gait]]) -> list[Rim]:
    """Group multipliers beyond the frame by close places at its rim."""
    found: list[Rim] = []
    for value, gait in sorted(far, key=lambda one: abs(one[0])):
        place = value * RIM / max(abs(value.real), abs(value.imag))
        for rim in found:
            if abs(complex(rim.x, rim.y) - place) < 0.2 * RIM:
                rim.members.append((value, gait))
                break
        else:
            found.append(Rim(place.real, place.imag, [(value, gait)]))
    return found


def draw_rim(ax: Axes, rim: Rim, labels: bool) -> None:
    """Draw a row for each multiplier at a place of the rim: its value, its sign, and an arrow."""
    figure = figure_of(ax)
    inwards = -1 if (rim.x >= 0) == (abs(rim.x) > RIM / 2) else 1
    # Zero counts by x, so that the two sides of a small frame differ in height.
    above = rim.y > 0 or (rim.y == 0 and rim.x > 0)
    up = 1 if above == (abs(rim.y) < RIM / 2) else -1
    shown = rim.members if len(rim.members) <= ROWS else rim.members[: ROWS - 1]
    for row, (value, gait) in enumerate(shown, 1):
        rise = up * ROW * row
        offset = value / abs(value) * 7
        tip = offset_copy(
            ax.transData, figure, 11 * inwards + offset.real, rise + offset.imag, units="points"
        )
        spot = offset_copy(ax.transData, figure, 27 * inwards, rise, units="points")
        style = gait_marker(len(gait.states), bool(gait.stable))
        arrow = {"arrowstyle": "->", "color": style["color"], "shrinkA": 0, "shrinkB": 0}
        tail = (-2 * offset.real, -2 * offset.imag)
        ax.annotate("", (rim.x, rim.y), tail, tip, "offset points", arrowprops=arrow)
        ax.add_line(Line2D([rim.x], [rim.y], transform=spot, zorder=4, **style))
        if labels:
            write_row(ax, rim, 36 * inwards, rise, short_number(value))
    if labels and len(shown) < len(rim.members):
        largest = short_number(rim.members[-1][0])
        words = f"and {len(rim.members) - len(shown)} more, up to {largest}"
        write_row(ax, rim, 5 * inwards, up * ROW * ROWS, words)


def write_row(ax: Axes, rim: Rim, shift: int, rise: int, words: str) -> None:
    """Write words on the inner side of a place of the rim, at an offset in points."""
    ax.annotate(
        words,
        (rim.x, rim.y),
        (shift, rise),
        textcoords="offset points",
        ha="left" if shift > 0 else "right",
        va="center_baseline",
        fontsize=SMALL,
    )

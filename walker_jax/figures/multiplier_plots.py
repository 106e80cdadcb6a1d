"""Floquet multipliers in the complex plane."""

from collections.abc import Sequence
from typing import Unpack

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Circle

from walker_jax.figures.layout import DrawnAxes, Style, axes_for, finish
from walker_jax.figures.style import INK, gait_marker
from walker_jax.figures.text import count_noun, format_number
from walker_jax.gaits.cycles import Gait

LINEAR = 2.0
"""Largest real and imaginary part up to which the axes are linear; beyond, they are logarithmic."""


def multipliers(gaits: Sequence[Gait], ax: Axes | None = None, **style: Unpack[Style]) -> DrawnAxes:
    """Draw the Floquet multipliers of gaits in the complex plane, with the unit circle.

    Colours and signs show periods; signs are filled for stable gaits and open for unstable ones.
    Parts of more than 2, if there are any, are on a logarithmic scale. `gaits` are, for example,
    those from `walker_jax.find_gaits`; failed searches are left out.
    """
    ax = axes_for(ax, style, 6.2, 6.7)
    gaits = sorted((one for one in gaits if one.found), key=lambda one: len(one.states))
    ax.add_patch(Circle((0, 0), 1, fc="#f2f2f2", ec=INK, lw=1, zorder=1))
    ax.axhline(0, color=INK, lw=0.4, zorder=1.5)
    ax.axvline(0, color=INK, lw=0.4, zorder=1.5)
    farthest = LINEAR
    for gait in gaits:
        values = np.asarray(gait.multipliers)
        parts = np.real(values), np.imag(values)
        farthest = max(farthest, np.abs(parts).max())
        ax.plot(*parts, zorder=3, **gait_marker(len(gait.states), bool(gait.stable)))
    limit = 1.1 * LINEAR
    if farthest > LINEAR:
        limit = 2 * farthest
        half = max(1, np.log10(limit / LINEAR))  # the linear part has half of the width
        decades = [10.0**k for k in range(1, 20, max(1, round(half / 3))) if 10**k < limit]
        ticks = [*(-one for one in decades[::-1]), -2.0, -1.0, 0.0, 1.0, 2.0, *decades]
        ax.set_xscale("symlog", linthresh=LINEAR, linscale=half)
        ax.set_yscale("symlog", linthresh=LINEAR, linscale=half)
        for axis in (ax.xaxis, ax.yaxis):
            axis.set_ticks(ticks, [format_number(one, "g") for one in ticks])
    ax.set(xlim=(-limit, limit), ylim=(-limit, limit), aspect="equal", anchor="W")
    stable = sum(bool(gait.stable) for gait in gaits)
    handles = [
        Line2D([], [], label=name, **gait_marker(1, stable))
        for name, stable in (("stable", True), ("unstable", False))
        if any(bool(gait.stable) == stable for gait in gaits)
    ]
    periods = sorted({len(gait.states) for gait in gaits})
    of_period = f" of period {periods[0]}" if len(periods) == 1 else ""
    for period in periods * (not of_period):
        handles.append(Line2D([], [], label=f"period {period}", **gait_marker(period, True)))
    note = f"of {count_noun(len(gaits), 'gait')}{of_period}, {stable} of them stable"
    x, y = "real part", "imaginary part"
    return finish(ax, style, "Floquet multipliers", note, x=x, y=y, legend=handles)

"""Pictures of long transients: a chaotic saddle, and the law of mean lives beyond a crisis."""

from collections.abc import Mapping
from typing import Any, Unpack

import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Float
from matplotlib.axes import Axes

from walker_jax.checks import WrongUse, check_kind, numbers
from walker_jax.figures.layout import DrawnAxes, Style, axes_for, finish
from walker_jax.figures.style import BASINS, INK, OTHERS
from walker_jax.gaits.cycles import Gait
from walker_jax.stability.escapes import CrisisLaw, Transients

ROUTES = 12
"""Most escapes that are drawn."""
STRIDES = 6
"""Number of last states drawn for each of them."""
AROUND = 0.3
"""Margin around the saddle, as a share of its width."""
DASHES = ((0, (6, 2)), (0, (3, 2)), (0, (1, 1.5)))
"""Line styles of predicted exponents."""


def chaotic_saddle(
    found: Transients,
    attractor: Float[ArrayLike, "n section"] | None = None,
    gait: Gait | None = None,
    ax: Axes | None = None,
    **style: Unpack[Style],
) -> DrawnAxes:
    """Draw a chaotic saddle, the attractor before the crisis, and the ways in which walks leave.

    States are just after heel strike. The axes are the first two coordinates of the section; for
    walkers they are theta and theta + thetadot, as otherwise all states lie close to a line. Each
    way has the last six states before a failure. The last of them may be outside the picture.

    **Arguments:**

    - `found`: what `walker_jax.transients` returns.
    - `attractor`: states of the attractor before the crisis.
    - `gait`: a gait whose states are marked, such as the gait that the attractor meets at the
      crisis.
    - `ax`: where to draw; by default, on a new figure of 7 by 5.6 inches.
    - `style`: which words to draw, as in `Style`.

    **Returns** the axes. Raises `ValueError` for a section of one dimension.
    """
    check_kind("found", found, Transients)
    if len(found.section) < 2:
        raise WrongUse(f"found must have two coordinates, not {', '.join(found.section)}")
    ax = axes_for(ax, style, 7, 5.6)
    summed = found.section[:2] == ("theta", "thetadot")

    def place(states: Any) -> tuple[np.ndarray, np.ndarray]:
        first, second = np.moveaxis(np.asarray(states, float)[..., :2], -1, 0)
        return first, first + second if summed else second

    dots: dict[str, Any] = {"ls": "", "marker": ".", "ms": 2.5, "mew": 0}
    handles = []
    ways = found.escapes[:ROUTES, -STRIDES:]
    for i, way in enumerate(ways):
        label = "on the way to a failure" if i == 0 else None
        handles += ax.plot(*place(way), "-o", color=OTHERS, lw=0.6, ms=2.5, label=label, zorder=1)
    shown: list[tuple[str, Any, str, int]] = [("saddle", found.saddle, BASINS[1], 2)]
    if attractor is not None:
        shown.append(("attractor before the crisis", attractor, BASINS[2], 3))
    for label, states, colour, order in shown:
        ax.plot(*place(states), color=colour, zorder=order, **dots)
        handles += ax.plot([], [], "o", color=colour, ms=5, label=label)
    if gait is not None:
        label = f"gait of period {len(gait.states)}"
        look: dict[str, Any] = {"mfc": "white", "mec": INK, "mew": 1.2, "ms": 6, "ls": ""}
        handles += ax.plot(*place(gait.states), "o", label=label, zorder=5, **look)
    for set_limits, values in zip((ax.set_xlim, ax.set_ylim), place(found.saddle), strict=True):
        low, high = np.quantile(values, [0.001, 0.999])
        set_limits(low - (high - low) * AROUND, high + (high - low) * AROUND)
    exponents = ", ".join(f"{one:.3f}" for one in found.exponents)
    return finish(
        ax,
        style,
        title="Chaotic saddle",
        note=f"mean life {found.mean_life:.1f}; exponents {exponents}; dimension "
        f"{found.dimension:.2f}",
        x=found.section[0],
        y="sum" if summed else found.section[1],
        legend=[one for one in handles if not one.get_label().startswith("_")],
    )


def crisis_law(
    values: Float[ArrayLike, " k"],
    lives: Float[ArrayLike, " k"],
    errors: Float[ArrayLike, " k"],
    law: CrisisLaw,
    predicted: Mapping[str, float] | None = None,
    openings: Mapping[str, float] | None = None,
    ax: Axes | None = None,
    **style: Unpack[Style],
) -> DrawnAxes:
    """Draw mean lives against the distance from a crisis, on logarithmic axes, and the fitted law.

    **Arguments:**

    - `values`, `lives`, `errors`: as for `walker_jax.crisis_law`; bars are two standard errors.
    - `law`: what `walker_jax.crisis_law` returns.
    - `predicted`: exponents by their labels, such as `law.predicted`. Lines with these
      exponents go through the centre of the lives, as the fitted law does.
    - `openings`: values of the parameter to mark, by their labels.
    - `ax`: where to draw; by default, on a new figure of 7 by 5 inches.
    - `style`: which words to draw, as in `Style`.

    **Returns** the axes. Raises `ValueError` for values that are not beyond the crisis.
    """
    check_kind("law", law, CrisisLaw)
    values, lives, errors = map(numbers, ("values", "lives", "errors"), (values, lives, errors))
    distance = values - law.crisis
    if not (values.ndim == 1 and len(values) and (distance > 0).all()):
        raise WrongUse(f"values must be above the crisis, {law.crisis:g}")
    ax = axes_for(ax, style, 7, 5)
    weights = (lives / errors) ** 2
    middle = [np.exp(np.average(np.log(one), weights=weights)) for one in (distance, lives)]
    ends = np.array([distance.min(), distance.max()])
    line = lambda exponent: middle[1] * (ends / middle[0]) ** -exponent
    ax.loglog(distance, lives, ls="")  # sets the scales
    bars = ax.errorbar(distance, lives, 2 * errors, fmt="o", ms=4, lw=1, color=BASINS[0])
    bars[0].set_label("mean life")
    fitted = f"fitted exponent {law.exponent:.2f} ({law.low:.2f} to {law.high:.2f})"
    handles: list[Any] = [
        bars[0],
        *ax.plot(ends, line(law.exponent), color=BASINS[0], label=fitted),
    ]
    for i, (name, exponent) in enumerate((predicted or {}).items()):
        look = {"color": BASINS[1], "lw": 1.1, "ls": DASHES[i % len(DASHES)]}
        handles += ax.plot(ends, line(exponent), label=f"{name}: {exponent:.2f}", **look)
    for name, value in (openings or {}).items():
        ax.axvline(value - law.crisis, color=OTHERS, lw=0.9, ls=":", zorder=1)
        words = f" {name} " * style.get("labels", True)
        ax.text(value - law.crisis, ax.get_ylim()[1], words, rotation=90, va="top", ha="right")
    return finish(
        ax,
        style,
        title="Mean life beyond the crisis",
        note=f"crisis at {law.crisis:.8g}; chi² per degree of freedom {law.misfit:.1f}",
        x=f"distance from {law.crisis:.8g}",
        y="mean life (strides)",
        legend=handles,
    )

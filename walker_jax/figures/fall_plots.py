"""Pictures of falls: the most probable one, rough ground, and long transients before a fall."""

from collections.abc import Mapping
from typing import Any, Unpack

import numpy as np
import xarray as xr
from jax.typing import ArrayLike
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from walker_jax.basins.cell_classes import along_axis
from walker_jax.checks import WrongUse, check_kind, numbers
from walker_jax.figures import layout
from walker_jax.figures.layout import DrawnAxes, Style, axes_for, begin, finish, widened
from walker_jax.figures.style import BASINS, INK, OTHERS, failure_words
from walker_jax.figures.text import walker_title, with_error
from walker_jax.gaits.cycles import Gait
from walker_jax.stability.escapes import CrisisLaw, Transients
from walker_jax.stability.probable_falls import ProbableFall
from walker_jax.walkers.model import Walker
from walker_jax.walkers.parameters import attributes_of

KINDS = ("height of the step (l)", "change of the slope (rad)", "push (rad / √(l/g))")
"""Disturbances of a stride with their units, in the order of their columns."""
LONGEST = 1e12
"""Largest mean number of strides to a fall at which the law is drawn."""
ROUGHEST = 2.0
"""action / deviation^2 at the other end: strides are few there, and the law does not hold."""
ROUTES, STRIDES = 12, 6
"""Most escapes that are drawn, and the number of last states drawn for each of them."""
AROUND = 0.3
"""Margin around the saddle, as a share of its width."""
DASHES = ((0, (6, 2)), (0, (3, 2)), (0, (1, 1.5)))
"""Line styles of predicted exponents."""
PIXELS, PARTS = 120, 8
"""Pixels of the picture along each side; parts of a cell along each edge, to avoid stripes."""
FAINTEST = 1e-6
"""Chance, relative to the largest one, below which a pixel is empty."""


def probable_fall(
    fall: ProbableFall, walker: Walker | None = None, **style: Unpack[Style]
) -> Figure:
    """Draw the most probable fall: its disturbances, its path through the section, and its law.

    Above are the disturbances of each stride, and the least action for each number of disturbed
    strides. Below are the states just after each heel strike, theta and theta + thetadot, from the
    gait to the last one before the fall. Beside them is the mean number of strides to a fall, over
    action / scale^2, for deviations `scale` times the given ones.

    **Arguments:**

    - `fall`: what `walker_jax.most_probable_fall` returns.
    - `walker`: what falls, for the title.
    """
    check_kind("fall", fall, ProbableFall)
    layout.check_style(style)
    figure, panels = layout.new_panels(9, 7.6, 2, 2)
    inner: Any = {name: one for name, one in style.items() if name != "title"}
    parts = draw_sequence, draw_actions, draw_path, draw_law
    for ax, draw in zip(panels, parts, strict=True):
        draw(ax, fall, inner)
    words = f"{failure_words(fall.outcome)} after {fall.strides} strides"
    lines = [f"The most probable fall: {words}, action {fall.action:.6g}"]
    if walker is not None:
        about = {"walker": type(walker).__name__} | attributes_of(walker)
        subtitle = lines if style.get("subtitle", True) else []
        lines = [walker_title(xr.Dataset(attrs=about)), *subtitle]
    layout.figure_title(figure, "\n".join(lines), style)
    return figure


def draw_sequence(ax: Axes, fall: ProbableFall, style: Style) -> None:
    """Draw the disturbances of each stride as bars."""
    number = np.arange(1, len(fall.disturbances) + 1)
    kinds = np.flatnonzero(fall.disturbances.any(axis=0))
    width = 0.8 / len(kinds)
    for i, kind in enumerate(kinds):
        at = number + (i - (len(kinds) - 1) / 2) * width
        ax.bar(at, fall.disturbances[:, kind], width, color=BASINS[i], label=KINDS[kind])
    ax.axhline(0, color=INK, lw=0.8)
    count_axis(ax)
    y = "disturbance"
    if len(kinds) == 1:
        style, y = style | {"legend": False}, KINDS[kinds[0]]
    finish(ax, style, "Disturbances", x="stride", y=y)


def count_axis(ax: Axes) -> None:
    """Number the x axis by whole numbers, and the y axis by short ones."""
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    ax.ticklabel_format(axis="y", style="sci", scilimits=(-2, 3), useMathText=True)


def draw_actions(ax: Axes, fall: ProbableFall, style: Style) -> None:
    """Draw the least action of each number of disturbed strides."""
    ax.plot(np.arange(1, len(fall.actions) + 1), fall.actions, "-o", color=BASINS[0], ms=4, lw=1)
    ax.axhline(fall.action, color=OTHERS, lw=0.8, ls=":")
    count_axis(ax)
    ax.set(ylim=(0, 1.1 * np.nanmax(fall.actions[np.isfinite(fall.actions)])))
    finish(ax, style, "Action", x="disturbed strides", y="least action")


def draw_path(ax: Axes, fall: ProbableFall, style: Style) -> None:
    """Draw states just after heel strike; open circles come after the last disturbance."""
    theta, thetadot = fall.states[:, [0, 2]].T
    places = np.stack([theta, theta + thetadot])
    number = np.arange(len(fall.states))
    first, last, disturbed = number == 0, number == number[-1], number <= len(fall.disturbances)
    blue: dict[str, Any] = {"marker": "o", "ms": 5, "color": BASINS[0]}
    signs: list[tuple[str, np.ndarray, dict[str, Any]]] = [
        ("disturbed", disturbed & ~first & ~last, blue),
        ("on even ground", ~disturbed & ~last, blue | {"mfc": "white"}),
        ("gait", first, {"marker": "*", "ms": 14, "color": INK, "mec": "white"}),
        ("before the fall", last, {"marker": "X", "ms": 9, "color": BASINS[1]}),
    ]
    ax.plot(*places, color=BASINS[0], lw=0.8)
    for label, some, look in signs:
        if some.any():
            ax.plot(*places[:, some], ls="", zorder=3, label=label, **look)
    ax.locator_params(axis="x", nbins=6)
    finish(ax, style, "States just after heel strike", x="theta", y="sum")


def draw_law(ax: Axes, fall: ProbableFall, style: Style) -> None:
    """Draw mean strides to a fall over action / scale^2, and the law without its prefactor."""
    exponent = np.linspace(ROUGHEST, np.log(LONGEST), 60)
    scales = np.sqrt(fall.action / exponent)
    means = np.array([fall.mean_strides(one) for one in scales.tolist()])
    shown = means <= LONGEST
    rare, law = exponent[shown], np.exp(exponent[shown])
    ax.semilogy(rare, means[shown], color=BASINS[0], label="mean strides to a fall")
    ax.semilogy(rare, law, "--", lw=1, color=OTHERS, label="exp(action / scale$^2$)")
    above = ax.secondary_xaxis("top")
    ticks = exponent[:: len(exponent) // 4]
    above.set_xticks(ticks, [f"{np.sqrt(fall.action / one):.2g}" for one in ticks])
    above.set_xlabel("scale of the deviations" * style.get("labels", True))
    finish(ax, style, "Law", x="action / scale$^2$", y="mean strides to a fall")


def metastability(data: xr.Dataset, ax: Axes | None = None, **style: Unpack[Style]) -> DrawnAxes:
    """Draw the quasi-stationary distribution of `walker_jax.steps_to_fall` by cells.

    That is where walks that still last are on the section. The axes are theta and theta + thetadot,
    as for basins; on rough ground the third direction is summed over. Colours show chance on a
    logarithmic scale.
    """
    ax = begin(ax, style, data, "metastable walking", 6.4, 5.2)
    edges, chance = data["edges"].values, data["chance"].values
    seen = chance > FAINTEST * chance.max()
    shares = (np.arange(PARTS) + 0.5) / PARTS - 0.5
    parts = np.stack(np.meshgrid(*[shares] * len(edges)), axis=-1).reshape(-1, len(edges)) @ edges
    points, x, y = np.concatenate(data["centre"].values[seen][:, None] + parts), "theta", "sum"
    names = data["direction"].values.tolist()
    theta, both = (along_axis(points, names, axis) for axis in (x, y))
    weights = np.repeat(chance[seen] / len(parts), len(parts))
    sums, *places = np.histogram2d(theta, both, PIXELS, weights=weights)
    least = FAINTEST * sums.max()
    look: Any = {"norm": LogNorm(least, sums.max()), "cmap": "viridis_r", "rasterized": True}
    image = ax.pcolormesh(*places, np.ma.masked_less(sums.T, least), **look)
    mean, error = float(data["mean_strides"]), 1.96 * float(data["mean_strides_error"])
    number = with_error(mean, error) if mean < 1e6 else f"{mean:.3g} ± {error:.2g}"
    note, bar = f"a fall after {number} strides on average", (image, "chance of each pixel")
    return finish(ax, style, walker_title(data), note, x=x, y=y, bar=bar)


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
    """
    check_kind("found", found, Transients)
    if len(found.section) < 2:
        raise WrongUse(f"found must have two coordinates, not {', '.join(found.section)}")
    ax = axes_for(ax, style, 7, 5.6)
    x, y = found.section[:2]
    y = "sum" if (x, y) == ("theta", "thetadot") else y
    place = lambda states: [along_axis(np.asarray(states), found.section, one) for one in (x, y)]
    ways = place(found.escapes[:ROUTES, -STRIDES:].swapaxes(0, 1))
    for line in ax.plot(*ways, "-o", color=OTHERS, lw=0.6, ms=2.5, zorder=1)[:1]:
        line.set_label("on the way to a failure")
    shown = [("saddle", found.saddle, BASINS[1])]
    shown += [] if attractor is None else [("attractor before the crisis", attractor, BASINS[2])]
    for order, (label, states, colour) in enumerate(shown, start=2):
        ax.plot(*place(states), ".", color=colour, zorder=order, ms=2.5, mew=0)
        ax.plot([], [], "o", color=colour, ms=5, label=label)
    if gait is not None:
        look: Any = {"mfc": "white", "mec": INK, "mew": 1.2, "ms": 6, "zorder": 5}
        label = f"gait of period {len(gait.states)}"
        ax.plot(*place(gait.states), "o", label=label, **look)
    across, up = widened(np.quantile(place(found.saddle), [0.001, 0.999], axis=1).T, AROUND)
    ax.set(xlim=across, ylim=up)
    exponents = ", ".join(f"{one:.3f}" for one in found.exponents)
    ends = f"exponents {exponents}; dimension {found.dimension:.2f}"
    note = f"mean life {found.mean_life:.1f}; {ends}"
    return finish(ax, style, "Chaotic saddle", note, x=x, y=y)


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
    ax.plot(ends, line(law.exponent), color=BASINS[0], label=fitted)
    for i, (name, exponent) in enumerate((predicted or {}).items()):
        look = {"color": BASINS[1], "lw": 1.1, "ls": DASHES[i % len(DASHES)]}
        ax.plot(ends, line(exponent), label=f"{name}: {exponent:.2f}", **look)
    for name, value in (openings or {}).items():
        ax.axvline(value - law.crisis, color=OTHERS, lw=0.9, ls=":", zorder=1)
        words = f" {name} " * style.get("labels", True)
        ax.text(value - law.crisis, ax.get_ylim()[1], words, rotation=90, va="top", ha="right")
    note = f"crisis at {law.crisis:.8g}; chi² per degree of freedom {law.misfit:.1f}"
    x, y = f"distance from {law.crisis:.8g}", "mean life (strides)"
    return finish(ax, style, "Mean life beyond the crisis", note, x=x, y=y)

"""Pictures of the boundary between fates and attractors."""

from typing import Any, Unpack

import numpy as np
import xarray as xr
from matplotlib.axes import Axes

from walker_jax.basins.cell_classes import large_basins
from walker_jax.checks import WrongUse
from walker_jax.figures.layout import DrawnAxes, Style, axes_for, finish
from walker_jax.figures.regions import (
    extent_of,
    paint,
    patch_of,
    place_states,
    regions_of,
    show_image,
)
from walker_jax.figures.style import BASINS, INK
from walker_jax.figures.text import walker_title
from walker_jax.stability.boundaries import region_name
from walker_jax.storage.schema import check_dataset
from walker_jax.systems.outcomes import outcome_in_words

CURVES = ("#e4572e", "#17a398", "#f2c14e")
"""Colours of stable manifolds, unlike those of regions."""
ENDS = {
    "backward": "leads to the stance leg at rest upright",
    "forward": "leads to a foot that grazes the ground",
    "running": "leads to a contact force of zero",
    "stopping": "leads to a foot that just lifts",
    "landing": "leads to a bent leg's foot that grazes the ground",
    "buckling": "leads to a knee that is not pressed on its stop",
    "scuffing": "leads to a bent leg's foot that scuffs",
    "sideways": "leads to a lean at its limit",
    "outside": "leads to the edge of feasible starts",
    "": "comes to no cycle",
}
"""Words for an edge state that is no saddle, but for those that lead to a system's own failure."""


def boundary(data: xr.Dataset, ax: Axes | None = None, **style: Unpack[Style]) -> DrawnAxes:
    """Draw the basin, the saddles on its boundary, and their stable manifolds.

    **Arguments:**

    - `data`: what `walker_jax.boundary` returns, over two dimensions.
    - `ax`: where to draw; by default, on a new figure of 7 by 6.2 inches.
    - `style`: which words to draw, as in `Style`.

    **Returns** the axes. Raises `ValueError` for another data set.
    """
    check_dataset(data, "boundary")
    fate = data["fate"]
    if fate.ndim != 2 or min(fate.shape) < 2:
        raise WrongUse(f"data must have a fate over 2 x 2 cells or more, not {dict(fate.sizes)}")
    ax = axes_for(ax, style, 7, 6.2)
    x, y = map(str, fate.dims)
    extent = extent_of(data, x, y)
    regions = regions_of(data, large_basins(data, len(BASINS)))
    show_image(ax, paint(regions, fate.shape), extent)
    marks = []
    seen: dict[bytes, str] = {}
    for i in range(data.sizes["edge"]):
        one = data.isel(edge=i)
        sides = zip(one["edge_fates"].values, one["edge_attractors"].values, strict=True)
        pair = " / ".join(outcome_in_words(region_name(data, *map(int, side))) for side in sides)
        colour = CURVES[len(seen) % len(CURVES)]
        states = one["edge_saddle"].values
        states = states[np.isfinite(states).all(axis=1)]
        known = np.sort(states.round(8), axis=0).tobytes()
        if len(states) and known in seen:
            marks += ax.plot([], [], "o", color=seen[known], mec=INK, label=f"{pair}: the same")
            continue
        look: dict[str, Any] = {"color": colour, "mec": INK, "mew": 0.8, "ls": "", "zorder": 4}
        if len(states):
            seen[known] = colour
            for curve in one["stable_manifold"].values:
                points = place_states(data, curve, (x, y))
                ax.plot(*points.T, "-", color=colour, lw=1.4, zorder=3)
            label = f"{pair}: {saddle_phrase(one)}"
            marks += ax.plot(*place_states(data, states, (x, y)).T, "o", label=label, **look)
        else:
            path = one["edge_path"].values
            path = path[np.isfinite(path).all(axis=1)]
            kind = str(one["edge_kind"].values)
            label = f"{pair}: {ENDS.get(kind, f'leads to {outcome_in_words(kind)}')}"
            look |= {"color": "white"}
            marks += ax.plot(*place_states(data, path[-1:], (x, y)).T, "D", label=label, **look)
    ax.set(xlim=extent[:2], ylim=extent[2:])
    return finish(
        ax,
        style,
        title=walker_title(data),
        note=entropy_phrase(data),
        x=x,
        y=y,
        legend=[*marks, *map(patch_of, regions)],
    )


def saddle_phrase(one: xr.Dataset) -> str:
    """Describe a saddle with its multipliers."""
    period = int(one["edge_period"])
    values = one["edge_multipliers"].values
    numbers = [complex(*value) for value in values[np.isfinite(values).all(axis=1)]]
    words = ", ".join(f"{value.real:.3g}" for value in numbers)
    return f"saddle of period {period}, multipliers {words}"


def entropy_phrase(data: xr.Dataset) -> str:
    """State the entropies of a basin, and whether its boundary is fractal."""
    value, error = float(data["boundary_entropy"]), float(data["boundary_entropy_error"])
    fractal = "fractal" if data["boundary_fractal"] else "no sign of a fractal"
    value_phrase = f"of the boundary {value:.3f} ± {error:.3f} ({fractal})"
    first = f"basin entropy {float(data['basin_entropy']):.4f}, {value_phrase};"
    return f"{first}\ncurves are stable manifolds of the saddles"

"""Pictures of the boundary between fates and attractors."""

from typing import Any, Unpack

import numpy as np
import xarray as xr
from matplotlib.axes import Axes

from walker_jax.figures import regions
from walker_jax.figures.basin_maps import check_plane
from walker_jax.figures.layout import DrawnAxes, Style, begin, finish
from walker_jax.figures.style import INK
from walker_jax.figures.text import walker_title
from walker_jax.stability.boundaries import region_name
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
    """Draw what `walker_jax.boundary` returns: the basin, and the saddles on its boundary.

    Curves are the stable manifolds of the saddles.
    """
    ax = begin(ax, style, data, "boundary", 7, 6.2)
    check_plane(data["fate"])
    (x, y), found = regions.axes_of(data), regions.draw_regions(ax, data)
    seen: dict[bytes, str] = {}
    for i in range(data.sizes["edge"]):
        one = data.isel(edge=i)
        sides = zip(one["edge_fates"].values, one["edge_attractors"].values, strict=True)
        pair = " / ".join(outcome_in_words(region_name(data, *map(int, side))) for side in sides)
        states = finite_rows(one["edge_saddle"].values)
        known = np.sort(states.round(8), axis=0).tobytes()
        colour, sign = CURVES[len(seen) % len(CURVES)], "o"
        if len(states) and known in seen:
            colour, states, words = seen[known], states[:0], "the same"
        elif len(states):
            seen[known] = colour
            for curve in one["stable_manifold"].values:
                ax.plot(*regions.place_states(data, curve).T, color=colour, lw=1.4, zorder=3)
            values = finite_rows(one["edge_multipliers"].values)
            words = f"saddle of period {int(one['edge_period'])}, multipliers "
            words += ", ".join(f"{real:.3g}" for real, _ in values)
        else:
            states = finite_rows(one["edge_path"].values)[-1:]
            kind = str(one["edge_kind"].values)
            words = ENDS.get(kind, f"leads to {outcome_in_words(kind)}")
            colour, sign = "white", "D"
        look: Any = {"label": f"{pair}: {words}", "mec": INK, "mew": 0.8, "ls": "", "zorder": 4}
        ax.plot(*regions.place_states(data, states).T, sign, color=colour, **look)
    value, error = float(data["boundary_entropy"]), float(data["boundary_entropy_error"])
    fractal = "fractal" if data["boundary_fractal"] else "no sign of a fractal"
    note = f"basin entropy {float(data['basin_entropy']):.4f}, of the boundary {value:.3f} ± "
    note += f"{error:.3f} ({fractal});\ncurves are stable manifolds of the saddles"
    patches = map(regions.patch_of, found)
    return finish(ax, style, walker_title(data), note, x=x, y=y, legend=patches)


def finite_rows(states: np.ndarray) -> np.ndarray:
    """Return the states that are known."""
    return states[np.isfinite(states).all(axis=1)]

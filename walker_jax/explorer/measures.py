"""Measures that take longer than a picture: gaits, area, least disturbance, bifurcations, data.

A worker computes them in a process of its own (`workers`). Answers are JSON values, or bytes.
"""

import io
import math
import tempfile
import zipfile
from collections.abc import Generator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from walker_jax.basins.attracting_gaits import is_same_cycle
from walker_jax.basins.computation import basin
from walker_jax.basins.refinement import refine
from walker_jax.explorer.lattice import Rectangle, home_of
from walker_jax.explorer.offers import window_of
from walker_jax.explorer.pictures import find_attractors, plane_of
from walker_jax.explorer.subjects import Subject
from walker_jax.gaits.branch_search import grow_branches
from walker_jax.gaits.branches import Branch, float64_tolerance
from walker_jax.gaits.cycles import Gait
from walker_jax.gaits.diagrams import complete_diagram
from walker_jax.gaits.search import find_gaits, search_gait
from walker_jax.grids import Grid
from walker_jax.stability.disturbances import least_disturbance
from walker_jax.systems.angles import turns_of
from walker_jax.systems.system import has_gait_region

PERIODS = (1, 2)
"""Periods for which all gaits are sought."""
SEARCHES = 2000
"""Number of searches for gaits in the window of a system without a `gait_region`."""
AREA_LEVELS, AREA_CHECKS = 2, 50_000
"""Levels and checks of `refine` for an area: 2 s, and a standard error of 0.1 % of the basin."""
PERIOD_MAX = 4
"""Longest period of the branches of a diagram on the page."""
DIAGRAM: dict[str, Any] = {"strides": 600, "scan": 160, "exponents": 0, "normal_forms": False}
"""Settings for the attractors of such a diagram."""
SHOWN_STATES = 24
"""Number of states of each orbit in a diagram."""


def gaits(subject: Subject) -> list[dict]:
    """Find the gaits of periods one and two, the most stable gait of each period first.

    If none of them is stable, the gaits of the attractors are added.
    """
    walker, region = subject.walker, region_of(subject)
    found = [
        gait for period in PERIODS for gait in find_gaits(walker, period, region, progress=False)
    ]
    main = main_gait(subject)
    if main is not None and not any(is_same_cycle(one, main, turns_of(walker)) for one in found):
        found.append(main)
    if not any(gait.stable for gait in found):
        cycles = [one.states for one in find_attractors(subject).mapper.attractors if one.period]
        longer = [search_gait(walker, states, len(states)) for states in cycles]
        found += [gait for gait in longer if gait.found]
    found.sort(key=lambda gait: (len(gait.states), abs(complex(gait.multipliers[0]))))
    return list(map(describe_gait, found))


def main_gait(subject: Subject) -> Gait | None:
    """Find the default gait of period one; without a `gait_region`, the window's most stable gait.

    The result is None if there is no such gait.
    """
    region = region_of(subject)
    if region is None:
        gait = search_gait(subject.walker)
        return gait if gait.found else None
    found = find_gaits(subject.walker, 1, region, progress=False)
    return min(found, key=lambda gait: abs(complex(gait.multipliers[0])), default=None)


def region_of(subject: Subject) -> Grid | None:
    """Return the window as the region of searches, or None for a system with a `gait_region`."""
    if has_gait_region(subject.walker):
        return None
    window = window_of(subject.offer)
    count = round(SEARCHES ** (1 / len(window)))
    return Grid.plain(**{name: (*ends, count) for name, ends in window.items()})


def describe_gait(gait: Gait) -> dict:
    """Describe a gait for the page; each multiplier is a pair, its real and its imaginary part."""
    return {
        "period": len(gait.states),
        "states": np.asarray(gait.states).tolist(),
        "multipliers": [[one.real, one.imag] for one in np.asarray(gait.multipliers).tolist()],
        "times": np.asarray(gait.step_times).tolist(),
        "stable": bool(gait.stable),
    }


def area(subject: Subject, cells: Rectangle) -> dict:
    """Compute the area of the basins in a rectangle, and its standard error, by `refine`."""
    grid = grid_of(subject, cells)
    found = refine(subject.walker, grid, AREA_LEVELS, check=AREA_CHECKS, progress=False)
    return {
        "area": float(found["total_area"]),
        "error": finite(float(found["total_area_error"])),
    }


def disturbance(subject: Subject) -> dict | None:
    """Find the least disturbance of the stable gait of period one; None without such a gait."""
    gait = main_gait(subject)
    if gait is None or not gait.stable:
        return None
    found = least_disturbance(subject.walker, gait, progress=False)
    return {
        "size": found.size,
        "gait": (found.state - found.size * found.direction).tolist(),
        "state": found.state.tolist(),
        "failure": int(found.failure),
        "strides": found.strides,
    }


def bifurcation(subject: Subject, over: str) -> Generator[dict, None, dict]:
    """Compute gaits and attractors over a parameter, by the first coordinate at a stride's start.

    Yield the branches of gaits as they are found; return the whole diagram, with attractors.
    """
    walker, ends = subject.walker, subject.offer.spans[over]
    how: Any = {"tolerance": float64_tolerance(None)}
    found, shown = ([], []), 0
    for found in grow_branches(walker, over, ends, PERIOD_MAX, **how):
        if len(found[0]) > shown:
            shown = len(found[0])
            yield describe_branches(ends, found[0])
    data = complete_diagram(walker, over, ends, *found, **DIAGRAM, **how)
    return describe_branches(ends, found[0]) | describe_attractors(data)


def describe_branches(ends: tuple[float, float], branches: Sequence[Branch]) -> dict:
    """Describe a diagram that has only branches of gaits."""
    return {
        "range": ends,
        "whole": False,
        "branches": [
            {
                "period": one.period,
                "value": one.values.tolist(),
                "state": one.states[:, :, 0].T.tolist(),
                "stable": one.stable.astype(int).tolist(),
            }
            for one in branches
        ],
        "points": [],
        "lost": [],
        "events": [],
    }


def describe_attractors(data: xr.Dataset) -> dict:
    """Describe the rest of a diagram: bifurcations, attractors, and where walking is lost."""
    orbit = data["orbit"].values[:, :, :SHOWN_STATES, 0]
    where = np.isfinite(orbit)
    at = np.broadcast_to(data["sample_value"].values[:, None, None], orbit.shape)[where]
    points = np.unique(np.round(np.stack([at, orbit[where]], axis=1), 6), axis=0)
    return {
        "whole": True,
        "points": points.tolist(),
        "lost": [finite(value) for value in data["lost"].values.tolist()],
        "events": [
            {
                "value": float(one["event_value"]),
                "state": float(one["event_states"][0, 0]),
                "fold": bool(one["event_fold"]),
                "cascade": bool(one["cascade"]),
            }
            for one in (data.isel(event=i) for i in range(data.sizes["event"]))
        ],
    }


def finite(value: float) -> float | None:
    """Return the number; None for NaN and infinities, which JSON lacks."""
    return value if math.isfinite(value) else None


def data(subject: Subject, cells: Rectangle, method: str) -> bytes:
    """Compute the data set of a rectangle by `wj.basin`: a Zarr store in a zip archive."""
    found = basin(subject.walker, grid_of(subject, cells), method, progress=False)
    return zipped(found)


def zipped(found: xr.Dataset) -> bytes:
    """Pack a data set as a Zarr store in a zip archive, which `xarray.open_zarr` reads directly."""
    packed = io.BytesIO()
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder) / "basin.zarr"
        found.to_zarr(place, consolidated=False)
        with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
            for file in sorted(place.rglob("*")):
                if file.is_file():
                    archive.write(file, file.relative_to(place))
    return packed.getvalue()


def grid_of(subject: Subject, cells: Rectangle) -> Grid:
    """Return the grid of a rectangle of cells."""
    home = home_of(subject.offer, subject.section)
    return home.grid(subject, cells, plane_of(subject))

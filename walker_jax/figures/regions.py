"""Regions of a basin as colours: which are shown, and how they are called."""

from typing import NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Bool, Int8, UInt8
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb

from walker_jax.basins.schema import artefacts
from walker_jax.figures.style import (
    ARTEFACTS,
    ASTRAY,
    BASINS,
    FAILURES,
    NOTABLE,
    OTHERS,
    SYMBOLS,
)
from walker_jax.walking.outcomes import Outcome


class Region(NamedTuple):
    """Cells that share a colour."""

    cells: Bool[np.ndarray, "*shape"]
    colour: str
    letter: str
    """The first line of its label; empty where it has only one."""
    words: str
    """The other line."""
    counted: bool = False
    """Whether the legend tells how many cells there are even where the label has room."""


def slices_of(data: xr.Dataset) -> str:
    """What to do with a basin of three dimensions where one of two is drawn."""
    dimensions = data["fate"].dims if "fate" in data and "number" in data.dims else ()
    others = [name for name in dimensions if name not in ("theta", "thetadot", "sum")]
    if len(dimensions) != 3 or len(others) != 1:
        return ""
    return f": take a slice, data.isel({others[0]}=0), or draw several, basin_slices(data)"


def notable_attractors(data: xr.Dataset) -> list[int]:
    """Numbers of the attractors whose basins are drawn each in a colour, the largest first."""
    walks = data["fate"].values == Outcome.STRIDE
    numbers, cells = np.unique(data["attractor"].values[walks], return_counts=True)
    real = np.isin(numbers, np.flatnonzero(~artefacts(data)))
    large = real & (cells >= NOTABLE * walks.sum())
    order = np.argsort(-cells[large], kind="stable")[: len(BASINS)]
    return numbers[large][order].tolist()


def regions_of(data: xr.Dataset, notable: list[int]) -> list[Region]:
    """The regions that there are in a data set: basins, what else walks on, and failures."""
    fate, attractor = data["fate"].values, data["attractor"].values
    walks = fate == Outcome.STRIDE
    found = []
    for number, colour in zip(notable, BASINS, strict=False):
        period = int(data["period"].sel(number=number))
        kind = f"basin of period {period}" if period else "basin without a period"
        words = "basin of attraction" if len(notable) == 1 else kind
        found.append(Region(walks & (attractor == number), colour, "A", words))
    known = attractor >= 0
    made_up = walks & np.isin(attractor, np.flatnonzero(artefacts(data)))
    others = walks & known & ~made_up & ~np.isin(attractor, notable)
    found.append(Region(others, OTHERS, "", "other attractors", counted=True))
    found.append(Region(made_up, ARTEFACTS, "", "artefacts of cells", counted=True))
    found.append(Region(walks & ~known, ASTRAY, "", "walks on, near no attractor", counted=True))
    return [region for region in (*found, *failures(fate)) if region.cells.any()]


def failures(fate: Int8[np.ndarray, "*shape"]) -> list[Region]:
    """The regions of all failures, whether there are any or not."""
    return [
        Region(fate == outcome, colour, letter, words, counted=outcome == Outcome.UNDECIDED)
        for outcome, (colour, letter, words) in FAILURES.items()
    ]


def painted(regions: list[Region], shape: tuple[int, ...]) -> UInt8[np.ndarray, "*shape 3"]:
    """Every cell in the colour of its region."""
    image = np.zeros((*shape, 3), np.uint8)
    for region in regions:
        image[region.cells] = np.round(np.multiply(to_rgb(region.colour), 255))
    return image


def show(
    ax: Axes, image: UInt8[np.ndarray, "nx ny 3"], extent: tuple[float, float, float, float]
) -> None:
    """An image of cells, the first axis along x."""
    ax.imshow(
        image.swapaxes(0, 1),
        origin="lower",
        extent=extent,
        aspect="auto",
        interpolation="auto",
        rasterized=True,
    )


def attractor_name(period: int, cycle: xr.DataArray) -> str:
    """What the legend says of an attractor: its period, and up to two of its states."""
    names = [SYMBOLS.get(name, str(name)) for name in cycle["coordinate"].values.tolist()]
    states = [", ".join(f"{value:.4f}" for value in state) for state in cycle.values.tolist()]
    shown = ", ".join(f"({state})" for state in states[:2]).replace("-", "−")
    more = ", …" if len(states) > 2 else ""
    kind = {0: "a state of the attractor", 1: "attractor"}.get(
        period, f"attractor of period {period}"
    )
    return f"{kind}: ({', '.join(names)}) = {shown}{more}"


def entry(region: Region, share: int) -> str:
    """What the legend says of a region, of whose cells one in so many is drawn."""
    count = int(region.cells.sum()) * share
    about = "about " * (share > 1)
    return f"{region.words} ({about}{count:,} cell{'s' * (count > 1)})"

"""Regions of a grid in their colours: basins, failures, and their names in the legend."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Bool, Float, Int, UInt8
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from walker_jax.basins.cell_classes import CellClass, along_axis, failing_cells, walking_cells
from walker_jax.figures.layout import cell_edges
from walker_jax.figures.style import (
    ARTEFACTS,
    BASINS,
    FAILURES,
    INK,
    OTHERS,
    UNMATCHED,
    failure_words,
)
from walker_jax.figures.text import SYMBOLS
from walker_jax.systems.outcomes import Outcome, failures_of, names_in

Extent = tuple[float, float, float, float]
BASIN, UNMATCHED_WORDS = "basin of attraction", "converges to no known attractor"


class Region(NamedTuple):
    """A class of cells, and how it is drawn."""

    of: CellClass
    colour: str
    letter: str
    """First line of its label; empty if it has only one."""
    words: str
    """The other line."""
    counted: bool = False
    """Whether the legend counts its cells even where the label has room."""

    @property
    def cells(self) -> Bool[np.ndarray, "*shape"]:
        """Whether each cell is in the region."""
        return self.of.cells


def regions_of(data: xr.Dataset, large: list[int]) -> list[Region]:
    """Return the nonempty regions of a data set, with one for each large basin."""
    walking = walking_cells(data, large)
    found = []
    for (number, cells), colour in zip(walking.large.items(), BASINS, strict=False):
        period = int(data["period"].sel(number=number))
        kind = f"basin of period {period}" if period else "basin without a period"
        found.append(Region(cells, colour, "A", BASIN if len(large) == 1 else kind))
    found += [
        Region(walking.others, OTHERS, "", "other attractors", counted=True),
        Region(walking.artefacts, ARTEFACTS, "", "artefacts of cell mapping", counted=True),
        Region(walking.unmatched, UNMATCHED, "", UNMATCHED_WORDS, counted=True),
    ]
    return with_failures(found, data["fate"].values, failures_of(data))


def regions_of_one_basin(data: xr.Dataset) -> list[Region]:
    """Return the nonempty regions of a data set if all of its basins have one colour."""
    fate = data["fate"].values
    walks, known = fate == Outcome.STRIDE, data["attractor"].values >= 0
    return with_one_basin(fate, walks & known, walks & ~known, failures_of(data))


def with_one_basin(
    fate: Int[np.ndarray, "*shape"],
    basin: Bool[np.ndarray, "*shape"],
    unmatched: Bool[np.ndarray, "*shape"],
    failures: Sequence[str],
) -> list[Region]:
    """Return the nonempty regions: failures, the basin, and walkers that converge elsewhere."""
    found = [
        Region(CellClass(basin), BASINS[0], "A", BASIN),
        Region(CellClass(unmatched), UNMATCHED, "", UNMATCHED_WORDS),
    ]
    return with_failures(found, fate, failures)


def with_failures(
    regions: list[Region], fate: Int[np.ndarray, "*shape"], failures: Sequence[str]
) -> list[Region]:
    """Add the regions of failures, and drop empty regions."""
    cells = failing_cells(fate)
    failing = [
        Region(cells[one], colour, letter, failure_words(one, failures), one == Outcome.UNDECIDED)
        for one, (colour, letter, _) in FAILURES.items()
        if one in cells
    ]
    return [region for region in (*regions, *failing) if region.cells.any()]


def paint(regions: list[Region], shape: tuple[int, ...]) -> UInt8[np.ndarray, "*shape 3"]:
    """Paint every cell in the colour of its region."""
    image = np.zeros((*shape, 3), np.uint8)
    for region in regions:
        image[region.cells] = np.round(np.multiply(to_rgb(region.colour), 255))
    return image


def extent_of(data: xr.Dataset, x: str, y: str) -> Extent:
    """Return the edges of a grid: left, right, low and high."""
    return (*cell_edges(data[x].values), *cell_edges(data[y].values))


def show_image(ax: Axes, image: UInt8[np.ndarray, "nx ny 3"], extent: Extent) -> None:
    """Draw an image of cells, the first axis along x."""
    ax.imshow(
        image.swapaxes(0, 1),
        origin="lower",
        extent=extent,
        aspect="auto",
        interpolation="auto",
        rasterized=True,
    )


def place_states(
    data: xr.Dataset, states: Float[np.ndarray, "n section"], axes: tuple[str, ...]
) -> Float[np.ndarray, "n axes"]:
    """Return the places of states on a picture with these axes."""
    section = names_in(data, "section")
    offsets = states - np.asarray(data.attrs.get("origin", 0.0))
    return np.stack([along_axis(offsets, section, axis) for axis in axes], axis=-1)


def cycle_of(data: xr.Dataset, number: int) -> Float[np.ndarray, "n section"]:
    """Return the states of an attractor."""
    return data["states"].sel(number=number).dropna("phase").values


WRITTEN_COORDINATES = 3
"""Most coordinates of a state that a legend has room for."""


def attractor_name(data: xr.Dataset, period: int, cycle: Float[np.ndarray, "n section"]) -> str:
    """Name an attractor in the legend: its period, and up to two of its states."""
    names = [SYMBOLS.get(name, name) for name in names_in(data, "section")]
    states = [", ".join(f"{value:.4f}" for value in state) for state in cycle.tolist()]
    shown = ", ".join(f"({state})" for state in states[:2]).replace("-", "−")
    more = ", …" if len(states) > 2 else ""
    kind = {0: "a state of the attractor", 1: "attractor"}.get(
        period, f"attractor of period {period}"
    )
    if len(names) > WRITTEN_COORDINATES:
        return kind
    return f"{kind}: ({', '.join(names)}) = {shown}{more}"


def attractor_mark(
    ax: Axes, dots: Float[np.ndarray, "n 2"], marker: str, label: str = ""
) -> Line2D:
    """Draw the states of an attractor."""
    style = {"color": INK, "mec": "white", "mew": 1.2, "ms": 7.5, "zorder": 5}
    return ax.plot(*dots.T, marker, ls="", label=label, **style)[0]


def patch_of(region: Region, label: str = "") -> Patch:
    """Return the sign of a region in a legend."""
    return Patch(fc=region.colour, ec=INK, lw=0.5, label=label or region.words)


def counted_patch(region: Region, share: int) -> Patch:
    """Return the sign of a region with its number of cells, one in `share` of which is given."""
    count = region.of.count * share
    about = "about " * (share > 1)
    return patch_of(region, f"{region.words} ({about}{count:,} cell{'s' * (count > 1)})")

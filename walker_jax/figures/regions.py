"""Regions of a grid in their colours: basins, failures, their letters, and their names."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Bool, Float, Int, UInt8
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.patches import Patch

from walker_jax.basins.cell_classes import along_axis, failing_cells, large_basins, walking_cells
from walker_jax.figures.layout import cell_edges, figure_of, width_of
from walker_jax.figures.style import (
    ARTEFACTS,
    BASINS,
    FAILURES,
    INK,
    LARGE,
    OTHERS,
    SMALL,
    UNMATCHED,
    failure_words,
    points_of,
)
from walker_jax.figures.text import NO_BREAK, SYMBOLS
from walker_jax.systems.outcomes import Outcome, failures_of, names_in

Extent = tuple[float, float, float, float]
BASIN, UNMATCHED_WORDS = "basin of attraction", "converges to no known attractor"


class Region(NamedTuple):
    """A class of cells, and how it is drawn."""

    cells: Bool[np.ndarray, "*shape"]
    """Whether each cell is in the region."""
    colour: str
    letter: str
    """First line of its label; empty if it has only one."""
    words: str
    """The other line."""
    counted: bool = False
    """Whether the legend counts its cells even where the label has room."""


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


def with_one_basin(
    fate: Int[np.ndarray, "*shape"],
    basin: Bool[np.ndarray, "*shape"],
    failures: Sequence[str],
) -> list[Region]:
    """Return the nonempty regions: the basin, walkers that converge elsewhere, and failures."""
    found = [
        Region(basin, BASINS[0], "A", BASIN),
        Region((fate == Outcome.STRIDE) & ~basin, UNMATCHED, "", UNMATCHED_WORDS),
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


def draw_regions(
    ax: Axes, data: xr.Dataset, large: list[int] | None = None
) -> tuple[list[Region], Extent]:
    """Draw the regions of a data set over two dimensions, by default with its largest basins.

    Returns them, and the edges of the grid.
    """
    large = large_basins(data, len(BASINS)) if large is None else large
    found = regions_of(data, large)
    extent = extent_of(data, *map(str, data["fate"].dims))
    show_image(ax, paint(found, data["fate"].shape), extent)
    return found, extent


def extent_of(data: xr.Dataset, x: str, y: str) -> Extent:
    """Return the edges of a grid: left, right, low and high."""
    return (*cell_edges(data[x].values), *cell_edges(data[y].values))


def show_image(ax: Axes, image: np.ndarray, extent: Extent, **look: Any) -> None:
    """Draw an image of cells, the first axis along x."""
    look = {"interpolation": "auto", "rasterized": True} | look
    ax.imshow(image.swapaxes(0, 1), origin="lower", extent=extent, aspect="auto", **look)


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
    kind = {0: "a state of the attractor", 1: "attractor"}
    words = kind.get(period, f"attractor of period {period}")
    names = [SYMBOLS.get(name, name) for name in names_in(data, "section")]
    if len(names) > WRITTEN_COORDINATES:
        return words
    states = [f",{NO_BREAK}".join(f"{value:.4f}" for value in state) for state in cycle.tolist()]
    shown = ", ".join(f"({state})" for state in states[:2]).replace("-", "−")
    return f"{words}: ({', '.join(names)}) = {shown}{', …' * (len(states) > 2)}"


def mark_attractor(ax: Axes, dots: Float[np.ndarray, "n 2"], marker: str, label: str = "") -> None:
    """Draw the states of an attractor."""
    style = {"color": INK, "mec": "white", "mew": 1.2, "ms": 7.5, "zorder": 5}
    ax.plot(*dots.T, marker, ls="", label=label, **style)


def patch_of(region: Region, label: str = "") -> Patch:
    """Return the sign of a region in a legend."""
    return Patch(fc=region.colour, ec=INK, lw=0.5, label=label or region.words)


def counted_patch(region: Region, share: int) -> Patch:
    """Return the sign of a region with its number of cells, one in `share` of which is given."""
    count = int(np.count_nonzero(region.cells)) * share
    about = "about " * (share > 1)
    return patch_of(region, f"{region.words} ({about}{count:,}{NO_BREAK}cell{'s' * (count > 1)})")


def draw_label(ax: Axes, region: Region, free: Bool[np.ndarray, "nx ny"], extent: Extent) -> bool:
    """Write letter and words of a region where it is widest, or the letter alone, as there is room.

    `free` marks where labels may stand. Returns whether there was room for the words.
    """
    cells = region.cells & free
    cells = cells[tuple(slice(None, None, -(-n // 400)) for n in cells.shape)]
    size = np.multiply(
        ax.bbox.size, 0.8 * 72 / figure_of(ax).dpi
    )  # the rest is for title and legend
    low, high = np.array(extent[::2]), np.array(extent[1::2])
    red, green, blue = to_rgb(region.colour)
    dark = 0.3 * red + 0.59 * green + 0.11 * blue < 0.5
    look: Any = {"ha": "center", "color": "white" if dark else INK, "clip_on": True}
    letter, words = (region.letter, LARGE, "bold"), (region.words, SMALL, "normal")
    for lines in ([letter, words], [letter]) if region.letter else ([words],):
        wide = 72 * max(width_of(*line) for line in lines)
        tall = sum(1.2 * points_of(font) for _, font, _ in lines)
        # The ellipse within the box of the words fits where its centre is deeper than 1.
        depth = depths(cells, 2 * size / np.array((wide, tall)) / cells.shape)
        if depth.max() < 1:
            continue
        deepest = np.argwhere(depth == depth.max())
        place = low + (deepest[len(deepest) // 2] + 0.5) / cells.shape * (high - low)
        for (text, font, weight), side in zip(lines, ("bottom", "top"), strict=False):
            look |= {"va": side if len(lines) == 2 else "center", "size": font, "weight": weight}
            ax.annotate(text, place.tolist(), **look)
        return lines[-1] is words
    return False


def depths(
    cells: Bool[np.ndarray, "nx ny"], steps: Float[np.ndarray, "2"]
) -> Float[np.ndarray, "nx ny"]:
    """Return how far each cell is from the nearest one that is not of these, or beyond the border.

    `steps` are the sides of a cell. SciPy has this, `distance_transform_edt`, in a package that
    takes a tenth of the time of the first command to load.
    """
    inside = np.pad(cells, 1)
    columns = np.arange(inside.shape[1])
    last = np.maximum.accumulate(np.where(inside, 0, columns), axis=1)
    coming = np.minimum.accumulate(np.where(inside, len(columns), columns)[:, ::-1], axis=1)
    within_row = (np.minimum(columns - last, coming[:, ::-1] - columns) * steps[1]) ** 2
    nearest = within_row.copy()
    for rows in range(1, len(inside)):
        across = (rows * steps[0]) ** 2
        if across >= nearest.max():
            break
        there = within_row + across
        np.minimum(nearest[rows:], there[:-rows], out=nearest[rows:])
        np.minimum(nearest[:-rows], there[rows:], out=nearest[:-rows])
    return np.sqrt(nearest)[1:-1, 1:-1]


def keep_clear(
    free: Bool[np.ndarray, "nx ny"], dots: Float[np.ndarray, "n 2"], extent: Extent
) -> None:
    """Mark in `free` that no label may stand on these dots."""
    shape, low = np.array(free.shape), np.array(extent[::2])
    for dot in np.nan_to_num((dots - low) / (np.array(extent[1::2]) - low), nan=-1):
        first, last = (np.clip(dot + side * 0.03, 0, 1) * shape for side in (-1, 1))
        free[int(first[0]) : int(last[0]) + 1, int(first[1]) : int(last[1]) + 1] = False

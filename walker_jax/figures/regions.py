"""Regions of a grid in their colours: basins, failures, their letters, and their names."""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Bool, Float, Int, UInt8
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.patches import Patch

from walker_jax.basins.cell_classes import along_axis, failing_cells, large_basins, walking_cells
from walker_jax.figures import style
from walker_jax.figures.layout import LETTER, figure_of
from walker_jax.figures.style import BASINS, INK
from walker_jax.figures.text import NO_BREAK, SYMBOLS, format_number
from walker_jax.systems.outcomes import Outcome, failures_of, names_in

WRITTEN_COORDINATES = 3
"""Most coordinates of a state that a legend has room for."""
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
        Region(walking.others, style.OTHERS, "", "other attractors", counted=True),
        Region(walking.artefacts, style.ARTEFACTS, "", "artefacts of cell mapping", counted=True),
        Region(walking.unmatched, style.UNMATCHED, "", UNMATCHED_WORDS, counted=True),
    ]
    return with_failures(found, data, data["fate"].values)


def paint_one_basin(
    data: xr.Dataset, fate: Int[np.ndarray, "*shape"], basin: Bool[np.ndarray, "*shape"]
) -> tuple[list[Region], UInt8[np.ndarray, "*shape 3"]]:
    """Return the nonempty regions: a basin, walkers that converge elsewhere, failures; painted."""
    found = [
        Region(basin, BASINS[0], "A", BASIN),
        Region((fate == Outcome.STRIDE) & ~basin, style.UNMATCHED, "", UNMATCHED_WORDS),
    ]
    found = with_failures(found, data, fate)
    return found, paint(found, fate.shape)


def with_failures(
    regions: list[Region], data: xr.Dataset, fate: Int[np.ndarray, "*shape"]
) -> list[Region]:
    """Add the regions of failures, and drop empty regions."""
    cells, own = failing_cells(fate), failures_of(data)
    failing = [
        Region(cells[one], colour, letter, style.failure_words(one, own), one == Outcome.UNDECIDED)
        for one, (colour, letter) in style.SIGNS.items()
        if one in cells
    ]
    return [region for region in (*regions, *failing) if region.cells.any()]


def paint(regions: list[Region], shape: tuple[int, ...]) -> UInt8[np.ndarray, "*shape 3"]:
    """Paint every cell in the colour of its region."""
    image = np.zeros((*shape, 3), np.uint8)
    for region in regions:
        image[region.cells] = np.round(np.multiply(to_rgb(region.colour), 255))
    return image


def largest(data: xr.Dataset) -> list[int]:
    """Return the numbers of the attractors whose basins have colours of their own."""
    return large_basins(data, len(BASINS))


def draw_regions(ax: Axes, data: xr.Dataset, large: list[int] | None = None) -> list[Region]:
    """Draw the regions of a plane, by default with its largest basins, and return them."""
    found = regions_of(data, largest(data) if large is None else large)
    show_image(ax, paint(found, data["fate"].shape), data["fate"])
    return found


def cell_edges(centres: Float[np.ndarray, " n"]) -> tuple[float, float]:
    """Return the outer edges of equal cells."""
    half = (centres[-1] - centres[0]) / max(len(centres) - 1, 1) / 2 or 0.5
    return float(centres[0] - half), float(centres[-1] + half)


def show_image(ax: Axes, image: np.ndarray, cells: xr.DataArray, **look: Any) -> None:
    """Draw an image of cells, the first of their axes along x, on all of the picture's axes."""
    x, y, *_ = cells.dims
    extent = *cell_edges(cells[x].values), *cell_edges(cells[y].values)
    look = {"interpolation": "auto", "rasterized": True} | look
    ax.imshow(image.swapaxes(0, 1), origin="lower", extent=extent, aspect="auto", **look)
    ax.set(xlim=extent[:2], ylim=extent[2:])


def axes_of(data: xr.Dataset) -> tuple[str, ...]:
    """Return the axes of a basin."""
    return tuple(map(str, data["fate"].dims))


def place_states(
    data: xr.Dataset, states: Float[np.ndarray, "n section"], axes: tuple[str, ...] = ()
) -> Float[np.ndarray, "n axes"]:
    """Return the places of states on a picture with these axes, by default those of a basin."""
    section = names_in(data, "section")
    offsets = states - np.asarray(data.attrs.get("origin", 0.0))
    return np.stack([along_axis(offsets, section, axis) for axis in axes or axes_of(data)], axis=-1)


def attractors(
    data: xr.Dataset, large: Sequence[int], axes: tuple[str, ...] = ()
) -> Iterator[tuple[Float[np.ndarray, "n axes"], str, str]]:
    """Yield places of the states of attractors, as `place_states` does, with signs and names."""
    for number, marker in zip(large, style.MARKERS, strict=False):
        own = data.sel(number=number)
        cycle = own["states"].dropna("phase").values
        name = attractor_name(data, int(own["period"]), cycle)
        yield place_states(data, cycle, axes), marker, name


def attractor_name(data: xr.Dataset, period: int, cycle: Float[np.ndarray, "n section"]) -> str:
    """Name an attractor in the legend: its period, and up to two of its states."""
    kind = {0: "a state of the attractor", 1: "attractor"}
    words = kind.get(period, f"attractor of period {period}")
    names = [SYMBOLS.get(name, name) for name in names_in(data, "section")]
    if len(names) > WRITTEN_COORDINATES:
        return words
    states = ([format_number(one, ".4f") for one in state] for state in cycle[:2].tolist())
    shown = ", ".join(f"({f',{NO_BREAK}'.join(values)})" for values in states)
    return f"{words}: ({', '.join(names)}) = {shown}{', …' * (len(cycle) > 2)}"


def mark_attractor(ax: Axes, dots: Float[np.ndarray, "n 2"], marker: str, label: str = "") -> None:
    """Draw the states of an attractor."""
    look: Any = {"color": INK, "mec": "white", "mew": 1.2, "ms": 7.5, "zorder": 5}
    ax.plot(*dots.T, marker, ls="", label=label, **look)


def patch_of(region: Region, label: str = "") -> Patch:
    """Return the sign of a region in a legend."""
    return Patch(fc=region.colour, ec=INK, lw=0.5, label=label or region.words)


def counted_patch(region: Region, share: int) -> Patch:
    """Return the sign of a region with its number of cells, one in `share` of which is given."""
    count = int(np.count_nonzero(region.cells)) * share
    about = "about " * (share > 1)
    return patch_of(region, f"{region.words} ({about}{count:,}{NO_BREAK}cell{'s' * (count > 1)})")


def draw_label(ax: Axes, region: Region, free: Bool[np.ndarray, "nx ny"]) -> bool:
    """Write letter and words of a region where it is widest, or the letter alone, as there is room.

    `free` marks where labels may stand. Returns whether there was room for the words.
    """
    cells = region.cells & free
    cells = cells[tuple(slice(None, None, -(-n // 400)) for n in cells.shape)]
    share = 0.8  # of the axes; the rest is for title and legend
    size = np.multiply(ax.bbox.size, share * 72 / figure_of(ax).dpi)
    dark = np.dot(to_rgb(region.colour), (0.3, 0.59, 0.11)) < 0.5
    look: Any = {"ha": "center", "color": "white" if dark else INK, "clip_on": True}
    letter, words = (region.letter, style.LARGE, "bold"), (region.words, style.SMALL, "normal")
    for lines in ([letter, words], [letter]) if region.letter else ([words],):
        wide = max(LETTER * style.points_of(font) * len(text) for text, font, _ in lines)
        tall = sum(1.2 * style.points_of(font) for _, font, _ in lines)
        # The ellipse within the box of the words fits where its centre is deeper than 1.
        depth = depths(cells, 2 * size / np.array((wide, tall)) / cells.shape)
        if depth.max() >= 1:
            deepest = np.argwhere(depth == depth.max())
            share_of_axes = (deepest[len(deepest) // 2] + 0.5) / cells.shape
            place = ax.transLimits.inverted().transform(share_of_axes)
            sides = ("bottom", "top") if len(lines) == 2 else ("center",)
            for (text, font, weight), side in zip(lines, sides, strict=True):
                ax.annotate(text, place.tolist(), va=side, size=font, weight=weight, **look)
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


def keep_clear(ax: Axes, free: Bool[np.ndarray, "nx ny"], dots: Float[np.ndarray, "n 2"]) -> None:
    """Mark in `free` that no label may stand on these dots."""
    x, y = (np.linspace(0, 1, n) for n in free.shape)
    for across, up in ax.transLimits.transform(dots):
        free[np.ix_(abs(x - across) < 0.03, abs(y - up) < 0.03)] = False

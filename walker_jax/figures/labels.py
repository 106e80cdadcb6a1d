"""Labels in the regions of a picture, each where there is most room."""

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb

from walker_jax.figures.regions import Extent, Region
from walker_jax.figures.style import INK, LETTER, SMALL, points_of


def draw_label(
    ax: Axes,
    region: Region,
    free: Bool[np.ndarray, "nx ny"],
    extent: Extent,
    axes_size: Float[np.ndarray, " 2"],
) -> bool:
    """Label a region inside itself, with letter and words, or the letter alone, as there is room.

    `free` marks where labels may stand, on axes of a size in points. Returns whether there was room
    for the words.
    """
    large, small = points_of(LETTER), points_of(SMALL)
    letter = [(region.letter, large, "bold", 0)]
    words = [(region.words, small, "normal", 0)]
    up, down = 0.6 * small, -0.55 * large
    both = [(region.letter, large, "bold", up), (region.words, small, "normal", down)]
    colour = "white" if luminance(region.colour) < 0.2 else INK
    low, high = np.array(extent[::2]), np.array(extent[1::2])
    for lines in (both, letter) if region.letter else (words,):
        width = max(size * (0.6 * len(text) + 0.5) for text, size, *_ in lines)
        height = sum(1.15 * size for _, size, *_ in lines)
        place = roomiest_place(region.cells & free, np.array([width, height]) / axes_size)
        if place is None:
            continue
        at_x, at_y = (low + place * (high - low)).tolist()
        for text, size, weight, rise in lines:
            ax.annotate(
                text,
                (at_x, at_y),
                (0, rise),
                textcoords="offset points",
                ha="center",
                va="center",
                color=colour,
                fontsize=size,
                fontweight=weight,
                clip_on=True,
            )
        return lines is not letter
    return False


def keep_clear(
    free: Bool[np.ndarray, "nx ny"],
    dots: Float[np.ndarray, "n 2"],
    extent: Extent,
) -> None:
    """Mark in `free` that no label may stand on these dots."""
    shape, low = np.array(free.shape), np.array(extent[::2])
    for dot in np.nan_to_num((dots - low) / (np.array(extent[1::2]) - low), nan=-1):
        first, last = (np.clip(dot + side * 0.02, 0, 1) * shape for side in (-1, 1))
        free[int(first[0]) : int(last[0]) + 1, int(first[1]) : int(last[1]) + 1] = False


def roomiest_place(
    cells: Bool[np.ndarray, "nx ny"], size: Float[np.ndarray, " 2"]
) -> Float[np.ndarray, " 2"] | None:
    """Find the place among the cells with the most room for a box; None where it does not fit.

    Box and place are fractions of the axes. The box grows in proportion while it fits. It fits if
    at most one cell in fifty of it is not among `cells`.
    """
    cells = cells[tuple(slice(None, None, -(-n // 400)) for n in cells.shape)]
    shape = np.array(cells.shape)
    total = np.zeros(shape + 1, int)
    total[1:, 1:] = cells.cumsum(0).cumsum(1)
    place = None
    for growth in np.geomspace(1, 32, 26):
        nx, ny = np.ceil(growth * size * shape).astype(int)
        if nx > shape[0] or ny > shape[1]:
            break
        inside = total[nx:, ny:] - total[:-nx, ny:] - total[nx:, :-ny] + total[:-nx, :-ny]
        fits = np.argwhere(inside >= 0.98 * nx * ny)
        if len(fits) == 0:
            break
        middle = fits[np.abs(fits - fits.mean(axis=0)).sum(axis=1).argmin()]
        place = (middle + np.array([nx, ny]) / 2) / shape
    return place


def luminance(colour: str) -> float:
    """Return the relative luminance of an sRGB colour, 0 for black to 1 for white (WCAG 2)."""
    rgb = np.array(to_rgb(colour))
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    return float(linear @ (0.2126, 0.7152, 0.0722))

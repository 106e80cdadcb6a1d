"""Labels in the regions of a picture, each where there is room."""

from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb

from walker_jax.figures.layout import LETTER_WIDTH, figure_of
from walker_jax.figures.regions import Extent, Region
from walker_jax.figures.style import INK, LETTER, SMALL, points_of

TITLE_AND_LEGEND = 0.8
"""Share of the height of axes that is left to them below a title and above a legend."""


def draw_label(ax: Axes, region: Region, free: Bool[np.ndarray, "nx ny"], extent: Extent) -> bool:
    """Label a region inside itself, with letter and words, or the letter alone, as there is room.

    `free` marks where labels may stand. Returns whether there was room for the words.
    """
    letter, words = (region.letter, LETTER, "bold"), (region.words, SMALL, "normal")
    cells = region.cells & free
    cells = cells[tuple(slice(None, None, -(-n // 400)) for n in cells.shape)]
    size = np.multiply(ax.bbox.size, (1, TITLE_AND_LEGEND)) * 72 / figure_of(ax).dpi
    low, high = np.array(extent[::2]), np.array(extent[1::2])
    look: dict[str, Any] = {"ha": "center", "clip_on": True}
    look["color"] = "white" if luminance(region.colour) < 0.2 else INK
    for lines in ([letter, words], [letter]) if region.letter else ([words],):
        width = max(LETTER_WIDTH * len(text) * points_of(font) for text, font, _ in lines)
        height = sum(1.2 * points_of(font) for _, font, _ in lines)
        place = middle_of(cells, np.array([width, height]) / size)
        if place is None:
            continue
        for (text, font, weight), side in zip(lines, ("bottom", "top"), strict=False):
            look |= {"va": side if len(lines) == 2 else "center", "size": font, "weight": weight}
            ax.annotate(text, (low + place * (high - low)).tolist(), **look)
        return lines[-1] is words
    return False


def keep_clear(
    free: Bool[np.ndarray, "nx ny"],
    dots: Float[np.ndarray, "n 2"],
    extent: Extent,
) -> None:
    """Mark in `free` that no label may stand on these dots."""
    shape, low = np.array(free.shape), np.array(extent[::2])
    for dot in np.nan_to_num((dots - low) / (np.array(extent[1::2]) - low), nan=-1):
        first, last = (np.clip(dot + side * 0.03, 0, 1) * shape for side in (-1, 1))
        free[int(first[0]) : int(last[0]) + 1, int(first[1]) : int(last[1]) + 1] = False


def middle_of(
    cells: Bool[np.ndarray, "nx ny"], size: Float[np.ndarray, " 2"]
) -> Float[np.ndarray, " 2"] | None:
    """Find the place deepest among cells for a box of some size; None where it does not fit.

    Box and place are fractions of the axes. The box fits if at most one cell in fifty of it is not
    among `cells`.
    """
    from scipy.ndimage import distance_transform_edt, uniform_filter

    shape = np.array(cells.shape)
    box: Any = np.ceil(size * shape).astype(int)
    fits = uniform_filter(cells.astype(float), box, mode="constant") >= 0.98
    if not fits.any():
        return None
    deep: Any = distance_transform_edt(np.pad(fits, 1), sampling=1 / shape)
    return (np.array(np.unravel_index(deep[1:-1, 1:-1].argmax(), fits.shape)) + 0.5) / shape


def luminance(colour: str) -> float:
    """Return the relative luminance of an sRGB colour, 0 for black to 1 for white (WCAG 2)."""
    rgb = np.array(to_rgb(colour))
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    return float(linear @ (0.2126, 0.7152, 0.0722))

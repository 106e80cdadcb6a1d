"""What stands on a picture, and in which colour."""

import numpy as np
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from matplotlib.text import Annotation, Text


def colours(ax):
    """Colour of each cell, its indices in the order of the data set's dimensions."""
    (image,) = ax.images
    assert image.origin == "lower"
    return np.asarray(image.get_array()).swapaxes(0, 1)


def legend(ax):
    """Texts of the legends, each in one line."""
    legends = [one for one in ax.get_children() if isinstance(one, Legend)]
    return [text.get_text().replace("\n", " ") for one in legends for text in one.get_texts()]


def labels(ax) -> dict[str, Annotation]:
    """The labels of the regions, which stand in data coordinates, by their text."""
    return {text.get_text(): text for text in ax.texts if text.xycoords == "data"}


def figure_of(ax) -> Figure:
    return ax.get_figure(root=True)


def luminance(colour):
    """Relative luminance of an sRGB colour."""
    rgb = np.asarray(to_rgb(colour))
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    return linear @ [0.2126, 0.7152, 0.0722]


def lightness(rgb):
    """CIE L*, 0 for black to 100 for white, of 8-bit sRGB."""
    return 116 * np.cbrt(luminance(np.asarray(rgb) / 255)) - 16


def lines(ax, dashed):
    """Points of the solid or of the dashed lines between points in data coordinates."""
    return [
        np.asarray(line.get_xydata())
        for line in ax.lines
        if line.get_transform() == ax.transData
        and line.get_linestyle() == ("--" if dashed else "-")
    ]


def signs(ax, marker):
    """Where a marker is drawn, in data coordinates."""
    found = [
        np.asarray(line.get_xydata())
        for line in ax.lines
        if line.get_marker() == marker and line.get_transform() == ax.transData
    ]
    return np.concatenate([np.zeros((0, 2)), *found])


def words(ax):
    """All texts of a picture but those of its legends."""
    return [text.get_text() for text in ax.texts]


def annotations(ax, text) -> list[Annotation]:
    """Those with this text."""
    return [t for t in ax.texts if isinstance(t, Annotation) and t.get_text() == text]


def box(text):
    """Where a text stands (pixels), without its arrow."""
    return Text.get_window_extent(text)


def line(ax, **look):
    """Points of the only line of this style."""
    (only,) = (one for one in ax.lines if all(getattr(one, f"get_{k}")() == look[k] for k in look))
    return np.asarray(only.get_xydata())


def extents(axes):
    """Where axes are drawn, and the texts and legends around them."""
    for ax in axes:
        own = [one for one in ax.get_children() if isinstance(one, Text | Legend)]
        names = [ax.xaxis.label, ax.yaxis.label]
        words = [one for one in (*own, *names) if isinstance(one, Legend) or one.get_text()]
        yield from (ax.get_tightbbox(), *(one.get_window_extent() for one in words))

"""Places on a picture: its axes, their limits, and the words around them."""

import math
import re
import textwrap
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TYPE_CHECKING, Any, Literal, TypedDict, cast

import numpy as np
from jaxtyping import Float
from matplotlib import rc_context
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.transforms import offset_copy

from walker_jax.checks import WrongUse, check_number
from walker_jax.figures.style import NOTE, SHEET, SMALL, points_of
from walker_jax.figures.text import NO_BREAK, axis_label

GAP = 7
"""Gap between the axes and the text above them, and between their names and legends (points)."""
LETTER_WIDTH = 0.49
"""Mean width of a letter, in sizes of the text."""
HANDLE, BETWEEN = 5, 4
"""Widths of a handle of a legend, and of the gap to the next column, in letters."""
ROW = 1.6
"""Height of a line of a legend, in sizes of its text."""
UPRIGHT = 0.92, 0.55
"""Longest name of a vertical axis, and in print, where legends take more of the height, as shares
of the height of axes without title and legend."""
MOST_COLUMNS = 6
"""Most columns of a legend."""
FORMULA, INSTEAD = re.compile(r"\$.*?\$"), "\ue000" * 3
"""A formula in a text, and letters that take about its place."""
BOLD = 0.83
"""Letters of bold text in the width of an ordinary letter."""
WIDER = 1.12
"""Factor by which a layout enlarges axes, at least."""
SMALLER = 0.6
"""Factor on lines and signs in print, the same as for text of 8 points against a screen's."""
Layout = Literal["constrained", "compressed"]
page_width: ContextVar[float | None] = ContextVar("page_width", default=None)
"""The width of all new figures (inches); None where each has its own."""


class Style(TypedDict, total=False):
    """Words around a picture and in it, each of which can be left out."""

    title: bool | str
    """Whether to write the title; a string replaces it."""
    subtitle: bool
    """Whether to write the lines below the title."""
    legend: bool
    """Whether to draw the legend."""
    labels: bool
    """Whether to write the names of axes, and words in the picture."""


@contextmanager
def for_print(
    width: float | int = 3.4,
    *,
    font: str | None = None,
    size: float | int = 8,
    dpi: float | int = 300,
) -> Iterator[None]:
    """Give pictures drawn in this context the width of a column of print, and its text.

    ```python
    with figures.for_print(width=3.4, font="Times New Roman"):
        figures.basin(data).figure.savefig("basin.pdf")
    ```

    Titles and notes are left out, as a caption replaces them; a title given as a string stays.
    Lines and signs are smaller in proportion. In vector files text stays text, which can be
    searched and edited.

    **Arguments:**

    - `width`: of each new figure, in inches; its height is in proportion. 3.4 is a column of many
      journals, and 7 a page.
    - `font`: of all text; by default, matplotlib's own. Another font must be installed.
    - `size`: of text, in points. Legends are smaller.
    - `dpi`: dots per inch of raster files, and of cells and dots in vector files.

    Raises `ValueError` for a width or a size that is not above zero.
    """
    for name, value in {"width": width, "size": size, "dpi": dpi}.items():
        check_number(name, value)
        if not 0 < value < math.inf:
            raise WrongUse(f"{name} must be above 0 and finite, not {value}", of=name)
    settings: Any = {
        "font.size": size,
        "legend.fontsize": "small",
        "savefig.dpi": dpi,
        "pdf.fonttype": 42,
        "ps.fonttype": 42,
        "svg.fonttype": "none",
        "axes.linewidth": 0.6,
        "xtick.major.width": 0.6,
        "ytick.major.width": 0.6,
        "lines.markersize": 4,
    } | ({} if font is None else {"font.family": font})
    token = page_width.set(float(width))
    try:
        with rc_context(settings):
            yield
    finally:
        page_width.reset(token)


def new_figure(width: float | int, height: float | int, layout: Layout = "constrained") -> Figure:
    """Make a figure of a size in inches; if one width is set for all, of the same proportions."""
    page = page_width.get()
    scale = 1.0 if page is None else page / width
    return Figure(figsize=(scale * width, scale * height), layout=layout)


if TYPE_CHECKING:

    class DrawnAxes(Axes):
        """To type checkers, axes that are in no subfigure, so that their figure has `savefig`."""

        figure: Figure

        def get_figure(self, root: bool = False) -> Figure: ...

else:
    DrawnAxes = Axes


def axes_for(
    ax: Axes | None,
    style: Style,
    width: float | int,
    height: float | int,
    layout: Layout = "constrained",
) -> DrawnAxes:
    """Return the given axes, or make those of a new figure, of a size in inches."""
    for name in style:
        if name not in Style.__annotations__:
            known = ", ".join(Style.__annotations__)
            raise WrongUse(f"style must be of {known}, not {name}", of="style")
    ax = new_figure(width, height, layout).add_subplot() if ax is None else ax
    return cast(DrawnAxes, ax)


def figure_of(ax: Axes) -> Figure:
    """Return the figure that axes are on."""
    return cast(Figure, ax.get_figure(root=True))


def cell_edges(centres: Float[np.ndarray, " n"]) -> tuple[float, float]:
    """Return the outer edges of equal cells."""
    half = (centres[-1] - centres[0]) / (len(centres) - 1) / 2
    return float(centres[0] - half), float(centres[-1] + half)


def padded_limits(values: Float[np.ndarray, " n"]) -> tuple[float, float] | None:
    """Return the range of values, slightly widened; None for a single value."""
    beyond = 0.03 * np.ptp(values)
    return (values.min() - beyond, values.max() + beyond) if beyond else None


def name_axes(ax: Axes, x: str | None = None, y: str | None = None, **look: Any) -> None:
    """Label axes with coordinates or parameters, or with words of their own."""
    if x is not None:
        ax.set_xlabel(axis_label(x), **look)
    if y is not None:
        ax.set_ylabel(axis_label(y), **look)


def name_outer_axes(panels: np.ndarray, used: int, x: str, y: str) -> None:
    """Name the axes at the left and below of rows of panels, and hide the last, unused ones."""
    for ax in panels.flat[used:]:
        ax.set_visible(False)
    for ax in panels[-1]:
        name_axes(ax, x=x, size=SMALL)
    for ax in panels[:, 0]:
        name_axes(ax, y=y, size=SMALL)


def finish(
    ax: Axes,
    style: Style,
    *,
    title: str,
    x: str,
    y: str,
    note: str = "",
    legend: Iterable[Artist] = (),
    beside: Sequence[Axes] = (),
) -> DrawnAxes:
    """Write title and note above axes, their names, and a legend below. Returns the axes.

    `beside` are axes that share the height, such as a colour bar.
    """
    printed = page_width.get() is not None
    if printed:
        make_smaller(ax)
    labelled = style.get("labels", True)
    if labelled:
        name_axes(ax, x, y)
    most = UPRIGHT[printed] * letters(ax, ax.bbox.height, "axes.labelsize")
    for one in (ax, *beside):
        one.set_ylabel(in_lines(one.get_ylabel(), most) * labelled)
    wide = WIDER * ax.bbox.width
    own = style.get("title", not printed)
    title = own if isinstance(own, str) else title * own
    note = in_lines(note * style.get("subtitle", not printed), letters(ax, wide, NOTE))
    with rc_context(SHEET):
        if note:
            ax.annotate(note, (0, 1), (0, GAP), "axes fraction", "offset points", fontsize=NOTE)
        pad = (GAP + 1.45 * points_of(NOTE) * len(note.splitlines())) if note else None
        ax.set_title(in_lines(title, BOLD * letters(ax, wide, "axes.titlesize")), pad=pad)
        if style.get("legend", True):
            draw_legends(ax, [*legend], letters(ax, wide, "legend.fontsize"))
    return cast(DrawnAxes, ax)


def draw_legends(ax: Axes, handles: Sequence[Artist], most: float) -> None:
    """Draw legends below axes: up to the last label that needs a line, then the rest in columns."""
    for one in handles:
        one.set_label(in_lines(str(one.get_label()), most - HANDLE))
    alone = [i for i, one in enumerate(handles, 1) if columns_for([one, one], most) == 1]
    first = max(alone, default=0)
    if handles[first:] and columns_for(handles[first:], most) == 1:
        first = len(handles)
    drop = 13 + 2.4 * points_of("font.size")  # height of the axes' names and numbers
    for group, others in ((handles[:first], handles[first:]), (handles[first:], [])):
        if group:
            below = offset_copy(ax.transAxes, figure_of(ax), y=-drop, units="points")
            place: dict[str, Any] = {"bbox_to_anchor": (0, 0), "bbox_transform": below}
            legend = ax.legend(handles=group, ncols=columns_for(group, most), **place)
            rows = sum(1 + str(one.get_label()).count("\n") for one in group)
            drop += ROW * points_of("legend.fontsize") * rows
            if others:
                ax.add_artist(legend)  # as the next one would replace it


def make_smaller(ax: Axes) -> None:
    """Make the lines and signs of a picture smaller, for print."""
    for line in ax.lines:
        line.set(markersize=SMALLER * line.get_markersize())
        line.set(linewidth=SMALLER * line.get_linewidth())
        line.set(markeredgewidth=SMALLER * line.get_markeredgewidth())


def letters(ax: Axes | Figure, wide: float, size: str) -> float:
    """Estimate the number of letters of a size in a width (pixels)."""
    figure = ax if isinstance(ax, Figure) else figure_of(ax)
    return wide * 72 / figure.dpi / (LETTER_WIDTH * points_of(size))


def in_lines(text: str, most: float) -> str:
    """Break a text into lines of about so many letters, none within a formula."""
    formulas = iter(FORMULA.findall(text))
    look: Any = {"break_long_words": False, "break_on_hyphens": False}
    short = FORMULA.sub(INSTEAD, text).split("\n")
    lines = "\n".join(textwrap.fill(line, max(10, int(most)), **look) for line in short)
    return re.sub(INSTEAD, lambda _: next(formulas), lines).replace(NO_BREAK, " ")


def columns_for(handles: Sequence[Artist], most: float) -> int:
    """Return the number of columns of a legend of about so many letters."""
    longest = max(len(FORMULA.sub(INSTEAD, str(one.get_label()))) for one in handles)
    fit = int((most + BETWEEN) / (longest + HANDLE + BETWEEN))
    return max(1, min(fit, len(handles), MOST_COLUMNS))


def figure_legend(figure: Figure, handles: Sequence[Artist], note: str = "") -> None:
    """Put a legend at the left, below all axes of a figure, under a note."""
    columns = columns_for(handles, letters(figure, figure.bbox.width, "legend.fontsize"))
    above = in_lines(note, letters(figure, figure.bbox.width, "legend.fontsize"))
    look: Any = {"loc": "outside lower left", "title": above or None, "alignment": "left"}
    figure.legend(handles=handles, ncols=columns, frameon=False, **look)


def figure_title(figure: Figure, title: str, size: str = "x-large", weight: str = "bold") -> None:
    """Write a title at the left, above all axes of a figure; none in print."""
    if page_width.get() is None:
        most = BOLD * letters(figure, figure.bbox.width, size)
        figure.suptitle(in_lines(title, most), x=0.01, ha="left", size=size, weight=weight)

"""Places on a picture: its axes, their limits, and the texts around them."""

import math
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, cast

import numpy as np
from jaxtyping import Float
from matplotlib import cbook, rc_context
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import RendererAgg
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpecFromSubplotSpec
from matplotlib.legend import Legend
from matplotlib.text import Text
from matplotlib.transforms import offset_copy

from walker_jax.checks import WrongUse, check_number
from walker_jax.figures.style import NOTE, TITLE, points_of
from walker_jax.figures.text import axis_label

GAP = 7
"""Gap between the axes and the text above them, and between their names and legends (points)."""
LARGER = 1.12
"""Least factor by which a layout enlarges axes together with their title and legends."""
MOST = 0.6
"""Largest share of the height of a panel for title and legends."""
PAD = 6
"""Gap between panels and around them (points)."""
AROUND = 100
"""Height of a title and legends, before it is known (points)."""
SIZES = (1.0, 0.9, 0.8, 0.7, 0.6, 0.5)
"""Shares of the sizes of text that are tried in turn, in a small panel."""


class Shown(NamedTuple):
    """Options for the texts around a picture and in it."""

    title: bool | str = True
    """True for the picture's own title, a string for another one, False for none."""
    subtitle: bool = True
    legend: bool = True
    labels: bool = True
    """The names of axes, and words in the picture."""


SMALLER = 0.6
"""Factor on lines and signs in print, the same as for text of 8 points against a screen's."""
Layout = Literal["constrained", "compressed"]
page_width: ContextVar[float | None] = ContextVar("page_width", default=None)
"""The width of all new figures (inches); None where each has its own."""


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
    - `size`: of text, in points. Legends are smaller where there is little room.
    - `dpi`: dots per inch of raster files, and of cells and dots in vector files.

    Raises `ValueError` for a width or a size that is not above zero.
    """
    for name, value in {"width": width, "size": size, "dpi": dpi}.items():
        check_number(name, value)
        if not 0 < value < math.inf:
            raise WrongUse(f"{name} must be above 0 and finite, not {value}", of=name)
    settings: Any = {
        "font.size": size,
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


def make_smaller(ax: Axes) -> None:
    """Make the lines and signs of a picture smaller, for print."""
    for line in ax.lines:
        line.set(markersize=SMALLER * line.get_markersize())
        line.set(linewidth=SMALLER * line.get_linewidth())
        line.set(markeredgewidth=SMALLER * line.get_markeredgewidth())


if TYPE_CHECKING:

    class DrawnAxes(Axes):
        """To type checkers, axes that are in no subfigure, so that their figure has `savefig`."""

        figure: Figure

        def get_figure(self, root: bool = False) -> Figure: ...

else:
    DrawnAxes = Axes


def axes_for(
    ax: Axes | None, width: float | int, height: float | int, layout: Layout = "constrained"
) -> DrawnAxes:
    """Return the given axes, or make those of a new figure, of a size in inches."""
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


def name_axes(
    ax: Axes, x: str | None = None, y: str | None = None, size: str | None = None
) -> None:
    """Label axes with coordinates or parameters, or with words of their own."""
    style: dict[str, Any] = {} if size is None else {"fontsize": size}
    if x is not None:
        ax.set_xlabel(axis_label(x), **style)
    if y is not None:
        ax.set_ylabel(axis_label(y), **style)


def dress(
    ax: Axes,
    shown: Shown,
    *,
    title: str,
    note: str,
    x: str,
    y: str,
    legends: Sequence[tuple[Sequence[Artist], int]] = (),
    beside: Sequence[Axes] = (),
) -> None:
    """Write title and note above axes, their names, and legends below, as wide as there is room.

    Each legend is a sequence of handles and its largest number of columns. `beside` are axes that
    share the height, such as a colour bar. In a small panel all texts are smaller.
    """
    if page_width.get() is not None:
        make_smaller(ax)
        shown = shown._replace(title=isinstance(shown.title, str) and shown.title, subtitle=False)
    measure = RendererAgg(1, 1, figure_of(ax).dpi)
    _, high = size_of(ax)
    if shown.labels:
        name_axes(ax, x, y)
    else:
        for one in beside:
            one.set_ylabel("")
    upright = [(one.yaxis.label, one.get_ylabel()) for one in (ax, *beside)]
    for name, _ in upright:
        fit_text(name, (1 - MOST) * high, measure)
    wide = width_between(ax, beside, measure)
    title = shown.title if isinstance(shown.title, str) else title * shown.title
    legends = [one for one in legends if one[0]] if shown.legend else []
    taken = 0.0
    for size in SIZES:
        fit_text(ax.xaxis.label, wide, measure)
        drawn, above = write_above(ax, title, note * shown.subtitle, size, wide, measure)
        below_it, below = write_below(ax, legends, size, wide, measure)
        taken = above + below
        if taken <= MOST * high or size == SIZES[-1]:
            break
        for one in (*drawn, *below_it):
            one.remove()
    for name, words in upright:
        name.set_text(words)
        fit_text(name, high - taken, measure)


def size_of(ax: Axes) -> tuple[float, float]:
    """Estimate the width and height that axes with title and legends will have (pixels)."""
    box = ax.get_position(original=True).transformed(ax.figure.transSubfigure)
    whole = figure_of(ax).get_layout_engine() is None or page_width.get() is not None
    larger = 1.0 if whole else LARGER
    return larger * box.width, larger * box.height


def width_between(ax: Axes, beside: Sequence[Axes], measure: RendererAgg) -> float:
    """Return the width of axes in their panel, without the space at their sides (pixels)."""
    wide, _ = size_of(ax)
    spec = ax.get_subplotspec()
    if spec is None or figure_of(ax).get_layout_engine() is None:
        return wide
    grid = spec.get_gridspec()
    if isinstance(grid, GridSpecFromSubplotSpec):
        return wide
    ratios = np.asarray(grid.get_width_ratios(), float)
    columns = ratios[spec.colspan.start : spec.colspan.stop]
    panel = ax.figure.bbox.width * float(columns.sum() / ratios.sum())
    boxes = [one.yaxis.get_tightbbox(measure) for one in (ax, *beside)]
    boxes += [one.get_window_extent(measure) for one in ax.texts if one.get_in_layout()]
    boxes = [box for box in boxes if box is not None]
    left = ax.bbox.x0 - min((box.x0 for box in boxes), default=ax.bbox.x0)
    right = max((box.x1 for box in boxes), default=ax.bbox.x1) - ax.bbox.x1
    room = panel - max(0.0, left) - max(0.0, right) - 2 * PAD * figure_of(ax).dpi / 72
    return max(room, wide / 2)


def size_between(ax: Axes) -> Float[np.ndarray, " 2"]:
    """Estimate the size of axes between a title above and legends below (points)."""
    wide, high = np.array(size_of(ax)) * 72 / figure_of(ax).dpi
    return np.array([wide, max(high - AROUND, 0.4 * high)])


def write_above(
    ax: Axes, title: str, note: str, size: float, wide: float, measure: RendererAgg
) -> tuple[list[Artist], float]:
    """Write a title, and one or more lines below it. Returns the artists and their height."""
    drawn: list[Artist] = []
    scale, high = figure_of(ax).dpi / 72, 0.0
    if note:
        size_of_note = size * points_of(NOTE)
        text = ax.annotate(
            note, (0, 1), (0, GAP), "axes fraction", "offset points", fontsize=size_of_note
        )
        fit_text(text, wide, measure)
        high = text.get_window_extent(measure).height + GAP * scale
        drawn.append(text)
    pad = high / scale + 4 if note else None
    words = ax.set_title(title, pad=pad, fontsize=size * points_of("axes.titlesize"), **TITLE)
    fit_text(words, wide, measure)
    return drawn, high + (words.get_window_extent(measure).height if title else 0)


def write_below(
    ax: Axes,
    legends: Sequence[tuple[Sequence[Artist], int]],
    size: float,
    wide: float,
    measure: RendererAgg,
) -> tuple[list[Artist], float]:
    """Put legends at the left, below one another. Returns them and their height."""
    drawn: list[Artist] = []
    figure, points = figure_of(ax), size * points_of("legend.fontsize")
    scale, high = figure.dpi / 72, 0.0
    names = ax.xaxis.get_tightbbox(measure)
    drop = GAP + (max(0.0, ax.bbox.y0 - names.y0) / scale if names is not None else 0)
    for handles, columns in legends:
        for count in range(min(columns, len(handles)), 0, -1):
            legend = Legend(
                ax,
                handles,
                [str(handle.get_label()) for handle in handles],
                loc="upper left",
                bbox_to_anchor=(0, 0),
                bbox_transform=offset_copy(
                    ax.transAxes, figure, y=-drop - high / scale, units="points"
                ),
                borderaxespad=0,
                borderpad=0,
                ncols=count,
                frameon=False,
                fontsize=points,
            )
            if legend.get_window_extent(measure).width <= wide:
                break
        else:
            for text in legend.get_texts():
                fit_text(text, wide - 3 * points * scale, measure)
        ax.add_artist(legend).set_clip_on(False)
        drawn.append(legend)
        high += legend.get_window_extent(measure).height + 0.4 * points * scale
    return drawn, high


def fit_text(text: Text, room: float, measure: RendererAgg) -> None:
    """Break a text, at spaces outside formulas, into lines that fit (pixels)."""
    font = text.get_fontproperties()
    width_of = lambda line: measure.get_text_width_height_descent(
        line, font, cbook.is_math_text(line)
    )[0]
    if all(width_of(line) <= room for line in text.get_text().split("\n")):
        return
    words = re.findall(r"(?:\$[^$]*\$|[^ \n])+", text.get_text())
    lines: list[str] = []
    for word in words:
        longer = f"{lines[-1]} {word}" if lines else word
        if lines and width_of(longer) <= room:
            lines[-1] = longer
        else:
            lines.append(word)
    text.set_text("\n".join(lines))


def figure_legend(figure: Figure, handles: list, *, columns: int) -> None:
    """Put a legend at the left, below all axes of a figure."""
    figure.legend(handles=handles, loc="outside lower left", ncols=columns, frameon=False)


def figure_title(figure: Figure, title: str, size: str = "x-large", weight: str = "bold") -> None:
    """Write a title at the left, above all axes of a figure; none in print."""
    if page_width.get() is None:
        figure.suptitle(title, x=0.01, ha="left", fontsize=size, fontweight=weight)

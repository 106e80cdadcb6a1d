"""Places on a picture: its axes, their limits, and the words around them."""

import math
import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from itertools import chain
from textwrap import TextWrapper
from typing import TYPE_CHECKING, Any, TypedDict, cast

import numpy as np
import xarray as xr
from jax.typing import ArrayLike
from jaxtyping import Float
from matplotlib import rc_context
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.container import Container
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.transforms import offset_copy

from walker_jax.checks import WrongUse, check_number
from walker_jax.figures.style import NOTE, SMALL, TITLE, points_of
from walker_jax.figures.text import NO_BREAK, axis_label
from walker_jax.storage.schema import check_dataset

GAP = 7
"""Gap between the axes and the text above them (points)."""
WIDER = 1.15
"""Factor by which a layout enlarges axes, at least, and by which bold letters are wider."""
LETTER, SIGN = 0.52, 9
"""Mean width of a letter, in sizes of the text; of a sign of a legend with its gaps, in letters."""
MANY = 65
"""Width (letters) from which a legend of more than five signs has two columns."""
FORMULA = re.compile(r"\$[^$]*\$")
SMALLER = 0.6
"""Factor on lines and signs in print, the same as for text of 8 points against a screen's."""
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
    thin = dict.fromkeys(("axes.linewidth", "xtick.major.width", "ytick.major.width"), 0.6)
    editable = {"pdf.fonttype": 42, "ps.fonttype": 42, "svg.fonttype": "none"}
    sizes = {"font.size": size, "legend.fontsize": "small", "lines.markersize": 4}
    settings: Any = thin | editable | sizes | {"savefig.dpi": dpi}
    token = page_width.set(float(width))
    try:
        with rc_context(settings if font is None else settings | {"font.family": font}):
            yield
    finally:
        page_width.reset(token)


def new_figure(width: float | int, height: float | int) -> Figure:
    """Make a figure of a size in inches; if one width is set for all, of the same proportions."""
    scale = (page_width.get() or width) / width
    return Figure(figsize=(scale * width, scale * height), layout="constrained")


def new_panels(
    width: float | int, height: float | int, rows: int, columns: int, **shared: Any
) -> tuple[Figure, list[Axes]]:
    """Make a figure of a size in inches with rows of axes."""
    figure = new_figure(width, height)
    return figure, [*figure.subplots(rows, columns, squeeze=False, **shared).flat]


if TYPE_CHECKING:

    class DrawnAxes(Axes):
        """To type checkers, axes that are in no subfigure, so that their figure has `savefig`."""

        figure: Figure

        def get_figure(self, root: bool = False) -> Figure: ...

else:
    DrawnAxes = Axes


def axes_for(
    ax: Axes | None, style: Style, width: float | int = 7, height: float | int = 5.4
) -> DrawnAxes:
    """Return the given axes, or make those of a new figure, of a size in inches."""
    check_style(style)
    return cast(DrawnAxes, new_figure(width, height).add_subplot() if ax is None else ax)


def begin(ax: Axes | None, style: Style, data: xr.Dataset, kind: str, *size: Any) -> DrawnAxes:
    """Check that the data of a picture are of a kind, and return its axes, as `axes_for`."""
    check_dataset(data, kind)
    return axes_for(ax, style, *size)


def check_style(style: Style) -> None:
    """Raise `WrongUse` for words around a picture that `Style` lacks."""
    for name in style:
        if name not in Style.__annotations__:
            known = ", ".join(Style.__annotations__)
            raise WrongUse(f"style must be of {known}, not {name}", of="style")


def figure_of(ax: Axes) -> Figure:
    """Return the figure that axes are on."""
    return cast(Figure, ax.get_figure(root=True))


def widened(
    ends: Float[np.ndarray, "*axes 2"], share: float, least: Float[ArrayLike, "..."] = 0.0
) -> np.ndarray:
    """Return the ends of ranges, moved outwards by a share of their widths, or by the least."""
    beyond = np.maximum(share * np.ptp(ends, axis=-1, keepdims=True), least)
    return ends + beyond * [-1, 1]


def show_from_zero(ax: Axes, values: Float[np.ndarray, " n"]) -> None:
    """Show all these values along the x axis, slightly widened, and the y axis from zero."""
    ax.update_datalim(np.stack([values, 0 * values], axis=1))
    ax.margins(x=0.03)
    ax.set_ylim(0)


def write_beside(ax: Axes, words: str, place: Any, shift: tuple[int, int], **look: Any) -> None:
    """Write small words at a distance (points) from a place, by default in data coordinates."""
    look = {"fontsize": SMALL, "textcoords": "offset points"} | look
    ax.annotate(words, place, shift, **look)


def name_axes(ax: Axes, x: str | None = None, y: str | None = None, **look: Any) -> None:
    """Label axes with coordinates or parameters, or with words of their own."""
    if x is not None:
        ax.set_xlabel(axis_label(x), **look)
    if y is not None:
        high = 0.9 * ax.bbox.height / figure_of(ax).dpi  # a legend leaves less
        ax.set_ylabel(in_lines(axis_label(y), letters_in(high, "axes.labelsize")), **look)


def name_outer_axes(panels: Sequence[Axes], used: int, x: str, y: str) -> None:
    """Name the axes at the left and below of rows of panels, and hide the last, unused ones."""
    for k, ax in enumerate(panels):
        ax.set_visible(k < used)
        name_axes(ax, x, y, size=SMALL)
        ax.label_outer()


def finish(
    ax: Axes,
    style: Style,
    title: str,
    note: str = "",
    *,
    x: str,
    y: str,
    legend: Iterable[Artist] = (),
    bar: tuple[ScalarMappable, str] | None = None,
) -> DrawnAxes:
    """Write title and note above axes, their names, and a legend below. Returns the axes.

    The legend has what is labelled on the axes, and then the given signs. `bar` has the colours of
    a bar beside the axes and its name.
    """
    labels = style.get("labels", True)
    if bar is not None:
        figure_of(ax).colorbar(bar[0], ax=ax, label=bar[1] * labels)
    printed = page_width.get() is not None
    for line in ax.lines if printed else ():
        for size in ("markersize", "linewidth", "markeredgewidth"):
            line.set(**{size: SMALLER * getattr(line, f"get_{size}")()})
    if labels:
        name_axes(ax, x, y)
    narrow = float(ax.bbox.width / figure_of(ax).dpi)  # as wide as bold letters need
    wide = WIDER * narrow
    title = chosen_title(style, title)
    note = in_lines(note, letters_in(wide, NOTE)) if style.get("subtitle", not printed) else ""
    if note:
        write_beside(ax, note, (0, 1), (0, GAP), xycoords="axes fraction", fontsize=NOTE)
    pad = GAP + 1.45 * points_of(NOTE) * len(note.splitlines()) if note else None
    ax.set_title(in_lines(title, letters_in(narrow, "axes.titlesize")), pad=pad, **TITLE)
    handles = [*ax.get_legend_handles_labels()[0], *legend]
    if style.get("legend", True) and handles:
        drop = 13 + 2.4 * points_of("font.size")  # height of the axes' names and numbers
        below = offset_copy(ax.transAxes, figure_of(ax), y=-drop, units="points")
        place: Any = {"loc": "upper left", "bbox_to_anchor": (0, 0), "bbox_transform": below}
        look = in_columns(handles, letters_in(wide, "legend.fontsize")) | place
        ax.legend(**look, frameon=False, borderpad=0, borderaxespad=0)
    return cast(DrawnAxes, ax)


def letters_in(inches: float, size: str) -> int:
    """Return how many letters of one of the sizes of `points_of` stand side by side."""
    return int(72 * inches / (LETTER * points_of(size)))


def in_lines(text: str, letters: int) -> str:
    """Break a text into lines of so many letters: none in a formula, which counts as a letter.

    Matplotlib's own `wrap` fills the whole figure, over other axes, and does nothing in notebooks,
    which save with `bbox_inches="tight"`.
    """
    formulas = iter(FORMULA.findall(text))
    wrap = TextWrapper(max(1, letters), break_long_words=False, break_on_hyphens=False)
    lines = "\n".join(map(wrap.fill, FORMULA.sub("\0", text).split("\n")))
    return re.sub("\0", lambda _: next(formulas), lines).replace(NO_BREAK, " ")


def in_columns(handles: Sequence[Artist | Container], letters: int) -> dict[str, Any]:
    """Return signs, labels and number of columns of a legend of a width; break longer labels.

    Labels of a long legend leave room for two columns.
    """
    count = len(handles)
    room = letters // (1 + (count > 5 and letters > MANY)) - SIGN
    labels = [in_lines(str(one.get_label()), room) for one in handles]
    longest = lambda lines: max(map(len, FORMULA.sub("x", lines).split("\n")))
    widths = [SIGN + longest(one) for one in labels]
    wide = lambda columns: sum(part.max() for part in np.array_split(widths, columns))
    rows = math.ceil(count / max((n for n in range(1, count + 1) if wide(n) <= letters), default=1))
    rows = max(rows, 1)
    return {"handles": handles, "labels": labels, "ncols": math.ceil(count / rows)}


def figure_legend(axes: Iterable[Axes], signs: Iterable[Artist] = (), note: str = "") -> None:
    """Put a legend at the left, below all axes of a figure, under a note.

    It has what is labelled on some of the axes, and then the given signs, each label and colour
    once.
    """
    axes = [*axes]
    labelled = chain(*(ax.get_legend_handles_labels()[0] for ax in axes), signs)
    colour = lambda one: str(one.get_facecolor() if isinstance(one, Patch) else one.get_color())
    handles = [*{(one.get_label(), colour(one)): one for one in labelled}.values()]
    figure = figure_of(axes[0])
    wide = letters_in(figure.get_figwidth(), "legend.fontsize")
    above: Any = in_lines(note, wide) or None
    look: Any = {"loc": "outside lower left", "frameon": False, "alignment": "left"}
    figure.legend(**in_columns(handles, wide), title=above, **look)


def chosen_title(style: Style, title: str) -> str:
    """Return the title of a picture, as its style says; by default none in print."""
    own = style.get("title", page_width.get() is None)
    return own if isinstance(own, str) else title * own


def figure_title(figure: Figure, title: str, style: Style | None = None) -> None:
    """Write a title at the left, above all axes of a figure."""
    if title := chosen_title(style or {}, title):
        most = letters_in(figure.get_figwidth() / WIDER, "figure.titlesize")
        figure.suptitle(in_lines(title, most), x=0.01, ha="left", weight="bold")

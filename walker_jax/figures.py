"""Pictures of results: one function a picture, which computes nothing and returns its Axes.

Each takes a result and draws it on `ax`, or on a figure of its own that no window, and no state of
pyplot, knows of: `figures.basin(data).figure.savefig("basin.png", dpi=150)`. Angles are in rad and
times in sqrt(l / g), with leg length l and gravity g. Colours differ in lightness as well as hue,
so that they are told apart in grey print and by the colour-blind.
"""

from typing import NamedTuple, cast

import numpy as np
import xarray as xr
from jaxtyping import Bool, Float
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from matplotlib.patches import Patch
from matplotlib.transforms import offset_copy

from walker_jax.stride import Outcome

INK = "#1a1a1a"
FAILURES = {
    Outcome.LEFT_GRID: ("#f7f7f7", "", "leaves the grid"),
    Outcome.BACKWARD: ("#fae0b5", "B", "falls backward"),
    Outcome.FORWARD: ("#b4d1e9", "F", "falls forward"),
    Outcome.RUNNING: ("#dea5b2", "R", "runs"),
    Outcome.OUTSIDE: ("#9b9b9b", "", "not a feasible start"),
    Outcome.STOPPED: ("#648f4b", "", "stops on both feet"),
    Outcome.UNDECIDED: ("#d1361b", "", "undecided"),
}
"""Colour, letter (Schwab and Wisse 2001, Figure 2) and words, from light to dark."""
BASINS = ("#0d2c5e", "#8c2566", "#0f7a72")
MARKERS = "os^"
"""Colours of the basins, from dark to light, and signs of their attractors; the largest first."""
OTHERS, ASTRAY = "#4d4d4d", "#7a5c00"
"""Colours of what walks on to other attractors, and to none that is known."""
NOTABLE = 0.1
"""Share of the walking cells that a basin must have for a colour of its own.

Cell mapping makes small cycles of its own beside a true attractor, each with a few cells.
"""
AXIS_LABELS = {
    "theta": r"stance leg angle $\theta$ (rad)",
    "thetadot": r"stance leg rate $\dot{\theta}$ (rad, time in √(l/g))",
    "sum": r"$\theta + \dot{\theta}$ (rad, time in √(l/g))",
}
METHODS = {"cell-map": "cell mapping", "direct": "direct iteration"}
LETTER, WORDS = 16, 9
"""Sizes of the two lines of a label (points)."""
BELOW, LINE = 40, 17
"""How far the legend stands below the axes, and its lines below one another (points)."""


class Region(NamedTuple):
    """Cells that share a colour."""

    cells: Bool[np.ndarray, "nx ny"]
    colour: str
    letter: str
    """The first line of its label; empty where it has only one."""
    words: str
    """The other line."""
    counted: bool = False
    """Whether the legend tells how many cells there are even where the label has room."""


def basin(data: xr.Dataset, ax: Axes | None = None) -> Axes:
    """The basin of attraction and the ways to fall around it, over a grid of two dimensions.

    Figures 2 (plain axes) and 4 (sheared ones) of Schwab and Wisse (2001). Each fate has a pale
    colour and each basin a dark one. The basins of a few cells share a colour. A region is
    labelled where there is room in it, and in the legend otherwise, with the number of its cells.
    Dots are the attractors of the large basins.

    **Arguments:**

    - `data`: what `walker_jax.basin` returns. The first dimension is drawn along the x axis.
    - `ax`: where to draw; by default, on a new figure of 7 by 5.4 inches.

    **Returns** the axes. Raises `ValueError` for a data set that is not of two dimensions, with
    two cells or more along each.
    """
    if "fate" not in data or data["fate"].ndim != 2 or min(data["fate"].shape) < 2:
        dimensions = dict(data["fate"].sizes) if "fate" in data else "no fate"
        raise ValueError(f"data must have a fate over 2 x 2 cells or more, not {dimensions}")
    data = data.assign_coords(coordinate=data.attrs["section"])
    fate = data["fate"]
    if ax is None:
        ax = Figure(figsize=(7, 5.4), layout="constrained").add_subplot()

    notable = notable_attractors(data)
    regions = regions_of(data, notable)
    image = np.zeros((*fate.shape, 3), np.uint8)
    for region in regions:
        image[region.cells] = np.round(np.multiply(to_rgb(region.colour), 255))
    x, y = map(str, fate.dims)
    extent = (*ends(data[x].values), *ends(data[y].values))
    ax.imshow(
        image.swapaxes(0, 1),
        origin="lower",
        extent=extent,
        aspect="auto",
        interpolation="auto",
        rasterized=True,
    )

    free = np.ones(fate.shape, bool)
    marks, patches = [], []
    for number, marker in zip(notable, MARKERS, strict=False):
        cycle = data["states"].sel(number=number).dropna("phase")
        dots = np.column_stack([along(cycle, x), along(cycle, y)])
        inside = (dots >= extent[::2]) & (dots <= extent[1::2])
        name = attractor_name(int(data["period"].sel(number=number)), cycle)
        marks += ax.plot(
            *dots.T,
            marker,
            color=INK,
            markeredgecolor="white",
            markeredgewidth=1.2,
            markersize=7.5,
            label=name if inside.all(axis=1).any() else f"{name} (not in the picture)",
        )
        keep_clear(free, dots, extent)
    for region in regions:
        if not draw_label(ax, region, free, extent) or region.counted:
            patches.append(Patch(fc=region.colour, ec=INK, lw=0.5, label=entry(region)))
    place_legend(ax, marks, BELOW, columns=1)
    place_legend(ax, patches, BELOW + LINE * len(marks), columns=2)
    ax.set(xlim=extent[:2], ylim=extent[2:])
    ax.set_xlabel(AXIS_LABELS.get(x, x), fontsize=11)
    ax.set_ylabel(AXIS_LABELS.get(y, y), fontsize=11)
    ax.set_title(title(data), loc="left", fontsize=12, fontweight="bold", pad=22)
    note = subtitle(data)
    ax.annotate(note, (0, 1), (0, 7), "axes fraction", "offset points", fontsize=9.5)
    return ax


def notable_attractors(data: xr.Dataset) -> list[int]:
    """Numbers of the attractors whose basins are drawn each in a colour, the largest first."""
    walks = data["fate"].values == Outcome.STRIDE
    numbers, cells = np.unique(data["attractor"].values[walks], return_counts=True)
    large = (numbers >= 0) & (cells >= NOTABLE * walks.sum())
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
    others = walks & known & ~np.isin(attractor, notable)
    found.append(Region(others, OTHERS, "", "other attractors", counted=True))
    found.append(Region(walks & ~known, ASTRAY, "", "walks on, near no attractor", counted=True))
    for outcome, (colour, letter, words) in FAILURES.items():
        counted = outcome == Outcome.UNDECIDED
        found.append(Region(fate == outcome, colour, letter, words, counted))
    return [region for region in found if region.cells.any()]


def ends(centres: Float[np.ndarray, " n"]) -> tuple[float, float]:
    """The outer edges of equal cells."""
    half = (centres[-1] - centres[0]) / (len(centres) - 1) / 2
    return float(centres[0] - half), float(centres[-1] + half)


def along(states: xr.DataArray, axis: str) -> Float[np.ndarray, " n"]:
    """Where states lie along an axis of the picture; NaN where the data set does not tell."""
    if axis == "sum":
        return along(states, "theta") + along(states, "thetadot")
    if axis not in states["coordinate"]:
        return np.full(states.sizes["phase"], np.nan)
    return states.sel(coordinate=axis).values


def attractor_name(period: int, cycle: xr.DataArray) -> str:
    """What the legend says of an attractor: its period, and up to two of its states."""
    symbols = {"theta": r"$\theta$", "thetadot": r"$\dot{\theta}$"}
    names = [symbols.get(name, str(name)) for name in cycle["coordinate"].values.tolist()]
    states = [", ".join(f"{value:.4f}" for value in state) for state in cycle.values.tolist()]
    shown = ", ".join(f"({state})" for state in states[:2]).replace("-", "−")
    more = ", …" if len(states) > 2 else ""
    kind = {0: "a state of the attractor", 1: "attractor"}.get(
        period, f"attractor of period {period}"
    )
    return f"{kind}: ({', '.join(names)}) = {shown}{more}"


def entry(region: Region) -> str:
    """What the legend says of a region."""
    count = int(region.cells.sum())
    return f"{region.words} ({count:,} cell{'s' * (count > 1)})"


def title(data: xr.Dataset) -> str:
    """The walker and its parameters."""
    name = str(data.attrs.get("walker", "Walker"))
    parameters = [
        f"{key.removeprefix('walker_')} {value:g}" + " rad" * (key == "walker_slope")
        for key, value in data.attrs.items()
        if str(key).startswith("walker_")
    ]
    return ", ".join([name, *parameters])


def subtitle(data: xr.Dataset) -> str:
    """The method, the number of cells, and the area of all basins together."""
    method = data.attrs.get("method", "")
    nx, ny = data["fate"].shape
    said = f"{METHODS.get(method, method)} on {nx} × {ny} cells"
    area = float(data["area"].sum())
    if data.sizes["coordinate"] != 2 or area == 0:
        return said
    mantissa, exponent = f"{area:.2e}".split("e")
    return rf"{said}; basin area {mantissa} × 10$^{{{int(exponent)}}}$ rad² / √(l/g)"


def place_legend(ax: Axes, handles: list, drop: int, *, columns: int) -> None:
    """A legend at the left, `drop` points below the axes."""
    if handles:
        figure = cast(Figure, ax.get_figure(root=True))
        legend = Legend(
            ax,
            handles,
            [handle.get_label() for handle in handles],
            loc="upper left",
            bbox_to_anchor=(0, 0),
            bbox_transform=offset_copy(ax.transAxes, figure, y=-drop, units="points"),
            borderaxespad=0,
            borderpad=0,
            ncols=columns,
            frameon=False,
            fontsize=WORDS,
        )
        ax.add_artist(legend).set_clip_on(False)


def draw_label(
    ax: Axes,
    region: Region,
    free: Bool[np.ndarray, "nx ny"],
    extent: tuple[float, float, float, float],
) -> bool:
    """Label a region inside itself, with letter and words, or the letter alone, as there is room.

    `free` is where labels may stand. Returns whether there was room for the words.
    """
    letter = [(region.letter, LETTER, "bold", 0)]
    words = [(region.words, WORDS, "normal", 0)]
    both = [(region.letter, LETTER, "bold", 5.5), (region.words, WORDS, "normal", -8.5)]
    colour = "white" if luminance(region.colour) < 0.2 else INK
    low, high = np.array(extent[::2]), np.array(extent[1::2])
    axes_size = np.array(ax.bbox.size) * 72 / ax.figure.dpi
    for lines in (both, letter) if region.letter else (words,):
        width = max(size * (0.6 * len(text) + 0.5) for text, size, *_ in lines)
        height = sum(1.15 * size for _, size, *_ in lines)
        place = roomiest(region.cells & free, np.array([width, height]) / axes_size)
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
            )
        return lines is not letter
    return False


def keep_clear(
    free: Bool[np.ndarray, "nx ny"],
    dots: Float[np.ndarray, "n 2"],
    extent: tuple[float, float, float, float],
) -> None:
    """Mark, in `free`, that labels are not to stand on dots."""
    shape, low = np.array(free.shape), np.array(extent[::2])
    for dot in np.nan_to_num((dots - low) / (np.array(extent[1::2]) - low), nan=-1):
        first, last = (np.clip(dot + side * 0.02, 0, 1) * shape for side in (-1, 1))
        free[int(first[0]) : int(last[0]) + 1, int(first[1]) : int(last[1]) + 1] = False


def roomiest(
    cells: Bool[np.ndarray, "nx ny"], size: Float[np.ndarray, " 2"]
) -> Float[np.ndarray, " 2"] | None:
    """Where, among the cells, a box has the most room around it; None where it does not fit.

    Box and place are fractions of the axes. The box is grown in proportion while it fits. It fits
    where one cell in fifty of it, at most, is not among `cells`.
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
        held = total[nx:, ny:] - total[:-nx, ny:] - total[nx:, :-ny] + total[:-nx, :-ny]
        fits = np.argwhere(held >= 0.98 * nx * ny)
        if len(fits) == 0:
            break
        middle = fits[np.abs(fits - fits.mean(axis=0)).sum(axis=1).argmin()]
        place = (middle + np.array([nx, ny]) / 2) / shape
    return place


def luminance(colour: str) -> float:
    """Relative luminance of an sRGB colour, 0 for black to 1 for white (WCAG 2)."""
    rgb = np.array(to_rgb(colour))
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    return float(linear @ (0.2126, 0.7152, 0.0722))

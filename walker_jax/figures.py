"""Pictures of results: one function a picture, which computes nothing and returns its Axes.

Each takes a result and draws it on `ax`, or on a figure of its own that no window, and no state of
pyplot, knows of: `figures.basin(data).figure.savefig("basin.png", dpi=150)`. Angles are in rad and
times in sqrt(l / g), with leg length l and gravity g. Colours differ in lightness as well as hue,
so that they are told apart in grey print and by the colour-blind.
"""

import json
import math
import textwrap
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any, NamedTuple, cast

import numpy as np
import xarray as xr
from jaxtyping import Bool, Complex, Float, Int8, UInt8
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch
from matplotlib.transforms import offset_copy

from walker_jax.basin import artefacts
from walker_jax.checks import WrongUse
from walker_jax.design import ATTRACTED, ENDS
from walker_jax.gaits import Gait
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
ARTEFACTS = "#8a63b8"
"""Colour of what walks on in cycles that cell mapping makes up."""
NOTABLE = 0.1
"""Share of the walking cells that a basin must have for a colour of its own."""
AREA = "area of the basin (rad² / √(l/g))"
AXIS_LABELS = {
    "theta": r"stance leg angle $\theta$ (rad)",
    "thetadot": r"stance leg rate $\dot{\theta}$ (rad, time in √(l/g))",
    "sum": r"$\theta + \dot{\theta}$ (rad, time in √(l/g))",
    "slope": "slope (rad)",
}
METHODS = {
    "cell-map": "cell mapping",
    "direct": "direct iteration",
    "direct, refined": "direct iteration, refined,",
}
MEASURES = {
    "total_area": (BASINS[0], "-o", "area of the basin"),
    "least_disturbance": (BASINS[1], "-s", "least disturbance"),
    "multiplier": (INK, "--", "modulus of the largest multiplier"),
}
"""Colour, line and words of each measure of robustness."""
OBJECTIVES = {
    "area": "area of the basin",
    "spectral-radius": "modulus of the largest multiplier",
}
"""Words of the objectives whose own name is not as good."""
STAGES = (
    ("#a9bfe3", 8.5, "long steps"),
    ("#7391c9", 7, "medium"),
    ("#3f5f9f", 5.5, "short"),
    (BASINS[0], 4, "very short"),
)
"""Colour, size and words of the evaluations in each stage of an optimisation."""
FAINT = 0.45
"""Opacity of the runs that did not lead to the optimum."""
WHOLE: dict[str, Any] = {"clip_on": False, "in_layout": False}
"""Signs that bounds do not cut; the layout must not count them, as it puts an empty line at 0."""
SCAN, BARRED = "#9b9b9b", "#ebebeb"
"""Colours of the scan, and behind what limits do not allow."""
WINDOW = 1.25
"""Half the width of the picture of the least disturbance, to the width of its curve."""
LETTER, WORDS = 16, 9
"""Sizes of the two lines of a label (points)."""
BELOW, LINE = 40, 17
"""How far the legend stands below the axes, and its lines below one another (points)."""
PERIODS = (
    (INK, "o"),
    ("#4a1a86", "s"),
    ("#8f1230", "^"),
    ("#04599b", "D"),
    ("#187d4b", "v"),
    ("#c6691d", "P"),
    ("#d377b4", "X"),
    ("#dfac02", "h"),
)
"""Colours, from dark to light, and signs of gaits of period 1, 2, ..."""
LONGER = ("#9b9b9b", "*")
"""Those of longer periods."""
GAITS = (
    *("branch", "period", "value", "states", "step_times", "multipliers", "stable", "on_cascade"),
    *("event_fold", "event_branch", "event_period", "event_value", "event_states"),
    *("event_multipliers", "cascade"),
)
ATTRACTORS = ("sample_value", "fate", "orbit", "lost")
"""What the pictures of bifurcations take from a data set."""
LOSS = "#b3261e"
"""Colour of the value at which walking is lost."""
SOLID: dict[str, Any] = {"lw": 2, "ls": "-"}
DASHED: dict[str, Any] = {"lw": 0.7, "ls": (0, (6, 3))}
"""Lines of stable and of unstable gaits."""
FOLD: dict[str, Any] = {"marker": "<", "ms": 6, "mfc": "white", "mew": 1, "ls": ""}
DOUBLING: dict[str, Any] = {"marker": "o", "ms": 4.5, "mec": "white", "mew": 0.5, "ls": ""}
"""Signs of bifurcations."""
TITLE: dict[str, Any] = {"loc": "left", "fontsize": 12, "fontweight": "bold", "pad": 18}
HIGHEST = 2
"""Largest modulus of a multiplier in a picture of it against a parameter."""
FRAME = 2.5
"""Largest real and imaginary part of a multiplier in the picture of the complex plane."""
ROW, ROWS = 13, 8
"""Height (points) of a line on multipliers beyond the frame, and how many stand at one place."""


PANELS = 6
"""Slices in a picture of a basin of three dimensions, at most."""
SYMBOLS = {"theta": r"$\theta$", "thetadot": r"$\dot{\theta}$", "phidot": r"$\dot{\varphi}$"}


class Region(NamedTuple):
    """Cells that share a colour."""

    cells: Bool[np.ndarray, "*shape"]
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
    colour and each basin a dark one. The basins of a few cells share a colour, and so do artefacts
    of cell mapping. A region is labelled where there is room in it, and in the legend otherwise,
    with the number of its cells. Dots are the attractors of the large basins.

    **Arguments:**

    - `data`: what `walker_jax.basin` returns. The first dimension is drawn along the x axis.
    - `ax`: where to draw; by default, on a new figure of 7 by 5.4 inches.

    **Returns** the axes. Raises `ValueError` for a data set that is not of two dimensions, with
    two cells or more along each.
    """
    if "fate" not in data or data["fate"].ndim != 2 or min(data["fate"].shape) < 2:
        dimensions = dict(data["fate"].sizes) if "fate" in data else "no fate"
        instead = slices_of(data)
        raise WrongUse(f"data must have a fate over 2 x 2 cells or more, not {dimensions}{instead}")
    data = data.assign_coords(coordinate=data.attrs["section"])
    fate = data["fate"]
    if ax is None:
        ax = Figure(figsize=(7, 5.4), layout="constrained").add_subplot()

    notable = notable_attractors(data)
    regions = regions_of(data, notable)
    image = painted(regions, fate.shape)
    x, y = map(str, fate.dims)
    extent = (*ends(data[x].values), *ends(data[y].values))
    show(ax, image, extent)

    free, share = np.ones(fate.shape, bool), drawn(data)
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
            patches.append(Patch(fc=region.colour, ec=INK, lw=0.5, label=entry(region, share)))
    place_legend(ax, marks, BELOW, columns=1)
    place_legend(ax, patches, BELOW + LINE * len(marks), columns=2)
    ax.set(xlim=extent[:2], ylim=extent[2:])
    ax.set_xlabel(AXIS_LABELS.get(x, x), fontsize=11)
    ax.set_ylabel(AXIS_LABELS.get(y, y), fontsize=11)
    note, name = subtitle(data), title(data)
    size, pad = (10.5 if "\n" in name else 12), 22 + 12 * note.count("\n")
    ax.set_title(name, loc="left", fontsize=size, fontweight="bold", pad=pad)
    ax.annotate(note, (0, 1), (0, 7), "axes fraction", "offset points", fontsize=9.5)
    return ax


def slices_of(data: xr.Dataset) -> str:
    """What to do with a basin of three dimensions where one of two is drawn."""
    dimensions = data["fate"].dims if "fate" in data and "number" in data.dims else ()
    others = [name for name in dimensions if name not in ("theta", "thetadot", "sum")]
    if len(dimensions) != 3 or len(others) != 1:
        return ""
    return f": take a slice, data.isel({others[0]}=0), or draw several, basin_slices(data)"


def basin_slices(data: xr.Dataset) -> Figure:
    """The basin of attraction over a grid of three dimensions, in slices across the last.

    Colours as in `basin`. Attractors are drawn in the slice that is nearest to them.

    **Arguments:**

    - `data`: what `walker_jax.basin` returns.

    **Returns** a figure of up to six panels, evenly spaced. Raises `ValueError` for a data set that
    is not of three dimensions, with two cells or more along the first two.
    """
    if "fate" not in data or data["fate"].ndim != 3 or min(data["fate"].shape[:2]) < 2:
        dimensions = dict(data["fate"].sizes) if "fate" in data else "no fate"
        raise WrongUse(f"data must have a fate over 2 x 2 x 1 cells or more, not {dimensions}")
    data = data.assign_coords(coordinate=data.attrs["section"])
    fate = data["fate"]
    x, y, z = map(str, fate.dims)
    depths = data[z].values
    panels = min(PANELS, len(depths))
    chosen = np.round(np.linspace(0, len(depths) - 1, panels + 2)[1:-1]).astype(int)
    chosen = np.unique(chosen) if len(depths) > panels else np.arange(len(depths))
    columns = min(3, len(chosen))
    rows = -(-len(chosen) // columns)
    figure = Figure(figsize=(3.1 * columns + 0.6, 2.7 * rows + 1.5), layout="constrained")
    grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)

    notable = notable_attractors(data)
    regions = regions_of(data, notable)
    image = painted(regions, fate.shape)
    extent = (*ends(data[x].values), *ends(data[y].values))
    marks: dict[str, Any] = {}
    for ax, index in zip(grid.flat, chosen, strict=False):
        show(ax, image[:, :, index], extent)
        symbol = SYMBOLS.get(z, z)
        ax.set_title(f"{symbol} = {depths[index]:.4g}".replace("-", "−"), fontsize=10)
    for number, marker in zip(notable, MARKERS, strict=False):
        cycle = data["states"].sel(number=number).dropna("phase")
        name = attractor_name(int(data["period"].sel(number=number)), cycle)
        places = (along(cycle, axis) for axis in (x, y, z))
        for at_x, at_y, at_z in zip(*places, strict=True):
            ax = grid.flat[int(np.abs(depths[chosen] - at_z).argmin())]
            (marks[name],) = ax.plot(
                *(at_x, at_y, marker), color=INK, mec="white", mew=1.2, ms=7, label=name
            )
    for ax in grid.flat[len(chosen) :]:
        ax.set_visible(False)
    grid[0, 0].set(xlim=extent[:2], ylim=extent[2:])
    for index in range(columns):
        grid[-1, index].set_xlabel(AXIS_LABELS.get(x, x), fontsize=WORDS)
    for ax in grid[:, 0]:
        ax.set_ylabel(AXIS_LABELS.get(y, y), fontsize=WORDS)
    share = drawn(data)
    patches = [Patch(fc=r.colour, ec=INK, lw=0.5, label=entry(r, share)) for r in regions]
    above = f"{title(data, 34 * columns)}\n{subtitle(data)}"
    figure.suptitle(above, x=0.01, ha="left", fontsize=10.5)
    figure.legend(
        handles=[*marks.values(), *patches],
        loc="outside lower left",
        ncols=2,
        frameon=False,
        fontsize=WORDS,
    )
    return figure


def basins_in_a_row(data: xr.Dataset) -> Figure:
    """Basins of attraction at several slopes, side by side, with colours as in `basin`.

    Figure 7 of Schwab and Wisse (2001).

    **Arguments:**

    - `data`: `fate` and `attractor` over `slope` and two axes of the section, and over `slope` the
      `area` of all basins.

    **Returns** the figure, of three panels in a row.
    """
    slopes, (x, y) = data["slope"].values.tolist(), map(str, data["fate"].dims[1:])
    rows = -(-len(slopes) // 3)
    figure = Figure(figsize=(10, 3 * rows + 0.9), layout="constrained")
    panels = figure.subplots(rows, 3, sharex=True, sharey=True, squeeze=False)
    fate, attractor = data["fate"].values, data["attractor"].values
    walks = fate == Outcome.STRIDE
    found = [
        Region(walks & (attractor >= 0), BASINS[0], "A", "basin of attraction"),
        Region(walks & (attractor < 0), ASTRAY, "", "walks on, near no attractor"),
        *failures(fate),
    ]
    regions = [region for region in found if region.cells.any()]
    extent = (*ends(data[x].values), *ends(data[y].values))
    image = painted(regions, fate.shape)
    for k, ax in enumerate(panels.flat):
        if k >= len(slopes):
            ax.set_visible(False)
            continue
        show(ax, image[k], extent)
        area = float(data["area"][k])
        note = area_of_basin(area) if area else "no basin of attraction"
        ax.set_title(f"slope {slopes[k]:g} rad", **TITLE | {"fontsize": 10, "pad": 16})
        ax.annotate(note, (0, 1), (0, 5), "axes fraction", "offset points", fontsize=8)
    for ax in panels[-1]:
        ax.set_xlabel(AXIS_LABELS.get(x, x), fontsize=WORDS)
    for ax in panels[:, 0]:
        ax.set_ylabel(AXIS_LABELS.get(y, y), fontsize=WORDS)
    patches = [Patch(fc=region.colour, ec=INK, lw=0.5, label=region.words) for region in regions]
    figure.legend(handles=patches, loc="outside lower left", ncols=3, frameon=False, fontsize=WORDS)
    return figure


def stability_and_area(gaits: xr.Dataset, sizes: xr.Dataset, ax: Axes | None = None) -> Axes:
    """Modulus of the largest multiplier of the gait, and area of the basin, against the slope.

    Figure 8 of Schwab and Wisse (2001).

    **Arguments:**

    - `gaits`: what `walker_jax.bifurcation_diagram` returns, over the slope.
    - `sizes`: over `slope`, the `mapped_area` by cell mapping, and the `area` by refinement, NaN
      where it is not known.
    - `ax`: where to draw; by default, on a new figure of 8 by 4.8 inches.

    **Returns** the axes, of the multiplier; those of the area share it.
    """
    check(gaits, GAITS)
    if ax is None:
        ax = Figure(figsize=(8, 4.8), layout="constrained").add_subplot()
    ax.axhline(1, color=INK, lw=0.8, zorder=1)
    colour, slopes = MEASURES["multiplier"][0], sizes["slope"].values
    for curve in map(refined, cascade(gaits)[:1]):
        draw_curve(ax, curve, np.abs(curve.multipliers).max(axis=1, keepdims=True))
    ax.set(xlim=(0, 1.02 * slopes.max()), ylim=(0, HIGHEST))
    ax.set_xlabel(AXIS_LABELS["slope"], fontsize=11)
    ax.set_ylabel("modulus of the largest multiplier", fontsize=11)
    other = ax.twinx()
    areas = other.plot(
        slopes, sizes["mapped_area"], "s", color=BASINS[1], ms=5, mfc="none", label="cell mapping"
    )
    known = np.isfinite(sizes["area"].values)
    if known.any():
        areas += other.plot(
            *(slopes[known], sizes["area"].values[known], "-o"),
            color=BASINS[0],
            ms=3,
            label="refined, exact to the width of the line",
        )
    other.set_ylim(0)
    other.set_ylabel(AREA, fontsize=11, color=BASINS[0])
    write_title(ax, "Stability of the gait, and area of its basin", "SimplestWalker")
    line = Line2D([], [], color=colour, **SOLID, label="largest multiplier; dashed: unstable")
    place_legend(ax, [line], BELOW, columns=1)
    for handle in areas:
        handle.set_label(f"area, {handle.get_label()}")
    place_legend(ax, areas, BELOW + LINE, columns=2)
    return ax


def notable_attractors(data: xr.Dataset) -> list[int]:
    """Numbers of the attractors whose basins are drawn each in a colour, the largest first."""
    walks = data["fate"].values == Outcome.STRIDE
    numbers, cells = np.unique(data["attractor"].values[walks], return_counts=True)
    real = np.isin(numbers, np.flatnonzero(~artefacts(data)))
    large = real & (cells >= NOTABLE * walks.sum())
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
    made_up = walks & np.isin(attractor, np.flatnonzero(artefacts(data)))
    others = walks & known & ~made_up & ~np.isin(attractor, notable)
    found.append(Region(others, OTHERS, "", "other attractors", counted=True))
    found.append(Region(made_up, ARTEFACTS, "", "artefacts of cells", counted=True))
    found.append(Region(walks & ~known, ASTRAY, "", "walks on, near no attractor", counted=True))
    return [region for region in (*found, *failures(fate)) if region.cells.any()]


def failures(fate: Int8[np.ndarray, "*shape"]) -> list[Region]:
    """The regions of all failures, whether there are any or not."""
    return [
        Region(fate == outcome, colour, letter, words, counted=outcome == Outcome.UNDECIDED)
        for outcome, (colour, letter, words) in FAILURES.items()
    ]


def painted(regions: list[Region], shape: tuple[int, ...]) -> UInt8[np.ndarray, "*shape 3"]:
    """Every cell in the colour of its region."""
    image = np.zeros((*shape, 3), np.uint8)
    for region in regions:
        image[region.cells] = np.round(np.multiply(to_rgb(region.colour), 255))
    return image


def show(
    ax: Axes, image: UInt8[np.ndarray, "nx ny 3"], extent: tuple[float, float, float, float]
) -> None:
    """An image of cells, the first axis along x."""
    ax.imshow(
        image.swapaxes(0, 1),
        origin="lower",
        extent=extent,
        aspect="auto",
        interpolation="auto",
        rasterized=True,
    )


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
    names = [SYMBOLS.get(name, str(name)) for name in cycle["coordinate"].values.tolist()]
    states = [", ".join(f"{value:.4f}" for value in state) for state in cycle.values.tolist()]
    shown = ", ".join(f"({state})" for state in states[:2]).replace("-", "−")
    more = ", …" if len(states) > 2 else ""
    kind = {0: "a state of the attractor", 1: "attractor"}.get(
        period, f"attractor of period {period}"
    )
    return f"{kind}: ({', '.join(names)}) = {shown}{more}"


def entry(region: Region, share: int) -> str:
    """What the legend says of a region, of whose cells one in so many is drawn."""
    count = int(region.cells.sum()) * share
    about = "about " * (share > 1)
    return f"{region.words} ({about}{count:,} cell{'s' * (count > 1)})"


def sweep(data: xr.Dataset, ax: Axes | None = None) -> Axes:
    """The area of the basin over one or two parameters, with its standard error over one.

    **Arguments:**

    - `data`: what `walker_jax.sweep` returns. Of three parameters and more, the others are at their
      first values.
    - `ax`: where to draw; by default, on a new figure of 7 by 4.8 inches.

    **Returns** the axes.
    """
    ax = Figure(figsize=(7, 4.8), layout="constrained").add_subplot() if ax is None else ax
    area, error = data["total_area"], data["total_area_error"]
    others = [str(name) for name in area.dims[2:]]
    at = {name: 0 for name in others}
    area, error = area.isel(at), error.isel(at)
    x = str(area.dims[0])
    ax.set_xlabel(named(x), fontsize=11)
    if area.ndim == 1:
        ax.errorbar(data[x], area, error, fmt="o-", color=BASINS[0], capsize=3)
        ax.set_ylabel(AREA, fontsize=11)
        ax.set_ylim(0, 1.1 * float(area.fillna(0).max()) or None)
    else:
        y = str(area.dims[1])
        image = ax.pcolormesh(data[x], data[y], area.T, cmap="viridis", rasterized=True)
        ax.set_ylabel(named(y), fontsize=11)
        bar = ax.figure.colorbar(image, ax=ax)
        bar.set_label(AREA, fontsize=11)
    held = valued({name: float(data[name][0]) for name in others})
    shape = " × ".join(map(str, data["total_area"].shape))
    failed = int(data["failed"].sum())
    note = listed([f"{shape} basins", *held, *([f"{failed} failed"] if failed else [])], 60)
    write_title(ax, title(data), note)
    return ax


def named(parameter: str) -> str:
    """A parameter, as the label of an axis."""
    return AXIS_LABELS.get(parameter, parameter.replace("_", " "))


def thinned(data: xr.Dataset, most: int = 2000) -> xr.Dataset:
    """Of many cells, some rows and columns, so many at most: enough for a picture."""
    over = {dim: -(-size // most) for dim, size in data["fate"].sizes.items()}
    some = data.isel({dim: slice(step // 2, None, step) for dim, step in over.items()})
    return some.assign_attrs(shape=list(data["fate"].shape), thinned=math.prod(over.values()))


def drawn(data: xr.Dataset) -> int:
    """One in so many cells is there."""
    return int(data.attrs.get("thinned", 1))


def title(data: xr.Dataset, width: int = 60) -> str:
    """The walker and its parameters, in lines of some width."""
    name = str(data.attrs.get("walker", "Walker"))
    parameters = {
        str(key).removeprefix("walker_"): value
        for key, value in data.attrs.items()
        if str(key).startswith("walker_")
    }
    return listed([name, *valued(parameters)], width)


def valued(parameters: Mapping[str, float]) -> list[str]:
    """Parameters with their values."""
    return [
        f"{name.replace('_', ' ')} {value:g}" + " rad" * (name == "slope")
        for name, value in parameters.items()
    ]


def listed(things: Sequence[str], width: int) -> str:
    """Things that are told one after another, in lines of some width, which break between them."""
    whole = [words.replace(" ", "\u00a0") for words in things]
    return textwrap.fill(", ".join(whole), width).replace("\u00a0", " ")


def subtitle(data: xr.Dataset) -> str:
    """The method, the number of cells, and the area of all basins together."""
    method = data.attrs.get("method", "")
    shape = data.attrs.get("shape", data["fate"].shape)
    said = f"{METHODS.get(method, method)} on {' × '.join(map(str, shape))} cells"
    held = [name for name in data.attrs["section"] if name in data.coords and not data[name].ndim]
    for name in held:
        said += f"\n{in_slice(name, float(data[name]))}"
    area = float(data["area"].sum())
    return said if data["fate"].ndim != 2 or area == 0 else f"{said}; {area_of_basin(area)}"


def in_slice(name: str, value: float) -> str:
    """Where the plane of a picture is."""
    return f"in the slice at {SYMBOLS.get(name, name)} = {value:.4g}".replace("-", "−")


def area_of_basin(area: float) -> str:
    """An area, with its unit."""
    mantissa, exponent = f"{area:.2e}".split("e")
    return rf"basin area {mantissa} × 10$^{{{int(exponent)}}}$ rad² / √(l/g)"


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


class Curve(NamedTuple):
    """A branch of gaits, with its bifurcations in their places among its points."""

    number: int
    """Of the branch."""
    period: int
    value: Float[np.ndarray, " n"]
    """Of the parameter."""
    states: Float[np.ndarray, "n period"]
    """The first coordinate at the start of each stride."""
    multipliers: Complex[np.ndarray, "n order"]
    stable: Bool[np.ndarray, " n"]
    """True for bifurcations too, at which both stable and unstable parts may end."""


def gait_branches(data: xr.Dataset, ax: Axes | None = None) -> Axes:
    """All gaits against a parameter: the first coordinate at the start of each of their strides.

    Figure 3 of Schwab and Wisse (2001), for gaits of every period. Colours tell periods. Lines are
    solid where a gait is stable and dashed where it is not. Triangles are folds, where two gaits
    are born, and dots are period doublings. At the right stand the step times, at the end of the
    range, of the gaits of period one.

    **Arguments:**

    - `data`: what `walker_jax.bifurcations.bifurcation_diagram` returns.
    - `ax`: where to draw; by default, on a new figure of 7 by 5.6 inches.

    **Returns** the axes. Raises `ValueError` for a data set without branches of gaits.
    """
    check(data, GAITS)
    if ax is None:
        ax = Figure(figsize=(7, 5.6), layout="constrained").add_subplot()
    drawn = curves(data)
    for curve in drawn:
        draw_curve(ax, curve, curve.states)
    folds, values = data["event_fold"].values, data["event_value"].values
    periods, states = data["event_period"].values.tolist(), first(data["event_states"])
    for period, fold, value, cycle in zip(periods, folds, values, states, strict=True):
        draw_event(ax, np.full(period, value), cycle[:period], period, fold=bool(fold))
    branches, fold, doubling = (
        counted(count, word)
        for count, word in (
            (len(drawn), "branch"),
            (int(folds.sum()), "fold"),
            (int((~folds).sum()), "period doubling"),
        )
    )
    dress(ax, data, "gaits", f"{branches} with {fold} and {doubling}")
    ax.set_ylabel(first_label(data), fontsize=11)
    write_step_times(ax, data)
    kinds = []
    for name, found, style in (
        ("stable", data["stable"].values, SOLID),
        ("unstable", ~data["stable"].values, DASHED),
        ("fold", folds, FOLD),
        ("period doubling", ~folds, DOUBLING),
    ):
        if found.any():
            kinds.append(Line2D([], [], color=INK, label=name, **style))
    periods = period_lines({curve.period for curve in drawn})
    place_legend(ax, kinds, BELOW, columns=4)
    place_legend(ax, periods, BELOW + LINE * bool(kinds), columns=4)
    return ax


def largest_multiplier(data: xr.Dataset, ax: Axes | None = None) -> Axes:
    """Modulus of the largest multiplier against a parameter, along a cascade of period doublings.

    The left axis of Figure 8 of Schwab and Wisse (2001), for the most stable gait of period one,
    the gaits of period two that leave it, and so on. A gait is stable, and its line solid, where
    the modulus is below one. Between two points of a branch, the coefficients of the polynomial
    whose roots the multipliers are change linearly.

    **Arguments:**

    - `data`: what `walker_jax.bifurcations.bifurcation_diagram` returns.
    - `ax`: where to draw; by default, on a new figure of 7 by 4.6 inches.

    **Returns** the axes. Raises `ValueError` for a data set without branches of gaits.
    """
    check(data, GAITS)
    if ax is None:
        ax = Figure(figsize=(7, 4.6), layout="constrained").add_subplot()
    ax.axhline(1, color=INK, lw=0.8, zorder=1)
    family = cascade(data)
    handles = period_lines({curve.period for curve in family})
    doublings = ~data["event_fold"].values
    for handle, period in zip(handles, sorted({c.period for c in family}), strict=True):
        of_period = [curve for curve in family if curve.period == period]
        for curve in map(refined, of_period):
            draw_curve(ax, curve, np.abs(curve.multipliers).max(axis=1, keepdims=True))
        ours = np.isin(data["event_branch"].values, [curve.number for curve in of_period])
        values = data["event_value"].values[ours & doublings]
        draw_event(ax, values, np.ones(len(values)), period, fold=False)
        if len(values):
            where = " and ".join(f"{value:.5f}" for value in values)
            handle.set_label(f"{handle.get_label()}, doubles at {where}")
    note = "of the most stable gait of period one and the gaits that double from it"
    dress(ax, data, "largest multiplier", note)
    ax.set_ylim(0, HIGHEST)
    ax.set_ylabel(r"modulus of the largest multiplier", fontsize=11)
    for words, rise, side in (("unstable", 3, "bottom"), ("stable", -4, "top")):
        place = ax.get_yaxis_transform()
        ax.annotate(words, (0, 1), (5, rise), place, "offset points", va=side, fontsize=WORDS)
    place_legend(ax, handles, BELOW, columns=2)
    return ax


def bifurcation_diagram(data: xr.Dataset, ax: Axes | None = None) -> Axes:
    """What walkers come to, against a parameter: the first coordinate at the start of each stride.

    A dot is a recorded state of a walker that walks on. For orientation, dashed lines show where
    the gait of period one is unstable from which the cascade of period doublings starts. A vertical
    line stands in the middle of the interval in which walking is lost.

    **Arguments:**

    - `data`: what `walker_jax.bifurcations.bifurcation_diagram` returns.
    - `ax`: where to draw; by default, on a new figure of 7 by 5 inches.

    **Returns** the axes. Raises `ValueError` for a data set without gaits and what walkers come to.
    """
    check(data, GAITS + ATTRACTORS)
    if ax is None:
        ax = Figure(figsize=(7, 5), layout="constrained").add_subplot()
    value, state = dots(data)
    ax.plot(value, state, "o", color=BASINS[0], ms=1, mew=0, rasterized=True, zorder=4)
    for curve in cascade(data)[:1]:
        draw_curve(ax, curve, curve.states, stable=False)
    dress(ax, data, "attractors", "")
    ax.set_ylabel(first_label(data), fontsize=11)
    lost = float(data["lost"].values.mean())
    if np.isfinite(lost):
        ax.axvline(lost, color=LOSS, lw=1, zorder=3)
        ax.annotate(
            f"walking is lost at {lost:.5f}",
            (lost, 1),
            (0, 3),
            ax.get_xaxis_transform(),
            "offset points",
            ha="center",
            color=LOSS,
            fontsize=WORDS,
        )
    return ax


def bifurcations(data: xr.Dataset) -> Figure:
    """Gaits, their largest multiplier and what walkers come to, over a range of a parameter.

    The pictures `gait_branches`, above `largest_multiplier`, and `bifurcation_diagram`, above the
    part of it between the first period doubling of the cascade and the loss of walking, if any.

    **Arguments:**

    - `data`: what `walker_jax.bifurcations.bifurcation_diagram` returns.

    **Returns** the figure, of 13 by 9.4 inches: `figures.bifurcations(data).savefig("slope.png")`.
    Raises `ValueError` as these do.
    """
    check(data, GAITS + ATTRACTORS)
    figure = Figure(figsize=(13, 9.4), layout="constrained")
    axes = figure.subplots(2, 2)
    gait_branches(data, axes[0, 0]).set_title("Gaits", **TITLE)
    bifurcation_diagram(data, axes[0, 1]).set_title("Attractors", **TITLE)
    largest_multiplier(data, axes[1, 0]).set_title("Largest multiplier", **TITLE)
    window = cascade_window(data)
    if window is None:
        axes[1, 1].remove()
    else:
        zoom = bifurcation_diagram(data, axes[1, 1])
        zoom.set_title("Attractors of the cascade", **TITLE)
        zoom.lines[0].set(markersize=0.8, alpha=0.5)
        zoom.set(xlim=window[:2], ylim=window[2:])
        zoom.locator_params(axis="x", nbins=6)
    figure.suptitle(title(data), x=0.01, ha="left", fontsize=14, fontweight="bold")
    return figure


def disturbance(data: xr.Dataset, ax: Axes | None = None) -> Axes:
    """The basin close to its gait, and the nearest start from which the walker does not come back.

    All starts inside the curve, which are nearer, come back. Where that start leads to another
    motion, the nearest one that falls is marked too: none inside the dashed curve does.

    **Arguments:**

    - `data`: what `walker_jax.robustness` returns, over two dimensions, with a gait.
    - `ax`: where to draw; by default, on a new figure of 5.4 by 5.4 inches.

    **Returns** the axes. Raises `ValueError` for another data set.
    """
    if not has_disturbance(data):
        raise WrongUse("data must hold the least disturbance of a gait, over two dimensions")
    data = data.assign_coords(coordinate=data.attrs["section"])
    if ax is None:
        ax = Figure(figsize=(5.4, 5.4), layout="constrained").add_subplot()
    x, y = map(str, data["fate"].dims)
    turn = np.linspace(0, 2 * np.pi, 400)
    section, gait = data["coordinate"], data["gait_state"]

    def circle(middle: np.ndarray, size: float) -> tuple[np.ndarray, np.ndarray]:
        """The points at a distance from a state, in the plane of the picture."""
        around = middle + size * np.stack([np.cos(turn), np.sin(turn)], axis=1)
        states = xr.DataArray(around, dims=("phase", "coordinate"), coords={"coordinate": section})
        return along(states, x), along(states, y)

    size, elsewhere = float(data["least_disturbance"]), int(data["failure"]) == Outcome.STRIDE
    curves = [circle(gait.values, size)]
    points = [(data["failing_state"], "X", disturbed(data, "failure", "failing_strides"))]
    nearest = "nearest start that does not come back" if elsewhere else "nearest failure"
    subject = f"{size:.4g}, from the gait to the {nearest}"
    if elsewhere and "least_fall" in data:
        farther = float(data["least_fall"])
        from_state = data["fall_state"] - farther * data["fall_direction"]
        curves.append(circle(from_state.values, farther))
        points.append((data["fall_state"], "P", disturbed(data, "fall_failure", "fall_strides")))
        subject = f"from the gait {size:.4g} to another motion, {farther:.4g} to a failure"
    both = [np.concatenate(axis) for axis in zip(*curves, strict=True)]
    middle, reach = [0.5 * (c.max() + c.min()) for c in both], [np.ptp(c) for c in both]
    limits, window = [], {}
    for name, centre, width in zip((x, y), middle, reach, strict=True):
        axis = data[name].values
        limits.append((centre - WINDOW * width, centre + WINDOW * width))
        first, last = np.searchsorted(axis, limits[-1])
        window[name] = slice(max(0, first - 2), last + 2)  # some cells, however large they are
    near = data.isel(window)
    regions = regions_of(near, notable_attractors(data))
    extent = (*ends(near[x].values), *ends(near[y].values))
    show(ax, painted(regions, near["fate"].shape), extent)
    for curve, style in zip(curves, ("-", "--"), strict=False):
        ax.plot(*curve, style, color="white", lw=1.6)
    name = attractor_name(int(data["gait_period"]), gait.expand_dims("phase"))
    marks = []
    look: dict[str, Any] = {"ls": "", "mec": "white", "color": INK, "zorder": 3}
    for state, sign, words in [(gait, "o", name), *points]:
        at, ms = state.expand_dims("phase"), 7.5 if sign == "o" else 10
        marks += ax.plot(along(at, x), along(at, y), sign, ms=ms, label=words, **look)
    patches = [Patch(fc=region.colour, ec=INK, lw=0.5, label=region.words) for region in regions]
    place_legend(ax, marks, BELOW, columns=1)
    place_legend(ax, patches, BELOW + LINE * len(marks), columns=2)
    ax.set(xlim=limits[0], ylim=limits[1])
    ax.set_xlabel(AXIS_LABELS.get(x, x), fontsize=11)
    ax.set_ylabel(AXIS_LABELS.get(y, y), fontsize=11)
    ax.locator_params(nbins=6)
    write_title(ax, "Least disturbance", subject)
    return ax


def disturbed(data: xr.Dataset, failure: str, strides: str) -> str:
    """What the legend says of the nearest start that is lost, given the names of how and when."""
    how = Outcome(int(data[failure]))
    if how == Outcome.STRIDE:
        return "nearest start that comes to another motion"
    return f"nearest start that {FAILURES[how][2]} after {counted(int(data[strides]), 'stride')}"


def has_disturbance(data: xr.Dataset) -> bool:
    """Whether a data set holds what `disturbance` draws."""
    known = {"fate", "least_disturbance", "failing_state", "gait_state"} <= set(data)
    if not known or data["fate"].ndim != 2 or data["least_disturbance"].ndim:
        return False
    return len(data.attrs["section"]) == 2 and bool(np.isfinite(data["least_disturbance"]))


def robustness(data: xr.Dataset) -> Figure:
    """The basin of a gait, and beside it its least disturbance where that is in the same plane.

    The pictures `basin` and `disturbance`.

    **Arguments:**

    - `data`: what `walker_jax.robustness` returns.

    **Returns** the figure, of 13 by 5.8 inches. Raises `ValueError` as these do.
    """
    both = has_disturbance(data)
    figure = Figure(figsize=(13 if both else 7, 5.8), layout="constrained")
    axes = figure.subplots(1, 2 if both else 1, squeeze=False)[0]
    basin(data, axes[0])
    if both:
        disturbance(data, axes[1])
    return figure


def robustness_measures(data: xr.Dataset, ax: Axes | None = None) -> Axes:
    """Area of the basin, least disturbance and largest multiplier against a parameter.

    Figure 8 of Schwab and Wisse (2001), and the least disturbance. Area and disturbance are drawn
    as parts of their largest values, the multiplier as it is: where the one grows, the others need
    not shrink.

    **Arguments:**

    - `data`: what `walker_jax.robustness_table` returns.
    - `ax`: where to draw; by default, on a new figure of 7 by 4.6 inches.

    **Returns** the axes. Raises `ValueError` for another data set.
    """
    values, parameter = table_axis(data)
    if ax is None:
        ax = Figure(figsize=(7, 4.6), layout="constrained").add_subplot()
    area, error = data["total_area"].values, data["total_area_error"].values
    most, farthest = np.max(area), np.nanmax([0.0, *data["least_disturbance"].values])
    kind = MEASURES["total_area"]
    handles = ax.plot(
        values, area / (most or 1), kind[1], color=kind[0], label=f"{kind[2]}, of {most:.4g}"
    )
    wide = 2 * error / (most or 1)
    ax.fill_between(values, area / (most or 1) - wide, area / (most or 1) + wide, color=kind[0])
    colour, sign, words = MEASURES["least_disturbance"]
    part = data["least_disturbance"].values / (farthest or 1)
    handles += ax.plot(values, part, sign, color=colour, label=f"{words}, of {farthest:.4g}")
    falls = data.get("least_fall", data["least_disturbance"]).values
    beyond = falls > data["least_disturbance"].values
    highest = np.max(falls[beyond] / (farthest or 1), initial=1)
    if beyond.any():
        words = "least one from which it falls, where that comes to another motion"
        part = falls[beyond] / farthest
        handles += ax.plot(values[beyond], part, "s", color=colour, mfc="white", label=words)
    colour, sign, words = MEASURES["multiplier"]
    handles += ax.plot(values, data["multiplier"].values, sign, color=colour, label=words)
    ax.set_xlabel(AXIS_LABELS.get(parameter, parameter), fontsize=11)
    ax.set_ylabel("part of the largest; modulus", fontsize=11)
    ax.set(xlim=margin(values), ylim=(0, 1.05 * highest))
    note = "with twice the error of the area; the multiplier is that of the gait walkers come to"
    write_title(ax, f"{title(data)}: robustness", note)
    place_legend(ax, handles, BELOW, columns=1)
    return ax


def boundary_dimension(data: xr.Dataset, ax: Axes | None = None) -> Axes:
    """The dimension of the boundary of the basin against a parameter, with its interval.

    It is 1 where the boundary is smooth, and above where it is fractal.

    **Arguments** and errors are those of `robustness_measures`.
    """
    values, parameter = table_axis(data)
    if ax is None:
        ax = Figure(figsize=(7, 4.6), layout="constrained").add_subplot()
    low, middle, high = (data[f"dimension{end}"].values for end in ("_low", "", "_high"))
    ax.fill_between(values, low, high, color=BASINS[0], alpha=0.25, lw=0)
    ax.plot(values, middle, "o-", color=BASINS[0], markersize=4)
    ax.axhline(1, color=INK, lw=0.8, zorder=1)
    ax.set_xlabel(AXIS_LABELS.get(parameter, parameter), fontsize=11)
    ax.set_ylabel("dimension", fontsize=11)
    top = np.nanmax([1.2, *high])
    ax.set(xlim=margin(values), ylim=(0.9, 1.05 * top))
    note = "by the uncertainty exponent, with its 95 % interval"
    write_title(ax, "Dimension of the basin's boundary", note)
    return ax


def robustness_table(data: xr.Dataset) -> Figure:
    """The pictures `robustness_measures` and `boundary_dimension`, side by side.

    **Arguments:**

    - `data`: what `walker_jax.robustness_table` returns.

    **Returns** the figure, of 13 by 5 inches. Raises `ValueError` as these do.
    """
    figure = Figure(figsize=(13, 5), layout="constrained")
    axes = figure.subplots(1, 2)
    robustness_measures(data, axes[0])
    boundary_dimension(data, axes[1])
    return figure


def margin(values: Float[np.ndarray, " n"]) -> tuple[float, float] | None:
    """The range of values, and a little more; none where there is but one."""
    beyond = 0.03 * np.ptp(values)
    return (values.min() - beyond, values.max() + beyond) if beyond else None


def table_axis(data: xr.Dataset) -> tuple[Float[np.ndarray, " n"], str]:
    """The values of a table's parameter, and its name; `ValueError` for what is no table."""
    dims = data["total_area"].dims if "total_area" in data else ()
    if len(dims) != 1 or "least_disturbance" not in data:
        raise WrongUse("data must be a table of robustness over one parameter")
    return data[dims[0]].values, str(dims[0])


def optimisation(data: xr.Dataset, parameter: str | None = None, ax: Axes | None = None) -> Axes:
    """What an optimisation tried of a parameter, over the objective between the bounds.

    Dots are evaluations, from light and large to dark and small as the steps become shorter, joined
    in their order; those of runs that did not lead to the optimum are faint. The broad line is the
    scan, other parameters as in the optimum, which is a point of it. It is dashed, on a shaded
    ground, from where limits allow nothing to the next point that they allow.

    **Arguments:**

    - `data`: what `walker_jax.optimise` returns.
    - `parameter`: one of those that were free; by default, the first.
    - `ax`: where to draw; by default, on a new figure of 7 by 5.6 inches.

    **Returns** the axes. Raises `ValueError` for a data set without an optimum, and for a parameter
    that was not free.
    """
    check_optimum(data)
    names = free(data)
    parameter = names[0] if parameter is None else parameter
    if parameter not in names:
        raise WrongUse(f"parameter must be one of {', '.join(names)}, not {parameter!r}")
    if ax is None:
        ax = Figure(figsize=(7, 5.6), layout="constrained").add_subplot()
    draw_optimisation(ax, data, parameter, aim(data, 60))
    return ax


def basins_compared(data: xr.Dataset) -> Figure:
    """The basins before and after an optimisation, side by side, with colours as in `basin`.

    **Arguments:**

    - `data`: what `walker_jax.optimise` returns.

    **Returns** the figure, of 11 by 5.2 inches. Raises `ValueError` for a data set without basins.
    """
    figure = Figure(figsize=(11, 5.2), layout="constrained")
    draw_basins([*figure.subplots(1, 2)], data)
    figure.suptitle(title(fixed(data), 80), x=0.01, ha="left", fontsize=14, fontweight="bold")
    return figure


def optimised(data: xr.Dataset) -> Figure:
    """An optimisation: the way to the optimum, and the basins before and after, if there are any.

    The pictures `optimisation`, of each parameter, above that of `basins_compared`.

    **Arguments:**

    - `data`: what `walker_jax.optimise` returns.

    **Returns** the figure. Raises `ValueError` for a data set without an optimum.
    """
    check_optimum(data)
    names, compared = free(data), "fate_start" in data
    columns = min(3, len(names))
    rows = -(-len(names) // columns)
    size = max(5.6 * columns, 11 if compared else 7), 5.2 * (rows + compared) + 0.4
    figure = Figure(figsize=size, layout="constrained")
    # Six columns can be shared by one panel, by two, and by three.
    grid, wide = figure.add_gridspec(rows + compared, 6), 6 // columns
    for k, name in enumerate(names):
        row, column = divmod(k, columns)
        ax = figure.add_subplot(grid[row, column * wide : (column + 1) * wide])
        draw_optimisation(ax, data, name, name.replace("_", " ").capitalize())
    if compared:
        halves = [figure.add_subplot(grid[-1, half]) for half in (slice(3), slice(3, 6))]
        draw_basins(halves, data)
    above = aim(data, int(8 * size[0]))
    figure.suptitle(above, x=0.01, ha="left", fontsize=14, fontweight="bold")
    return figure


def check_optimum(data: xr.Dataset) -> None:
    """Raise `ValueError` where no optimum was found."""
    if "found" not in data or not data["found"]:
        raise WrongUse("data must be of an optimisation that found an optimum")


def free(data: xr.Dataset) -> list[str]:
    """The parameters that were free in an optimisation."""
    return data["parameter"].values.tolist()


def fixed(data: xr.Dataset) -> xr.Dataset:
    """Only the attributes of an optimisation, without the parameters that were free."""
    changed = {f"walker_{name}" for name in free(data)}
    return xr.Dataset(attrs={key: data.attrs[key] for key in data.attrs if key not in changed})


def draw_optimisation(ax: Axes, data: xr.Dataset, parameter: str, subject: str) -> None:
    """The picture `optimisation`."""
    own = data.sel(parameter=parameter)
    scan, barred = draw_scan(ax, own, others=data.sizes["parameter"] > 1)
    stages, others = draw_runs(ax, own)
    marks = [*draw_ends(ax, own), *scan, *others]
    ax.set_xlim(*json.loads(data.attrs["bounds"])[parameter])
    ax.locator_params(axis="x", nbins=6)
    ax.set_xlabel(named(parameter), fontsize=11)
    ax.set_ylabel(objective(data), fontsize=11)
    write_title(ax, subject, listed([gain(data), *ending(own)], 60))
    rows = -(-len(marks) // 2)
    place_legend(ax, marks, BELOW, columns=2)
    place_legend(ax, stages, BELOW + LINE * rows, columns=len(STAGES))
    place_legend(ax, barred, BELOW + LINE * (rows + bool(stages)), columns=1)


def draw_ends(ax: Axes, own: xr.Dataset) -> list[Line2D]:
    """Start and optimum, whole even at a bound. Returns what the legend tells of."""
    marks = []
    for side, style in (
        ("start", {"marker": "o", "mfc": "none", "mec": INK, "mew": 1.4, "ms": 12}),
        ("optimum", {"marker": "*", "mfc": BASINS[1], "mec": "white", "ms": 17}),
    ):
        at = float(own[side])
        place = [at], [float(own[f"exact_{side}"])]
        label = f"{side}, at {at:.4g}"
        marks += ax.plot(*place, ls="", label=label, zorder=6, **WHOLE, **style)
    return marks


def draw_scan(ax: Axes, own: xr.Dataset, *, others: bool) -> tuple[list[Line2D], list[Patch]]:
    """The scan, if there is one, and what limits do not allow. Returns what legends tell of."""
    if "scan_value" not in own:
        return [], []
    at, value, allowed = (own[f"scan_{name}"].values for name in ("parameters", "value", "allowed"))
    optimum = float(own["optimum"])
    if optimum not in at:  # where a limit holds it, what that does not allow begins there
        place = np.searchsorted(at, optimum)
        at = np.insert(at, place, optimum)
        value = np.insert(value, place, float(own["objective_optimum"]))
        allowed = np.insert(allowed, place, True)
    words = "scan, others as in the optimum" if others else "scan"
    solid = np.where(allowed, value, np.nan)
    scan = ax.plot(at, solid, color=SCAN, lw=2.5, label=words, zorder=2)
    barred = ~(allowed[:-1] & allowed[1:])
    if not barred.any():
        return scan, []
    ax.plot(at, value, color=SCAN, lw=1, ls=(0, (4, 3)), zorder=1)
    turns = np.flatnonzero(np.diff(barred, prepend=False, append=False))
    for left, right in at[turns].reshape(-1, 2).tolist():
        ax.axvspan(left, right, color=BARRED, lw=0, zorder=0)
    return scan, [Patch(fc=BARRED, ec=SCAN, lw=0.5, label=beyond_limits(own))]


def draw_runs(ax: Axes, own: xr.Dataset) -> tuple[list[Line2D], list[Line2D]]:
    """The steps of all runs. Returns what legends tell of: stages, and other runs."""
    run, stage, at, value = (own[name].values for name in ("run", "stage", "parameters", "value"))
    best = run[stage == ENDS][0]
    numbers = np.unique(run[stage >= 0]).tolist()
    for number in numbers:
        order, opacity = (4, 1) if number == best else (3, FAINT)
        style: dict[str, Any] = {"zorder": order, "alpha": opacity, **WHOLE}
        ours = (stage >= 0) & (run == number)
        ax.plot(at[ours], value[ours], color=BASINS[0], lw=0.8, **style)
        for k, (colour, size, _) in enumerate(STAGES):
            dots = at[ours & (stage == k)], value[ours & (stage == k)]
            ax.plot(*dots, "o", color=colour, ms=size, mec="white", **style)
    stages = [
        Line2D([], [], marker="o", ls="", color=colour, ms=size, label=words)
        for k, (colour, size, words) in enumerate(STAGES)
        if (stage == k).any()
    ]
    faint = {"marker": "o", "mec": "white", "ms": 7, "lw": 0.8, "color": STAGES[0][0]}
    others = [Line2D([], [], alpha=FAINT, label="other runs", **faint)]
    return stages, others if numbers != [best] else []


def draw_basins(panels: Sequence[Axes], data: xr.Dataset) -> None:
    """The basins at start and optimum, on two axes of a figure, whose legend is for both."""
    if "fate_start" not in data or "fate_optimum" not in data:
        raise WrongUse("data must hold the basins at start and optimum of an optimisation")
    x, y = map(str, data["fate_start"].dims)
    fate = np.stack([data["fate_start"].values, data["fate_optimum"].values])
    found = [
        Region(fate == ATTRACTED, BASINS[0], "A", "basin of attraction"),
        Region(fate == Outcome.STRIDE, ASTRAY, "", "walks on, near no attractor"),
        *failures(fate),
    ]
    regions = [region for region in found if region.cells.any()]
    extent = (*ends(data[x].values), *ends(data[y].values))
    for ax, side, image in zip(
        panels, ("start", "optimum"), painted(regions, fate.shape), strict=True
    ):
        show(ax, image, extent)
        values = dict(zip(free(data), data[side].values.tolist(), strict=True))
        words = f"{side.capitalize()}: {listed(valued(values), 42)}"
        write_title(ax, words, about_basin(data, side))
        ax.set_xlabel(AXIS_LABELS.get(x, x), fontsize=11)
    panels[0].set_ylabel(AXIS_LABELS.get(y, y), fontsize=11)
    panels[1].sharex(panels[0])
    panels[1].sharey(panels[0])
    panels[1].tick_params(labelleft=False)
    patches = [Patch(fc=region.colour, ec=INK, lw=0.5, label=region.words) for region in regions]
    figure = cast(Figure, panels[0].get_figure(root=True))
    figure.legend(handles=patches, loc="outside lower left", ncols=5, frameon=False, fontsize=WORDS)


def about_basin(data: xr.Dataset, side: str) -> str:
    """Its area, where nothing else was optimised, and what slice it is in, if it is in one."""
    weights, region = json.loads(data.attrs["objective"]), json.loads(data.attrs["region"])
    area = float(data[f"exact_{side}"]) / weights["area"] if [*weights] == ["area"] else 0.0
    slices = [in_slice(name, at) for name, at in region.items() if not isinstance(at, list)]
    return "; ".join([*([area_of_basin(area)] if area else []), *slices])


def aim(data: xr.Dataset, width: int) -> str:
    """The walker, what is fixed of it, and what was optimised, in lines of some width."""
    walker, words = title(fixed(data), width), objective(data)
    fits = len(walker.splitlines()[-1]) + len(words) < width
    return f"{walker}: {words}" if fits else f"{walker}:\n{words}"


def objective(data: xr.Dataset) -> str:
    """What was optimised, in words."""
    weights = json.loads(data.attrs["objective"])
    if [*weights.values()] == [1]:
        return measure(*weights)
    terms = (
        f"{'−' if weight < 0 else '+'} {abs(weight):g} {name.replace('-', ' ')}"
        for name, weight in weights.items()
    )
    return " ".join(terms).removeprefix("+ ")


def measure(name: str) -> str:
    """What is optimised or has limits, in words."""
    return OBJECTIVES.get(name, name.replace("-", " "))


def beyond_limits(data: xr.Dataset) -> str:
    """What limits do not allow; without any, a walker is only missed where it has no gait."""
    sides = [
        f"{measure(name)} {side} {limit:g}"
        for name, pair in json.loads(data.attrs["limits"]).items()
        for side, limit in zip(("below", "above"), pair, strict=True)
        if limit is not None
    ]
    return " or ".join(sides) or "no gait"


def gain(data: xr.Dataset) -> str:
    """From where the objective came, and to where."""
    start, optimum = float(data["exact_start"]), float(data["exact_optimum"])
    notes = [f"× {optimum / start:.3g}"] if start > 0 and optimum > 0 else []
    notes += ["small is better"] if data.attrs["sign"] < 0 else []
    return f"{start:.4g} to {optimum:.4g}" + (f" ({'; '.join(notes)})" if notes else "")


def ending(own: xr.Dataset) -> list[str]:
    """Where the way of one parameter ended, and whether too early."""
    side, binding = int(own["at_bound"]), own["measure"].values[own["binding"].values]
    where = f"at the {'upper' if side > 0 else 'lower'} bound"
    if not side:
        limits = " and ".join(map(measure, binding.tolist()))
        where = f"held by a limit of {limits}" if limits else "inside the bounds"
    return [where] if own["converged"] else [where, "not converged"]


def multipliers(gaits: Sequence[Gait], ax: Axes | None = None) -> Axes:
    """The multipliers of gaits in the complex plane, with the unit circle.

    Colours and signs tell periods; they are filled for stable gaits and open for unstable ones.
    Multipliers beyond the frame are at its rim, where an arrow points to them, with their values.

    **Arguments:**

    - `gaits`: such as `walker_jax.gaits.find_gaits` returns. Failed searches are left out.
    - `ax`: where to draw; by default, on a new figure of 6.2 by 7.2 inches.

    **Returns** the axes.
    """
    if ax is None:
        ax = Figure(figsize=(6.2, 7.2), layout="compressed").add_subplot()
    gaits = [gait for gait in gaits if gait.found]
    ax.add_patch(Circle((0, 0), 1, fc="#f2f2f2", ec=INK, lw=1, zorder=1))
    ax.axhline(0, color=INK, lw=0.4, zorder=1.5)
    ax.axvline(0, color=INK, lw=0.4, zorder=1.5)
    far: list[tuple[complex, Gait]] = []
    for gait in sorted(gaits, key=lambda gait: len(gait.states)):
        values = np.asarray(gait.multipliers)
        beyond = np.maximum(np.abs(np.real(values)), np.abs(np.imag(values))) > FRAME
        x, y = np.real(values[~beyond]), np.imag(values[~beyond])
        ax.plot(x, y, zorder=3, **sign(len(gait.states), bool(gait.stable)))
        far += [(complex(value), gait) for value in values[beyond]]
    for rim in rims(far):
        draw_rim(ax, rim)
    ax.set(xlim=(-FRAME, FRAME), ylim=(-FRAME, FRAME), aspect="equal")
    ax.set_xlabel("real part", fontsize=11)
    ax.set_ylabel("imaginary part", fontsize=11)
    stable = sum(bool(gait.stable) for gait in gaits)
    write_title(ax, "Multipliers", f"of {counted(len(gaits), 'gait')}, {stable} of them stable")
    kinds = [
        Line2D([], [], label=name, **sign(1, stable))
        for name, stable in (("stable", True), ("unstable", False))
        if any(bool(gait.stable) == stable for gait in gaits)
    ]
    periods = [
        Line2D([], [], label=f"period {period}", **sign(period, True))
        for period in sorted({len(gait.states) for gait in gaits})
    ]
    place_legend(ax, kinds, BELOW, columns=4)
    place_legend(ax, periods, BELOW + LINE * bool(kinds), columns=4)
    return ax


def check(data: xr.Dataset, names: tuple[str, ...]) -> None:
    """Raise `ValueError` where a data set lacks what a picture of bifurcations takes from it."""
    missing = [name for name in names if name not in data]
    missing += [f"attribute {name}" for name in ("parameter", "section") if name not in data.attrs]
    if missing:
        lacking = ", ".join(missing)
        raise WrongUse(f"data must be of a bifurcation diagram, unlike one without {lacking}")


def curves(data: xr.Dataset) -> list[Curve]:
    """The branches of a data set."""
    branch, event_branch = data["branch"].values, data["event_branch"].values
    states, event_states = (first(data[name]) for name in ("states", "event_states"))
    multipliers, event_multipliers = (
        data[name].values[..., 0] + 1j * data[name].values[..., 1]
        for name in ("multipliers", "event_multipliers")
    )
    found = []
    for number in np.unique(branch).tolist():
        ours = branch == number
        period = int(data["period"].values[ours][0])
        curve = Curve(
            number,
            period,
            data["value"].values[ours],
            states[ours, :period],
            multipliers[ours],
            data["stable"].values[ours],
        )
        for i in np.flatnonzero(event_branch == number):
            value, cycle = data["event_value"].values[i], event_states[i, :period]
            curve = with_event(curve, float(value), cycle, event_multipliers[i])
        found.append(curve)
    return found


def with_event(
    curve: Curve,
    value: float,
    states: Float[np.ndarray, " period"],
    multipliers: Complex[np.ndarray, " order"],
) -> Curve:
    """A branch with a bifurcation put between those two of its points where the detour is least."""
    path = np.column_stack([curve.value, curve.states])
    scale = np.maximum(np.ptp(path, axis=0), np.finfo(float).tiny)
    legs = np.linalg.norm(np.diff(path, axis=0) / scale, axis=1)
    away = np.linalg.norm((path - [value, *states]) / scale, axis=1)
    at = int((away[:-1] + away[1:] - legs).argmin()) + 1 if len(legs) else 1
    return curve._replace(
        value=np.insert(curve.value, at, value),
        states=np.insert(curve.states, at, states, axis=0),
        multipliers=np.insert(curve.multipliers, at, multipliers, axis=0),
        stable=np.insert(curve.stable, at, True),
    )


def cascade(data: xr.Dataset) -> list[Curve]:
    """The most stable gait of period one, those that leave it at its doublings, and so on."""
    family = data["branch"].values[data["on_cascade"].values]
    return [curve for curve in curves(data) if curve.number in family]


def refined(curve: Curve) -> Curve:
    """A branch with points between its own, where the multipliers' polynomial is interpolated."""
    count = len(curve.value)
    if count < 2:
        return curve
    at = np.linspace(0, count - 1, 16 * (count - 1) + 1)
    low = np.minimum(at.astype(int), count - 2)
    share = (at - low)[:, None]
    solid = curve.stable[:-1] & curve.stable[1:]
    polynomials = np.array([np.poly(row) for row in curve.multipliers])
    value, states, polynomials = (
        (1 - share) * points[low] + share * points[low + 1]
        for points in (curve.value[:, None], curve.states, polynomials)
    )
    return curve._replace(
        value=value[:, 0],
        states=states,
        multipliers=np.array([np.roots(row) for row in polynomials], complex),
        stable=np.where(share[:, 0] % 1, solid[low], curve.stable[at.astype(int)]),
    )


def draw_curve(
    ax: Axes,
    curve: Curve,
    heights: Float[np.ndarray, "n k"],
    *,
    stable: bool = True,
) -> None:
    """Lines along a branch: solid where it is stable, if that is wanted, dashed where it is not."""
    solid = curve.stable[:-1] & curve.stable[1:]
    changes = np.flatnonzero(solid[1:] != solid[:-1]) + 1
    colour, _ = look(curve.period)
    for start, stop in pairwise([0, *changes.tolist(), len(solid)]):
        if start < stop and (stable or not solid[start]):
            run = slice(start, stop + 1)
            order = 3 * solid[start] + 1 / curve.period
            style = SOLID if solid[start] else DASHED
            ax.plot(curve.value[run], heights[run], color=colour, zorder=2 + order, **style)


def draw_event(
    ax: Axes,
    values: Float[np.ndarray, " n"],
    heights: Float[np.ndarray, " n"],
    period: int,
    *,
    fold: bool,
) -> None:
    """The signs of a bifurcation."""
    colour, _ = look(period)
    ax.plot(values, heights, color=colour, zorder=7, **(FOLD if fold else DOUBLING))


def look(period: int) -> tuple[str, str]:
    """Colour and sign of gaits of a period."""
    return PERIODS[period - 1] if period <= len(PERIODS) else LONGER


def sign(period: int, stable: bool) -> dict[str, Any]:
    """How multipliers of a gait are drawn."""
    colour, marker = look(period)
    face = colour if stable else "white"
    return {"color": colour, "marker": marker, "mfc": face, "mew": 1.2, "ms": 7, "ls": ""}


def period_lines(periods: set[int]) -> list[Line2D]:
    """What the legend says of periods, the shortest first."""
    return [
        Line2D([], [], color=look(period)[0], lw=3, label=f"period {period}")
        for period in sorted(periods)
    ]


def write_title(ax: Axes, subject: str, note: str) -> None:
    """A title, and a line or more below it."""
    ax.set_title(subject, **TITLE | {"pad": TITLE["pad"] + 12 * note.count("\n")})
    ax.annotate(note, (0, 1), (0, 7), "axes fraction", "offset points", fontsize=9.5)


def counted(count: int, word: str) -> str:
    """A number of things."""
    ending = "" if count == 1 else "es" if word.endswith("ch") else "s"
    return f"{count} {word}{ending}"


def dress(ax: Axes, data: xr.Dataset, subject: str, note: str) -> None:
    """Title, name of the parameter, and its range."""
    write_title(ax, f"{title(data)}: {subject}", note)
    parameter = str(data.attrs["parameter"])
    ax.set_xlabel(AXIS_LABELS.get(parameter, parameter), fontsize=11)
    samples = data["sample_value"].values if "sample_value" in data else []
    values = np.concatenate([data["value"].values, samples])
    if len(values) and np.ptp(values) > 0:
        ax.set_xlim(values.min(), values.max())


def first(states: xr.DataArray) -> Float[np.ndarray, "..."]:
    """The coordinate that is drawn."""
    return states.isel(coordinate=0).values


def first_label(data: xr.Dataset) -> str:
    """Its name."""
    name = str(data.attrs["section"][0])
    return AXIS_LABELS.get(name, name)


def dots(data: xr.Dataset) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Parameter and state of all that was recorded of walkers that walk on."""
    orbit = first(data["orbit"])
    seen = np.isfinite(orbit) & (data["fate"].values == Outcome.STRIDE)[..., None]
    return data["sample_value"].values[np.nonzero(seen)[0]], orbit[seen]


def cascade_window(data: xr.Dataset) -> tuple[float, float, float, float] | None:
    """Limits of the picture from the first doubling of the cascade to the loss of walking.

    None where there is no such range, or no walker in it.
    """
    doublings = data["event_value"].values[data["cascade"].values & ~data["event_fold"].values]
    low, high = float(doublings.min(initial=np.inf)), float(data["lost"].values.mean())
    if not low < high:
        return None
    low, high = low - 0.05 * (high - low), high + 0.05 * (high - low)
    value, state = dots(data)
    inside = state[(value >= low) & (value <= high)]
    if len(inside) == 0:
        return None
    room = 0.05 * float(np.ptp(inside)) or 0.05
    return low, high, float(inside.min()) - room, float(inside.max()) + room


def write_step_times(ax: Axes, data: xr.Dataset) -> None:
    """Step times of the gaits of period one at the end of the range, beside the axes."""
    value, period = data["value"].values, data["period"].values
    last = np.flatnonzero((period == 1) & np.isclose(value, value.max(initial=-np.inf), rtol=1e-9))
    heights, times = first(data["states"])[last, 0], data["step_times"].values[last, 0]
    at, room, free = ax.get_yaxis_transform(), 0.05 * np.ptp(ax.get_ylim()), -np.inf
    for height, time in sorted(zip(heights.tolist(), times.tolist(), strict=True)):
        free = max(height, free + room)
        line = {"arrowstyle": "-", "lw": 0.5, "shrinkA": 0, "shrinkB": 0}
        ax.annotate(
            f"{time:.2f}",
            (1, height),
            (1.03, free),
            at,
            at,
            va="center",
            fontsize=WORDS,
            arrowprops=line,
        )
    if len(last):
        ax.annotate(
            "step time\n(√(l/g))",
            (1.03, 1),
            (0, 3),
            "axes fraction",
            "offset points",
            fontsize=WORDS,
        )


class Rim(NamedTuple):
    """Multipliers beyond the frame whose places at its rim are close together."""

    x: float
    y: float
    members: list[tuple[complex, Gait]]
    """With their gaits; the smallest first."""


def rims(far: list[tuple[complex, Gait]]) -> list[Rim]:
    """The places at the rim of the frame of multipliers beyond it."""
    found: list[Rim] = []
    for value, gait in sorted(far, key=lambda one: abs(one[0])):
        place = value * FRAME / max(abs(value.real), abs(value.imag))
        for rim in found:
            if abs(complex(rim.x, rim.y) - place) < 0.2 * FRAME:
                rim.members.append((value, gait))
                break
        else:
            found.append(Rim(place.real, place.imag, [(value, gait)]))
    return found


def draw_rim(ax: Axes, rim: Rim) -> None:
    """A row for each multiplier at a place of the rim: its value, its sign, and an arrow to it."""
    figure = cast(Figure, ax.get_figure(root=True))
    inward = -1 if (rim.x >= 0) == (abs(rim.x) > FRAME / 2) else 1
    up = 1 if (rim.y >= 0) == (abs(rim.y) < FRAME / 2) else -1
    shown = rim.members if len(rim.members) <= ROWS else rim.members[: ROWS - 1]
    for row, (value, gait) in enumerate(shown, 1):
        rise = up * ROW * row
        way = value / abs(value) * 7
        tip = offset_copy(
            ax.transData, figure, 11 * inward + way.real, rise + way.imag, units="points"
        )
        spot = offset_copy(ax.transData, figure, 27 * inward, rise, units="points")
        style = sign(len(gait.states), bool(gait.stable))
        arrow = {"arrowstyle": "->", "color": style["color"], "shrinkA": 0, "shrinkB": 0}
        tail = (-2 * way.real, -2 * way.imag)
        ax.annotate("", (rim.x, rim.y), tail, tip, "offset points", arrowprops=arrow)
        ax.add_line(Line2D([rim.x], [rim.y], transform=spot, zorder=4, **style))
        write_row(ax, rim, 36 * inward, rise, number(value))
    if len(shown) < len(rim.members):
        largest = number(rim.members[-1][0])
        words = f"and {len(rim.members) - len(shown)} more, up to {largest}"
        write_row(ax, rim, 5 * inward, up * ROW * ROWS, words)


def write_row(ax: Axes, rim: Rim, shift: int, rise: int, words: str) -> None:
    """Words that stand off a place of the rim by so many points, on its inner side."""
    ax.annotate(
        words,
        (rim.x, rim.y),
        (shift, rise),
        textcoords="offset points",
        ha="left" if shift > 0 else "right",
        va="center_baseline",
        fontsize=WORDS,
    )


def number(value: complex) -> str:
    """A number in short."""
    real, imaginary = (
        f"{part:.2e}" if part >= 1e6 else f"{part:,.0f}" if part >= 100 else f"{part:.1f}"
        for part in (abs(value.real), abs(value.imag))
    )
    minus = "−" * (value.real < 0)
    if value.imag == 0:
        return minus + real
    return f"{minus}{real} {'−' if value.imag < 0 else '+'} {imaginary}i"

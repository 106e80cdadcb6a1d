"""What all pictures share: colours, letters, titles, legends."""

import math
import textwrap
from collections.abc import Mapping, Sequence
from typing import Any, cast

import numpy as np
import xarray as xr
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from matplotlib.lines import Line2D
from matplotlib.transforms import offset_copy

from walker_jax.checks import WrongUse
from walker_jax.walking.outcomes import Outcome

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
FAINT = 0.45
"""Opacity of the runs that did not lead to the optimum."""
WHOLE: dict[str, Any] = {"clip_on": False, "in_layout": False}
"""Signs that bounds do not cut; the layout must not count them, as it puts an empty line at 0."""
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
SOLID: dict[str, Any] = {"lw": 2, "ls": "-"}
DASHED: dict[str, Any] = {"lw": 0.7, "ls": (0, (6, 3))}
"""Lines of stable and of unstable gaits."""
TITLE: dict[str, Any] = {"loc": "left", "fontsize": 12, "fontweight": "bold", "pad": 18}
HIGHEST = 2
"""Largest modulus of a multiplier in a picture of it against a parameter."""
SYMBOLS = {"theta": r"$\theta$", "thetadot": r"$\dot{\theta}$", "phidot": r"$\dot{\varphi}$"}


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


def margin(values: Float[np.ndarray, " n"]) -> tuple[float, float] | None:
    """The range of values, and a little more; none where there is but one."""
    beyond = 0.03 * np.ptp(values)
    return (values.min() - beyond, values.max() + beyond) if beyond else None


def check(data: xr.Dataset, names: tuple[str, ...]) -> None:
    """Raise `ValueError` where a data set lacks what a picture of bifurcations takes from it."""
    missing = [name for name in names if name not in data]
    missing += [f"attribute {name}" for name in ("parameter", "section") if name not in data.attrs]
    if missing:
        lacking = ", ".join(missing)
        raise WrongUse(f"data must be of a bifurcation diagram, unlike one without {lacking}")


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

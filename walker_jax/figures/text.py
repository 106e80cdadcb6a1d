"""Words of pictures: names of axes, titles, numbers with their units."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

import numpy as np
import xarray as xr

from walker_jax.basins.cell_classes import fixed_coordinates, has_known_units, total_area
from walker_jax.systems.family import SYSTEMS
from walker_jax.systems.trees import HASHED
from walker_jax.walkers.family import WALKERS

AREA_LABEL = "area of the basin (rad² / √(l/g))"
VOLUME_LABEL = "volume of the basin (rad³·g/l)"
RADIUS = "modulus of the largest multiplier"
RATE = "(rad / √(l/g))"
COORDINATES = {
    "theta": (r"$\theta$", "stance leg angle ", "(rad)"),
    "thetadot": (r"$\dot{\theta}$", "stance leg rate ", RATE),
    "sum": (r"$\theta + \dot{\theta}$", "", "(rad, time in √(l/g))"),
    "phi": (r"$\varphi$", "angle between the legs ", "(rad)"),
    "phidot": (r"$\dot{\varphi}$", "rate between the legs ", RATE),
    "yaw": ("yaw", "", "(rad)"),
    "yawdot": ("rate of yaw", "", RATE),
    "leandot": ("rate of lean", "", RATE),
    "slope": ("slope", "", "(rad)"),
}
"""Symbols of coordinates and parameters, words before the symbol on an axis, and units after it."""
SYMBOLS = {name: symbol for name, (symbol, _, _) in COORDINATES.items()}
AXIS_LABELS = {name: f"{words}{one} {unit}" for name, (one, words, unit) in COORDINATES.items()}
METHOD_NAMES = {
    "cell-map": "cell mapping",
    "direct": "direct iteration",
    "direct, refined": "direct iteration, refined,",
}
NO_BREAK = "\u00a0"
"""Space at which no line ends."""
MOST_PARAMETERS = 6
"""Most parameters in a title."""


def axis_label(name: str) -> str:
    """Return the label of an axis for a coordinate or a parameter."""
    return AXIS_LABELS.get(name, name.replace("_", " "))


def walker_title(data: xr.Dataset) -> str:
    """Return the walker and its parameters, without those that have their default values."""
    name = str(data.attrs.get("walker", "Walker"))
    known = (kind for kind in (*WALKERS.values(), *SYSTEMS.values()) if kind.__name__ == name)
    usual = {f"walker_{one.name}": one.default for kind in known for one in fields(kind)}
    own = {key: value for key, value in data.attrs.items() if key.startswith("walker_")}
    values = parameter_values(
        {key.removeprefix("walker_"): own[key] for key in own if own[key] != usual.get(key)}
    )
    shown = values[:MOST_PARAMETERS] + ["…"] * (len(values) > MOST_PARAMETERS)
    return join_phrases([name, *shown])


def parameter_values(parameters: Mapping[str, Any]) -> list[str]:
    """Return parameters with their values: numbers and words, without arrays."""
    return [
        f"{name.replace('_', ' ')} {value if isinstance(value, str) else f'{value:g}'}"
        + " rad" * (name == "slope")
        for name, value in parameters.items()
        if not np.ndim(value) and not str(value).startswith(HASHED)
    ]


def join_phrases(phrases: Sequence[str]) -> str:
    """Join phrases with commas; lines break between them alone."""
    return ", ".join(words.replace(" ", NO_BREAK) for words in phrases)


def basin_note(data: xr.Dataset) -> str:
    """Return the method, the number of cells, and the area of all basins together."""
    method = data.attrs.get("method", "")
    shape = data.attrs.get("shape", data["fate"].shape)
    note = f"{METHOD_NAMES.get(method, method)} on {' × '.join(map(str, shape))} cells"
    fixed = fixed_coordinates(data)
    note += f"\n{slice_phrase(fixed)}" if fixed else ""
    area = total_area(data)
    return note if data["fate"].ndim != 2 or not area > 0 else f"{note}; {area_phrase(data, area)}"


def known_label(data: xr.Dataset, label: str) -> str:
    """Return the label of a measure, without its unit if that is not known."""
    return label if has_known_units(data) else label.partition(" (")[0]


def format_number(value: float, form: str) -> str:
    """Format a number, with the sign of a minus rather than a hyphen."""
    return f"{value:{form}}".replace("-", "−")


def with_error(value: float, error: float) -> str:
    """Format a number to the digits that its standard error leaves, with that error."""
    if not 0 < error < math.inf:
        return f"{value:.4g}"
    digits = max(0, 1 - math.floor(math.log10(error)))
    return f"{value:.{digits}f} ± {error:.{digits}f}"


def slice_phrase(fixed: Mapping[str, float]) -> str:
    """Say where the plane of a picture is, by the coordinates that it holds fixed."""
    values = [coordinate_value(name, value) for name, value in fixed.items()]
    return join_phrases([f"in the slice at {values[0]}", *values[1:]])


def coordinate_value(name: str, value: float, form: str = ".4g") -> str:
    """Format a coordinate with its value."""
    return f"{SYMBOLS.get(name, name)} = {format_number(value, form)}"


def area_phrase(data: xr.Dataset, area: float) -> str:
    """Format an area of a data set, with its unit on a walker's section."""
    if not has_known_units(data):
        return f"basin area {area:.4g}"
    mantissa, exponent = f"{area:.2e}".split("e")
    size = rf"{mantissa} × 10$^{{{int(exponent)}}}$ rad² / √(l/g)"
    return f"basin area {size.replace(' ', NO_BREAK)}"


def count_noun(count: int, noun: str) -> str:
    """Format a count and its noun, in the plural where needed."""
    ending = "" if count == 1 else "es" if noun.endswith("ch") else "s"
    return f"{count} {noun}{ending}"

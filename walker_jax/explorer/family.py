"""The page's walkers and systems: coordinates, parameters, units; words and colours of fates."""

from walker_jax.explorer.lattice import FARTHEST, HOME_CELLS, LEVELS, MAX_TILES, TILE
from walker_jax.explorer.offers import Offer, Offers, slider_range, slider_step, window_of
from walker_jax.explorer.pictures import FIRST_ATTRACTOR, UNMATCHED
from walker_jax.figures.style import (
    ARTEFACTS,
    BASINS,
    FAILURES,
    OTHERS,
    failure_words,
)
from walker_jax.figures.style import (
    UNMATCHED as UNMATCHED_COLOUR,
)
from walker_jax.systems.maps import Map
from walker_jax.systems.outcomes import OWN, Outcome
from walker_jax.walkers.parameters import Parameter

NOT_LOST = (Outcome.STRIDE, Outcome.OUTSIDE, Outcome.UNDECIDED, Outcome.LEFT_GRID)
"""Outcomes of which none is a walker's failure on its way."""
RATE = "rad / √(l/g)"
COORDINATES = {
    "theta": ("θ", "rad", "stance leg angle θ (rad)"),
    "sum": ("θ + θ̇", "rad", "θ + θ̇ (rad, time in √(l/g))"),
    "thetadot": ("θ̇", RATE, f"stance leg rate θ̇ ({RATE})"),
    "phi": ("φ", "rad", "angle between the legs φ (rad)"),
    "phidot": ("φ̇", RATE, f"rate between the legs φ̇ ({RATE})"),
    "yaw": ("yaw", "rad", "yaw (rad)"),
    "yawdot": ("yaw rate", RATE, f"yaw rate ({RATE})"),
    "leandot": ("lean rate", RATE, f"lean rate ({RATE})"),
}
"""Symbols, units and labels of a walker's coordinates."""
SLICES = 0.3
"""A walker's slices are shown from minus this to this."""


def describe_family(offers: Offers) -> dict:
    """All that the page shows and does not compute, from where it is defined."""
    return {
        "walkers": {name: describe_offer(one) for name, one in offers.items()},
        "fates": {int(one): describe_failure(one) for one in FAILURES if one not in OWN},
        "basins": list(BASINS),
        "others": OTHERS,
        "unmatched": UNMATCHED_COLOUR,
        "artefacts": ARTEFACTS,
        "labels": {"unmatched": UNMATCHED, "first": FIRST_ATTRACTOR, "stride": int(Outcome.STRIDE)},
        "lattice": {
            "tile": TILE,
            "home": HOME_CELLS,
            "levels": LEVELS,
            "farthest": FARTHEST,
            "most": MAX_TILES,
        },
    }


def describe_failure(outcome: Outcome, failures: tuple[str, ...] = ()) -> dict:
    """A way to fail, of a system with these failures of its own: its words and its colour."""
    return {
        "name": outcome.name,
        "words": failure_words(outcome, failures),
        "colour": FAILURES[outcome][0],
        "lost": outcome not in NOT_LOST,
    }


def describe_offer(offered: Offer) -> dict:
    """A walker or a system: what it is, its section, its parameters and its own failures."""
    own, fates = offered.kind.failures, {}
    if not offered.is_walker:  # of a map also where it escapes
        fates = {int(Outcome.OUTSIDE): describe_failure(Outcome.OUTSIDE) | {"words": "infeasible"}}
    names = {name for plane in offered.planes.values() for name in plane.names}
    return {
        "about": about(offered),
        "walker": offered.is_walker,
        "film": offered.has_film,
        "section": offered.section,
        "coordinates": {name: describe_coordinate(offered, name) for name in names},
        "planes": {
            name: {"axes": one.axes, "others": one.others} for name, one in offered.planes.items()
        },
        "parameters": list(map(describe_parameter, offered.parameters)),
        "spans": offered.spans,
        "fates": fates | {int(one): describe_failure(one, own) for one in OWN[: len(own)]},
    }


def about(offered: Offer) -> str:
    """The first line of its documentation; of a map, of that of its function."""
    kind = offered.kind.f if isinstance(offered.kind, Map) else offered.kind
    line, _, _ = (kind.__doc__ or "").strip().partition("\n")
    generated = line.startswith(f"{getattr(kind, '__name__', '')}(")  # its fields, by dataclass
    return "" if generated else line.replace("`", "")


def describe_coordinate(offered: Offer, name: str) -> dict:
    """A coordinate: how it is written, and the ends of the slider of a slice there."""
    symbol, unit, label = name.replace("_", " "), "", name.replace("_", " ")
    if offered.is_walker:
        symbol, unit, label = COORDINATES.get(name, (symbol, "rad", label))
    low, high = (-SLICES, SLICES) if offered.has_film else window_of(offered)[name]
    step = slider_step(low, high)
    return {"symbol": symbol, "unit": unit, "label": label, "low": low, "high": high, "step": step}


def describe_parameter(one: Parameter) -> dict:
    """A parameter with the ends of its slider and the step between its values."""
    low, high = slider_range(one)
    return {
        "name": one.name,
        "meaning": one.meaning,
        "unit": one.unit,
        "default": one.default,
        "low": low,
        "high": high,
        "step": slider_step(low, high),
        "bounds": one.bounds(),
    }

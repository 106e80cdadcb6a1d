"""The page's walkers and systems: coordinates, parameters and units; names and colours of fates."""

from walker_jax.explorer.lattice import FARTHEST, HOME_CELLS, LEVELS, MAX_TILES, TILE
from walker_jax.explorer.offers import Offer, Offers, slider_range, slider_step, window_of
from walker_jax.explorer.pictures import FIRST_ATTRACTOR, UNMATCHED
from walker_jax.figures import style
from walker_jax.systems.maps import Map
from walker_jax.systems.outcomes import OWN, Outcome
from walker_jax.walkers.parameters import Parameter

NOT_LOST = (Outcome.STRIDE, Outcome.OUTSIDE, Outcome.UNDECIDED, Outcome.LEFT_GRID)
"""Outcomes that are no failure of a walker on its way."""
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
"""Largest coordinate of a walker's slice on its slider, to either side of zero."""


def describe_family(offers: Offers) -> dict:
    """Describe all that the page shows without computing: walkers, fates and the lattice."""
    return {
        "walkers": {name: describe_offer(one) for name, one in offers.items()},
        "fates": {int(one): describe_failure(one) for one in style.SIGNS if one < OWN},
        "basins": list(style.BASINS),
        "others": style.OTHERS,
        "unmatched": style.UNMATCHED,
        "artefacts": style.ARTEFACTS,
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
    """Describe an outcome of a system with these failures of its own: its words and its colour."""
    return {
        "name": outcome.name,
        "words": style.failure_words(outcome, failures),
        "colour": style.SIGNS[outcome][0],
        "lost": outcome not in NOT_LOST,
    }


def describe_offer(offered: Offer) -> dict:
    """Describe a walker or a system: its section, its parameters and its own failures."""
    own, fates = offered.kind.failures, {}
    if not offered.is_walker:  # a map may escape
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
        "fates": fates
        | {OWN + i: describe_failure(Outcome(OWN + i), own) for i in range(len(own))},
    }


def about(offered: Offer) -> str:
    """Return the first line of its documentation; for a map, that of its function."""
    kind = offered.kind.f if isinstance(offered.kind, Map) else offered.kind
    line, _, _ = (kind.__doc__ or "").strip().partition("\n")
    generated = line.startswith(f"{getattr(kind, '__name__', '')}(")  # its fields, by dataclass
    return "" if generated else line.replace("`", "")


def describe_coordinate(offered: Offer, name: str) -> dict:
    """Describe a coordinate: its symbol, unit and label, and the slider for a slice."""
    symbol, unit, label = name.replace("_", " "), "", name.replace("_", " ")
    if offered.is_walker:
        unit = "rad" if isinstance(offered.kind, type) else ""  # a robot's may be a slide
        symbol, unit, label = COORDINATES.get(name, (symbol, unit, label))
    low, high = (-SLICES, SLICES) if offered.has_film else window_of(offered)[name]
    step = slider_step(low, high)
    return {"symbol": symbol, "unit": unit, "label": label, "low": low, "high": high, "step": step}


def describe_parameter(one: Parameter) -> dict:
    """Describe a parameter, with the ends and the step of its slider."""
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

"""The subject of a request, checked: a walker or another system, its plane, and its parameters.

A request is JSON from a stranger. Every number in it is bounded, and every name must be a known
one. `WrongUse` says in one sentence what is wrong.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from walker_jax.checks import WrongUse, is_number, short
from walker_jax.explorer.offers import FAMILY, Offer, Offers, Plane
from walker_jax.systems.system import System
from walker_jax.walking.starts import sizes_of_starts

METHODS = ("direct", "cell-map")
LARGEST = 1e6
"""Largest absolute value of a number in a request, far beyond any useful value."""


class Subject(NamedTuple):
    """The walker, or other system, of a request, and the plane that is shown."""

    offer: Offer
    values: tuple[float, ...]
    """Values of its parameters, in the order of `parameters`."""
    section: str
    """Name of one of its planes."""
    at: tuple[float | None, ...]
    """Fixed coordinates of the plane; None for those of the gait."""

    @property
    def parameters(self) -> dict[str, float]:
        """The parameters by name."""
        names = (one.name for one in self.offer.parameters)
        return dict(zip(names, self.values, strict=True))

    @property
    def walker(self) -> System:
        """The walker, or other system, with these parameters."""
        return self.offer.build(self.values)

    @property
    def plane(self) -> Plane:
        """The plane that is shown."""
        return self.offer.planes[self.section]


class WrongParameter(WrongUse):
    """The value of a slider is refused; the second argument is the slider's name."""

    def __str__(self):
        return str(self.args[0])


def read_subject(asked: Any, offers: Offers = FAMILY) -> Subject:
    """Return the subject of a request; raise `WrongUse` for a request that is wrong."""
    asked = mapping("request", asked)
    name = choice("walker", asked.get("walker"), tuple(offers))
    offered = offers[name]
    given = mapping("parameters", asked.get("parameters", {}))
    known = {one.name: one.default for one in offered.parameters}
    for parameter in given:
        if parameter not in known:
            raise WrongUse(
                f"{short(parameter)} is not a parameter of {name}: /api/about lists them"
            )
    values = tuple(slider_number(one, given.get(one, known[one])) for one in known)
    try:
        offered.build(values)
    except WrongUse as error:
        reason = str(error)
        for one in known:
            if reason.startswith(f"{one} "):
                raise WrongParameter(reason, one) from None
        raise
    planes = offered.planes
    section = choice("section", asked.get("section", next(iter(planes))), tuple(planes))
    at = read_slice(planes[section].others, asked.get("at", {}))
    return Subject(offered, values, section, at)


def read_slice(others: tuple[str, ...], asked: Any) -> tuple[float | None, ...]:
    """Return the fixed coordinates of a request; None for those of the gait."""
    given = mapping("at", asked)
    for name in given:
        if name not in others:
            among = ", ".join(others) or "none"
            raise WrongUse(f"at must name coordinates among {among}, not {short(name)}")
    values = ((f"at_{name}", given.get(name)) for name in others)
    return tuple(None if value is None else slider_number(name, value) for name, value in values)


def read_start(subject: Subject, asked: Any) -> Float[np.ndarray, " coordinates"]:
    """Return the start of a request: a state on the section, or a full state."""
    return np.array(numbers("start", asked, sizes_of_starts(subject.walker)))


def mapping(name: str, value: Any) -> Mapping[str, Any]:
    """Return the value if it is a JSON object."""
    if not isinstance(value, dict):
        raise WrongUse(f"{name} must be an object, not {short(value)}")
    return value


def choice(name: str, value: Any, among: tuple[str, ...]) -> str:
    """Return the value if it is one of some words."""
    if not isinstance(value, str) or value not in among:
        raise WrongUse(f"{name} must be one of {', '.join(among)}, not {short(value)}")
    return value


def number(name: str, value: Any) -> float:
    """Return the value if it is a number of a reasonable size."""
    if not is_number(value) or not abs(value) <= LARGEST:  # True for NaN
        raise WrongUse(f"{name} must be a number of at most {LARGEST:g}, not {short(value)}")
    return float(value)


def slider_number(name: str, value: Any) -> float:
    """Return the number of a slider; a refusal names the slider."""
    try:
        return number(name, value)
    except WrongUse as error:
        raise WrongParameter(str(error), name) from None


def whole(name: str, value: Any, least: int, most: int) -> int:
    """Return the value if it is a whole number from `least` to `most`."""
    if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= most:
        raise WrongUse(f"{name} must be a whole number from {least} to {most}, not {short(value)}")
    return value


def numbers(name: str, value: Any, lengths: tuple[int, ...]) -> list[float]:
    """Return the numbers of a list that has one of some lengths."""
    if not isinstance(value, list) or len(value) not in lengths:
        raise WrongUse(
            f"{name} must be {' or '.join(map(str, lengths))} numbers, not {short(value)}"
        )
    return [number(name, one) for one in value]

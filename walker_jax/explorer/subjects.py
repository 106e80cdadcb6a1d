"""What a request is about, checked: a walker, its section, places on it.

A request is JSON from a stranger. Every number in it is bounded, every name is looked up among
those that there are, and `WrongUse` says in one sentence what is wrong.
"""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from walker_jax.checks import WrongUse, is_number, short
from walker_jax.walkers.family import PLANAR_WALKERS
from walker_jax.walkers.fingerprints import code_fingerprint
from walker_jax.walkers.model import Walker, check_planar
from walker_jax.walkers.parameters import Parameter, parameters
from walker_jax.walking.starts import state_kinds

SECTIONS = ("sheared", "plain")
METHODS = ("direct", "cell-map")
ADDRESS_KEYS = ("walker", "section", "method", "tab", "view", "start")
"""What the page's address holds besides values of parameters; state.js writes and reads them."""
LARGEST = 1e6
"""Largest absolute value of a number in a request, far beyond any that a walker walks with."""


class Offer(NamedTuple):
    """A walker that the page offers."""

    name: str
    """By which requests name it."""
    kind: type[Walker]
    defaults: tuple[float, ...]
    """Values of its parameters until others are chosen, in the order of `parameters`."""
    code: str
    """The fingerprint of its code when the server started; empty for a class of the package."""

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Its parameters, with these defaults."""
        described = zip(parameters(self.kind), self.defaults, strict=True)
        return tuple(one._replace(default=value) for one, value in described)

    def build(self, values: tuple[float, ...]) -> Walker:
        """The walker with values of its parameters, in their order.

        Raises `WrongUse` in a process that has loaded other code than the server has.
        """
        if self.code and code_fingerprint(self.kind) != self.code:
            raise WrongUse(f"the code of {self.name} has changed: start the server anew")
        described = zip(self.parameters, values, strict=True)
        return self.kind(**{one.name: one.convert(value) for one, value in described})


Offers = dict[str, Offer]
"""What the page offers, by name: a request may name these walkers, and no others."""


FAMILY: Offers = {
    name: Offer(name, kind, tuple(one.default for one in parameters(kind)), "")
    for name, kind in PLANAR_WALKERS.items()
}
"""The package's walkers in the plane, at the defaults of their parameters."""


def offer(walker: Walker) -> Offer:
    """A walker for the page: one of the family, or one of a user's own with its parameters.

    Raises `WrongUse` for one that does not move in the plane, and for one with a parameter whose
    name the page's address uses for something else.
    """
    check_planar(walker)
    kind = type(walker)
    for one in parameters(kind):
        if one.name in ADDRESS_KEYS:
            raise WrongUse(f"the page's address has a {one.name} of its own: rename the parameter")
    for one in FAMILY.values():
        if one.kind is kind:
            return one
    values = tuple(float(getattr(walker, one.name)) for one in parameters(kind))
    return Offer(kind.__name__, kind, values, code_fingerprint(kind))


class Subject(NamedTuple):
    """The walker that a request is about, and the plane of its section that is shown."""

    offer: Offer
    values: tuple[float, ...]
    """Of its parameters, in the order of `parameters`."""
    section: str
    """One of `SECTIONS`."""
    at: tuple[float | None, ...]
    """Coordinates of the plane beyond the second; None for that of the gait."""

    @property
    def kind(self) -> type[Walker]:
        """The class of the walker."""
        return self.offer.kind

    @property
    def parameters(self) -> dict[str, float]:
        """The parameters by name."""
        names = (one.name for one in parameters(self.kind))
        return dict(zip(names, self.values, strict=True))

    @property
    def walker(self) -> Walker:
        """The walker itself."""
        return self.offer.build(self.values)

    @property
    def axes(self) -> tuple[str, str]:
        """The names of the two axes of the picture."""
        return "theta", "sum" if self.section == "sheared" else "thetadot"


class WrongParameter(WrongUse):
    """A value of a slider is refused; the second argument is the slider's name."""

    def __str__(self):
        return str(self.args[0])


def read_subject(asked: Any, offers: Offers = FAMILY) -> Subject:
    """The subject of a request; raises `WrongUse` for one that there is not."""
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
    section = choice("section", asked.get("section", SECTIONS[0]), SECTIONS)
    return Subject(offered, values, section, read_slice(offered.kind, asked.get("at", {})))


def read_slice(kind: type[Walker], asked: Any) -> tuple[float | None, ...]:
    """The coordinates beyond the second; None where the gait's are asked for."""
    given, others = mapping("at", asked), kind.section[2:]
    for name in given:
        if name not in others:
            among = ", ".join(others) or "none"
            raise WrongUse(f"at must name coordinates among {among}, not {short(name)}")
    values = ((f"at_{name}", given.get(name)) for name in others)
    return tuple(None if value is None else slider_number(name, value) for name, value in values)


def read_start(subject: Subject, asked: Any) -> Float[np.ndarray, " coordinates"]:
    """A start on the section, or a full state."""
    section = len(subject.kind.section)
    kinds = state_kinds(subject.walker)
    values = numbers("start", asked, (section, *(len(kind._fields) for kind in kinds)))
    return np.array(values)


def mapping(name: str, value: Any) -> Mapping[str, Any]:
    """The value, where it is a JSON object."""
    if not isinstance(value, dict):
        raise WrongUse(f"{name} must be an object, not {short(value)}")
    return value


def choice(name: str, value: Any, among: tuple[str, ...]) -> str:
    """The value, where it is one of some words."""
    if not isinstance(value, str) or value not in among:
        raise WrongUse(f"{name} must be one of {', '.join(among)}, not {short(value)}")
    return value


def number(name: str, value: Any) -> float:
    """The value, where it is a number of a reasonable size."""
    if not is_number(value) or not abs(value) <= LARGEST:  # nor so for NaN
        raise WrongUse(f"{name} must be a number of at most {LARGEST:g}, not {short(value)}")
    return float(value)


def slider_number(name: str, value: Any) -> float:
    """The same; a refusal names the slider."""
    try:
        return number(name, value)
    except WrongUse as error:
        raise WrongParameter(str(error), name) from None


def whole(name: str, value: Any, least: int, most: int) -> int:
    """The value, where it is a whole number between two others."""
    if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= most:
        raise WrongUse(f"{name} must be a whole number from {least} to {most}, not {short(value)}")
    return value


def numbers(name: str, value: Any, lengths: tuple[int, ...]) -> list[float]:
    """The values of a list of one of some lengths."""
    if not isinstance(value, list) or len(value) not in lengths:
        raise WrongUse(
            f"{name} must be {' or '.join(map(str, lengths))} numbers, not {short(value)}"
        )
    return [number(name, one) for one in value]


def slider_range(parameter: Parameter) -> tuple[float, float]:
    """The ends of a parameter's slider; a value beyond them may be typed.

    From zero, or a little below its default where it may be negative, to a few times its default.
    """
    scale = 5 * abs(parameter.default) or 1.0
    above = 0.2 * scale if parameter.low == -math.inf or not parameter.default else 0.8 * scale
    if parameter.low == 0 and not parameter.default:
        above = scale
    low = parameter.low if parameter.low >= 0 else parameter.default - 0.2 * scale
    return max(low, parameter.low), min(parameter.default + above, parameter.high)

"""Offers of the page: walkers and other systems, each with the planes and a window to show."""

import dataclasses
import functools
import importlib
import itertools
import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np

from walker_jax.checks import WrongUse, check_kind, is_number
from walker_jax.fingerprints import code_fingerprint
from walker_jax.robots.robot_files import path_of
from walker_jax.robots.robots import Robot
from walker_jax.systems.family import SYSTEMS
from walker_jax.systems.maps import Map
from walker_jax.systems.system import System, check_single, code_of, has_gait_region, numbers_of
from walker_jax.systems.trees import is_tree, make_static
from walker_jax.walkers.family import OPENING, WALKERS, WINDOWS
from walker_jax.walkers.model import Walker, is_planar
from walker_jax.walkers.parameters import (
    SLOPE,
    Parameter,
    parameters_of,
    span_of,
    trees,
    with_values,
)
from walker_jax.walkers.references import place_of, reference_of

ADDRESS_KEYS = ("walker", "section", "method", "tab", "over", "view", "start")
"""Keys of the page's address besides parameters; state.js writes and reads them."""


class Plane(NamedTuple):
    """A plane in which the page shows the section, along two axes."""

    axes: tuple[str, str]
    names: tuple[str, ...]
    """Names of these axes and of all other coordinates, in the order of the section."""

    @property
    def others(self) -> tuple[str, ...]:
        """The coordinates that are fixed in the plane."""
        return tuple(name for name in self.names if name not in self.axes)


@dataclasses.dataclass(frozen=True)
class Offer:
    """A walker, or another system, that the page offers."""

    name: str
    """Name in requests."""
    kind: type[System] | Map | Robot = dataclasses.field(compare=False)
    """Its class; a `Map` or a `Robot` itself, as all of these share one class."""
    defaults: tuple[float, ...]
    """Initial values of its parameters, in the order of `parameters`."""
    code: str = ""
    """Fingerprint of its code when the server started; empty for a class of the package."""
    axes: tuple[tuple[str, Any], ...] = ()
    """Coordinates that the command has named, each with (low, high, count) or with one value."""

    @property
    def section(self) -> tuple[str, ...]:
        """The names of its coordinates."""
        return self.kind.section

    @property
    def is_walker(self) -> bool:
        """Whether the offer is a walker, in the plane or in space, or a robot from a file."""
        kind = self.kind if isinstance(self.kind, type) else type(self.kind)
        return issubclass(kind, (Walker, Robot))

    @property
    def has_film(self) -> bool:
        """Whether the page draws its motion, as for walkers in the plane."""
        return isinstance(self.kind, type) and self.is_walker and is_planar(self.kind)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Its parameters, with the defaults of this offer."""
        described = zip(parameters_of(self.kind), self.defaults, strict=True)
        return tuple(one._replace(default=value) for one, value in described)

    @property
    def planes(self) -> dict[str, Plane]:
        """The planes in which the page shows it, by name; the page opens in the first one."""
        if self.has_film:
            others = self.section[2:]
            plain = Plane(("theta", "thetadot"), self.section)
            return {"sheared": Plane(("theta", "sum"), ("theta", "sum", *others)), "plain": plain}
        fixed = [name for name, axis in self.axes if is_number(axis)]
        first = ("theta", "thetadot") if self.is_walker else ()
        if isinstance(self.kind, Robot):
            first = self.section[0], f"{self.section[0]}_rate"
        order = lambda pair: (any(name in fixed for name in pair), pair != first)
        pairs = sorted(itertools.combinations(self.section, 2), key=order)
        return {"-".join(pair): Plane(pair, self.section) for pair in pairs}

    @property
    def spans(self) -> dict[str, tuple[float, float]]:
        """The parameters over which its gaits can be followed, each with its range.

        It is empty for a walker in space and for a robot, whose gaits take too long for a page.
        """
        if self.has_film and isinstance(self.kind, type):
            return {"slope": span_of(self.kind, "slope") or SLOPE.span}
        if self.is_walker or not has_gait_region(self.build(self.defaults)):
            return {}
        return {one.name: span_around(one) for one in self.parameters}

    def build(self, values: tuple[float, ...]) -> System:
        """Build the system with values of its parameters, in their order.

        Raises `WrongUse` in a process whose code of the system differs from the server's.
        """
        if self.code and fingerprint_of(self.kind) != self.code:
            raise WrongUse(f"the code of {self.name} has changed: start the server anew")
        described = zip(self.parameters, values, strict=True)
        numbers = {one.name: one.convert(value) for one, value in described}
        if isinstance(self.kind, type):
            return self.kind(**numbers)
        return with_values(self.kind, numbers)

    def __reduce__(self) -> tuple:
        """Pickle a map by its name in a file, as its functions may have no name."""
        kind = self.kind
        if isinstance(kind, Map) or (isinstance(kind, Robot) and path_of(kind) is None):
            module, name = place_of(kind)
            kind = module.__name__, name
        return loaded_offer, (self.name, kind, self.defaults, self.code, self.axes)


def loaded_offer(name: str, kind: type[System] | Robot | tuple[str, str], *others: Any) -> Offer:
    """Restore an offer that comes from another process."""
    if isinstance(kind, tuple):
        return Offer(name, vars(importlib.import_module(kind[0]))[kind[1]], *others)
    return Offer(name, kind, *others)


def flag_of(kind: type[System] | Map | Robot) -> tuple[str, str]:
    """Return the option of a command for a kind, and its name there.

    Raises `WrongUse` for a kind that other processes cannot import or read from a file.
    """
    path = path_of(kind) if isinstance(kind, Robot) else None
    if path is not None:
        return "walker", str(path)
    is_walker = isinstance(kind, type) and issubclass(kind, Walker)
    return "walker" if is_walker else "system", reference_of(kind)


def fingerprint_of(kind: type[System] | Map | Robot) -> str:
    """Return the fingerprint of the code of a class, a map or a robot.

    It is empty for a class of the package.
    """
    if isinstance(kind, type):
        return code_fingerprint(kind)
    return code_fingerprint(type(kind), code_of(kind))


Offers = dict[str, Offer]
"""The offers of a page, by name; a request may name these only."""


def at_defaults(kinds: Mapping[str, type[System]]) -> Offers:
    """Make offers of the classes with defaults for all parameters and two coordinates or more."""
    defaults = {
        name: tuple(OPENING.get(name, {}).get(one.name, one.default) for one in parameters_of(kind))
        for name, kind in kinds.items()
    }
    return {
        name: Offer(name, kind, defaults[name])
        for name, kind in kinds.items()
        if len(kind.section) > 1 and not np.isnan(defaults[name]).any()
    }


FAMILY = at_defaults(WALKERS)
"""Offers of the package's walkers, with default parameters."""
OTHERS = at_defaults(SYSTEMS)
"""Offers of the package's other systems, with default parameters."""


def offer(walker: System, axes: Mapping[str, Any] | None = None) -> Offer:
    """Return the page's offer of a system, or make one with the system's own parameters.

    The window has the given axes; by default it covers the `gait_region`. Raises `WrongUse` for a
    section of one coordinate, for a system without a window, and for a parameter whose name the
    page's address uses for something else.
    """
    check_kind("walker", walker, System)
    check_single(walker)
    if len(walker.section) < 2:
        raise WrongUse(f"{walker.label()} has a section of one coordinate, and pictures have two")
    kind = walker if isinstance(walker, (Map, Robot)) else type(walker)
    check_trees(walker)
    described = parameters_of(kind)
    for one in described:
        if one.name in ADDRESS_KEYS or one.name.startswith("at_"):
            raise WrongUse(f"the page's address has a {one.name} of its own: rename the parameter")
    for one in (FAMILY | OTHERS).values():
        if one.kind is kind and not axes:
            return one
    given = numbers_of(walker)
    values = tuple(float(given[one.name]) for one in described)
    names = {one: name for name, one in SYSTEMS.items()}
    name = names.get(type(walker), walker.label())
    made = Offer(name, kind, values, fingerprint_of(kind), tuple((axes or {}).items()))
    if not made.has_film and not window_of(made):
        raise WrongUse(
            f"{name} has no gait_region, over which the window of the page is: define one, or give "
            "--axis to walker-jax explore"
        )
    return made


def check_trees(walker: System) -> None:
    """Raise `WrongUse` for arrays or trees that are not the defaults of the class."""
    if isinstance(walker, (Map, Robot)):
        wrong = [name for name, one in walker.parameters.items() if is_tree(one) or np.ndim(one)]
    else:
        fields = [(one, getattr(walker, one.name)) for one in trees(type(walker))]
        same = lambda one, value: eqx.tree_equal(value, make_static(one.default, one.name))
        known = lambda one: one.default is not dataclasses.MISSING
        wrong = [one.name for one, value in fields if not (known(one) and same(one, value))]
    if wrong:
        raise WrongUse(
            f"{wrong[0]} must be a number, or the default of the class of {walker.label()}: the "
            "page changes single numbers alone"
        )


def beside(offered: Offer) -> Offers:
    """Return the offers of a page that opens with one offer: it and the package's of its sort."""
    return (FAMILY if offered.is_walker else OTHERS) | {offered.name: offered}


@functools.cache
def window_of(offered: Offer) -> dict[str, tuple[float, float]]:
    """Return the window of an offer: the ends of each coordinate.

    They are those given; otherwise those of `WINDOWS` or of the `gait_region`. Without any of
    these the window is empty. A fixed coordinate has ends
    for its slider.
    """
    walker = offered.build(offered.defaults)
    window = {}
    if offered.name in WINDOWS:
        window |= WINDOWS[offered.name]
    elif has_gait_region(walker):
        region = walker.gait_region()
        shear, origin = np.asarray(region.shear), np.asarray(region.origin)
        middle = origin + shear @ (np.asarray(region.lower) + region.upper) / 2
        half = abs(shear) @ (np.asarray(region.upper) - region.lower) / 2
        ends = np.stack([middle - half, middle + half], axis=1).tolist()
        window = dict(zip(offered.section, map(tuple, ends), strict=True))
    for name, axis in offered.axes:
        if not is_number(axis):
            window[name] = float(axis[0]), float(axis[1])
        elif name not in window or not window[name][0] <= axis <= window[name][1]:
            window[name] = axis - 1, axis + 1
    return window


def slider_range(parameter: Parameter) -> tuple[float, float]:
    """Return the ends of a parameter's slider; the user may type a value beyond them.

    The slider goes from zero, or a little below the default if the parameter may be negative, to a
    few times the default. Both ends are allowed values.
    """
    scale = 5 * abs(parameter.default) or 1.0
    above = 0.2 * scale if parameter.low == -math.inf or not parameter.default else 0.8 * scale
    if parameter.low == 0 and not parameter.default:
        above = scale
    low = parameter.low if parameter.low >= 0 else parameter.default - 0.2 * scale
    low = float(max(low, parameter.low))
    high = float(min(parameter.default + above, parameter.high))
    step = slider_step(low, high)
    return (
        low if parameter.closed or low > parameter.low else low + step,
        high if high < parameter.high else high - step,
    )


def span_around(parameter: Parameter) -> tuple[float, float]:
    """Return the range within half of a parameter's default, cut at the ends of its slider.

    For a default of zero it is the whole slider.
    """
    low, high = slider_range(parameter)
    half = abs(parameter.default) / 2 or high - low
    return max(low, parameter.default - half), min(high, parameter.default + half)


def slider_step(low: float, high: float) -> float:
    """Return the step between the values of a slider, a power of ten."""
    return 10.0 ** math.floor(math.log10((high - low) / 150))

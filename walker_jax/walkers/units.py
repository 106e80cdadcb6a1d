"""Units of length, mass and gravity: numbers of a walker in SI, and SI in the walker's numbers.

A walker has units of its own, such as its leg, its hip mass and gravity: all three are 1, and so
times are in √(l/g). A unit is a product of powers of length, mass, gravity and rad, written as in
`Parameter.unit` and the tables of data sets: "√(l/g)", "rad²/√(l/g)", "mass g length".
"""

import re
from collections.abc import Iterable
from fractions import Fraction
from math import isfinite
from typing import TYPE_CHECKING, Any, NamedTuple

from walker_jax.checks import WrongUse, is_number, short
from walker_jax.storage.schema import KINDS, kind_of
from walker_jax.systems.outcomes import names_in

if TYPE_CHECKING:
    import xarray  # takes half a second to load

BASES = "rad", "mass", "length", "gravity"
WORDS = {"m": "mass", "l": "length", "g": "gravity", "leg length": "length", "hip mass": "mass"}
WORDS |= {"unit of time": "√(length/gravity)", "gl": "gravity length", "sqrt": "√"}
WORDS |= {"²": "^2", "³": "^3", "·": " "}
ANGLE, RATE, TIME, VOLUME = "rad", "rad/√(l/g)", "√(l/g)", "rad³·g/l"
SIZES = {"area", "total_area", "total_area_error"}
"""Sizes of basins, which are volumes over a grid of three dimensions."""
OF_STATES = f"{ANGLE}, {RATE}"
"""Unit of arrays along the coordinates of a section: of angles, and of their rates."""
Powers = dict[str, Fraction]
"""Exponents of the `BASES` in a unit."""


class Units(NamedTuple):
    """Sizes of a walker's units in SI.

    ```python
    units = wj.Units(length=0.8, mass=10.0)  # legs of 0.8 m, a hip of 10 kg, on the Earth
    walker = wj.SpringWalker(**units.numbers(wj.SpringWalker, slope=0.01, hip_stiffness=2.0))
    units.size("√(l/g)") * wj.find_gait(walker).step_times  # in s
    ```
    """

    length: float
    """Unit of length, in m."""
    mass: float
    """Unit of mass, in kg."""
    gravity: float = 9.81
    """Gravity, in m/s²."""

    def size(self, unit: str) -> float:
        """Return the size in SI of a walker's unit, such as "√(l/g)"; raise for an unknown one."""
        for name, value in self._asdict().items():
            if not (is_number(value) and isfinite(value) and value > 0):
                raise WrongUse(f"{name} must be finite and above 0, not {short(value)}", of=name)
        size = 1.0
        for base, power in powers_of(unit).items():
            size *= getattr(self, base, 1.0) ** float(power)
        return size

    def numbers(self, kind: Any, **values: float) -> dict[str, float]:
        """Return a walker's parameters, by the units of its class, from their values in SI."""
        from walker_jax.walkers.parameters import parameters_of

        units = {one.name: one.unit for one in parameters_of(kind)}
        for name in values:
            if name not in units:
                raise WrongUse(f"{name} must be one of {', '.join(units)}", of=name)
        return {name: value / self.size(units[name]) for name, value in values.items()}

    def convert(self, data: "xarray.Dataset") -> "xarray.Dataset":
        """Return a data set in SI; each variable says its unit in the attribute `units`.

        The kind of the data set has the units. A variable without a unit keeps its numbers, such
        as a count, and the axis `sum`, which adds an angle and a rate. Parameters among the
        attributes stay those of the walker.
        """
        kind, units = kind_of(data), units_of(data)
        if not units:
            raise WrongUse(
                f"data must be of a walker, for units, not of {[*names_in(data, 'section')]}"
            )
        data = data.copy()
        for name, unit in units.items():
            data[name] = self.converted(data[name], unit, names_in(data, "section"))
        for name, meaning in KINDS[kind].attributes.items():
            unit = meaning.rpartition("; ")[2]
            if name in data.attrs and is_unit(unit):
                data.attrs[name] = data.attrs[name] * self.size(unit)
        sizes = f"length {self.length:g} m, mass {self.mass:g} kg, gravity {self.gravity:g} m/s²"
        return data.assign_attrs(units=f"SI, from {sizes}")

    def converted(self, array: Any, unit: str, section: Iterable[str]) -> Any:
        """Return an array in SI, with its unit."""
        if unit == OF_STATES and array.dims[-1:] == ("coordinate",):
            each = units_of_section(section)
            found, named = array * [*map(self.size, each)], ", ".join(map(si_unit, each))
        elif is_unit(unit):
            found, named = array * self.size(unit), si_unit(unit)
        else:
            found, named = array, unit
        return found.assign_attrs({**array.attrs, "units": named})


def with_units(data: "xarray.Dataset") -> "xarray.Dataset":
    """Return a data set whose variables say their units, those of the walker, if they are known."""
    units = units_of(data)
    return data.assign({name: data[name].assign_attrs(units=one) for name, one in units.items()})


def units_of_section(section: Iterable[str]) -> list[str]:
    """Return the units of the coordinates of a walker's section: angles, and their rates."""
    return [RATE if name.endswith("dot") else ANGLE for name in section]


def units_of(data: "xarray.Dataset") -> dict[str, str]:
    """Return the unit of each variable that has one, also of axes; none for other systems."""
    section = names_in(data, "section")
    if section[:1] != ("theta",):
        return {}
    known = {name: one.unit for name, one in KINDS[kind_of(data)].variables.items()}
    known |= dict(zip(section, units_of_section(section), strict=True))
    found = {name: unit for name, unit in known.items() if unit and name in data}
    if "fate" in data and {*section[2:]} & {*data["fate"].dims}:
        found |= dict.fromkeys(found.keys() & SIZES, VOLUME)
    return found


def is_unit(text: str) -> bool:
    """Return whether a text is a unit of these bases."""
    try:
        return bool(powers_of(text))
    except WrongUse:
        return False


def powers_of(unit: str) -> Powers:
    """Return the exponents of a unit's bases."""
    text = unit
    for word in sorted(WORDS, key=len, reverse=True):
        bounds = r"\b{}\b" if word.isalpha() or " " in word else "{}"
        text = re.sub(bounds.format(re.escape(word)), WORDS[word], text)
    tokens = re.findall(r"[a-z]+|\^\d+|\S", text)
    found = read_product(tokens)
    if tokens:
        raise WrongUse(f"unit must be of {', '.join(BASES)}, not {short(unit)}", of="unit")
    return {base: power for base, power in found.items() if power}


def read_product(tokens: list[str]) -> Powers:
    """Read factors, of which those after a slash divide, as far as they are units."""
    found: Powers = {base: Fraction(0) for base in BASES}
    sign = 1
    while tokens and (tokens[0] in (*BASES, "/") or tokens[:2] == ["√", "("]):
        token = tokens.pop(0)
        if token == "/":
            sign = -1
            continue
        factor = {token: Fraction(1)}
        if token == "√":
            del tokens[0]
            factor = {base: power / 2 for base, power in read_product(tokens).items()}
            del tokens[:1]
        power = int(tokens.pop(0)[1:]) if "^" in "".join(tokens[:1])[:-1] else 1
        for base, one in factor.items():
            found[base] += sign * power * one
    return found


def si_unit(unit: str) -> str:
    """Return the unit of SI in the place of a walker's unit, such as m/s for √(gl)."""
    powers = dict.fromkeys(BASES, Fraction(0)) | powers_of(unit)
    gravity = powers["gravity"]
    parts = {"rad": powers["rad"], "kg": powers["mass"], "m": powers["length"] + gravity}
    parts["s"] = -2 * gravity
    above = "·".join(with_power(name, power) for name, power in parts.items() if power > 0)
    below = "·".join(with_power(name, -power) for name, power in parts.items() if power < 0)
    return f"{above or '1'}/{below}" if below else above or "1"


def with_power(name: str, power: Fraction) -> str:
    """Write a power of a unit."""
    marks = {Fraction(1): "", Fraction(2): "²", Fraction(3): "³"}
    return name + marks.get(power, f"^{power}")

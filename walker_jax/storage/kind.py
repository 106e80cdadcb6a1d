"""Kinds of data sets: names, dimensions, types, units and attributes of their contents.

A dimension `*name` stands for one or more dimensions, and `?name` for exactly one; the same name
stands for the same dimensions throughout a data set. States are those at the start of a stride, on
the section. Angles are in rad, times in √(l/g), with leg length l and gravity g.
"""

from typing import NamedTuple

SCHEMA_VERSION = 1
"""Version of the tables of kinds; stores of another version are refused."""
TYPES = {"integer": "iub", "real": "fiu", "boolean": "biu", "text": "UOST"}
"""Letters of the NumPy kinds that each type of variable may have."""
STATE = "rad, rad/√(l/g)"
AREA = "rad²/√(l/g)"
TIME = "√(l/g)"
FAILS = "the `Outcome` of its last stride; -1 for none"
DIFFERS = "the gait of `find_gait`, if another one attracts"


class Variable(NamedTuple):
    """A variable of a data set."""

    dims: str
    """Its dimensions in their order."""
    type: str
    """One of `TYPES`."""
    unit: str
    about: str
    when: str = ""
    """The data sets that have it; empty for all."""


class Kind(NamedTuple):
    """A kind of data set."""

    about: str
    variables: dict[str, Variable]
    attributes: dict[str, str]
    """Attributes that every data set of this kind has, with their meaning."""
    base: str = ""
    """The kind whose variables and attributes this one inherits."""


WALKER = {
    "walker": "class of the walker; each parameter is an attribute `walker_` + its name; `code` is "
    "a fingerprint of a class of your own, `failures` the names of its own failures"
}
SECTION = {"section": "names of the coordinates of a state"}

"""The contents of each kind of data set, and whether a data set is of a kind.

The tables are in `kinds.toml`, which says what they mean.
"""

import tomllib
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from walker_jax.checks import WrongUse

if TYPE_CHECKING:
    import xarray  # takes half a second to load

SCHEMA_VERSION = 1
"""Version of the tables of kinds; stores of another version are refused."""
TYPES = {"integer": "iub", "real": "fiu", "boolean": "biu", "text": "UOST"}
"""Letters of the NumPy kinds that each type of variable may have."""
COUNTS = ("checked", "mistaken", "strides_made")
"""Counts of a refined basin; a table lacks them for a walker without a gait."""


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


TABLES = tomllib.loads((Path(__file__).parent / "kinds.toml").read_text(encoding="utf-8"))
COMMON: dict[str, str] = TABLES["common"]
"""Attributes of nearly all kinds, with their meaning."""
KINDS = {
    kind: Kind(
        table["about"],
        {name: Variable(*row) for name, row in table.get("variables", {}).items()},
        {name: one or COMMON[name] for name, one in table.get("attributes", {}).items()},
        table.get("base", ""),
    )
    for kind, table in TABLES["kind"].items()
}
"""The kinds of data sets by name."""
KINDS["robustness table"].variables.update(
    {
        # Integers are reals in a table, which has NaN for a walker without a gait.
        name: one._replace(
            dims=f"?parameter {one.dims}".rstrip(),
            type="real" if one.type == "integer" else one.type,
            when="some walker has a gait" if name in COUNTS else one.when,
        )
        for name, one in {
            "at_border": KINDS["basin"].variables["at_border"],
            **KINDS["refined basin"].variables,
            **KINDS["robustness"].variables,
        }.items()
        if "level" not in one.dims
    }
)
KINDS["sweep"].variables.update(
    {
        name: one._replace(dims=f"*parameters {one.dims}".rstrip(), when="`robust`")
        for name, one in KINDS["robustness"].variables.items()
        if name not in KINDS["sweep"].variables
    }
)


OF_SLICES = {"phidot"}
"""Arrays named after the coordinate whose value they hold."""


def names_in_use(kind: str) -> frozenset[str]:
    """Return the names of a kind's arrays and dimensions, which no axis of its grid may have."""
    variables = variables_of_kind(kind)
    dimensions = {name for one in variables.values() for name in one.dims.split()}
    return frozenset(variables.keys() - OF_SLICES | dimensions)


def variables_of_kind(kind: str) -> dict[str, Variable]:
    """Return the variables of a kind, including those of its base."""
    base = KINDS[kind].base
    return (variables_of_kind(base) if base else {}) | KINDS[kind].variables


def with_dims(kind: str, values: Mapping[str, Any]) -> dict[str, tuple[list[str], Any]]:
    """Return variables of a kind from their values, with the dimensions that its table says."""
    known = variables_of_kind(kind)
    return {name: (known[name].dims.split(), value) for name, value in values.items()}


def attributes_of_kind(kind: str) -> dict[str, str]:
    """Return the attributes of a kind, including those of its base."""
    base = KINDS[kind].base
    return (attributes_of_kind(base) if base else {}) | KINDS[kind].attributes


def kind_of(data: "xarray.Dataset") -> str:
    """Return the kind of a data set: of those that it fits, the one that knows most of it."""
    known: dict[str, int] = {}
    for kind in KINDS:
        with suppress(WrongUse):
            check_dataset(data, kind)
            known[kind] = sum(name in data for name in variables_of_kind(kind))
    if not known:
        raise WrongUse("data must be of a kind of data sets, as docs/data.md lists them")
    return max(known, key=lambda kind: known[kind])


def check_dataset(data: "xarray.Dataset", kind: str) -> None:
    """Raise `WrongUse` for a data set that is not of a kind of `KINDS`, and say why in one line."""
    variables, attributes = variables_of_kind(kind), attributes_of_kind(kind)
    missing = [name for name, one in variables.items() if not one.when and name not in data]
    missing += [f"attribute {name}" for name in attributes if name not in data.attrs]
    if missing:
        raise WrongUse(f"data must be of the kind {kind!r}, not one without {', '.join(missing)}")
    bound: dict[str, tuple[str, ...]] = {}
    for name, one in variables.items():
        if name not in data:
            continue
        dims, letter = tuple(map(str, data[name].dims)), data[name].dtype.kind
        if not matches(one.dims, dims, bound):
            expected = f"over ({', '.join(one.dims.split())}), not ({', '.join(dims)})"
            raise WrongUse(f"data must be of the kind {kind!r}, with {name} {expected}")
        if letter not in TYPES[one.type]:
            expected = f"of type {one.type}, not {data[name].dtype}"
            raise WrongUse(f"data must be of the kind {kind!r}, with {name} {expected}")


def matches(pattern: str, dims: tuple[str, ...], bound: dict[str, tuple[str, ...]]) -> bool:
    """Return whether dimensions fit a pattern; add the meaning of its placeholders to `bound`."""
    before, placeholder, after = [], "", []
    for name in pattern.split():
        known = bound.get(name, () if name[0] in "*?" else (name,))
        if known:
            (after if placeholder else before).extend(known)
        else:
            placeholder = name
    fixed = len(before) + len(after)
    middle = dims[len(before) : len(dims) - len(after)]
    if dims[: len(before)] != tuple(before) or dims[len(dims) - len(after) :] != tuple(after):
        return False
    if not placeholder:
        return len(dims) == fixed
    if len(dims) <= fixed or (placeholder[0] == "?" and len(middle) > 1):
        return False
    bound[placeholder] = middle
    return True

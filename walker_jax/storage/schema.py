"""The contents of each kind of data set, and whether a data set is of a kind.

The tables are in `kinds.toml`, which says what they mean.
"""

import re
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
PLACEHOLDERS = {"*": r"((?:.+\n)+)", "?": r"(.+\n)"}
"""Dimensions, a line each, that a placeholder may stand for, by its sign."""
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


TABLES = tomllib.loads((Path(__file__).parent / "kinds.toml").read_text(encoding="utf-8"))
COMMON: dict[str, str] = TABLES["common"]
"""Attributes of nearly all kinds, with their meaning."""
OWN = {
    kind: {name: Variable(*row) for name, row in table.get("variables", {}).items()}
    for kind, table in TABLES["kind"].items()
}
"""The variables of each kind besides those of its base."""
OWN["robustness table"] |= {
    # Integers are reals in a table, which has NaN for a walker without a gait.
    name: one._replace(
        dims=f"?parameter {one.dims}".rstrip(),
        type="real" if one.type == "integer" else one.type,
        when="some walker has a gait" if name in COUNTS else one.when,
    )
    for name, one in {
        "at_border": OWN["basin"]["at_border"],
        **OWN["refined basin"],
        **OWN["robustness"],
    }.items()
    if "level" not in one.dims
}
OWN["sweep"] |= {
    name: one._replace(dims=f"*parameters {one.dims}".rstrip(), when="`robust`")
    for name, one in OWN["robustness"].items()
    if name not in OWN["sweep"]
}


def with_bases() -> dict[str, Kind]:
    """Return the kinds by name, each with the variables and attributes of its base."""
    found = {"": Kind("", {}, {})}
    for kind, table in TABLES["kind"].items():  # a base comes before the kinds that have it
        base, own = found[table.get("base", "")], table.get("attributes", {})
        attributes = base.attributes | {name: one or COMMON[name] for name, one in own.items()}
        found[kind] = Kind(table["about"], base.variables | OWN[kind], attributes)
    del found[""]
    return found


KINDS = with_bases()
"""The kinds of data sets by name."""
OF_SLICES = {"phidot"}
"""Arrays named after the coordinate whose value they hold."""


def names_in_use(kind: str) -> frozenset[str]:
    """Return the names of a kind's arrays and dimensions, which no axis of its grid may have."""
    variables = KINDS[kind].variables
    dimensions = {name for one in variables.values() for name in one.dims.split()}
    return frozenset(variables.keys() - OF_SLICES | dimensions)


def with_dims(kind: str, values: Mapping[str, Any]) -> dict[str, tuple[list[str], Any]]:
    """Return variables of a kind from their values, with the dimensions that its table says."""
    known = KINDS[kind].variables
    return {name: (known[name].dims.split(), value) for name, value in values.items()}


def kind_of(data: "xarray.Dataset") -> str:
    """Return the kind of a data set: of those that it fits, the one that knows most of it."""
    known: dict[str, int] = {}
    for name, kind in KINDS.items():
        with suppress(WrongUse):
            check_dataset(data, name)
            known[name] = sum(one in data for one in kind.variables)
    if not known:
        raise WrongUse("data must be of a kind of data sets, as docs/data.md lists them")
    return max(known, key=lambda name: known[name])


def check_dataset(data: "xarray.Dataset", kind: str) -> None:
    """Raise `WrongUse` for a data set that is not of a kind of `KINDS`, and say why in one line."""
    _, variables, attributes = KINDS[kind]
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
    names = pattern.split()
    new = [name for name in names if name[0] in PLACEHOLDERS and name not in bound]
    in_lines = lambda known: "".join(f"{one}\n" for one in known)
    known = lambda name: re.escape(in_lines(bound.get(name, (name,))))
    form = "".join(PLACEHOLDERS[name[0]] if name in new else known(name) for name in names)
    found = re.fullmatch(form, in_lines(dims))
    if found is not None:
        bound.update(zip(new, (tuple(one.splitlines()) for one in found.groups()), strict=True))
    return found is not None

"""Each kind of data set has one table, which the library keeps to, and pages and pictures too."""

from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import walker_jax as wj
from walker_jax import storage
from walker_jax.checks import WrongUse
from walker_jax.storage.schema import (
    COMMON,
    KINDS,
    OWN,
    TABLES,
    TYPES,
    Variable,
    check_dataset,
)

PAGE = Path(__file__).parents[2] / "docs" / "data.md"
FIRST = "## "
"""What the tables of the page begin with."""


SUFFIXES = {
    "_error": "its standard error",
    "_low": "end of its 95 % interval",
    "_high": "the other end",
}
"""The page says once what these mean."""


def tables() -> str:
    """The page's tables, as they follow from the code."""
    lines = []
    for name, kind in KINDS.items():
        base = TABLES["kind"][name].get("base", "")
        base = f" It has the variables of {link(base)} too." * bool(base)
        lines += [f"{FIRST}{name.capitalize()}", "", f"{kind.about}{base}", ""]
        lines += ['<details markdown="1"><summary>Variables and attributes</summary>', ""]
        lines += [*own_variables(name), *shared_variables(name), *attributes(name)]
        lines += ["</details>", ""]
    return "\n".join(lines)


def own_variables(kind: str) -> list[str]:
    """The table of variables that no kind before this one describes."""
    own = {name: one for name, one in OWN[kind].items() if not described(kind, name)}
    rows = [
        f"| {', '.join(names)} | {' '.join(f'`{dim}`' for dim in own[name].dims.split())} | "
        f"{'; '.join(filter(None, (own[name].type, own[name].unit)))} | {own[name].about}"
        f"{f' ({own[name].when})' * bool(own[name].when)} |"
        for name, names in together(own).items()
    ]
    return (
        ["| variable | dimensions | type; unit | |", "|---|---|---|---|", *rows, ""] if rows else []
    )


def shared_variables(kind: str) -> list[str]:
    """The variables that another kind describes, by kind, added dimension and condition."""
    groups: dict[tuple[str, str], dict[str, Variable]] = {}
    for name, one in OWN[kind].items():
        if found := described(kind, name):
            other, added = found
            when = one.when if one.when != OWN[other][name].when else ""
            place = f", over `{added}` too" * bool(added) + f" ({when})" * bool(when)
            groups.setdefault((other, place), {})[name] = one
    lines = [
        f"- As in {link(other)}{place}: {names_of(group, OWN[other])}"
        for (other, place), group in groups.items()
    ]
    return [*lines, ""] if lines else []


def names_of(some: dict[str, Variable], of: dict[str, Variable]) -> str:
    """Names of some variables of a kind, or of the others if these are fewer."""
    others = {name: one for name, one in of.items() if name not in some}
    listed = others if len(others) < len(some) else some
    quoted = ", ".join(name for names in together(listed).values() for name in names)
    return quoted if listed is some else "all" + f" but {quoted}" * bool(others)


def link(kind: str) -> str:
    """A link to the section of a kind."""
    return f"[{kind}](#{kind.replace(' ', '-')})"


def together(variables: dict[str, Variable]) -> dict[str, list[str]]:
    """The names for each row: a variable, its error or interval, and neighbours alike in all."""
    rows: dict[str, list[str]] = {}
    last = ""
    for name, one in variables.items():
        first, mark, suffix = name.rpartition("_")
        if first in rows and one.about == SUFFIXES.get(mark + suffix):
            rows[first].append(f"`{name}`")
        elif last and one == variables[last]:
            rows[last].append(f"`{name}`")
        else:
            rows[name] = [f"`{name}`"]
            last = name
    return rows


def described(kind: str, name: str) -> tuple[str, str] | None:
    """The kind before this one that describes a variable alike, and the dimension added here."""
    mine = OWN[kind][name]
    added, _, rest = mine.dims.partition(" ")
    first, mark, suffix = name.rpartition("_")
    if first in OWN[kind] and mine.about == SUFFIXES.get(mark + suffix):
        return described(kind, first)
    for other in [*KINDS][: [*KINDS].index(kind)]:
        one = OWN[other].get(name)
        if one and (one.unit, one.about) == (mine.unit, mine.about):
            if (one.dims, one.type, one.when) == (mine.dims, mine.type, mine.when):
                return other, ""
            if added in ("*parameters", "?parameter", "frame", "slope") and one.dims == rest:
                return other, added
    return None


def attributes(kind: str) -> list[str]:
    """The table of attributes, but those that the page describes once for all kinds."""
    named = TABLES["kind"][kind].get("attributes", {})
    own = {name: KINDS[kind].attributes[name] for name in named}
    rows = [f"| `{name}` | {about} |" for name, about in own.items() if COMMON.get(name) != about]
    lines = ["| attribute | |", "|---|---|", *rows, ""] if rows else []
    missing = [f"`{name}`" for name in COMMON if name not in KINDS[kind].attributes]
    return [*lines, f"No attribute {' or '.join(missing)}.", ""] if missing else lines


def renewed(page: str) -> str:
    """A page with the tables that follow from the code."""
    return page[: page.index(FIRST)] + tables()


def test_the_page_has_the_tables_of_the_code():
    """After a change of the code, `python tests/storage/test_schema.py` writes the page anew."""
    page = PAGE.read_text()
    assert page == renewed(page)


def test_every_variable_has_a_type_and_a_meaning():
    for kind in KINDS:
        for name, one in KINDS[kind].variables.items():
            assert one.type in TYPES and one.about, (kind, name)


def basin() -> xr.Dataset:
    grid = wj.Grid.sheared(theta=(0.1, 0.3, 6), sum=(-0.02, 0.01, 5))
    return wj.basin(wj.SimplestWalker(0.004), grid, "direct")


@pytest.fixture(scope="module")
def data():
    return basin()


def check_known(data: xr.Dataset, kind: str, *more: str) -> None:
    """A data set is of a kind, and has no variable of which its table does not know."""
    check_dataset(data, kind)
    assert set(map(str, data.data_vars)) <= {*KINDS[kind].variables, *more}


def test_the_library_keeps_to_the_tables(data, tmp_path):
    walker = wj.SimplestWalker(0.004)
    grid = wj.Grid.sheared(theta=(0.1, 0.3, 6), sum=(-0.02, 0.01, 5))
    check_known(data, "basin")
    check_known(wj.basin(walker, grid), "basin")
    check_known(wj.basin(walker, grid, "direct", out=tmp_path / "basin.zarr"), "basin")
    check_known(wj.refine(walker, grid, 1, check=100), "refined basin")
    check_known(wj.motion(walker, np.array([0.2, -0.23]), 2, step=0.4), "walk")
    check_known(wj.sweep(walker, {"slope": [0.004, 0.005]}, grid, levels=0, check=0), "sweep")


def test_a_gait_that_is_not_there_is_robustness_too():
    """On so steep a slope nothing attracts."""
    walker = wj.SimplestWalker(0.03)
    grid = wj.Grid.sheared(theta=(0.1, 0.3, 6), sum=(-0.02, 0.01, 5))
    check_known(wj.robustness(walker, grid, levels=0, check=0), "robustness")
    table = wj.robustness(walker, grid, values=[0.03, 0.04], levels=0, check=0)
    check_known(table, "robustness table")


def test_a_data_set_from_disk_is_of_its_kind(data, tmp_path):
    storage.save(data, tmp_path / "basin.zarr", {})
    check_dataset(storage.open_dataset(tmp_path / "basin.zarr"), "basin")


@pytest.mark.parametrize(
    "change, message",
    [
        (lambda data: data.drop_vars(["fate", "period"]), "not one without fate, period"),
        (lambda data: data.drop_attrs(), "without attribute walker, attribute section"),
        (
            lambda data: data.assign(attractor=data["attractor"].T),
            r"with attractor over \(\*grid\), not \(sum, theta\)",
        ),
        (
            lambda data: data.assign(cells=data["cells"].expand_dims("level")),
            r"with cells over \(number\), not \(level, number\)",
        ),
        (
            lambda data: data.assign(fate=data["fate"].astype(float)),
            "with fate of type integer, not float64",
        ),
    ],
    ids=["missing", "attributes", "grid", "dimension", "type"],
)
def test_what_is_wrong_is_said_in_one_line(data, change, message):
    with pytest.raises(WrongUse, match=f"^data must be of the kind 'basin', .*{message}") as error:
        check_dataset(change(data), "basin")
    assert "\n" not in str(error.value)


def test_one_dimension_is_not_two(data):
    """That of a table is a parameter, whatever its name; those of a sweep may be many."""
    zeros = lambda one: np.zeros((2,) * len(one.dims.split()), str if one.type == "text" else float)
    table = xr.Dataset(
        {
            name: (["slope", *one.dims.split()[1:]], zeros(one))
            for name, one in KINDS["robustness table"].variables.items()
        },
        attrs={"walker": "SimplestWalker"},
    )
    check_dataset(table, "robustness table")
    with pytest.raises(WrongUse, match=r"over \(\?parameter\), not \(mass, slope\)"):
        check_dataset(table.expand_dims(mass=2), "robustness table")


def test_what_some_data_sets_lack_may_be_missing(data):
    mapped = data.assign(artefact=("number", np.zeros(data.sizes["number"], bool)))
    check_dataset(mapped, "basin")
    check_dataset(mapped.drop_vars("artefact"), "basin")


if __name__ == "__main__":
    PAGE.write_text(renewed(PAGE.read_text()))

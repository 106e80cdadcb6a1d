"""Each kind of data set has one table, which the library keeps to, and pages and pictures too."""

from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import walker_jax as wj
from walker_jax import storage
from walker_jax.checks import WrongUse
from walker_jax.storage.schema import KINDS, TYPES, check_dataset, variables_of_kind

PAGE = Path(__file__).parents[2] / "docs" / "data.md"
FIRST = "## "
"""What the tables of the page begin with."""


def tables() -> str:
    """The page's tables, as they follow from the code."""
    lines = []
    for name, kind in KINDS.items():
        base = f" It has the variables of *{kind.base}* too." * bool(kind.base)
        lines += [f"{FIRST}{name.capitalize()}", "", f"{kind.about}{base}", ""]
        lines += ['<details markdown="1"><summary>Variables and attributes</summary>', ""]
        lines += ["| variable | dimensions | type | unit | | where |", "|---|---|---|---|---|---|"]
        lines += [
            f"| `{variable}` | {' '.join(f'`{dim}`' for dim in one.dims.split())} | {one.type} | "
            f"{one.unit} | {one.about} | {one.when} |"
            for variable, one in kind.variables.items()
        ]
        if kind.attributes:
            lines += ["", "| attribute | |", "|---|---|"]
            lines += [
                f"| `{attribute}` | {about} |" for attribute, about in kind.attributes.items()
            ]
        lines += ["", "</details>", ""]
    return "\n".join(lines)


def renewed(page: str) -> str:
    """A page with the tables that follow from the code."""
    return page[: page.index(FIRST)] + tables()


def test_the_page_has_the_tables_of_the_code():
    """After a change of the code, `python tests/storage/test_schema.py` writes the page anew."""
    page = PAGE.read_text()
    assert page == renewed(page)


def test_every_variable_has_a_type_and_a_meaning():
    for kind in KINDS:
        for name, one in variables_of_kind(kind).items():
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
    assert set(map(str, data.data_vars)) <= {*variables_of_kind(kind), *more}


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
    table = wj.robustness_table(walker, [0.03, 0.04], grid=grid, levels=0, check=0)
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
            for name, one in variables_of_kind("robustness table").items()
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

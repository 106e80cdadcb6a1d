"""Data sets as tables and as MATLAB's files, read again by other readers."""

import csv
import io

import numpy as np
import pytest
import xarray as xr
from scipy.io import loadmat

from walker_jax import storage
from walker_jax.checks import WrongUse
from walker_jax.storage.tables import as_tex, table_of

SPEED = xr.DataArray([0.1, np.nan, 1 / 3], dims="slope", attrs={"units": "m/s"})
STATES = xr.DataArray(np.arange(6.0).reshape(3, 2), dims=("slope", "coordinate"))
STATES.attrs["units"] = "rad, rad/s"
CELLS = xr.DataArray([[1, 2, 3], [4, 5, 6]], dims=("x", "slope"))


@pytest.fixture
def data():
    note = np.array(["a_b", "", "5 %"], object)
    variables = {"speed": SPEED, "state": STATES, "note": ("slope", note)}
    variables |= {"cells": CELLS, "total": 3.0}
    attributes = {"section": "theta, thetadot"}
    return xr.Dataset(variables, {"slope": [0.1, 0.2, 0.3], "x": [1.0, 2.0]}, attributes)


def test_a_table_has_rows_of_a_variable(data):
    table = table_of(data)
    columns = ["slope", "note", "speed (m/s)", "state_theta (rad)", "state_thetadot (rad/s)"]
    assert [*table.columns] == columns
    np.testing.assert_array_equal(table["state_thetadot (rad/s)"], [1, 3, 5])
    cells = table_of(data, "cells")
    assert cells.to_dict("list") == {
        "x": [1.0] * 3 + [2.0] * 3,
        "slope": [0.1, 0.2, 0.3] * 2,
        "cells": [1, 2, 3, 4, 5, 6],
    }
    with pytest.raises(WrongUse, match=r"rows must be one of .*, not cell$"):
        table_of(data, "cell")
    with pytest.raises(WrongUse, match="data has no variable with dimensions"):
        table_of(data[["total"]])


def test_files_for_other_programs(tmp_path, data):
    """CSV keeps all digits, MATLAB's file all variables and their units."""
    path = tmp_path / "a.zarr"
    storage.save(data, path, {"command": "sweep", "version": "1"})
    for name in ("a.csv", "a.tex", "a.mat"):
        storage.export(path, tmp_path / name)
    rows = list(csv.DictReader(io.StringIO((tmp_path / "a.csv").read_text())))
    assert [row["speed (m/s)"] for row in rows] == ["0.1", "", "0.3333333333333333"]
    found = loadmat(tmp_path / "a.mat", squeeze_me=True, simplify_cells=True)
    np.testing.assert_array_equal(found["state"], data["state"])
    assert found["units"]["speed"] == "m/s" and found["dimensions"]["cells"] == "x slope"
    assert [found["note"][0], found["note"][2]] == ["a_b", "5 %"]
    assert (tmp_path / "a.tex").read_text() == as_tex(table_of(storage.open_dataset(path)))
    with pytest.raises(WrongUse, match=r"must end in one of \.nc, \.csv, \.tex, \.mat, not"):
        storage.export(path, tmp_path / "a.txt")


def test_latex_reads_each_row(data):
    lines = as_tex(table_of(data[["speed", "note"]])).splitlines()
    assert lines[:3] == [r"\begin{tabular}{rrr}", r"\toprule", r"slope & note & speed (m/s) \\"]
    rows = [r"0.1 & a\_b & 0.1 \\", r"0.2 &  & -- \\", r"0.3 & 5 \% & 0.333333 \\"]
    assert lines[4:7] == rows and lines[-1] == r"\end{tabular}"

"""Robots from files on the command line."""

import json
import shutil

import numpy as np
import pytest
import xarray as xr
from robot_examples import FILES, as_robot

GAIT = as_robot((0.28809807504, -0.35705418063, -0.20285043033))
START = [
    f"--start={name}={value}"
    for name, value in zip(
        ("stance_leg", "stance_leg_rate", "swing_leg_rate"), GAIT.tolist(), strict=True
    )
]


@pytest.fixture
def run(run, tmp_path, monkeypatch):
    """Run a command beside the files of robots."""
    for file in FILES.glob("*.xml"):
        shutil.copy(file, tmp_path)
    monkeypatch.chdir(tmp_path)
    return run


def test_a_file_leads_to_a_gait_and_its_numbers_are_options(run):
    code, out, error = run("gait", "--walker", "compass.xml", *START, "--json")
    assert code == 0, error
    (gait,) = json.loads(out)["gaits"]
    assert np.abs(np.array(gait["states"][0]) - GAIT).max() < 1e-7
    code, out, error = run("gait", "--walker", "compass.xml", "--leg-mass", "4.9", *START)
    assert code == 0 and "stable gait of period 1 at slope 0.05 rad" in out, error


@pytest.mark.slow
def test_a_file_leads_to_a_basin(run, tmp_path):
    code, out, error = run("basin", "--walker", "compass.xml")
    assert code == 0, error
    assert "walks" in out and "slice at swing_leg_rate 0.48298" in out
    data = xr.open_zarr(tmp_path / "basin.zarr", consolidated=False)
    assert data.fate.shape == (100, 100) and int((data.attractor == 0).sum()) > 300


def test_a_foreign_file_is_refused_in_one_line(run, tmp_path):
    (tmp_path / "page.xml").write_text("<html/>")
    code, out, error = run("gait", "--walker", "page.xml")
    assert (code, out) == (2, "") and error.count("\n") == 1
    assert "--walker page.xml: path page.xml cannot be read: XML Error" in error

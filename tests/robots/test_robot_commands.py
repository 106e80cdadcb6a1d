"""Robots from files on the command line."""

import json
import pickle
import shutil
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr
from robot_examples import FILES, as_robot

import walker_jax as wj

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


def test_a_robot_travels_without_its_file_and_mujoco(tmp_path, monkeypatch):
    file = tmp_path / "compass.xml"
    shutil.copy(FILES / file.name, file)
    robot = wj.robot(file)
    packed = pickle.dumps(robot)
    file.unlink()
    monkeypatch.setitem(sys.modules, "mujoco", None)
    there = pickle.loads(packed)
    assert there.parameters == robot.parameters and there.section == robot.section
    rates = lambda one: one.modes()["stance"].field(one.lift(jnp.asarray(GAIT)))
    np.testing.assert_array_equal(jax.tree.leaves(rates(there)), jax.tree.leaves(rates(robot)))


@pytest.mark.slow
def test_workers_compute_the_basin_of_a_robot(tmp_path, monkeypatch):
    """As this process does, to the last bit; they have neither its file nor MuJoCo."""
    pytest.importorskip("distributed")
    file = tmp_path / "compass.xml"
    shutil.copy(FILES / file.name, file)
    robot = wj.robot(file)
    file.unlink()
    (tmp_path / "mujoco.py").write_text("raise ImportError('there is none')")
    monkeypatch.syspath_prepend(tmp_path)  # workers look for packages where this process does
    at = dict(zip(robot.section, GAIT.tolist(), strict=True))
    grid = wj.Grid.through(at, stance_leg=(-0.4, -0.2, 8), stance_leg_rate=(0.7, 1.5, 8))
    here = wj.basin(robot, grid, "direct", progress=False)
    there = wj.basin(robot, grid, "direct", progress=False, out=tmp_path / "a", cluster=1)
    for name in ("fate", "attractor", "strides"):
        np.testing.assert_array_equal(there[name], here[name])
    assert 0 < int((here.attractor == 0).sum()) < here.attractor.size


def test_a_foreign_file_is_refused_in_one_line(run, tmp_path):
    (tmp_path / "page.xml").write_text("<html/>")
    code, out, error = run("gait", "--walker", "page.xml")
    assert (code, out) == (2, "") and error.count("\n") == 1
    assert "--walker page.xml: path page.xml cannot be read: XML Error" in error

"""Answers of commands in SI, and files of other programs."""

import csv
import json

import numpy as np
import pytest

import walker_jax as wj
from walker_jax import storage

UNITS = ["--units", "length=0.8", "--units", "mass=10", "--units", "gravity=1.62"]
TIME = (0.8 / 1.62) ** 0.5
"""The unit of time, √(l/g), in s."""


def test_a_gait_and_a_walk_in_si(run):
    gait = wj.find_gait(wj.SimplestWalker(0.009))
    code, out, err = run("gait", "--slope", "0.009", *UNITS, "--json")
    assert (code, err) == (0, "")
    (found,), said = json.loads(out)["gaits"], json.loads(out)["units"]
    assert found["step_times"] == pytest.approx(gait.step_times * TIME, rel=1e-14)
    assert found["states"][0] == pytest.approx(np.asarray(gait.states[0]) / [1, TIME], rel=1e-14)
    assert said == {"angle": "rad", "rate": "rad/s", "time": "s"} | {
        "length": 0.8,
        "mass": 10.0,
        "gravity": 1.62,
    }
    code, out, err = run("gait", "--slope", "0.009", *UNITS)
    assert code == 0 and f"step time {found['step_times'][0]:.10f} s\n" in out, err
    start = ["--theta", "0.2", "--thetadot", "-0.2", "--strides", "1", "--slope", "0.009"]
    code, out, err = run("walk", *start, *UNITS)
    made = wj.stride(wj.SimplestWalker(0.009), [0.2, -0.2])
    head, names, first, *_ = out.splitlines()
    assert head == "Angles in rad, rates in rad/s, times in s." and "time" in names
    numbers = [float(one) for one in first.split()[1:4]]
    assert numbers == pytest.approx([0.2, -0.2 / TIME, float(made.time) * TIME], abs=1e-4)
    code, out, err = run("walk", *start)
    assert code == 0 and "rad" not in out and float(out.splitlines()[1].split()[2]) == -0.2, err


def test_an_exported_table_says_its_units(run, tmp_path):
    grid = wj.Grid.sheared(theta=(0.1, 0.2, 4), sum=(-0.01, 0.01, 5))
    data = wj.basin(wj.SimplestWalker(0.004), grid, progress=False)
    storage.save(data, tmp_path / "a.zarr", {"command": "basin", "version": "1"})
    area = float(data.area[0])
    for units, expected, named in (([], area, "rad²/√(l/g)"), (UNITS, area / TIME, "rad²/s")):
        code, out, err = run("export", "a.zarr", "a.csv", "--overwrite", *units)
        assert code == 0 and "a.csv: a table, with units in brackets" in out, err
        with (tmp_path / "a.csv").open() as file:
            (row, *_) = csv.DictReader(file)
        assert float(row[f"area ({named})"]) == pytest.approx(expected, rel=1e-14)
    code, _, err = run("export", "a.zarr", "cells.csv", "--rows", "fate")
    assert code == 0, err
    table = np.genfromtxt(tmp_path / "cells.csv", delimiter=",", names=True)
    assert len(table) == 20
    np.testing.assert_array_equal(table["fate"], data.fate.values.ravel())

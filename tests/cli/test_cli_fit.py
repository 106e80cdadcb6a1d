"""The command that fits a walker to a file of recordings."""

import json

import numpy as np
import pytest
import xarray as xr

import walker_jax as wj

NOISE = 1e-3


@pytest.fixture
def file(tmp_path):
    """Six steps of the simplest walker, in degrees, with a column that tells the leg."""
    random, walker = np.random.default_rng(0), wj.SimplestWalker(0.009)
    made = wj.walk(walker, wj.find_gait(walker).states[0], 6)
    strikes = np.append(0, np.cumsum(made.times))
    times = np.arange(-0.5, strikes[-1] + 0.5, 0.1)
    within = np.clip(times, 0, strikes[-1] - 1e-9)
    state = wj.trajectory(walker, made.states[0], within, strides=6)
    draw = lambda values: np.rad2deg(np.asarray(values) + NOISE * random.normal(size=len(times)))
    legs = np.searchsorted(strikes, times) % 2
    rows = np.column_stack([times, draw(state.theta), draw(state.phi), legs])
    path = tmp_path / "walk.csv"
    np.savetxt(path, rows, "%.12g", ",", header="time,stance,hip,leg", comments="")
    return path


def test_a_file_gives_a_slope_with_its_error(run, file):
    columns = ["--column", "theta=stance", "--column", "phi=hip"]
    units = ["--unit", "theta=deg", "--unit", "phi=deg"]
    noise = ["--noise", f"theta={NOISE}", "--noise", f"phi={NOISE}"]
    out = file.with_suffix(".zarr")
    line = ["fit", str(file), "--slope", "0.0095", "--parameters", "slope", "--strikes", "leg"]
    line += [*columns, *units, *noise, "--out", str(out)]
    code, said, err = run(*line, "--json")
    assert (code, err) == (0, "")
    answer = json.loads(said)
    slope = answer["parameters"]["slope"]
    assert answer["steps"] == 6 and answer["converged"]
    assert abs(slope["value"] - 0.009) < 4 * slope["error"] < 2e-3
    data = xr.open_zarr(out, consolidated=False)
    assert float(data["value"][0]) == slope["value"]
    assert out.with_suffix(".png").stat().st_size > 10_000
    code, said, _ = run(*line)  # again, from the data set
    assert code == 0 and f"slope {slope['value']:.8g} +- {slope['error']:.2g}" in said


def test_columns_are_named_as_they_are_in_the_file(run, file):
    """A column of times has another unit, and its name a hyphen; those of angles have colons."""
    times, rows = "time-ms,leg:stance,leg:hip,leg", file.read_text().splitlines()[1:]
    cells = [row.split(",", 1) for row in rows]
    file.write_text("\n".join([times, *(f"{1000 * float(t):.12g},{one}" for t, one in cells)]))
    line = ["fit", str(file), "--slope", "0.0095", "--parameters", "slope", "--strikes", "leg"]
    line += ["--time", "time-ms", "--unit", "time-ms=ms", "--column", "theta=leg:stance"]
    line += ["--column", "phi=leg:hip", "--unit", "theta=deg", "--unit", "phi=deg", "--json"]
    code, said, err = run(*line)
    assert (code, err) == (0, "")
    slope = json.loads(said)["parameters"]["slope"]
    assert abs(slope["value"] - 0.009) < 4 * slope["error"] < 2e-3


def test_degrees_are_told(run, file):
    line = ["fit", str(file), "--parameters", "slope", "--slope", "0.0095"]
    code, out, err = run(*line, "--column", "theta=stance")
    assert (code, out) == (2, "") and "--column must be in rad, but theta reaches 11." in err
    assert err.endswith(": give --unit, such as deg for theta\n")

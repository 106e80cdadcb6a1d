"""Recordings are read from files and arrays, cut into steps, and wrong ones are told."""

import numpy as np
import pytest
import xarray as xr
from made_up_recordings import record_ball
from scipy.io import savemat

import walker_jax as wj
from walker_jax.fitting.recordings import as_recordings
from walker_jax.fitting.steps import cut_steps, tables_of_inputs

TIME = np.arange(0, 3.0, 0.01)
STRIKES = np.array([0.204, 0.906, 1.603, 2.298])
NUMBER = np.searchsorted(STRIKES, TIME)
THETA = 0.2 - 0.6 * (TIME - np.append(-0.5, STRIKES)[NUMBER])
SAMPLES = {"time": TIME, "stance": np.rad2deg(THETA), "leg": NUMBER % 2, "motor": np.sin(TIME)}


def write(path):
    """Write the samples as a file of one of the formats."""
    match path.suffix:
        case ".csv":
            rows = np.column_stack([*SAMPLES.values()])
            np.savetxt(path, rows, "%.17g", ",", header=",".join(SAMPLES), comments="")
        case ".nc":
            data = {name: ("row", one) for name, one in SAMPLES.items()}
            xr.Dataset(data).to_netcdf(path, engine="h5netcdf")
        case ".mat":
            savemat(path, SAMPLES)
    return path


READ = {"columns": {"theta": "stance"}, "units": {"theta": "deg"}, "strikes": "leg"}


@pytest.mark.parametrize("suffix", [".csv", ".nc", ".mat"])
def test_files_give_what_arrays_give(suffix, tmp_path):
    (known,) = wj.read_recordings(SAMPLES, inputs=["motor"], **READ)
    (found,) = wj.read_recordings(write(tmp_path / f"walk{suffix}"), inputs=["motor"], **READ)
    np.testing.assert_allclose(found.values["theta"], THETA, rtol=1e-14)
    np.testing.assert_allclose(found.inputs["motor"], np.sin(TIME), rtol=1e-14)
    np.testing.assert_array_equal(found.strikes, known.strikes)
    np.testing.assert_allclose(found.strikes, STRIKES, atol=0.005)
    assert found.stance == known.stance == 1


def test_a_pandas_table_is_read():
    pandas = pytest.importorskip("pandas")
    (found,) = wj.read_recordings(pandas.DataFrame(SAMPLES), **READ)
    np.testing.assert_allclose(found.values["theta"], THETA, rtol=1e-14)


def test_heel_strikes_are_found_where_a_coordinate_jumps():
    """Half-way between two samples; noise finds no more."""
    noisy = THETA + 1e-3 * np.random.default_rng(0).normal(size=len(THETA))
    (found,) = wj.read_recordings({"time": TIME, "theta": noisy})
    assert found.strikes.shape == STRIKES.shape
    assert np.abs(found.strikes - STRIKES).max() <= 0.005 + 1e-12


def test_units_are_words_or_sizes():
    given = {"time": 1e3 * TIME, "theta": -2 * THETA}
    (found,) = wj.read_recordings(given, units={"time": "ms", "theta": -0.5}, strikes=1e3 * STRIKES)
    np.testing.assert_allclose(found.time, TIME, rtol=1e-14)
    np.testing.assert_allclose(found.values["theta"], THETA, rtol=1e-14)
    np.testing.assert_allclose(found.strikes, STRIKES, rtol=1e-14)


def test_experiments_in_one_file_are_told_apart():
    twice = {name: np.tile(one, 2) for name, one in SAMPLES.items()}
    twice["number"] = np.repeat([7, 3], len(TIME))
    found = wj.read_recordings(twice, experiment="number", inputs=["motor"], **READ)
    assert len(found) == 2
    np.testing.assert_array_equal(found[0].time, found[1].time)


def test_the_table_counts_steps_and_gaps():
    theta = THETA.copy()
    theta[40:60] = np.nan
    found = wj.read_recordings({"time": TIME, "theta": theta}, strikes=STRIKES)
    ((number, steps, name, samples, gaps, least, largest),) = found.table()
    assert (number, steps, name, samples, gaps) == (0, 3, "theta", 300, 20)
    assert (float(least), float(largest)) == pytest.approx(
        (np.nanmin(theta), np.nanmax(theta)), rel=1e-3
    )
    assert "theta" in repr(found) and "<td>20</td>" in found._repr_html_()


def test_a_step_without_samples_ends_a_run():
    theta = THETA.copy()
    theta[91:160] = np.nan  # all of the second step
    (one,) = wj.read_recordings({"time": TIME, "theta": theta}, strikes=STRIKES)
    steps, places = cut_steps([one], ["theta"], 0.0, 0.0)
    assert steps.run.tolist() == [0, 1] and steps.is_first.tolist() == [True, True]
    assert steps.known.sum() == 70 + 69  # from 0.21 to 0.9, and from 1.61 to 2.29
    assert steps.stance.tolist() == [0, 0]  # the second step was the other leg's
    np.testing.assert_array_equal(TIME[places[1]], steps.times[1][steps.known[1, :, 0]])


def test_samples_without_numbers_are_not_predicted():
    """A quarter of 70 is kept, padded to a multiple of 16; inputs have all."""
    theta = np.where(np.arange(len(TIME)) % 4, np.nan, THETA)
    (one,) = wj.read_recordings({"time": TIME, "theta": theta}, strikes=STRIKES)
    steps, places = cut_steps([one], ["theta"], 0.0, 0.0)
    assert steps.times.shape == (3, 32)
    for i, place in enumerate(places):
        there = np.isfinite(theta[place])
        assert len(there) in (69, 70)
        np.testing.assert_array_equal(steps.times[i][steps.known[i, :, 0]], TIME[place][there])


def test_samples_near_heel_strikes_are_left_out():
    (one,) = wj.read_recordings({"time": TIME, "theta": THETA}, strikes=STRIKES)
    steps, _ = cut_steps([one], ["theta"], 0.05, 0.02)
    after = (steps.times - steps.begins[:, None])[steps.known[..., 0]]
    before = (steps.ends[:, None] - steps.times)[steps.known[..., 0]]
    assert 0.05 <= after.min() < 0.06 and 0.02 <= before.min() < 0.03


def test_an_input_becomes_a_table_for_each_step():
    """A broken line is its own table; after the samples it stays as it ends."""
    broken = np.interp((TIME - 0.204) % 0.7, [0, 0.2, 0.4, 0.6, 0.8], [1, 3, 2, 0, 4])
    samples = {"time": TIME, "theta": THETA, "push": broken}
    one = as_recordings(
        wj.read_recordings(samples, inputs=["push"], strikes=0.204 + 0.7 * np.arange(4))
    )
    steps, places = cut_steps(one, ["theta"], 0.0, 0.0)
    table = tables_of_inputs(one, steps, places, {"push": ("push", 0.2, 6)})["push"]
    np.testing.assert_allclose(table[:, :4], np.tile([1, 3, 2, 0], (3, 1)), atol=1e-9)
    np.testing.assert_allclose(table[:, 4:], 4, atol=1e-9)


def test_a_file_with_a_short_row_is_told(tmp_path):
    path = tmp_path / "walk.csv"
    path.write_text("time,theta\n0,0.1\n0.1\n")
    with pytest.raises(ValueError, match="2 cells in each row, but row 3 has 1"):
        wj.read_recordings(path)


def test_parquet_without_a_reader_is_told(tmp_path, monkeypatch):
    pandas = pytest.importorskip("pandas")

    def fail(path):
        raise ImportError("no pyarrow")

    monkeypatch.setattr(pandas, "read_parquet", fail)
    (tmp_path / "walk.parquet").touch()
    with pytest.raises(ValueError, match="install pandas and pyarrow"):
        wj.read_recordings(tmp_path / "walk.parquet")


def test_parquet_is_read_as_pandas_reads_it(tmp_path, monkeypatch):
    pandas = pytest.importorskip("pandas")
    monkeypatch.setattr(pandas, "read_parquet", lambda path: pandas.DataFrame(SAMPLES))
    (tmp_path / "walk.parquet").touch()
    (found,) = wj.read_recordings(tmp_path / "walk.parquet", **READ)
    np.testing.assert_allclose(found.values["theta"], THETA, rtol=1e-14)


def test_words_in_a_file_are_gaps(tmp_path):
    path = tmp_path / "walk.csv"
    path.write_text("time,theta\n0,0.1\n0.1,lost\n0.2,0.3\n\n0.3,\n")
    (found,) = wj.read_recordings(path, strikes=[0.0, 0.3])
    np.testing.assert_array_equal(found.values["theta"], [0.1, np.nan, 0.3, np.nan])


def test_bounces_are_recorded_in_closed_form():
    (one,) = record_ball(3)
    assert one.values["height"].min() > 0

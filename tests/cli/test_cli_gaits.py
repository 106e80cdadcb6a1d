"""Gaits, bifurcations and robustness on the command line."""

import functools
import json

import numpy as np
import pytest
import xarray as xr
from command_lines import SMALL

import walker_jax as wj
from walker_jax.stability.robustness_fields import without_gait


def test_gait_prints_the_long_gait_as_json(run, tmp_path):
    code, out, err = run("gait", "--slope", "0.009", "--json")
    assert (code, err) == (0, "")
    answer = json.loads(out)
    assert list(answer) == ["slope", "gaits", "walker"] and answer["slope"] == 0.009
    (gait,) = answer["gaits"]
    assert list(gait) == [*("period", "states", "multipliers", "step_times", "stable", "residual")]
    assert gait["period"] == 1 and gait["stable"] is True and gait["residual"] < 1e-14
    np.testing.assert_allclose(gait["states"], [[0.2003109005442, -0.199832473005]], atol=1e-12)
    expected = [[-0.19009984107, 0.55759877668], [-0.19009984107, -0.55759877668]]
    np.testing.assert_allclose(gait["multipliers"], expected, atol=1e-10)
    np.testing.assert_allclose(gait["step_times"], [3.882463752851], atol=1e-11)
    assert list(tmp_path.iterdir()) == []


def test_gait_finds_all_the_long_one_first_and_draws_them(run, tmp_path, monkeypatch):
    few = wj.Grid.sheared(theta=(0.1, 0.2, 10), sum=(-0.02, 0.01, 10))  # places to search from
    monkeypatch.setattr(wj.SimplestWalker, "gait_region", lambda _: few)
    arguments = ["gait", "--slope", "0.004", "--all"]
    code, out, _ = run(*arguments, "--figure", "m.png", "--json")
    gaits = json.loads(out)["gaits"]
    assert code == 0 and len(gaits) >= 2
    np.testing.assert_allclose(gaits[0]["states"], [[0.1533895648762, -0.1560801466757]])
    np.testing.assert_allclose(gaits[1]["states"], [[0.1487783869696, -0.1588066734576]])
    assert [gait["stable"] for gait in gaits[:2]] == [True, False]
    assert (tmp_path / "m.png").read_bytes().startswith(b"\x89PNG")
    assert run("gait", "--figure", "m.png")[0] == 2  # of another request
    assert run(*arguments, "--figure", "m.png")[0] == 0


def test_gait_from_a_guess_and_of_a_longer_period(run):
    code, out, _ = run("gait", "--slope", "0.009", "--guess", "0.1939", "-0.2039", "--json")
    (gait,) = json.loads(out)["gaits"]
    assert code == 0 and gait["stable"] is False
    np.testing.assert_allclose(gait["states"], [[0.1939373698102, -0.203866927442]], atol=1e-12)
    arguments = ["gait", "--slope", "0.016", "--period", "2", "--guess", "0.2357", "-0.2313"]
    code, out, _ = run(*arguments, "--json")
    (gait,) = json.loads(out)["gaits"]
    assert code == 0 and gait["stable"] is True and len(gait["states"]) == 2
    assert len(gait["step_times"]) == 2 and len(gait["multipliers"]) == 2
    code, out, _ = run(*arguments)
    assert code == 0 and out.startswith("stable gait of period 2") and out.count("theta ") == 2


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["--guess", "3", "3"], "no stride"),
        (["--guess", "0.2", "-0.5"], "no stride"),
        (["--period", "2", "--guess", "0.1534", "-0.1561"], "shorter period"),
        (["--slope", "0.5"], "no gait of period 1 found for SimplestWalker, slope 0.5: it makes"),
        (["--slope", "0.5", "--period", "2"], "none of the searches from 1983 starts that make"),
        (["--guess", "0.2", "-0.4"], "another start, or another --slope"),
    ],
)
def test_a_gait_that_is_not_found_ends_with_1_and_a_reason(run, arguments, reason):
    code, out, err = run("gait", *arguments, "--json")
    assert (code, out) == (1, "") and err.count("\n") == 1 and reason in err


@pytest.mark.slow
def test_bifurcation_answers_keeps_and_draws(run, tmp_path, monkeypatch):
    diagram = functools.partial(wj.bifurcation_diagram, scan=10)
    arguments = ["bifurcation", "--from", "0.0149", "--to", "0.0155", "--period-max", "2"]
    arguments += ["--strides", "100", "--normal-forms"]
    with monkeypatch.context() as patch:
        patch.setattr("walker_jax.bifurcation_diagram", diagram)
        code, out, err = run(*arguments, "--json")
    assert (code, err) == (0, "")
    answer = json.loads(out)
    kinds = {"doublings", "other_doublings", "folds", "neimark_sackers"}
    assert set(answer) == kinds | {"lost", "stable_beyond"}
    (doubling,) = answer["doublings"]
    assert (doubling["from"], doubling["to"]) == (1, 2)
    assert doubling["slope"] == pytest.approx(0.01508843794111946, abs=1e-12)
    assert doubling["criticality"] == "supercritical"
    assert doubling["state"][0] == pytest.approx(0.23716586359158, abs=1e-11)
    assert answer["folds"] == answer["other_doublings"] == []
    assert answer["lost"] == {"below": 0.0155, "above": None}
    assert (tmp_path / "bifurcation.png").read_bytes().startswith(b"\x89PNG")
    with monkeypatch.context() as patch:
        patch.setattr("walker_jax.bifurcation_diagram", lambda *_, **__: 1 / 0)
        code, again, _ = run(*arguments, "--json")
        assert code == 0 and json.loads(again) == answer
        code, text, _ = run(*arguments)
        assert code == 0 and "period 1 to 2 at 0.0150884379" in text
    before = {p: p.stat().st_mtime_ns for p in (tmp_path / "bifurcation.zarr").rglob("*")}
    assert run(*arguments, "--to", "0.02")[0] == 2
    assert before == {p: p.stat().st_mtime_ns for p in (tmp_path / "bifurcation.zarr").rglob("*")}


@pytest.mark.slow
def test_robustness_answers_keeps_and_draws(run, tmp_path, monkeypatch):
    arguments = ["robustness", *SMALL, "--levels", "1", "--strides", "200"]
    code, out, err = run(*arguments, "--json")
    assert (code, err) == (0, "")
    answer = json.loads(out)
    assert list(answer) == [
        *("walker", "slope", "area", "area_error", "at_border", "note"),
        *("gait", "least_disturbance", "least_fall"),
        *("step_down", "step_down_failure", "step_down_fall"),
        *("basin_stability", "boundary_dimension"),
    ]
    assert answer["slope"] == 0.004 and answer["gait"]["period"] == 1
    assert 0 < answer["area_error"] < 0.05 * answer["area"]
    least = answer["least_disturbance"]
    assert least["size"] == pytest.approx(0.00225617, abs=1e-7)
    assert set(least) == {"size", "direction", "state", "failure", "strides"}
    assert least["failure"] == "FORWARD" and answer["least_fall"] == least
    assert answer["step_down_fall"] == answer["step_down"]
    survived, dimension = answer["basin_stability"], answer["boundary_dimension"]
    assert survived["low"] < 0.3056 < survived["high"] and survived["disturbances"] == 0.1
    assert dimension["low"] < dimension["value"] < dimension["high"] < 1.2
    assert (tmp_path / "robustness.png").read_bytes().startswith(b"\x89PNG")
    monkeypatch.setattr("walker_jax.robustness", lambda *_, **__: 1 / 0)
    code, text, _ = run(*arguments)
    assert code == 0 and "least disturbance 0.00225617" in text and "falls forward after" in text
    assert run(*arguments, "--disturbances", "0.2")[0] == 2


def test_answers_on_robustness(run, tmp_path, monkeypatch):
    """One slope, and a table of two, on the second of which nothing walks."""
    grid = wj.Grid.sheared(theta=(0.05, 0.35, 30), sum=(-0.03, 0.01, 20))
    walker = wj.SimplestWalker(0.004)
    data = wj.refine(walker, grid, 0, check=0).assign_attrs(disturbances=0.1)
    found = without_gait(walker) | {
        **{"stability": 0.25, "stability_low": 0.2, "stability_high": 0.375},
        **{"dimension": 1.5, "dimension_low": 1.4, "dimension_high": 1.75},
        **{"multiplier": 0.625, "step_time": 3.75, "step_down": 0.03125},
        **{"return_strides": 2.125, "in_time": 0.125, "mean_strides": 13.0, "pace": 90.0},
        **{"median_pace": 80.0, "mean_shock": 0.0625, "largest_shock": 0.09375},
        "gait_period": 1,
        "gait_state": ("coordinate", data["states"].values[0, 0]),
        "failing_state": ("coordinate", data["states"].values[0, 0] + [0.0, 0.01]),
        "direction": ("coordinate", np.array([0.0, 1.0])),
        "least_disturbance": 0.01,
        "failure": 1,
        "failing_strides": 7,
        "least_fall": 0.01,
        "fall_failure": 1,
        "step_down_failure": 1,
        "step_down_fall": 0.03125,
        **{"median_strides": 12.0, "slowest_strides": np.inf},
        "at_border": 23,
    }
    one, none = data.assign(found), data.assign(without_gait(walker))
    names = [name for name in one if set(one[name].dims) <= {"coordinate"}]
    rows = [one[names], none[names].assign(total_area=0.0)]
    slopes = xr.DataArray([0.004, 0.2], dims="slope", name="slope")
    table = xr.concat(rows, slopes).assign_attrs(one.attrs)
    measured = lambda *_, values=None, **__: one if values is None else table
    monkeypatch.setattr("walker_jax.robustness", measured)
    code, out, err = run("robustness", "--json")
    assert (code, err) == (0, "")
    answer = json.loads(out)
    assert answer["least_disturbance"]["failure"] == "FORWARD"
    assert answer["least_disturbance"]["direction"] == [0.0, 1.0]
    assert answer["least_disturbance"]["strides"] == 7 and answer["step_down"] == 0.03125
    state, failing = answer["gait"]["state"], answer["least_disturbance"]["state"]
    np.testing.assert_allclose(np.subtract(failing, state), [0, 0.01], atol=1e-15)
    assert answer["gait"] == {
        **{"period": 1, "state": state, "multiplier": 0.625, "step_time": 3.75},
        "return_strides": 2.125,
    }
    assert answer["basin_stability"] == {
        **{"value": 0.25, "low": 0.2, "high": 0.375, "disturbances": 0.1, "in_time": 0.125},
        **{"median_strides": 12.0, "slowest_strides": None, "mean_strides": 13.0, "pace": 90.0},
        **{"median_pace": 80.0, "mean_shock": 0.0625, "largest_shock": 0.09375},
    }
    assert answer["boundary_dimension"] == {"value": 1.5, "low": 1.4, "high": 1.75}
    with monkeypatch.context() as patch:
        patch.setattr("walker_jax.cli.answers.draw", lambda *_: None)
        text = run("robustness")[1]
    assert answer["at_border"] == 23
    assert "    the basin reaches the border of the grid, in 23 cells\n" in text
    assert "falls forward after 7 strides" in text and "least step down 0.03125000" in text
    assert "25.0% (20.0% to 37.5%)" in text and "1.500 (1.400 to 1.750)" in text
    assert "from which it falls" not in text
    assert "in 12 strides" in text and "95 of 100 in inf" in text
    assert "12.5% are over in 10 strides; on average they take 13, and" in text
    assert "a factor of e in 2.12; the largest that is survived is 0.0938" in text
    arguments = ["robustness", "--from", "0.004", "--to", "0.2", "--count", "2", "--out", "t.zarr"]
    code, out, err = run(*arguments, "--json")
    assert (code, err) == (0, "")
    rows = json.loads(out)["slopes"]
    assert [row["slope"] for row in rows] == [0.004, 0.2]
    assert rows[0]["gait"]["period"] == 1
    for name in ("least_disturbance", "least_fall", "step_down", "step_down_fall"):
        assert rows[0][name] is not None and rows[1][name] is None
    monkeypatch.setattr("walker_jax.cli.answers.draw", lambda *_: None)
    assert "no gait attracts" in run(*arguments)[1]
    # where another motion is nearer than a fall both are told; a store that does not tell is read
    nearer = {"failure": 0, "failing_strides": 500, "fall_strides": 9, "step_down_failure": 0}
    nearer |= {"least_fall": 0.03, "step_down_fall": 0.0625}
    nearer |= {"fall_direction": one["direction"], "fall_state": one["gait_state"] + [0.0, 0.03]}
    one = one.assign(nearer | {"at_border": 0})
    for name in ("robustness.png", "t.png"):
        assert (tmp_path / name).read_bytes().startswith(b"\x89PNG")
    answer = json.loads(run("robustness", "--json", "--overwrite")[1])
    assert answer["least_disturbance"]["size"] == 0.01 and answer["step_down"] == 0.03125
    assert answer["least_disturbance"]["failure"] == answer["step_down_failure"] == "STRIDE"
    assert answer["least_fall"]["size"] == 0.03 and answer["least_fall"]["failure"] == "FORWARD"
    assert answer["least_fall"]["strides"] == 9 and answer["step_down_fall"] == 0.0625
    text = run("robustness")[1]
    assert "least disturbance 0.01000000 along (0.0000, 1.0000): leads to another motion" in text
    assert "border" not in text
    assert (
        "from which it falls 0.03000000 along (0.0000, 1.0000): falls forward after 9 strides"
        in text
    )
    assert "step down 0.03125000: leads to another motion; falls from 0.06250000" in text

"""Walks, basins and sweeps on the command line, and the places where results go."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from command_lines import RESUME, SMALL
from PIL import Image, ImageSequence

import walker_jax as wj
from walker_jax import storage
from walker_jax.cli import answers, app, basin_command, optimise_command, sweep_command
from walker_jax.paper import numbers


def test_walk_prints_table_1_as_json(run):
    code, out, err = run("walk", "--json")
    assert (code, err) == (0, "")
    answer = json.loads(out)
    assert list(answer) == ["states", "outcomes", "times"]
    assert len(answer["states"]) == 10 and answer["outcomes"] == ["STRIDE"] * 9
    angles = [0.2000, 0.1788, 0.1756, 0.1878, 0.1586, 0.1459, 0.1492, 0.1539, 0.1558]
    np.testing.assert_allclose(np.array(answer["states"])[:9, 0], angles, atol=5e-5)
    assert answer["times"][0] == pytest.approx(2.929164, abs=1e-6)


def test_walk_ends_with_the_stride_that_failed(run):
    code, out, _ = run("walk", "--thetadot", "-0.23", "--strides", "20", "--json")
    answer = json.loads(out)
    assert code == 0
    assert answer["outcomes"][-1] == "FORWARD" and set(answer["outcomes"][:-1]) <= {"STRIDE"}
    assert len(answer["states"]) == len(answer["outcomes"]) == len(answer["times"])
    assert answer["times"][-1] is None
    code, out, _ = run("walk", "--thetadot", "-0.23", "--strides", "20")
    assert code == 0 and out.splitlines()[-2].endswith("         -  falls forward")


@pytest.mark.slow
def test_walk_makes_a_film_which_is_not_replaced_by_another(run, tmp_path, monkeypatch):
    command = ["walk", "--strides", "1", "--animate", "w.gif"]
    code, out, err = run(*command)
    assert (code, err) == (0, "") and "film w.gif" in out
    with Image.open(tmp_path / "w.gif") as film:
        assert sum(1 for _ in ImageSequence.Iterator(film)) == 21  # 2.93 at 0.15, and the first
    before = (tmp_path / "w.gif").read_bytes()
    monkeypatch.setattr("walker_jax.figures.film", lambda *_, **__: None)
    assert run(*command)[0] == 0
    code, out, err = run(*command, "--theta", "0.21")
    assert (code, out) == (2, "") and err == (
        "walker-jax: w.gif is something else: "
        "give another --animate, or --overwrite to replace it\n"
    )
    assert (tmp_path / "w.gif").read_bytes() == before


def test_reproduce_prints_what_differs(run, monkeypatch):
    found = [
        numbers.Number("5.2", "slope", "0.022", "0.019", False, "No cells."),
        numbers.Number("5.1", "fate", "F", "F", True, ""),
    ]
    monkeypatch.setattr("walker_jax.paper.reproduction.reproduce", lambda out, **_: found)
    code, out, _ = run("reproduce", "--quick")
    assert code == 0 and "1 of 2 numbers agree" in out
    assert "5.2, slope: printed 0.022, ours 0.019. No cells." in out
    code, out, _ = run("reproduce", "--json")
    answer = json.loads(out)
    assert answer["report"] == "report/report.html"
    assert [one["agrees"] for one in answer["numbers"]] == [False, True]


def test_basin_answers_keeps_and_draws(run, tmp_path):
    code, out, err = run("basin", *SMALL, "--method", "direct", "--out", "b.zarr", "--json")
    assert (code, err) == (0, "")
    answer = json.loads(out)
    assert answer["slope"] == 0.004 and answer["method"] == "direct" and answer["cells"] == 600
    assert sum(answer["fates"].values()) == 600
    assert answer["fates"]["STRIDE"] == answer["attractors"][0]["cells"] > 0
    assert answer["area"] == sum(one["area"] for one in answer["attractors"])
    assert answer["area"] == pytest.approx(answer["fates"]["STRIDE"] * 0.01 * 0.002)
    assert answer["attractors"][0]["period"] == 1
    np.testing.assert_allclose(
        answer["attractors"][0]["states"], [[0.15338956, -0.15608015]], atol=1e-8
    )
    assert set(answer["seconds"]) == {"compile", "run"} and answer["seconds"]["run"] > 0
    with xr.open_zarr(tmp_path / "b.zarr", consolidated=False) as data:
        assert (
            data.sizes["theta"] == 30 and int((data.fate == 0).sum()) == answer["fates"]["STRIDE"]
        )
    assert (tmp_path / "b.png").read_bytes().startswith(b"\x89PNG")
    at_border = answer["at_border"]
    out = run("basin", *SMALL, "--method", "direct", "--out", "b.zarr")[1]
    said = f"the basin reaches the border of the grid, in {at_border} cells"
    assert (said in out) == (at_border > 0)


def test_a_cycle_of_cells_that_is_no_gait_is_an_artefact(run, tmp_path, monkeypatch):
    """On the paper's own grid; a store that does not tell is read as it is."""
    code, text, _ = run("basin", "--out", "b.zarr")
    assert code == 0
    gait, made_up = (line.strip() for line in text.splitlines()[1:3])
    assert gait.startswith("attractor 0: period 1, 3043 cells, ") and gait.endswith("-0.156080)")
    assert made_up.startswith("artefact 1: period 1, 1 cell, ")
    assert made_up.endswith(": a walker falls from there")
    with monkeypatch.context() as patch:
        patch.setattr("walker_jax.cli.answers.draw", lambda *_: None)
        _, out, _ = run("basin", "--out", "b.zarr", "--json")
    told = [
        {name: one[name] for name in ("cells", "artefact", "cycles", "falling")}
        for one in json.loads(out)["attractors"]
    ]
    assert told == [
        {"cells": 3043, "artefact": False, "cycles": 1, "falling": 0},
        {"cells": 1, "artefact": True, "cycles": 1, "falling": 1},
    ]


def test_what_is_said_of_cycles_of_cells():
    said = lambda artefact, cycles, falling, centres=2: basin_command.cycles_in_words(
        {"artefact": artefact, "cycles": cycles, "falling": falling, "states": [0] * centres}
    )
    assert said(False, 1, 0) == basin_command.cycles_in_words({"artefact": False}) == ""
    assert said(False, 3, 0) == ": 3 cycles of cells"
    told = ": 2 cycles of cells, a walker falls from 1 of their centres"
    assert said(False, 2, 1) == told
    assert said(True, 1, 1) == ": a walker falls from 1 of 2"
    assert said(True, 1, 0) == ": walkers from there do not converge to one attractor"


@pytest.mark.parametrize(
    ("over", "values"),
    [((1e-14, 2e-14, 2), [1e-14, 2e-14]), ((0.0, 0.3, 4), [0.0, 0.1, 0.2, 0.3])],
)
def test_values_are_as_written(over, values):
    assert sweep_command.values_of({"slope": over}) == {"slope": values}


def test_names_of_parameters_have_hyphens_or_underscores():
    walker, read = wj.SpringWalker(0.004), app.load("optimise").make_context
    for over in ("hip-stiffness", "hip_stiffness"):
        for bound in ("hip-stiffness=0:1", "hip_stiffness=0:1"):
            given = read(None, ["--walker", "spring", "--over", over, "--bound", bound]).params
            assert given["bounds"] == {"hip_stiffness": (0.0, 1.0)}
            found = optimise_command.bounds_of(walker, given["over"], given["bounds"])
            assert found == {"hip_stiffness": (0.0, 1.0)}
        with pytest.raises(ValueError, match=r"^--bound is required for hip-stiffness: hip-stiff"):
            optimise_command.bounds_of(walker, [over], {})
    assert optimise_command.objective_of(("least_disturbance",)) == "least-disturbance"
    assert optimise_command.objective_of(("step_length=2",)) == {"step-length": 2.0}


def test_a_sweep_answers_with_a_row_for_each_combination(run, tmp_path, monkeypatch):
    """The numbers are made up, by the walker's parameters."""

    def measured(walker, plan):
        slope, stiffness = float(walker.slope), float(walker.hip_stiffness)
        if stiffness == 1:
            raise FloatingPointError
        note = "another gait" if slope == stiffness else ""
        areas = {"total_area": slope + stiffness, "total_area_error": 0.5}
        return areas | {"speed": slope, "note": note}

    monkeypatch.setattr("walker_jax.design.sweeps.measure_basin", measured)
    command = ["sweep", "--walker", "spring", "--over", "slope=0.25:0.5:2"]
    command += ["--over", "hip-stiffness=0:1:3", *SMALL]
    code, out, err = run(*command, "--json")
    assert (code, err) == (0, "")
    answer = json.loads(out)
    assert answer["walker"] == {"name": "SpringWalker"}
    keys = ("slope", "hip_stiffness", "total_area", "total_area_error", "speed", "failed")
    rows = [tuple(point[key] for key in keys) for point in answer["points"]]
    assert rows == [
        *((0.25, 0.0, 0.25, 0.5, 0.25, 0), (0.25, 0.5, 0.75, 0.5, 0.25, 0)),
        *((0.25, 1.0, None, None, None, 1), (0.5, 0.0, 0.5, 0.5, 0.5, 0)),
        *((0.5, 0.5, 1.0, 0.5, 0.5, 0), (0.5, 1.0, None, None, None, 1)),
    ]
    monkeypatch.setattr("walker_jax.sweep", lambda *_, **__: 1 / 0)
    code, text, _ = run(*command)
    assert code == 0 and text.splitlines()[2].split() == [
        *("0.25", "0.5", "0.75", "0.5", "0", "nan", "0.25", "0")
    ]
    assert [point["reason"] for point in answer["points"]] == [*("", "", "FloatingPointError")] * 2
    assert "  failed at slope 0.5, hip_stiffness 1: FloatingPointError\n" in text
    assert "  slope 0.5, hip_stiffness 0.5: another gait\n" in text
    assert text.count("another gait") == 1
    assert (tmp_path / "sweep.png").read_bytes().startswith(b"\x89PNG")


def test_the_same_command_goes_on_with_what_was_interrupted(run, tmp_path, monkeypatch):
    def interrupted(place, piece, values, done=False):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(storage.Pieces, "write", interrupted)
        code, out, err = run("basin", *SMALL)
        again = f"{RESUME} basin.zarr"
        assert (code, out, err) == (130, "", f"walker-jax: interrupted: {again}\n")
        _, _, err = run("basin", *SMALL, "--overwrite")
        assert again.replace("again", "again, without --overwrite,") in err
        patch.setattr(
            storage.Pieces, "write", lambda *_, **__: os.kill(os.getpid(), signal.SIGTERM)
        )
        before = signal.getsignal(signal.SIGTERM)
        code, _, err = run("basin", *SMALL)
        signal.signal(signal.SIGTERM, before)
        assert (code, err) == (143, f"walker-jax: terminated: {again}\n")
    code, out, _ = run("basin", *SMALL)
    assert code == 0 and "resumed basin.zarr" in out and "to store" not in out
    assert "computed before" in run("basin", *SMALL)[1]


def test_the_same_command_takes_what_is_there_another_may_not(run, tmp_path, monkeypatch):
    command = ["basin", *SMALL, "--out", "b.zarr"]
    code, first, _ = run(*command)
    assert code == 0 and " strides; " in first and "%  walks, " in first
    before = {p: p.stat().st_mtime_ns for p in (tmp_path / "b.zarr").rglob("*")}
    (tmp_path / "b.png").unlink()
    with monkeypatch.context() as patch:
        patch.setattr("walker_jax.basin", lambda *_, **__: 1 / 0)
        code, again, _ = run(*command)
    assert code == 0 and "computed before" in again and (tmp_path / "b.png").exists()
    assert again.splitlines()[:3] == first.splitlines()[:3]
    code, out, err = run(*command, "--slope", "0.005")
    assert (code, out) == (2, "") and err == (
        "walker-jax: b.zarr holds another result (walker slope: 0.004, not 0.005): "
        "give another --out, or --overwrite to replace it\n"
    )
    assert before == {p: p.stat().st_mtime_ns for p in (tmp_path / "b.zarr").rglob("*")}
    code, out, _ = run(*command, "--slope", "0.005", "--overwrite", "--json")
    assert code == 0 and json.loads(out)["slope"] == 0.005


def test_a_picture_of_something_else_is_not_replaced(run, tmp_path):
    (tmp_path / "holiday.png").write_bytes(b"beach")
    code, out, err = run("basin", *SMALL, "--figure", "holiday.png")
    assert (code, out) == (2, "") and "holiday.png" in err
    assert [p.name for p in tmp_path.iterdir()] == ["holiday.png"]
    assert (tmp_path / "holiday.png").read_bytes() == b"beach"


@pytest.mark.parametrize(
    "command",
    [
        *("basin", "bifurcation", "robustness", "sweep --over slope=0.002:0.01:3"),
        "optimise --over slope --bound slope=0.01:0.02",
    ],
)
def test_a_refusal_says_what_is_other_about_the_data(run, command):
    """A data set and its picture lie where those of this command go by default."""
    name, *options = command.split()
    place = {"optimise": "optimum"}.get(name, name)
    storage.save(xr.Dataset({"x": 1}), Path(f"{place}.zarr"), {"command": "walk", "a": 1})
    Path(f"{place}.png").write_bytes(b"of that")
    code, out, err = run(name, *options)
    what = f'{place}.zarr holds another result (command: "walk", not "{name}")'
    help_ = "give another --out, or --overwrite to replace it"
    assert (code, out, err) == (2, "", f"walker-jax: {what}: {help_}\n")
    code, out, err = run(name, *options, "--out", "o.zarr", "--figure", f"{place}.png")
    help_ = help_.replace("out", "figure")
    assert (code, out, err) == (2, "", f"walker-jax: {place}.png is something else: {help_}\n")
    assert sorted(path.name for path in Path().iterdir()) == [f"{place}.png", f"{place}.zarr"]


def test_other_places_that_are_taken_name_their_options(run, tmp_path):
    for name in ("taken.zarr", "report", "g.png", "d.nc"):
        (tmp_path / name).write_bytes(b"mine")
    storage.save(xr.Dataset({"x": 1}), tmp_path / "d.zarr", {})
    replaced = ", or --overwrite to replace it"
    for command, said in (
        ("basin --out taken.zarr", "taken.zarr exists and is not a data set: give another --out"),
        ("reproduce", "report exists and is not a folder: give another --out"),
        ("gait --figure g.png", f"g.png is something else: give another --figure{replaced}"),
        ("export d.zarr d.nc", f"d.nc exists: give another file{replaced}"),
    ):
        assert run(*command.split()) == (2, "", f"walker-jax: {said}\n")


def test_the_plain_section(run, tmp_path):
    arguments = ["--theta", "0.01", "0.7", "12", "--thetadot", "-1", "-0.1", "10"]
    code, out, _ = run("basin", *arguments, "--out", "plain.zarr", "--figure", "p.svg", "--json")
    assert code == 0 and json.loads(out)["cells"] == 120
    with xr.open_zarr(tmp_path / "plain.zarr", consolidated=False) as data:
        assert list(data.fate.dims) == ["theta", "thetadot"]
    assert b"<svg" in (tmp_path / "p.svg").read_bytes()
    for figure in ("p.svg", "p.pdf", "p.pdf"):  # one that is there is known again
        assert run("basin", *arguments, "--out", "plain.zarr", "--figure", figure)[0] == 0


def test_an_interruption_is_one_line(run, monkeypatch):
    def interrupt(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("walker_jax.walk", interrupt)
    assert run("walk") == (130, "", "walker-jax: interrupted\n")


def test_a_termination_is_one_line(run, monkeypatch):
    monkeypatch.setattr("walker_jax.walk", lambda *_, **__: os.kill(os.getpid(), signal.SIGTERM))
    before = signal.getsignal(signal.SIGTERM)
    try:
        assert run("walk") == (143, "", "walker-jax: terminated\n")
    finally:
        signal.signal(signal.SIGTERM, before)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("number", "end"),
    [
        (signal.SIGINT, (130, f"walker-jax: interrupted: {RESUME} basin.zarr\n")),
        (signal.SIGTERM, (143, f"walker-jax: terminated: {RESUME} basin.zarr\n")),
    ],
)
def test_a_signal_ends_a_command_in_one_line_without_a_draft(tmp_path, number, end):
    command = [str(Path(sys.executable).with_name("walker-jax")), "basin", "--method", "direct"]
    window = ["--theta", "0", "0.4", "4000", "--sum", "-0.04", "0.01", "4000"]
    start = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True, "cwd": tmp_path}
    with subprocess.Popen([*command, *window], **start) as process:
        while not (tmp_path / "basin.zarr").exists():
            assert process.poll() is None
            time.sleep(0.1)
        process.send_signal(number)
        out, err = process.communicate(timeout=120)
    assert (process.returncode, err) == end and out == ""
    assert [path.name for path in tmp_path.iterdir()] == ["basin.zarr"]  # with which to go on


def test_a_grid_that_is_refused_leaves_what_it_was_to_replace(run, tmp_path):
    assert run("basin", *SMALL)[0] == 0
    before = {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}
    large = ["--theta", "0", "0.4", "46000", "--sum", "0", "1", "46000"]
    code, out, err = run("basin", *large, "--overwrite")
    assert (code, out) == (2, "") and "memory" in err and err.count("\n") == 1
    assert before == {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}


def test_an_interrupted_drawing_leaves_the_picture_before(run, tmp_path, monkeypatch):
    assert run("basin", *SMALL)[0] == 0
    before = (tmp_path / "basin.png").read_bytes()

    def half(self, path, **_):
        Path(path).write_bytes(b"half")
        raise KeyboardInterrupt

    monkeypatch.setattr("matplotlib.figure.Figure.savefig", half)
    assert run("basin", *SMALL)[0] == 130
    assert (tmp_path / "basin.png").read_bytes() == before
    assert {path.name for path in tmp_path.iterdir()} == {"basin.zarr", "basin.png"}


def test_the_seed_of_a_refined_basin_is_part_of_it(run, monkeypatch):
    asked, find = [], answers.Output.find

    def refine(*_, seed, **__):
        raise wj.ComputationFailed(f"this was seed {seed}")

    def find_and_tell(output, request):
        asked.append(request["seed"])
        return find(output, request)

    monkeypatch.setattr("walker_jax.refine", refine)
    monkeypatch.setattr(answers.Output, "find", find_and_tell)
    for given, seed in (([], 0), (["--seed", "3"], 3)):
        said = f"walker-jax: this was seed {seed}\n"
        assert run("basin", *SMALL, "--levels", "1", *given) == (1, "", said)
    assert asked == [0, 3]
    said = "walker-jax: --seed goes with --levels: give it too\n"
    assert run("basin", "--seed", "1") == (2, "", said)


def test_a_place_that_is_taken_is_refused_before_a_search(run, tmp_path, monkeypatch):
    monkeypatch.setattr(
        "walker_jax.basins.windows.require_gait", lambda *_: pytest.fail("a search")
    )
    (tmp_path / "basin.png").write_bytes(b"mine")
    code, out, err = run("basin", "--walker", "round-foot")
    assert code == 2 and out == "" and "basin.png" in err and err.count("\n") == 1
    assert (tmp_path / "basin.png").read_bytes() == b"mine"
    code, _, err = run(
        "basin", "--walker", "round-foot", "--theta", "1", "0", "9", "--out", "b.zarr"
    )
    assert code == 2 and "low must be below high" in err


@pytest.mark.slow
def test_prove_states_the_theorem(run):
    code, out, _ = run("prove", "--radius", "0.001", "--json")
    answer = json.loads(out)
    assert code == 0 and answer["all_walk"] and answer["cells"]["open"] == 0
    code, out, _ = run("prove", "--radius", "0.001")
    assert code == 0 and "theorem: every start within 0.001 of the gait walks for ever" in out
    assert Path("proof.zarr").is_dir() and Path("proof.png").is_file()
    window = ("--theta", "0.1", "0.2", "8", "--sum", "-0.01", "0.004", "8", "--levels", "1")
    code, out, _ = run("prove", *window, "--out", "window.zarr")
    assert code == 0 and "starts that walk for ever have an area between" in out


def test_prove_takes_a_radius_or_a_window(run):
    code, _, err = run("prove", "--radius", "0.001", "--theta", "0", "0.4", "9")
    assert code == 2 and "exclude each other" in err


def test_viable_tells_the_kernel_and_what_is_caught(run):
    window = ("--theta", "0.05", "0.45", "20", "--sum", "-0.05", "0.01", "24")
    command = ("viable", "--walker", "powered", "--action", "push-off=0:0.08:5", *window)
    code, out, _ = run(*command, "--json")
    assert code == 0
    answer = json.loads(out)
    assert answer["inner_area"] <= answer["area"] <= answer["outer_area"]
    assert answer["target_area"] < answer["capturable"][0] <= answer["capturable"][-1]
    assert answer["actions"] == {"push_off": [0.0, 0.08, 5]} and answer["cells"] == 480
    assert Path("viable.zarr").is_dir() and Path("viable.png").is_file()
    again = run(*command)
    assert again[0] == 0 and f"area {answer['area']:.6g}, between" in again[1]
    assert "caught within 1 stride: " in again[1]


def test_viable_narrows_its_bounds_and_goes_on_if_interrupted(run, monkeypatch):
    window = ("--theta", "0.05", "0.45", "20", "--sum", "-0.05", "0.01", "24")
    command = ("viable", "--walker", "powered", "--action", "push-off=0:0.08:5", *window)
    command += ("--levels", "1")

    def interrupted(place, piece, values, done=False):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(storage.Pieces, "write", interrupted)
        code, out, err = run(*command)
        assert (code, out, err) == (130, "", f"walker-jax: interrupted: {RESUME} viable.zarr\n")
    code, _, err = run(*command[:-1], "2")
    assert code == 2 and "viable.zarr holds another result (levels: 1, not 2)" in err
    code, out, _ = run(*command, "--json")
    first, second = json.loads(out)["levels"]
    assert code == 0 and first["mapped"] == 480 and second["mapped"] > 0
    assert second["outer_area"] - second["inner_area"] < first["outer_area"] - first["inner_area"]
    said = f"  level 1: between {second['inner_area']:.4g} and {second['outer_area']:.4g}, "
    assert said + f"{second['mapped']} cells mapped\n" in run(*command)[1]

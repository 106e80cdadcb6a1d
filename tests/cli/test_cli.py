import functools
import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import jax
import numpy as np
import pytest
import xarray as xr
from PIL import Image, ImageSequence

import walker_jax as wj
from walker_jax import storage
from walker_jax.checks import WrongUse
from walker_jax.cli import (
    answers,
    app,
    basin_command,
    main,
    optimise_command,
    startup,
    sweep_command,
)
from walker_jax.cli.answers import Stopwatch
from walker_jax.cli.app import COMMANDS
from walker_jax.cli.examples import DURATIONS, EXAMPLES
from walker_jax.cli.rewording import message_of, option_of
from walker_jax.design import evaluation
from walker_jax.design.measures import Measure
from walker_jax.design.summary import summarise_optimum
from walker_jax.kernels import private_files
from walker_jax.paper import numbers
from walker_jax.stability.robustness_fields import without_gait
from walker_jax.walkers.family import WALKERS
from walker_jax.walkers.parameters import describe_walker, parameters

RESUME = "run the same again to resume from"
SMALL = ["--theta", "0.05", "0.35", "30", "--sum", "-0.03", "0.01", "20"]


@pytest.fixture
def run(monkeypatch, capsys, tmp_path, few_dots):
    """Run a command in an empty folder; returns exit code, standard output and error."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("walker_jax.cli.startup.keep_compiled", lambda: None)

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["walker-jax", *map(str, arguments)])
        with pytest.raises(SystemExit) as stop:
            main.main()
        return (stop.value.code, *capsys.readouterr())

    return run


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
    assert code == 0 and "falls forward" in out and "nan" in out


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


def test_a_cycle_of_cells_that_is_no_gait_is_said_to_be_an_artefact(run, tmp_path, monkeypatch):
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
    [
        ("slope=1e-14:2e-14:2", [1e-14, 2e-14]),
        ("hip-stiffness=0:0.3:4", [0.0, 0.1, 0.2, 0.3]),
    ],
)
def test_values_are_as_written(over, values):
    (found,) = sweep_command.values_of([over]).values()
    assert found == values


def test_names_of_parameters_have_hyphens_or_underscores():
    hyphens, underscores = ["hip-stiffness"], ["hip_stiffness"]
    walker = wj.SpringWalker(0.004)
    for names in (hyphens, underscores):
        assert [*sweep_command.values_of([f"{names[0]}=0:1:2"])] == underscores
        for others in (hyphens, underscores):
            bounds = optimise_command.bounds_of(walker, names, [f"{others[0]}=0:1"])
            assert bounds == {"hip_stiffness": (0.0, 1.0)}
    assert optimise_command.objective_of(["least_disturbance"]) == "least-disturbance"
    assert optimise_command.objective_of(["step_length=2"]) == {"step-length": 2.0}
    for names in (hyphens, underscores):
        with pytest.raises(ValueError, match=r"^--bound is required for hip-stiffness: hip-stiff"):
            optimise_command.bounds_of(walker, names, [])


@pytest.mark.parametrize(
    ("over", "named"),
    [
        (["slope=0.001:0.02:30000000"], "N of at most 1048576"),
        (["slope=0.001:0.02:2000", "foot-mass=0.1:0.2:1000"], "at most 1048576 combinations"),
    ],
)
def test_a_sweep_of_too_much_is_refused_at_once(run, tmp_path, over, named):
    options = [word for one in over for word in ("--over", one)]
    code, out, err = run("sweep", "--walker", "point-foot", *options)
    assert (code, out) == (2, "") and named in err and err.count("\n") == 1
    assert not [*tmp_path.iterdir()]


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


def test_the_same_command_takes_what_is_there_and_another_is_refused(run, tmp_path, monkeypatch):
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
def test_a_refusal_says_what_is_other_about_the_data_and_not_that_the_picture_is(run, command):
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
def test_a_signal_ends_a_command_in_one_line_and_leaves_no_draft(tmp_path, number, end):
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


def test_no_command_is_wrong_usage_in_one_line(run):
    code, out, err = run()
    assert code == 2 and "basin" in out
    assert err == "walker-jax: name a command, one of those above\n"


def test_a_grid_that_is_refused_leaves_what_it_was_to_replace(run, tmp_path):
    assert run("basin", *SMALL)[0] == 0
    before = {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}
    large = ["--theta", "0", "0.4", "46000", "--sum", "0", "1", "46000"]
    code, out, err = run("basin", *large, "--overwrite")
    assert (code, out) == (2, "") and "memory" in err and err.count("\n") == 1
    assert before == {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}


def test_an_interrupted_drawing_leaves_the_picture_that_was_there(run, tmp_path, monkeypatch):
    assert run("basin", *SMALL)[0] == 0
    before = (tmp_path / "basin.png").read_bytes()

    def half(self, path, **_):
        Path(path).write_bytes(b"half")
        raise KeyboardInterrupt

    monkeypatch.setattr("matplotlib.figure.Figure.savefig", half)
    assert run("basin", *SMALL)[0] == 130
    assert (tmp_path / "basin.png").read_bytes() == before
    assert {path.name for path in tmp_path.iterdir()} == {"basin.zarr", "basin.png"}


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["--slope", "0"], "slope"),
        (["--slope", "-0.01"], "slope"),
        (["--slope", "nan"], "slope"),
        (["--slope", "inf"], "slope"),
        (["--slope", "steep"], "slope"),
        (["--theta", "0.4", "0", "10"], "theta"),
        (["--theta", "0.2", "0.2", "10"], "theta"),
        (["--theta", "0", "0.4", "0"], "theta"),
        (["--theta", "0", "0.4", "1.5"], "theta"),
        (["--theta", "nan", "0.4", "10"], "theta"),
        (["--sum", "0", "-1", "10"], "sum"),
        (["--theta", "0", "0.4", "1000000", "--sum", "0", "1", "1000000"], "cells"),
        (["--theta", "0", "0.4", "100000", "--sum", "0", "1", "20000"], "cells"),
        (["--sum", "0", "1", "10", "--thetadot", "-1", "0", "10"], "--thetadot"),
        (["--method", "guess"], "method"),
        (["--method", "direct", "--strides", "0"], "strides"),
        (["--out", "no/such/folder/b.zarr"], "no/such/folder"),
        (["--out", "/"], "/"),
        (["--figure", "b.xyz"], "b.xyz"),
        (["--figure", "b.jpg"], "b.jpg"),
        (["--out", "b.png"], "b.png"),
        (["--out", "."], "--out"),
        (["--strides", "50"], "--strides"),
        (["--colour", "red"], "--colour"),
        (["extra"], "extra"),
    ],
)
def test_wrong_usage_gets_one_line_and_changes_nothing(
    run, tmp_path, arguments, named, monkeypatch
):
    monkeypatch.setattr("walker_jax.basins.memory.memory_of_machine", lambda: 8 * 2**30)
    code, out, err = run("basin", *arguments)
    assert (code, out) == (2, "")
    assert err.startswith("walker-jax: ") and err.count("\n") == 1 and named in err
    assert "Traceback" not in err
    assert list(tmp_path.iterdir()) == []


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
        (["--slope", "0.5"], "no gait of period 1 found for SimplestWalker, slope 0.5: the walker"),
        (["--slope", "0.5", "--period", "2"], "none of the searches from 1983 starts that make"),
        (["--guess", "0.2", "-0.4"], "another --guess, or another --slope"),
    ],
)
def test_a_gait_that_is_not_found_ends_with_1_and_a_reason(run, arguments, reason):
    code, out, err = run("gait", *arguments, "--json")
    assert (code, out) == (1, "") and err.count("\n") == 1 and reason in err


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["--slope", "0"], "slope"),
        (["--period", "0"], "period"),
        (["--guess", "nan", "0"], "--guess must be finite, not nan"),
        (["--guess", "0.2", "inf"], "--guess must be finite, not inf"),
        (["--guess", "0.2"], "guess"),
        (["--all", "--guess", "0.2", "-0.2"], "--all"),
        (["--figure", "m.jpg"], "m.jpg"),
        (["--figure", "no/such/folder/m.png"], "no/such/folder"),
    ],
)
def test_wrong_searches(run, tmp_path, arguments, named):
    code, out, err = run("gait", *arguments)
    assert (code, out) == (2, "") and err.count("\n") == 1 and named in err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_bifurcation_answers_keeps_and_draws(run, tmp_path, monkeypatch):
    diagram = functools.partial(wj.bifurcation_diagram, scan=10)
    arguments = ["bifurcation", "--from", "0.0149", "--to", "0.0155", "--period-max", "2"]
    arguments += ["--strides", "100"]
    with monkeypatch.context() as patch:
        patch.setattr("walker_jax.bifurcation_diagram", diagram)
        code, out, err = run(*arguments, "--json")
    assert (code, err) == (0, "")
    answer = json.loads(out)
    assert set(answer) == {"doublings", "other_doublings", "folds", "lost", "stable_beyond"}
    (doubling,) = answer["doublings"]
    assert (doubling["from"], doubling["to"]) == (1, 2)
    assert doubling["slope"] == pytest.approx(0.01508843794111946, abs=1e-12)
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


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["--from", "0.02", "--to", "0.01"], "--from"),
        (["--from", "0"], "slope"),
        (["--slope", "0.01"], "--slope is not for this command: give --from and --to"),
        (["--to", "nan"], "slope"),
        (["--period-max", "0"], "period-max"),
        (["--strides", "0"], "strides"),
        (["--out", "b.png"], "b.png"),
        (["--figure", "b.gif"], "b.gif"),
    ],
)
def test_wrong_bifurcations(run, tmp_path, arguments, named):
    code, out, err = run("bifurcation", *arguments)
    assert (code, out) == (2, "") and err.count("\n") == 1 and named in err
    assert list(tmp_path.iterdir()) == []


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
    monkeypatch.setattr("walker_jax.robustness", lambda *_, **__: one)
    monkeypatch.setattr("walker_jax.robustness_table", lambda *_, **__: table)
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


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["--from", "0.01"], "--to"),
        (["--count", "5"], "--from"),
        (["--from", "0.02", "--to", "0.01"], "--from"),
        (["--from", "0", "--to", "0.01"], "slope"),
        (["--from", "0.01", "--to", "0.02", "--count", "1"], "count"),
        (["--levels", "-1"], "levels"),
        (["--levels", "9"], "levels"),
        (["--disturbances", "0"], "--disturbances"),
        (["--disturbances", "nan"], "disturbances"),
        (["--strides", "0"], "strides"),
        (["--theta", "0", "0.4", "10"], "--sum"),
        (["--theta", "0", "0.4", "1", "--sum", "0", "0.4", "5"], "2 cells"),
        (["--at-phidot", "0.1"], "--at-phidot"),
        (["--walker", "round-foot", "--at-phidot", "0.1"], "--theta"),
        (["--out", "r.png"], "r.png"),
        (["--figure", "r.gif"], "r.gif"),
    ],
)
def test_wrong_robustness(run, tmp_path, arguments, named):
    code, out, err = run("robustness", *arguments)
    assert (code, out) == (2, "") and err.count("\n") == 1 and named in err
    assert list(tmp_path.iterdir()) == []


FASTEST = ["optimise", "--over", "slope", "--bound", "slope=0.001:0.015", "--objective", "speed"]
FASTEST += ["--at-most", "spectral-radius", "0.9", "--starts", "1", "--scan", "3"]
FASTEST += ["--theta", "0", "0.4", "20", "--sum", "-0.02", "0.01", "12"]


def proportional(walker, parameters=(), *_, **__):
    """Made-up measures: a speed of 8 times the slope, and a spectral radius of 75 times it."""
    return {
        name: Measure(factor * float(walker.slope), np.full(len(parameters), factor))
        for name, factor in (("speed", 8.0), ("spectral-radius", 75.0))
    }


@pytest.mark.parametrize(
    ("made_up", "slope", "speed"),
    [
        (True, 0.012, 0.032),
        pytest.param(False, 0.0146558225, 0.0793169483, marks=pytest.mark.slow),
    ],
)
def test_optimise_answers_keeps_and_draws(run, tmp_path, monkeypatch, made_up, slope, speed):
    monkeypatch.setattr("walker_jax.design.optimisation.VIEW_CELLS", 40)  # of the picture
    if made_up:
        for module in ("climbs", "evaluation", "limits"):
            monkeypatch.setattr(f"walker_jax.design.{module}.gait_measures", proportional)
    code, out, err = run(*FASTEST, "--json")
    assert (code, err) == (0, "")
    answer = json.loads(out)
    assert list(answer) == [
        *("start", "optimum", "objective", "exact", "exact_error", "at_bound", "binding"),
        *("note", "evaluations", "converged", "walker"),
    ]
    assert answer["note"] == {"start": "", "optimum": ""}
    assert answer["start"] == {"slope": 0.004} and answer["converged"] is True
    assert answer["optimum"]["slope"] == pytest.approx(slope, abs=1e-10)
    assert answer["at_bound"] == [] and answer["binding"] == ["spectral-radius"]
    assert set(answer["exact"]) == set(answer["objective"]) == {"start", "optimum"}
    assert answer["exact"]["start"] == pytest.approx(speed, abs=1e-10)
    data = xr.open_zarr(tmp_path / "optimum.zarr", consolidated=False)
    assert data.sizes["evaluation"] == answer["evaluations"]
    assert (tmp_path / "optimum.png").read_bytes().startswith(b"\x89PNG")
    monkeypatch.setattr("walker_jax.optimise", lambda *_, **__: 1 / 0)
    code, text, _ = run(*FASTEST)
    assert code == 0 and "held by the limit of spectral-radius; converged" in text
    assert run(*FASTEST, "--seed", "1")[0] == 2


def test_two_optimisations_do_not_write_in_one_place(run, monkeypatch):
    refused = []

    def optimise(*_, keep, **__):
        keep(xr.Dataset({"value": ("evaluation", [0.5])}))
        refused.append(run(*FASTEST))
        raise KeyboardInterrupt

    monkeypatch.setattr("walker_jax.optimise", optimise)
    assert run(*FASTEST)[0] == 130
    ((code, _, err),) = refused
    way_out = "wait, or give another --out"
    assert (code, err) == (
        2,
        f"walker-jax: optimum.zarr is being written by another run: {way_out}\n",
    )


@pytest.mark.slow
def test_an_interrupted_optimisation_goes_on(run, tmp_path, monkeypatch):
    measured = evaluation.evaluate_objective

    def interrupted(problem, stage, values, gait_of):
        if stage == 1:
            raise KeyboardInterrupt
        return measured(problem, stage, values, gait_of)

    monkeypatch.setattr("walker_jax.design.trace.evaluate_objective", interrupted)
    code, _, err = run(*FASTEST)
    assert (code, err) == (130, f"walker-jax: interrupted: {RESUME} optimum.zarr\n")
    assert "found" not in xr.open_zarr(tmp_path / "optimum.zarr", consolidated=False)
    stages = []
    monkeypatch.setattr(
        "walker_jax.design.trace.evaluate_objective",
        lambda *all: stages.append(all[1]) or measured(*all),
    )
    assert run(*FASTEST)[0] == 0
    assert 0 not in stages and {1, 2, 3} < set(stages)


def test_an_optimum_is_told_with_both_ends_as_they_were_measured():
    found = xr.Dataset(
        {
            "start": ("parameter", [0.004, 0.5]),
            "optimum": ("parameter", [0.012, 0.25]),
            **{"objective_start": 0.5, "objective_optimum": 0.75},
            **{"exact_start": 0.5625, "exact_optimum": 0.84375},
            **{"exact_start_error": 0.125, "exact_optimum_error": 0.0625},
            "at_bound": ("parameter", [0, -1]),
            "binding": ("measure", [False, True]),
            "converged": True,
            "note_start": "",
            "note_optimum": "another gait",
            "value": ("evaluation", np.zeros(9)),
        },
        {"parameter": ["slope", "hip_stiffness"], "measure": ["area", "speed"]},
    )
    answer = summarise_optimum(found)
    assert answer == {
        "start": {"slope": 0.004, "hip_stiffness": 0.5},
        "optimum": {"slope": 0.012, "hip_stiffness": 0.25},
        "objective": {"start": 0.5, "optimum": 0.75},
        "exact": {"start": 0.5625, "optimum": 0.84375},
        "exact_error": {"start": 0.125, "optimum": 0.0625},
        **{"at_bound": ["hip_stiffness"], "binding": ["speed"]},
        **{"evaluations": 9, "converged": True},
        "note": {"start": "", "optimum": "another gait"},
    }
    told = "\n".join(optimise_command.optimum_in_words(wj.SpringWalker(0.004, 0.5), answer, "area"))
    assert "slope 0.004, hip_stiffness 0.5: 0.5625 +- 0.1" in told
    assert "slope 0.012, hip_stiffness 0.25: 0.84375 +- 0.06" in told
    assert "+0.2812, by a factor of 1.500" in told and "  optimum: another gait\n" in told
    assert "at a bound of hip_stiffness, held by the limit of speed; converged, 9 ev" in told


def test_an_optimum_after_a_start_where_nothing_walks_is_told():
    ends = {"start": 0.0, "optimum": 0.002}
    answer = {
        "exact": ends,
        "exact_error": {"start": np.nan, "optimum": 1e-6},
        "at_bound": ["slope"],
        "binding": [],
        "converged": False,
        "note": {"start": "", "optimum": ""},
        "evaluations": 5,
    }
    answer |= {end: {"slope": 0.01} for end in ends}
    told = "\n".join(optimise_command.optimum_in_words(wj.SimplestWalker(0.03), answer, "area"))
    assert "slope 0.01: 0\n" in told and "slope 0.01: 0.002 +- 1e-06\n" in told
    assert "a change of +0.002\n" in told and "at a bound of slope; not converged" in told


def test_an_optimisation_that_leads_nowhere_ends_with_1_and_a_reason(run, tmp_path):
    arguments = ["optimise", "--slope", "0.45", "--over", "slope", "--bound", "slope=0.4:0.5"]
    code, out, err = run(*arguments, "--objective", "spectral-radius", "--starts", "1", "--json")
    assert (code, out) == (1, "")
    assert err == "walker-jax: no start leads anywhere: slope 0.45: no gait is found\n"


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        ([], "--over is required"),
        (["--over", "slope"], "--bound is required for slope: slope=LO:HI"),
        (["--over", "mass", "--bound", "mass=1:2"], "not 'mass'"),
        (["--over", "slope", "--bound", "slope=0.1"], "--bound must be NAME=LO:HI, not slope=0.1"),
        (["--over", "slope", "--bound", "slope=0.2:0.1"], "--bound of slope must be finite"),
        (
            ["--over", "slope", "--bound", "slope=0:0.1"],
            "slope must be above 0 and below 1.5708, not 0",
        ),
        (
            ["--over", "slope", "--bound", "slope=0.1:0.2", "--bound", "foot_mass=1:2"],
            "--bound is of foot-mass, which is not free: add --over foot-mass",
        ),
        ([*FASTEST[1:5], "--objective", "beauty"], "--objective must be one of area"),
        ([*FASTEST[1:5], *["--objective", "speed"] * 2], "--objective must be one NAME, or NAME="),
        ([*FASTEST[1:5], *["--objective", "speed=1"] * 2], "--objective is given twice for speed"),
        ([*FASTEST[1:5], "--bound", "slope=0.1:0.2"], "--bound is given twice for slope"),
        (
            [*FASTEST[1:5], "--objective", "area=much"],
            "--objective must be one NAME, or NAME=WEIGHT",
        ),
        ([*FASTEST[1:5], "--at-least", "area", "1"], "'area'"),
        (
            [*FASTEST[1:5], "--at-least", "speed", "nan"],
            "--at-least and --at-most of speed must be finite",
        ),
        ([*FASTEST[1:5], "--starts", "0"], "--starts"),
        ([*FASTEST[1:5], "--theta", "0", "1", "10"], "give --theta and --sum, or none of them"),
        ([*FASTEST[1:5], "--at-phidot", "0.1"], "--at-phidot must be left out"),
    ],
)
def test_wrong_optimisations(run, tmp_path, arguments, named):
    code, out, err = run("optimise", *arguments)
    assert (code, out) == (2, "") and named in err and err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "arguments",
    [
        ["--theta", "nan"],
        ["--thetadot", "inf"],
        ["--strides", "-1"],
        ["--strides", "1000001"],
        ["--theta", "0.9", "--animate", "walk.gif"],
        ["--animate", "walk.png"],
    ],
)
def test_wrong_walks(run, arguments):
    code, out, err = run("walk", *arguments)
    assert (code, out) == (2, "") and err.count("\n") == 1
    assert arguments[0].strip("-") in err or arguments[1] in err


def test_a_failed_computation_ends_with_1_and_a_reason(run, monkeypatch):
    def fail(*_, **__):
        raise RuntimeError("no more memory\non the device")

    monkeypatch.setattr("walker_jax.walk", fail)
    code, out, err = run("walk")
    assert (code, out) == (
        1,
        "",
    ) and err == "walker-jax: RuntimeError: no more memory on the device\n"


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (np.linalg.LinAlgError("SVD did not converge"), "LinAlgError: SVD did not converge"),
        (ValueError("f(a) and f(b) differ"), "ValueError: f(a) and f(b) differ"),
        (wj.ComputationFailed("no failure found"), "no failure found"),
    ],
)
def test_a_value_error_from_within_a_computation_is_no_wrong_use(run, monkeypatch, error, said):
    def fail(*_, **__):
        raise error

    names = {"basin": [], "robustness": [], "bifurcation_diagram": ["bifurcation"]}
    names |= {"optimise": FASTEST, "sweep": ["sweep", "--over", "slope=0.01:0.02:2"], "walk": []}
    for name, command in names.items():
        monkeypatch.setattr(wj, name, fail)
        assert run(*(command or [name])) == (1, "", f"walker-jax: {said}\n")


def test_the_installed_command_starts(tmp_path):
    command = Path(sys.executable).with_name("walker-jax")
    done = subprocess.run([command, "--help"], capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 0 and "basin" in done.stdout and "walk" in done.stdout
    assert list(tmp_path.iterdir()) == []


def python(*arguments, **settings):
    """Run Python; returns exit code, standard output and error."""
    done = subprocess.run(
        [sys.executable, *arguments], capture_output=True, text=True, env=os.environ | settings
    )
    return done.returncode, done.stdout, done.stderr


@pytest.mark.parametrize("option", ["--help", "-h"])
def test_the_help_loads_no_jax_and_no_command(option):
    program = (
        "import sys\n"
        f"sys.argv = ['walker-jax', '{option}']\n"
        "from walker_jax.cli.main import main\n"
        "try:\n"
        "    main()\n"
        "finally:\n"
        "    loaded = {name.split('.')[0] for name in sys.modules}\n"
        "    assert not loaded & {'jax', 'numpy', 'equinox', 'matplotlib', 'xarray', 'zarr'}\n"
        "    mine = {name for name in sys.modules if name.startswith('walker_jax')}\n"
        "    assert not any('walkers' in name.split('.') or '_command' in name for name in mine)\n"
    )
    code, out, err = python("-c", program)
    assert (code, err) == (0, "")
    assert all(
        name in out and first_line.split()[0] in out for name, first_line in COMMANDS.items()
    )


def test_the_help_of_a_command_flows_and_begins_as_the_list_of_commands_says(run):
    for name, first_line in COMMANDS.items():
        long, short = run(name, "--help"), run(name, "-h")
        assert long == short and long[0] == 0
        assert first_line in " ".join(long[1].split())
        assert not any("\n" in paragraph for paragraph in str(app.load(name).help).split("\n\n"))


def test_every_command_has_examples_and_says_how_long_it_takes():
    assert {*EXAMPLES} == {*DURATIONS} == {*COMMANDS}


def test_the_page_takes_no_walker_in_space(run):
    code, out, err = run("explore", "--no-browser", "--walker", "spatial")
    assert (code, out) == (2, "")
    assert err == "walker-jax: --walker must be planar, not a SpatialWalker\n"


def test_a_host_that_cannot_be_one_is_refused(run):
    for host, shown in (("a..b", "a..b"), ("", "''"), (" ", "''")):
        must = f"--host must be a name or an address, such as 127.0.0.1, not {shown}"
        assert run("explore", "--no-browser", "--host", host) == (2, "", f"walker-jax: {must}\n")


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
    said = "walker-jax: --seed is for --levels alone: give it too\n"
    assert run("basin", "--seed", "1") == (2, "", said)


def test_the_package_is_run_as_the_command():
    code, out, err = python("-m", "walker_jax", "--help")
    assert (code, err) == (0, "") and "basin" in out
    code, out, err = python("-m", "walker_jax", "bassin")
    said = "walker-jax: bassin is not a command: did you mean basin?\n"
    assert (code, out, err) == (2, "", said)


@pytest.mark.parametrize(("settings", "coloured"), [({}, True), ({"NO_COLOR": "1"}, False)])
def test_help_has_colours_unless_no_color_is_set(settings, coloured, monkeypatch):
    monkeypatch.delenv("NO_COLOR", raising=False)
    monkeypatch.setenv("TERM", "xterm-256color")
    code, out, _ = python("-m", "walker_jax", "--help", FORCE_COLOR="1", **settings)
    codes = {number for found in re.findall(r"\x1b\[([\d;]*)m", out) for number in found.split(";")}
    assert code == 0 and codes
    assert any(30 <= int(number or 0) <= 48 for number in codes) == coloured


def test_messages_name_options():
    for said, arguments, named in (
        (["objective must be one of area"], "objective", "--objective must be one of area"),
        (
            ["at_least and at_most of speed must be finite"],
            "at_least at_most",
            "--at-least and --at-most of speed must be finite",
        ),
        (
            ["out is taken", "give another out, or overwrite"],
            "out overwrite",
            "out is taken: give another --out, or --overwrite",
        ),
        (["leg must be below leg_mass, not 1"], "leg", "--leg must be below leg_mass, not 1"),
        (["slope 1: no gait; give theta, or another slope"], "theta slope", None),
        (["a grid island"], "", "a grid island"),
    ):
        error = WrongUse(*said, of=arguments)
        assert str(error) == ": ".join(said)
        assert message_of(error) == (named or "slope 1: no gait; give --theta, or another --slope")


def test_compiled_programs_are_kept_where_the_user_says(tmp_path, monkeypatch):
    settings, at_exit = {}, []
    monkeypatch.setattr(jax.config, "update", settings.__setitem__)
    monkeypatch.setattr(startup.atexit, "register", lambda *given: at_exit.append(given))
    for variable, place, kept in [
        ("WALKER_JAX_CACHE_DIR", tmp_path / "here", tmp_path / "here" / "xla-programs"),
        ("WALKER_JAX_CACHE_DIR", "", None),
        ("JAX_COMPILATION_CACHE_DIR", tmp_path / "of JAX", None),  # which takes care of it itself
    ]:
        monkeypatch.delenv("JAX_COMPILATION_CACHE_DIR", raising=False)
        monkeypatch.setenv(variable, str(place))
        settings.clear()
        startup.keep_compiled()
        assert settings.get("jax_compilation_cache_dir") == (str(kept) if kept else None)
    assert [path.name for path in tmp_path.iterdir()] == ["here"]
    assert at_exit == [(startup.close_to_others, tmp_path / "here" / "xla-programs")]


def test_what_xla_compiles_is_kept_from_others(tmp_path, monkeypatch):
    settings, folder = {}, tmp_path / "here" / "xla-programs"
    monkeypatch.setattr(jax.config, "update", settings.__setitem__)
    monkeypatch.setattr(startup.atexit, "register", lambda *_: None)
    monkeypatch.delenv("JAX_COMPILATION_CACHE_DIR", raising=False)
    monkeypatch.setenv("WALKER_JAX_CACHE_DIR", str(tmp_path / "here"))
    before = os.umask(0)
    try:
        startup.keep_compiled()
    finally:
        os.umask(before)
    assert settings["jax_compilation_cache_dir"] == str(folder)
    assert [place.stat().st_mode & 0o777 for place in (folder.parent, folder)] == [0o700] * 2
    kept, open_, other = (folder / name for name in ("a-cache", "b-cache", "mine"))
    for path, mode in ((kept, 0o644), (open_, 0o666), (other, 0o666)):
        path.write_bytes(b"program")
        path.chmod(mode)
    (folder / "c-cache").symlink_to(kept)  # whose own mode is 0777
    startup.keep_compiled()
    assert sorted(folder.iterdir()) == [kept, other]
    startup.close_to_others(folder)
    assert [path.stat().st_mode & 0o777 for path in (kept, other)] == [0o600, 0o666]
    for place in (folder, folder.parent):
        place.chmod(0o777)
        settings.clear()
        private_files.warn_of.cache_clear()
        with pytest.warns(RuntimeWarning, match=f"compiled programs in {place} are not used"):
            startup.keep_compiled()
        assert settings == {}
    startup.close_to_others(tmp_path / "gone")


def test_importing_sets_no_flag_and_loads_no_drawing():
    program = (
        "import jax, sys\n"
        "before = dict(jax.config.values)\n"
        "import walker_jax\n"
        "assert before == dict(jax.config.values)\n"
        "walker_jax.find_gait, walker_jax.SimplestWalker, walker_jax.strides\n"
        "late = {'matplotlib', 'dask', 'zarr', 'typer', 'xarray', 'scipy.stats'}\n"
        "assert not late & set(sys.modules)\n"
    )
    subprocess.run([sys.executable, "-c", program], check=True)


def test_public_names_are_what_they_name_whatever_is_loaded_first():
    """A module of that name would take its place."""
    program = (
        "import types, walker_jax.design.sweeps, walker_jax\n"  # which loads most of the others
        "from walker_jax import basin, stride, storage\n"
        "from walker_jax import *\n"
        "values = [getattr(walker_jax, name) for name in walker_jax.__all__]\n"
        "assert not any(isinstance(value, types.ModuleType) for value in values)\n"
        "assert basin.__name__ == walker_jax.basin.__name__ == 'basin' and callable(stride)\n"
        "assert isinstance(storage, types.ModuleType)\n"
        "assert set(walker_jax.__all__) < set(globals())\n"
        "assert dir(walker_jax) == sorted([*walker_jax.__all__, '__version__'])\n"
        "assert not hasattr(walker_jax, 'no_such_name')\n"
    )
    subprocess.run([sys.executable, "-c", program], check=True)


def test_compile_time_counts_once():
    clock = Stopwatch()
    start = clock.start
    clock.compiling = [(start + 1, start + 3), (start + 2, start + 4), (start + 6, start + 7)]
    assert clock.seconds()["compile"] == pytest.approx(4)


def test_the_walkers_are_listed_with_parameters_units_and_defaults(run):
    for arguments in (["--list-walkers"], ["basin", "--list-walkers"]):
        code, out, err = run(*arguments)
        assert (code, err) == (0, "")
        for name, kind in WALKERS.items():
            assert f"{name}:" in out and ", ".join(kind.section) in out
            own = out[out.index(f"{name}:") :].splitlines()
            for one in parameters(kind):
                row = next(line for line in own if f"{option_of(one.name)} " in line)
                assert f"{one.default:g}" in row and one.unit in row and one.meaning in row


def test_help_has_the_slopes_that_a_walker_has_by_default(run):
    words = lambda *arguments: " ".join(run(*arguments)[1].replace("│", " ").split())
    assert "--slope X of the ground; rad (default: 0.004)" in words("walk", "--help")
    kneed = words("walk", "--walker", "kneed", "--help")
    assert "--slope X of the ground; rad (default: 0.05)" in kneed
    said = words("bifurcation", "--help")
    assert "Lowest value (default, of the slope: 0.001, kneed: 0.03)" in said
    assert "Highest value (default, of the slope: 0.022, kneed: 0.12)" in said


def test_help_has_the_parameters_of_the_walker_that_is_named(run):
    for named in ([], ["--walker", "round-foot"], ["--walker=upper-body"], ["--system", "henon"]):
        code, out, _ = run("basin", *named, "--help")
        kind = WALKERS.get(named[-1].rpartition("=")[2] if named else "simplest", wj.HenonMap)
        own = {option_of(one.name) for one in parameters(kind)}
        others = {option_of(one.name) for kind in WALKERS.values() for one in parameters(kind)}
        found = set(re.findall(r"^  (--[\w-]+) ", out, re.M))
        assert code == 0 and own <= found and not (others - own) & found


@pytest.mark.parametrize("name", COMMANDS)
def test_help_begins_with_examples_and_is_short(run, name, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    lines = run(name, "--help")[1].splitlines()
    assert lines[0].startswith(f"walker-jax {name} ") and "Examples:" in lines[:6]
    assert len(lines) <= 60 and max(map(len, lines)) <= 80
    assert not any("None" in line for line in lines)


def test_another_walker_walks_and_is_named(run):
    start = ["--theta", "0.16", "--thetadot", "-0.17"]
    walker = ["--walker", "spring", "--hip-stiffness", "0.5", "--slope", "0.005"]
    code, out, err = run("walk", *walker, *start, "--strides", "3", "--json")
    assert (code, err) == (0, "")
    walk = wj.walk(wj.SpringWalker(0.005, 0.5), np.array([0.16, -0.17]), 3)
    np.testing.assert_allclose(json.loads(out)["states"], walk.states, rtol=0, atol=1e-14)


@pytest.mark.slow
def test_a_walker_with_three_dimensions_has_a_gait_a_slice_and_a_basin(run, tmp_path):
    walker = ["--walker", "round-foot", "--slope", "0.01"]
    code, out, err = run("gait", *walker, "--json")
    assert (code, err) == (0, "")
    answer = json.loads(out)
    gait = answer["gaits"][0]
    assert answer["walker"] == {
        "name": "RoundFootWalker",
        **describe_walker(wj.RoundFootWalker(0.01)),
    }
    assert gait["stable"] and len(gait["multipliers"]) == 3
    guess = ["--guess", *gait["states"][0][:2], "--phidot", gait["states"][0][2]]
    code, out, _ = run("gait", *walker, *guess)
    assert code == 0 and "phidot" in out

    window = ["--theta", "0.05", "0.45", "20", "--sum", "-0.15", "-0.02", "16"]
    code, out, err = run("basin", *walker, *window, "--out", "s.zarr", "--json")
    assert (code, err) == (0, "")
    answer = json.loads(out)
    assert answer["method"] == "direct" and answer["attractors"][0]["period"] == 1
    data = xr.open_zarr(tmp_path / "s.zarr", consolidated=False).load()
    assert data.fate.dims == ("theta", "sum")
    assert float(data.phidot) == pytest.approx(gait["states"][0][2], abs=1e-12)
    assert (tmp_path / "s.png").stat().st_size > 10_000

    depth = ["--phidot", "-0.1", "0.0", "7"]
    code, out, err = run("basin", *walker, *window, *depth, "--out", "w.zarr", "--json")
    assert (code, err) == (0, "")
    answer = json.loads(out)
    assert answer["method"] == "cell-map" and answer["cells"] == 20 * 16 * 7
    assert (tmp_path / "w.png").stat().st_size > 10_000


def test_a_place_that_is_taken_is_refused_before_a_gait_is_searched_for(run, tmp_path, monkeypatch):
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


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["walk", "--walker", "giraffe"], ["--walker", "giraffe", "--list-walkers"]),
        (["walk", "--foot-mass", "0.1"], ["--foot-mass", "simplest", "--slope"]),
        (["gait", "--walker", "point-foot", "--foot-mass", "-1"], ["--foot-mass", "-1"]),
        (["gait", "--walker", "point-foot", "--foot-mass", "nan"], ["--foot-mass", "nan"]),
        (
            ["basin", "--walker", "round-foot", "--foot-radius", "1"],
            ["--foot-radius", "--leg-length", "1"],
        ),
        (["basin", "--walker", "round-foot", "--leg-length", "0"], ["--leg-length", "0"]),
        (["basin", "--walker", "round-foot", "--leg-mass", "inf"], ["--leg-mass", "inf"]),
        (["basin", "--phidot", "0", "1", "5"], ["--phidot", "theta, thetadot"]),
        (["basin", "--at-phidot", "0"], ["--at-phidot", "theta, thetadot"]),
        (
            ["basin", "--walker", "round-foot", "--phidot", "0", "1", "5", "--at-phidot", "0"],
            ["--phidot", "--at-phidot"],
        ),
        (["basin", "--walker", "round-foot", "--at-phidot", "nan"], ["at-phidot", "nan"]),
        (
            ["basin", "--walker", "round-foot", "--at-phidot", "0", "--method", "cell-map"],
            ["method", "slice"],
        ),
        (["walk", "--walker", "round-foot", "--theta", "0.2"], ["--thetadot"]),
        (["walk", "--phidot", "0.2"], ["--phidot", "theta, thetadot"]),
        (["gait", "--phidot", "0.2"], ["--phidot", "--guess"]),
        (["gait", "--walker", "round-foot", "--guess", "0.2", "-0.2"], ["--phidot"]),
        (["bifurcation", "--walker", "spring", "--hip-stiffness", "-1"], ["--hip-stiffness", "-1"]),
    ],
)
def test_wrong_walkers(run, tmp_path, arguments, named):
    code, out, err = run(*arguments)
    assert code == 2 and out == "" and err.count("\n") == 1
    for word in named:
        assert word in err
    assert list(tmp_path.iterdir()) == []


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


def test_viable_narrows_its_bounds_and_goes_on_with_what_was_interrupted(run, monkeypatch):
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

"""Whatever is asked for: an answer, or one line that says what is wrong, and nothing is lost."""

import contextlib
import io
import json
import operator
import shutil
import sys
from collections import Counter
from pathlib import Path
from typing import Any
from unittest import mock

import click
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from small_calls import Measured, black_box
from unchecked import unchecked

import walker_jax as wj
from walker_jax import storage
from walker_jax.basins.computation import check_grid
from walker_jax.basins.mapper import Mapper
from walker_jax.basins.refinement import Refined, dataset_of_runs, finer
from walker_jax.basins.runs import Runs
from walker_jax.checks import ComputationFailed, WrongUse
from walker_jax.cli import app, main
from walker_jax.design.climbs import Climb
from walker_jax.design.evaluation import Evaluation
from walker_jax.execution import tiles
from walker_jax.execution.workers import open_workers
from walker_jax.fractals.dimensions import Uncertainty
from walker_jax.integrators.integrator import Integrator
from walker_jax.kernels import decorator
from walker_jax.stability import rough_ground
from walker_jax.stability.disturbances import LeastDisturbance
from walker_jax.stability.sampling import BasinStability
from walker_jax.stability.steps_down import LeastStepDown

NUMBERS = ["0.004", "0.2", "-0.2", "0.01", "0.3", "1", "2", "3", "10", "0", "-1", "1.5", "1e-300"]
NUMBERS += ["1e300", "1e400", "nan", "inf", "-inf", "abc", "", " ", "0x10", "1_0", "٣", "9" * 30]
WORDS = ["slope", "simplest", "spring", "mass", "direct", "cell-map", "speed", "area", "speed=1"]
WORDS += ["slope=0.003:0.004:2", "slope=0.001:0.02:9999999", "slope=1e-14:2e-14:2"]
WORDS += ["slope=0.001:0.02", "slope=0.02:0.001", "slope=nan:1", "slope=", "=", "", "ä\n", "--json"]
PLACES = ["a.zarr", "a.png", "b.svg", "c.xyz", "w.gif", "no/a.zarr", ".", "..", "/", "", "\0.zarr"]
PLACES += ["taken", "taken/a.zarr", "file.txt", "file.txt/a.png", "broken.zarr", "held.zarr"]
PLACES += ["held.nc", "b.nc", "held.png", "n" * 250 + ".zarr", "n" * 300, "/proc/a.zarr"]
PLACES += ["/proc/a.png", "ä b.zarr"]
AXES = [("0.05", "0.35", "6"), ("-0.03", "0.01", "6"), ("0", "0.4", "46000"), ("0.4", "0", "6")]
GOOD = {
    "boundary": ["--theta", *AXES[0], "--sum", *AXES[1]],
    "basin": ["--theta", *AXES[0], "--sum", *AXES[1]],
    "optimise": ["--over", "slope", "--bound", "slope=0.001:0.02", "--scan", "3"],
    "robustness": ["--theta", *AXES[0], "--sum", *AXES[1]],
    "sweep": ["--over", "slope=0.003:0.004:2"],
    "prove": ["--radius", "0.001", "--levels", "3"],
    "viable": ["--action", "slope=0.003:0.004:2", "--theta", *AXES[0], "--sum", *AXES[1]],
    "export": ["held.zarr", "b.nc"],
}
"""What some commands need to answer, or to do so soon."""

QUICK = settings(
    max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
LONG = settings(QUICK, max_examples=5000)
COMMANDS = {
    name: one.get_params(click.Context(one, **one.context_settings))
    for name, one in ((name, app.load(name)) for name in app.NAMES)
}


@st.composite
def commands(draw, walkers=("simplest",)):
    """A command line: mostly what there is, with values good and bad."""
    name = draw(st.sampled_from(sorted(COMMANDS)))
    arguments = [name] if draw(st.integers(0, 30)) else [draw(st.sampled_from(WORDS))]
    arguments += draw(st.sampled_from([[], GOOD.get(name, [])]))
    chosen = draw(st.lists(st.sampled_from(COMMANDS[name]), max_size=5))
    for option in chosen:
        if option.param_type_name == "argument":
            continue
        arguments.append(option.opts[0])
        if option.opts[0] == "--walker":
            arguments.append(draw(st.sampled_from([*walkers, "giraffe"])))
        elif option.nargs > 1:
            several = st.lists(
                st.sampled_from(NUMBERS), min_size=option.nargs, max_size=option.nargs
            )
            axes = st.sampled_from(AXES) if option.nargs == 3 else several
            arguments += draw(axes if draw(st.integers(0, 3)) else several)
        elif not option.is_flag:
            kinds = {"out": PLACES, "figure": PLACES, "animate": PLACES, "over": WORDS}
            kinds |= {"bounds": WORDS, "parameter": WORDS, "objective": WORDS, "method": WORDS}
            arguments.append(draw(st.sampled_from(kinds.get(option.name, NUMBERS))))
    for option in COMMANDS[name]:
        if option.param_type_name == "argument" and len(arguments) < 3 and draw(st.integers(0, 20)):
            good = [{"data": "held.zarr", "file": "b.nc", "source": "b.csv"}[option.name]] * 30
            arguments.append(draw(st.sampled_from(PLACES + good)))
    if not draw(st.integers(0, 20)):
        arguments.append(draw(st.sampled_from(WORDS + NUMBERS)))
    return arguments


MISTAKES = ("TypeError", "AttributeError", "KeyError", "IndexError", "NameError", "AssertionError")
"""Of a program, not of what it was given."""


def refuse(*_, **__):
    raise RuntimeError("so much is not computed here")


def unreachable(cluster):
    raise ValueError(f"cluster {cluster} cannot be reached, which takes too long")


ANSWERS = {
    "least_disturbance_if_any": LeastDisturbance(
        0.002, np.array([0.6, 0.8]), np.array([0.16, -0.15]), 0, wj.Outcome.FORWARD, 6
    ),
    "least_step_down": LeastStepDown(0.001, np.zeros(4), 0, wj.Outcome.FORWARD, 6),
    "basin_stability": BasinStability(*map(np.asarray, (0.3, 0.2, 0.4, 8 * [0], 0, 20.0, 30.0))),
    "boundary_dimension": Uncertainty(1.0, 0.9, 1.1, 1.0, np.zeros(0), np.zeros(0)),
}
"""What is measured of a walker's robustness."""
PICTURES = "basin basin_slices multipliers robustness robustness_table optimum sweep".split()


def climb(trace, run, stage, place):
    row = trace.measure(run, stage, place)
    return Climb(row, row, True)


def measured(problem, stage, values, *_, **__):
    gradient, of_measures = np.ones(len(values)), np.zeros(len(problem.measures))
    return Evaluation(
        -1, stage, values, float(values.sum()), 0.0, gradient, 0 * gradient, of_measures, 0
    )


def put(path: Path, request: dict) -> None:
    path.write_bytes(storage.signature(request).encode())


@pytest.fixture(scope="module")
def made():
    """Answers that stand in for others: a basin, one that is refined, and a gait."""
    walker = wj.SimplestWalker(0.004)
    grid = wj.Grid.sheared(theta=(0.05, 0.35, 6), sum=(-0.03, 0.01, 6))
    fine = wj.refine(walker, grid, 0, check=0)
    return wj.basin(walker, grid, "direct"), fine, wj.find_gait(walker)


@pytest.fixture
def bench(tmp_path_factory, made):
    """Run command lines in a folder with things in it; what takes long is left out."""
    answer, fine, gait = made
    folder = tmp_path_factory.mktemp("fuzz")
    there, template = folder / "there", folder / "template"
    for name in ("taken", "broken.zarr"):
        (template / name).mkdir(parents=True)
    (template / "file.txt").write_text("mine")
    for name in ("held.png", "held.nc"):
        (template / name).write_bytes(b"beach")
    (template / "broken.zarr" / "zarr.json").write_text('{"zarr_f')
    storage.save(
        xr.Dataset({"x": ("n", np.arange(3))}), template / "held.zarr", {"command": "other"}
    )
    before = content(template)

    def refine(walker, grid, levels, **_):
        check_grid(walker, finer(grid, levels), "direct")
        return fine.copy()

    def basin(walker, grid, method, *, out=None, request=None, cluster=None, **_):
        check_grid(walker, grid, method)
        with open_workers(cluster):
            return answer if out is None else storage.save(answer, out, request or {})

    with contextlib.ExitStack() as stack:
        patch = lambda place, value: stack.enter_context(mock.patch(place, value))
        patch("walker_jax.cli.startup.keep_compiled", lambda: None)
        for place in ("answers", "gait_command"):
            patch(f"walker_jax.cli.{place}.draw", lambda axes, path, request: put(path, request))
        for name in PICTURES:
            patch(f"walker_jax.figures.{name}", lambda data: None)
        film = lambda *all, **more: all[1].write_bytes(more["signature"].encode())
        patch("walker_jax.figures.film", film)
        patch("walker_jax.paper.reproduction.reproduce", refuse)
        patch("walker_jax.execution.workers.connect", unreachable)
        patch("walker_jax.design.sweeps.measure_basin", lambda *_: {"total_area": 0.001})
        patch("walker_jax.basin", basin)
        for name in "bifurcation_diagram chart continue_basins most_probable_fall".split():
            patch(f"walker_jax.{name}", refuse)
        patch("walker_jax.stability.boundaries.LONGEST_CURVED", 0)  # no curves
        one = lambda walker, period: [gait] if period == 1 else []
        patch("walker_jax.gaits.selection.find_gaits", one)
        patch("walker_jax.gaits.search.find_gaits", lambda *_, **__: [])
        measured_by = "walker_jax.stability.gait_robustness"
        for name, found in ANSWERS.items():
            patch(f"{measured_by}.{name}", lambda *_, found=found, **__: found)
        patch(f"{measured_by}.refine", refine)
        patch("walker_jax.design.optimisation.climb", climb)
        patch("walker_jax.design.trace.evaluate_objective", measured)
        patch("walker_jax.design.optimisation.compare_basins", lambda *_: {})
        patch("walker_jax.explorer.server.run_server", lambda *_, **__: None)

        def run(arguments):
            if not there.exists() or content(there) != before:
                shutil.rmtree(there, ignore_errors=True)
                shutil.copytree(template, there)
            out, err = io.StringIO(), io.StringIO()
            with (
                contextlib.chdir(there),
                contextlib.redirect_stdout(out),
                contextlib.redirect_stderr(err),
                mock.patch.object(sys, "argv", ["walker-jax", *arguments]),
                pytest.raises(SystemExit) as stop,
            ):
                main.main()
            after = content(there)
            lost = [path for path, value in before.items() if after.get(path) != value]
            return stop.value.code, out.getvalue(), err.getvalue(), lost, after

        yield run, before


def content(folder: Path) -> dict[Path, bytes]:
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder): path.read_bytes() for path in files}


def check(bench, arguments, tried: Counter) -> None:
    run, before = bench
    try:
        code, out, err, lost, after = run(arguments)
    except BaseException:
        tried["tracebacks"] += 1
        raise
    tried[f"exit code {code}"] += 1
    told = {"-h", "--help", "--list-walkers"} & {*arguments}
    tried[f"answers of {arguments[0]}"] += code == 0 and not told
    tried["wrong exit codes"] += code not in (0, 1, 2)
    assert code in (0, 1, 2)
    assert err.count("\n") == (code != 0) and err.startswith("walker-jax: ") == (code != 0), err
    assert (
        "Traceback" not in out + err
        and not any(name in err for name in MISTAKES)
        and (len(err) > len("walker-jax: \n")) == (code != 0)
    )
    tried["longest line"] = max(tried["longest line"], len(err.rstrip()))
    assert tried["longest line"] < 200, err
    assert code != 2 or after == before
    assert "--overwrite" in arguments or not lost
    # What is no data set stays in any case, and what a command may replace it must have named.
    assert not {str(path) for path in lost} & {"file.txt", "broken.zarr/zarr.json"}
    assert "held.nc" not in map(str, lost) or arguments[0] == "export"
    if code == 0 and "--json" in arguments and not told:
        json.loads(out, parse_constant=lambda name: pytest.fail(name))


@pytest.mark.slow
@QUICK
@given(arguments=commands())
def test_any_command_line_ends_in_order(bench, arguments):
    check(bench, arguments, Counter())


STOPPED = {"reproduce", "bifurcation", "chart", "continuation", "explore", "fall", "fit"}
"""For which nothing stands in, and the page, which gives no answer; a fit needs recordings."""


@pytest.mark.slow
def test_every_command_answers(bench):
    run, _ = bench
    tables = {"robustness": [[], ["--from", "0.003", "--to", "0.004", "--count", "2"]]}
    for name in (one for one in COMMANDS if one not in STOPPED):
        for more in tables.get(name, [[]]):
            code, out, err, lost, _ = run([name, *GOOD.get(name, []), *more, "--json"])
            assert (code, err, lost) == (0, "", []), (name, err)
            assert json.loads(out), name


@pytest.mark.slow
def test_thousands_of_command_lines_end_in_order(bench):
    tried = Counter()

    @LONG
    @given(arguments=commands(walkers=("simplest", "spring", "point-foot", "round-foot")))
    def run(arguments):
        check(bench, arguments, tried)

    try:
        run()
    finally:
        print(dict(tried))
    assert tried["tracebacks"] == tried["wrong exit codes"] == 0
    assert sum(tried[f"exit code {code}"] for code in (0, 1, 2)) >= 5000
    assert all(tried[f"answers of {name}"] for name in {*COMMANDS} - STOPPED)


X = np.array([0.2, -0.21645])
BAD = [
    None,
    "abc",
    "slope",
    "",
    np.nan,
    np.inf,
    -np.inf,
    -1,
    0,
    1.5,
    1e300,
    -1e300,
    10**30,
    1j,
    [],
    {},
]
BAD += [np.int64(3), np.float32(0.1), np.bool_(True)]
BAD += [(), [np.nan], [[1.0, 2.0], [3.0]], object(), (2, 1), (np.nan, 1), (0.01, 0.01), ["slope"]]
BAD += [
    np.zeros((2, 3, 4)),
    np.zeros(0),
    np.array("a"),
    [np.nan, 0.1],
    [0.2, np.inf],
    [[0.2, -0.2]],
]
BAD += [
    wj.SimplestWalker(0.004),
    wj.RoundFootWalker,
    print,
    {"speed": np.nan},
    {"slope": None},
    b"x",
]


def calls() -> dict[str, dict]:
    """Public functions, and arguments by name that are good and take little time."""
    walker = wj.SimplestWalker(0.004)
    grid = wj.Grid.sheared(theta=(0.05, 0.35, 4), sum=(-0.03, 0.01, 4))
    gait, interval = wj.find_gait(walker), (0.0039, 0.0041)
    start = (of_walker := {"walker": walker, "tolerance": None}) | {"x": X}
    on_grid = {**of_walker, "grid": grid, "strides": 20}
    refined = {**on_grid, "levels": 0, "check": 0, "seed": 0}
    ends = lambda points: np.asarray(points)[:, 0] > 0
    draw = lambda rng, n: rng.normal(size=(n, 2))
    fit = {"confidence": 0.9, "seed": 0}
    of_gait = {**of_walker, "gait": gait}
    measured = {**of_gait, "parameters": ("slope",)}
    box = wj.Grid.sheared(theta=(0, 1, 2), sum=(0, 1, 2), phidot=(0, 1, 2))
    runs = Runs.from_cells(np.zeros((2, 2, 2), int), np.zeros((2, 2, 2), int))
    rolling = wj.RoundFootWalker(0.01)
    cells = np.arange(8), np.ones(8, int), Mapper(rolling, [], Integrator(1e-10), 10)
    none = np.zeros(0, int)
    volume = dataset_of_runs(
        rolling, Refined(box, runs, *cells, 0.0, 0.0, [8], [0], 0, none, none, 8), {"method": ""}
    ).assign(dict.fromkeys(("total_area", "total_area_error", "strides_made"), 0))
    volume = volume.assign(checked=0, mistaken=0, followed=("level", [8]), boundary=("level", [0]))
    axis = (0.05, 0.35, 4)
    cube = wj.Map(lambda x, a: a * x**3, ("x", "y"), parameters={"a": 1.0})
    square = wj.Grid.plain(x=(-2, 2, 1), y=(-2, 2, 1))
    settled = wj.find_attractors(cube, [X])
    optimum = {
        "bounds": {"slope": (0.003, 0.005)},
        "objective": "speed",
        "starts": 1,
        "known": None,
    }
    optimum |= {"at_least": {"speed": 0.01}, "at_most": None, "seed": 0, "scan": 0, "levels": 0}
    return {
        "SimplestWalker": {"slope": 0.004},
        "SpringWalker": {"slope": 0.004, "hip_stiffness": 0.1},
        "PointFootWalker": {"slope": 0.004, "foot_mass": 0.1},
        "RoundFootWalker": {"slope": 0.01, "foot_radius": 0.1, "leg_inertia": 0.1},
        "UpperBodyWalker": {"slope": 0.01, "body_mass": 0.1, "com_from_hip": 0.1},
        "Grid": {"axes": {"theta": axis}, "shear": [[1.0]], "origin": [0.0]},
        "Grid.plain": {"theta": axis, "thetadot": (-1, 0, 3)},
        "Grid.sheared": {"theta": axis, "sum": (-0.1, 0, 3)},
        "stride": {**start, "step": -0.001},
        "margins": start,
        "integrals": {"system": Measured(0.004), "x": X, "tolerance": None},
        "strides": {**of_walker, "xs": np.array([X, X])},
        "walk": {**start, "n": 2},
        "trajectory": {**start, "times": np.array([0.0, 1.0]), "strides": 2},
        "phase_times": start,
        "steps_to_fall": {**of_gait, "ground": 0.001, "n": 2, "limit": 2, "confidence": 0.9},
        "most_probable_fall": {**of_gait, "ground": 1.0, "strides": 1, "directions": 2},
        "transients": {"system": wj.systems.HenonMap(1.6), "starts": np.zeros((2, 2)), "settle": 1},
        "crisis_law": {"values": np.arange(1.0, 5.0), "lives": np.ones(4), "errors": np.ones(4)}
        | {"multipliers": [4.0, 0.1]},
        "gait_sensitivity": {**of_gait, "disturbances": ("push",), "indicators": ("time",)},
        "measure sensitivity-norm": {**measured, "quantity": "sensitivity-norm"},
        "motion": {**start, "strides": 2, "step": 0.1},
        "explain": start,
        "find_gait": {**of_walker, "guess": X, "period": 1},
        "find_gaits": {**of_walker, "period": 1, "region": grid, "descent": 0},
        "descend": {**of_walker, "cycles": np.array([[X]]), "steps": 2, "rate": 0.001},
        "measure multipliers": {**measured, "quantity": "multipliers"},
        "measure speed": {**measured, "quantity": "speed"},
        "continue_gait": {**of_gait, "parameter": "slope", "interval": interval}
        | {"normal_forms": False},
        "basin": {**on_grid, "method": "direct"},
        "compare_methods": on_grid,
        "viable": {"walker": walker, "grid": grid, "actions": {"slope": [0.003, 0.005]}}
        | {"target": None, "bounds": True, "tolerance": None},
        "prove_basin": {"walker": walker, "region": 1e-3, "levels": 1, "strides": 5},
        "prove_doubling": {"walker": walker, "low": 0.004, "high": 0.005},
        "prove_gait": {"walker": walker, "period": 1},
        "refine": refined,
        "slice_basin": {"data": volume, "axis": "phidot", "value": 0.1},
        "measure area": {**refined, "quantity": "area", "parameters": ("slope",), "bands": None},
        "measure basin-stability": {**refined, "quantity": "basin-stability"}
        | {"density": lambda x: np.ones(len(x))},
        "boundary_dimension": {**on_grid, **fit, "distances": [0.1, 0.01, 0.001], "pairs": 20},
        "basin_stability": {**of_gait, **fit, "disturbances": 0.01}
        | {"within": 1e-3, "samples": 5, "strides": 20}
        | {"scale": None, "along": None, "metric": None, "horizon": 3},
        "tipping_probability": {**of_walker, "parameter": "slope", "value": 0.005, "region": grid}
        | {"samples": 5, "strides": 20, "seed": 0, "confidence": 0.9},
        "boundary": {**on_grid, "side": 2, "radius": 1.0},
        "boundary_point": {**on_grid, "near": X},
        "zoom": {**on_grid, "factor": 10.0, "centre": X, "frames": 2},
        "edge_state": {**of_walker, "a": X, "b": [0.15, -0.2], "rounds": 2, "strides": 20},
        "stable_manifold": {**of_gait, "spacing": 0.01, "points": 3},
        "fractals.basin_entropy": {"labels": np.eye(64) > 0, "side": 5},
        "fractals.merge_regions": {"labels": np.arange(4096).reshape(64, 64) % 3}
        | {"radius": 1.0, "halvings": 1},
        "fractals.box_counting": {"labels": np.eye(64) > 0, "spacing": 1.0, "confidence": 0.9},
        "fractals.uncertainty_exponent": {**fit, "label_of": ends, "draw": draw}
        | {"distances": [0.1, 0.2, 0.3], "pairs": 100},
        "find_attractors": {"system": cube, "starts": [X], "strides": 9, "tolerance": None},
        "label": {"system": cube, "attractors": settled, "start": X, "strides": 9, "further": 9},
        "basin_volume": {"system": cube, "attractor": settled[0], "region": square}
        | {"samples": 64, "moves": 2, "strides": 9, "seed": 0, "tolerance": None},
        "attractors": {**of_walker, "parameter": "slope", "values": [0.004]}
        | {"starts": [[X]], "strides": 5},
        "loss_of_walking": {**of_walker, "parameter": "slope", "interval": interval, "branches": []}
        | {"strides": 5, "resolution": 1e-4},
        "continue_event": {
            "system": wj.systems.HenonMap(0.1, 0.3),
            "event": wj.Bifurcation(
                *("doubling", 0.3675, np.array([[20 / 21, 2 / 7]]), np.array([-1, 0.3 + 0j])),
                *(np.array([[1, -0.3]]), 0.0),
            ),
            "parameters": ("a", "b"),
            "bounds": {"a": (0.0, 1.0), "b": (0.0, 0.5)},
        },
        "chart": {"system": wj.SpringWalker(0.004)}
        | {"bounds": {"slope": interval, "hip_stiffness": (0.0, 0.1)}}
        | {"gait": gait, "period_max": 1, "cells": (3, 2), "strides": 5},
        "lyapunov": {"system": walker, "x": np.array(X), "strides": 3, "walks": 2}
        | {"settling": 1, "seed": 0},
        "fractals.information_dimension": {"points": np.random.default_rng(0).random((999, 1))}
        | {"confidence": 0.9},
        "bifurcation_diagram": {**of_walker, "parameter": "slope", "interval": interval},
        "least_disturbance": {**of_gait, "scale": None, "along": None, "fall": True, "strides": 20}
        | {"metric": None},
        "least_step_down": {**of_gait, "fall": True, "strides": 20},
        "measure least-disturbance": {**measured, "quantity": "least-disturbance"}
        | {"bands": None, "fall": True, "along": None, "directions": 90, "strides": 20},
        "robustness": {**on_grid, "levels": 0, "check": 0, "disturbances": 0.1, "seed": 0},
        "robustness over values": {**on_grid, "values": [0.004], "parameter": "slope"}
        | {"levels": 0, "check": 0, "seed": 0},
        "continue_basins": {**of_walker, "parameter": "slope", "values": [0.004, 0.005]}
        | {"region": grid, "samples": 10, "strides": 20, "seed": 0},
        "sweep": {**of_walker, "over": {"slope": [0.004]}, "grid": grid, "strides": 20, "seed": 0}
        | {"levels": 0, "check": 0, "robust": False},
        "optimise": {**of_walker, **optimum, "strides": 20, "grid": grid},
        "measure fall-action": {**measured, "quantity": "fall-action"}
        | {"ground": 1.0, "strides": 1, "directions": 2},
        "audit": {"box": black_box(), "state": [0.0, 0.0], "disturbances": 0.1}
        | {"samples": 20, "strides": 5, "seed": 0},
        "pareto": {**of_walker, "bounds": {"slope": (0.003, 0.01)}, "objectives": GOALS}
        | {"points": 3},
    }


OF_FILES = {"read_recordings", "fit", "propagate", "robot", "export_motion"}
GOALS = "speed", "spectral-radius"
HEAVY = {"bifurcation_diagram", "least_disturbance", "optimise"}
HEAVY |= {"measure least-disturbance", "measure fall-action", "pareto"}
HEAVY |= {"continue_basins", "robustness", "robustness over values"}
HEAVY |= {"chart", "continue_event", "lyapunov", "most_probable_fall"}
"""Always stopped where their work begins: where a bad value is a default, they take minutes."""


BEGINNINGS = ((tiles, "program_of"), (decorator, "program_of"), (rough_ground, "walk_disturbed"))
BEGINNINGS += ((storage, "open_pieces"),)
"""Of a kernel, of the one computation without any that takes long to compile, and of a store."""


class Begun(BaseException):
    """Arguments have been taken."""


def stop(*_, **__):
    raise Begun


def reaction(name: str, arguments: dict, *, begin: bool) -> str:
    """What becomes of a public function with its arguments; it may `begin` its work, or not."""
    function: Any = wj
    for part in name.split()[0].split("."):
        function = getattr(function, part)
    try:
        with contextlib.ExitStack() as stopped:
            for module, work in () if begin else BEGINNINGS:
                stopped.enter_context(mock.patch.object(module, work, stop))
            function(**arguments)
    except (WrongUse, ComputationFailed) as error:
        assert str(error) and "\n" not in str(error), str(error)
        return "refused" if isinstance(error, WrongUse) else "failed"
    except Begun:
        return "begun"
    return "answered"


def spoil(good: dict[str, dict], count: int, *, repeatable: bool) -> Counter:
    """Call public functions with a bad value for one argument, as users do, without beartype.

    So many times at random; or, with a count of 0, each argument with every fourth value, until the
    work begins.
    """
    pairs = [(name, argument) for name in good for argument in good[name]]
    tried = Counter()
    if not count:
        for k, (name, argument) in enumerate(pairs):
            for bad in BAD[k % 4 :: 4]:
                tried[reaction(name, good[name] | {argument: bad}, begin=False)] += 1
        return tried

    @settings(QUICK, max_examples=count, derandomize=repeatable)
    @given(pair=st.sampled_from(pairs), bad=st.sampled_from(range(len(BAD))))
    def run(pair, bad):
        name, argument = pair
        try:
            arguments = good[name] | {argument: BAD[bad]}
            tried[reaction(name, arguments, begin=name not in HEAVY)] += 1
        except BaseException:
            tried["tracebacks"] += 1
            raise

    run()
    return tried


def test_bad_arguments_of_functions_are_refused_before_any_work():
    """Or are not bad there; but of the explorer, a server, and of a map that takes seconds."""
    functions = {name for name in wj.__all__ if callable(getattr(wj, name)) and name[0].islower()}
    good = calls()
    functions |= {f"fractals.{name}" for name in wj.fractals.__all__}
    # Wrong recordings and files of robots are rows of their own tables.
    assert {name.split()[0] for name in good} >= functions - {"explore"} - OF_FILES
    with unchecked(), jax.numpy_dtype_promotion("standard"):
        assert spoil(good, 0, repeatable=True)["refused"] > 2000


TRACEABLE = "stride margins walk trajectory find_gait integrals phase_times label"


def test_what_jax_cannot_trace_says_so():
    names = "box_counting", "basin_entropy", "merge_regions"
    others = {f"fractals.{name}": "labels" for name in names}
    others |= {"fractals.uncertainty_exponent": "distances", "slice_basin": "value"}
    others |= {"fractals.information_dimension": "points"}
    others |= {"crisis_law": "lives", "audit": "state"}
    others |= dict.fromkeys(("chart", "continue_event", "lyapunov", "transients"), "system")
    others |= dict.fromkeys(("find_attractors", "basin_volume"), "system")
    for name, good in calls().items():
        if name[0].isupper() or name in (*TRACEABLE.split(), "gait_sensitivity"):
            continue
        argument = others.get(name, "walker")
        value = jax.tree.map(jnp.asarray, good.pop(argument))
        function = operator.attrgetter(name.split()[0])(wj)
        call = lambda value, function=function, good=good, argument=argument: function(
            **good, **{argument: value}
        )
        said = (
            f"^{argument} must not be traced: {function.__name__} runs outside of jax.jit, .*; .+"
        )
        with pytest.raises(WrongUse, match=said):
            jax.eval_shape(call, value if argument in ("walker", "system") else jnp.asarray(value))


@pytest.mark.slow
def test_thousands_of_bad_arguments_are_refused_or_answered():
    good = calls()
    with unchecked(), jax.numpy_dtype_promotion("standard"):
        tried = spoil(good, 3000, repeatable=settings().derandomize)
    assert tried.get("tracebacks", 0) == 0 and sum(tried.values()) >= 3000

"""Optimisations on the command line."""

import json

import numpy as np
import pytest
import xarray as xr
from command_lines import RESUME

import walker_jax as wj
from walker_jax.cli import optimise_command
from walker_jax.design import evaluation
from walker_jax.design.measures import Measure
from walker_jax.design.results import summarise_optimum

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
    [(True, 0.012, 0.032), pytest.param(False, 0.0146558225, 0.0793169483, marks=pytest.mark.slow)],
)
def test_optimise_answers_keeps_and_draws(run, tmp_path, monkeypatch, made_up, slope, speed):
    if made_up:
        for module in ("climbs", "evaluation", "limits"):
            monkeypatch.setattr(f"walker_jax.design.{module}.differentiate_measures", proportional)
        monkeypatch.setattr("walker_jax.design.optimisation.compare_basins", lambda *_: {})
    else:
        monkeypatch.setattr("walker_jax.design.optimisation.VIEW_CELLS", 40)  # of the picture
    code, out, err = run(*FASTEST, "--json")
    assert (code, err) == (0, "")
    answer = json.loads(out)
    assert list(answer) == [
        *("start", "optimum", "objective", "exact", "exact_error", "at_bound", "binding"),
        *("note", "evaluations", "converged", "out_of_time", "walker"),
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


def test_an_optimisation_that_is_out_of_time_goes_on(run, monkeypatch):
    monkeypatch.setattr("walker_jax.design.optimisation.compare_basins", lambda *_: {})
    monkeypatch.setattr("walker_jax.cli.answers.draw", lambda *_: None)
    for module in ("climbs", "evaluation", "limits"):
        monkeypatch.setattr(f"walker_jax.design.{module}.differentiate_measures", proportional)
    code, out, err = run(*FASTEST, "--seconds", "1e-9", "--json")
    short = json.loads(out)
    assert (code, err) == (0, "") and short["out_of_time"] and not short["converged"]
    assert short["optimum"] == short["start"] == {"slope": 0.004}
    code, out, err = run(*FASTEST, "--json")
    whole = json.loads(out)
    assert (code, err) == (0, "") and whole["converged"] and not whole["out_of_time"]
    assert whole["optimum"]["slope"] == pytest.approx(0.012, abs=1e-10)
    assert run(*FASTEST, "--seconds", "1e-9")[1].count("converged") == 1  # there is no more to do
    code, out, err = run(*FASTEST, "--seconds", "0", "--overwrite")
    assert (code, out, err) == (2, "", "walker-jax: --seconds must be above 0, not 0\n")


def test_two_optimisations_do_not_write_in_one_place(run, monkeypatch):
    refused = []

    def optimise(*_, keep, **__):
        keep(xr.Dataset({"value": ("evaluation", [0.5])}))
        refused.append(run(*FASTEST))
        raise KeyboardInterrupt

    monkeypatch.setattr("walker_jax.optimise", optimise)
    assert run(*FASTEST)[0] == 130
    ((code, _, err),) = refused
    what, way_out = "optimum.zarr is being written by another run", "wait, or give another --out"
    assert (code, err) == (2, f"walker-jax: {what}: {way_out}\n")


@pytest.mark.slow
def test_an_interrupted_optimisation_goes_on(run, tmp_path, monkeypatch):
    measured = evaluation.evaluate_objective

    def interrupted(problem, stage, *others, **how):
        if stage == 1:
            raise KeyboardInterrupt
        return measured(problem, stage, *others, **how)

    monkeypatch.setattr("walker_jax.design.trace.evaluate_objective", interrupted)
    code, _, err = run(*FASTEST)
    assert (code, err) == (130, f"walker-jax: interrupted: {RESUME} optimum.zarr\n")
    assert "found" not in xr.open_zarr(tmp_path / "optimum.zarr", consolidated=False)
    stages = []
    monkeypatch.setattr(
        "walker_jax.design.trace.evaluate_objective",
        lambda *all, **how: stages.append(all[1]) or measured(*all, **how),
    )
    assert run(*FASTEST)[0] == 0
    assert 0 not in stages and {1, 2} <= set(stages)


def test_an_optimum_is_told_with_both_ends_as_measured():
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
            "out_of_time": False,
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
        **{"evaluations": 9, "converged": True, "out_of_time": False},
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
        "out_of_time": False,
        "note": {"start": "", "optimum": ""},
        "evaluations": 5,
    }
    answer |= {end: {"slope": 0.01} for end in ends}
    told = "\n".join(optimise_command.optimum_in_words(wj.SimplestWalker(0.03), answer, "area"))
    assert "slope 0.01: 0\n" in told and "slope 0.01: 0.002 +- 1e-06\n" in told
    assert "a change of +0.002\n" in told and "at a bound of slope; not converged" in told


def test_an_optimisation_that_leads_nowhere_ends_with_1(run, tmp_path):
    arguments = ["optimise", "--slope", "0.45", "--over", "slope", "--bound", "slope=0.4:0.5"]
    code, out, err = run(*arguments, "--objective", "spectral-radius", "--starts", "1", "--json")
    assert (code, out) == (1, "")
    assert err == "walker-jax: no start leads anywhere: slope 0.45: no gait is found\n"


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (np.linalg.LinAlgError("SVD did not converge"), "LinAlgError: SVD did not converge"),
        (ValueError("f(a) and f(b) differ"), "ValueError: f(a) and f(b) differ"),
        (wj.ComputationFailed("no failure found"), "no failure found"),
    ],
)
def test_a_value_error_within_a_computation_is_no_wrong_use(run, monkeypatch, error, said):
    def fail(*_, **__):
        raise error

    names = {"basin": [], "robustness": [], "bifurcation_diagram": ["bifurcation"]}
    names |= {"optimise": FASTEST, "sweep": ["sweep", "--over", "slope=0.01:0.02:2"], "walk": []}
    for name, command in names.items():
        monkeypatch.setattr(wj, name, fail)
        assert run(*(command or [name])) == (1, "", f"walker-jax: {said}\n")

"""The answers of commands in words, and what they say to do next."""

import math
import re
from typing import Any

import click
import numpy as np
import pytest
import xarray as xr

import walker_jax as wj
from walker_jax.cli import (
    answers,
    app,
    basin_command,
    bifurcation_command,
    boundary_command,
    chart_command,
    continuation_command,
    robustness_command,
)
from walker_jax.stability.probable_falls import ProbableFall
from walker_jax.systems.outcomes import Outcome


def options_of(command):
    loaded = app.load(command)
    params = loaded.get_params(click.Context(loaded, **loaded.context_settings))
    return {name for one in params for name in one.opts}


@pytest.mark.parametrize(
    ("line", "part"),
    [
        ("walk --strides 1", "a larger --strides"),
        ("walk --thetadot -0.23", "It ends in stride 1: walker-jax explain"),
        pytest.param(
            *("walk --ground 0.1 --strides 20", "another --seed gives other ground"),
            marks=pytest.mark.slow,
        ),
        pytest.param(
            *("explain --theta 0.2 --thetadot -0.2", "walker-jax walk, from there"),
            marks=pytest.mark.slow,
        ),
        ("explain --theta -0.1 --thetadot -0.2", "walker-jax gait gives a start that is feasible"),
        ("gait --slope 0.009", "converge to it: walker-jax basin"),
        ("gait --slope 0.009 --guess 0.1939 -0.2039", "None is stable: walker-jax bifurcation"),
    ],
)
def test_an_answer_ends_with_a_sentence_on_what_to_do_next(run, line, part):
    code, text, _ = run(*line.split())
    sentence = text.rstrip().splitlines()[-1]
    assert code == 0 and part in sentence and sentence.endswith(".")
    assert not any(re.search(rf"\b{one.name}\b", text) for one in Outcome)
    assert {*re.findall(r"walker-jax (\w+)", sentence)} <= {*app.NAMES}
    assert {*re.findall(r"--[a-z-]+", sentence)} <= options_of(line.split()[0])


BASIN = {"attractors": [{"artefact": False, "cells": 5}], "fates": {"STRIDE": 5, "FORWARD": 75}}


@pytest.mark.parametrize(
    ("answer", "request_", "part"),
    [
        ({"attractors": []}, {}, "walker-jax gait tells where"),
        ({"attractors": [{"artefact": True, "cells": 5}]}, {}, "No start in this window converges"),
        (BASIN, {}, "6.25% of these starts converge to an attractor: --levels 2"),
        (BASIN, {"levels": 2}, "walker-jax robustness"),
        (BASIN, {"zoom": 1e4}, "a larger --zoom"),
    ],
)
def test_the_next_step_after_a_basin(answer, request_, part):
    assert part in basin_command.next_step(answer, request_)


@pytest.mark.parametrize("artefact", [False, True])
def test_artefacts_alone_have_no_border(artefact):
    attractor = {"period": 1, "cells": 2, "area": 0.1, "artefact": artefact, "states": [[0.1, 0.2]]}
    answer = {"attractors": [attractor], "area": 0.1, "at_border": 2, "fates": {}}
    lines = "\n".join(basin_command.sizes_in_words(answer, "area", "", zoomed=False))
    assert ("reaches the border" in lines) == (not artefact)


@pytest.mark.parametrize(("share", "words"), [(1, "0.00%"), (39_999, "100.00%")])
def test_cells_of_every_fate_are_counted(share, words):
    fates = {"STRIDE": share, "FORWARD": 40_000 - share}
    line, _ = basin_command.fates_in_words(fates, wj.SimplestWalker(0.004))
    assert line == f"  {words:>7}  walks, {share:,} cells"
    line, _ = basin_command.fates_in_words(fates, wj.systems.HenonMap())
    assert line == f"  {words:>7}  goes on, {share:,} cells"


def test_no_boundary_is_said_to_be_none():
    entropy = {"value": None, "error": None, "fractal": False, "crowded": None}
    answer = {"basin_entropy": 0.0, "boundary_entropy": entropy, "wada": [], "edges": []}
    *_, last = boundary_command.boundary_in_words(wj.SimplestWalker(0.004), answer)
    assert "No boundary was found" in last


@pytest.mark.parametrize(
    ("options", "residual", "part"),
    [
        ([], 0.0, "nearly all falls are like this one."),
        (["--way", "forward"], 0.0, "nearly all falls of this kind are like this one."),
        (["--tilt", "1e-4"], 0.0, "Under slight disturbances nearly all falls are like this one."),
        ([], 1e-3, "The search has not converged"),
        ([], math.nan, "The search has not converged"),
    ],
)
def test_what_is_said_of_a_fall(run, monkeypatch, options, residual, part):
    fall = ProbableFall(
        1.0, np.zeros((1, 3)), np.zeros((1, 4)), Outcome.FORWARD, 1, np.ones(1), 1.0, residual
    )
    monkeypatch.setattr(wj, "most_probable_fall", lambda *_, **__: fall)
    code, text, _ = run("fall", *options)
    assert code == 0 and part in text


def test_maps_have_cycles_and_no_times(run):
    """Other systems than walkers do not walk; a map's step takes no time, a ball's does."""
    code, text, err = run("gait", "--system", "henon", "--a", "0.3")
    assert code == 0 and text.startswith("stable cycle of period 1 of HenonMap"), err
    assert "gait" not in text and "time" not in text
    start = ("--start", "x=0.5", "--start", "y=0")
    code, text, err = run("walk", "--system", "henon", "--a", "0.3", *start, "--strides", "2")
    assert code == 0 and text.splitlines()[0].split() == ["iterate", "x", "y", "outcome"], err
    assert text.splitlines()[1].endswith("  goes on") and "walks" not in text
    code, text, _ = run("explain", "--system", "henon", "--a", "0.3", *start)
    assert code == 0 and text.startswith("HenonMap from (0.5, 0): goes on\n")


@pytest.mark.parametrize(
    ("command", "said"),
    [
        ("explore", "Walkers in space and other systems have no film"),
        ("explore", "Walkers in space have no tab of bifurcations"),
        ("fall", "Under slight disturbances nearly all falls are like this one"),
    ],
)
def test_helps_claim_no_more_than_is_so(command, said):
    assert said in " ".join(str(app.load(command).epilog).split())


ROW = {"area": 1.0, "area_error": 0.1, "at_border": 0, "note": "", "step_down": math.inf}
ROW |= {"gait": {"period": 2, "multiplier": 0.5, "return_strides": 1.0}, "least_fall": None}
ROW |= {"least_disturbance": {"failure": "FORWARD", "strides": 3, "size": 0.1, "direction": [1.0]}}
NUMBERS = ("value", "low", "high", "disturbances", "median_strides", "slowest_strides", "in_time")
STABILITY = dict.fromkeys((*NUMBERS, "mean_strides", "largest_shock"), 1.0)
ROW |= {"basin_stability": STABILITY, "boundary_dimension": STABILITY}
BASIN_OF_CELLS = {"attractors": [], "method": "cell-map", "cells": 9, "fates": {}}
BASIN_OF_CELLS |= {"seconds": {"compile": 0.0, "run": 0.0}}
NO_TALLY: Any = None
LOST = {"lost": {"below": 1.0, "above": 2.0}, "stable_beyond": [{"from": 1, "to": 2, "period": 2}]}
LOST |= {title: [] for title in bifurcation_command.TITLES}
CURVE = {"kind": "fold", "period": 1, "criticality": [], "special": []}
CURVE |= {"ends": [{"values": [1.0], "reason": "the gait of period 1 that it doubles"}]}


def said_of(terms):
    """All that commands say of motions, for answers of every kind."""
    artefact = {"artefact": True, "states": [(1.0, 2.0)] * 2}
    yield from robustness_command.measures_in_words(ROW, "", terms)
    yield from robustness_command.measures_in_words(ROW | {"gait": None}, "", terms)
    yield basin_command.next_step({"attractors": [], "fates": {}}, {}, terms)
    yield basin_command.next_step(BASIN, {"levels": 2}, terms)
    yield basin_command.effort(xr.Dataset(), BASIN_OF_CELLS, NO_TALLY, terms)
    for falling in (0, 1):
        yield basin_command.cycles_in_words(artefact | {"falling": falling}, terms)
    for below, above in ((math.nan, 1.0), (1.0, math.nan), (1.0, 2.0)):
        lost = LOST | {"lost": {"below": below, "above": above}}
        yield from bifurcation_command.bifurcations_in_words(lost, "a", 9, terms)
    chart = {"curves": [CURVE], "cells": {"no gait": 1.0}}
    yield from chart_command.chart_in_words(chart, ["a"], terms)
    nothing = {"attractors": [], "bifurcations": []}
    yield from continuation_command.attractors_in_words(nothing, terms)


WALKS = r"\bgaits?\b|\bstrides?\b|\bwalk|\bfalls? from\b"


def test_only_walkers_walk():
    """Of a map commands tell cycles and iterates; names of commands and options stay."""
    told = {
        kind: re.sub(r"walker-jax \w+|--\w+", "", "\n".join(said_of(answers.terms_of(system))))
        for kind, system in {
            "walker": wj.SimplestWalker(0.004),
            "map": wj.systems.HenonMap(),
        }.items()
    }
    assert not re.findall(WALKS, told["map"])
    assert len(re.findall(r"\bcycle", told["map"])) == len(re.findall(r"\bgait", told["walker"]))
    assert len(re.findall(r"\biterate", told["map"])) == len(re.findall("stride", told["walker"]))


@pytest.mark.parametrize("line", ["walk --strides 2", "gait", "explain", "gait --period 3"])
def test_what_is_told_of_a_map(run, line):
    _, told, error = run(*line.split(), "--system", "henon")
    said = re.sub(r"walker-jax( \w+)?|--\w+", "", told + error)
    assert re.search(r"iterate|cycle", said) and not re.findall(WALKS + "|time", said)


def test_a_radius_beyond_the_least_disturbance_is_named(run):
    code, out, err = run("prove", "--radius", "0.01")
    start = "walker-jax: --radius 0.01 must be at most the least disturbance: the start ("
    assert (code, out) == (2, "") and err.startswith(start) and err.count("\n") == 1

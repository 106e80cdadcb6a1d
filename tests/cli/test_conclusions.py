"""Answers end with a sentence: what they mean, and what to do next."""

import math
import re

import numpy as np
import pytest

import walker_jax as wj
from walker_jax.cli import (
    app,
    basin_command,
    bifurcation_command,
    boundary_command,
    chart_command,
    conclusions,
    known_options,
)
from walker_jax.stability.probable_falls import ProbableFall
from walker_jax.systems.outcomes import Outcome

GAIT = {"period": 1}
SIZED = {"size": 0.002, "failure": "FORWARD"}
ROW = {"gait": GAIT, "least_disturbance": SIZED, "slope": 0.003}
UNSIZED = ROW | {"slope": 0.005, "least_disturbance": {"failure": None}}
OPTIMUM = {"converged": True, "out_of_time": False, "at_bound": []}
SURE = {"converged": True, "chosen": False, "steps_only": True, "filmed": False}
SWEPT = {"total_area": 0.0, "failed": 0}
SAID = [
    (conclusions.conclude_walk(["STRIDE"] * 9, rough=False), "all its strides: a larger --strides"),
    (conclusions.conclude_walk(["STRIDE", "FORWARD"], rough=False), "in stride 2: walker-jax expl"),
    (conclusions.conclude_walk(["STRIDE", "FORWARD"], rough=True), "in stride 2: another --seed"),
    (conclusions.conclude_explanation("STRIDE", []), "walker-jax walk"),
    (conclusions.conclude_explanation("BACKWARD", []), "(falls backward)"),
    (conclusions.conclude_explanation("STRIDE", ["wrong"]), "lines with !"),
    (
        conclusions.conclude_explanation("OUTSIDE", ["the start is not feasible"]),
        "This start is not feasible: walker-jax gait",
    ),
    (conclusions.conclude_gaits(0, 2), "walker-jax bifurcation"),
    (conclusions.conclude_gaits(1, 1), "converge to it: walker-jax basin"),
    (conclusions.conclude_gaits(1, 4), "1 of these 4"),
    (conclusions.conclude_boundary(found=True, fractal=True), "--zoom"),
    (conclusions.conclude_boundary(found=True, fractal=False), "finer grid"),
    (conclusions.conclude_boundary(found=False, fractal=False), "No boundary between fates"),
    (conclusions.conclude_robustness([ROW], "slope"), "disturbance of 0.002 is enough"),
    (
        conclusions.conclude_robustness(
            [ROW, ROW | {"slope": 0.004, "least_disturbance": SIZED | {"size": 0.003}}], "slope"
        ),
        "0.003 in the worst direction, at slope 0.004",
    ),
    (conclusions.conclude_robustness([{"gait": None}], "slope"), "nothing to disturb"),
    (conclusions.conclude_robustness([UNSIZED], "slope"), "that were tried."),
    (conclusions.conclude_robustness([ROW, UNSIZED], "slope"), "tried, at slope 0.005."),
    (
        conclusions.conclude_fall(**SURE),
        "rough ground nearly all falls are like this one: --animate",
    ),
    (conclusions.conclude_fall(**SURE | {"filmed": True}), "like this one."),
    (conclusions.conclude_fall(**SURE | {"chosen": True}), "nearly all falls of this kind"),
    (
        conclusions.conclude_fall(**SURE | {"steps_only": False}),
        "Under slight disturbances nearly all falls are like this one.",
    ),
    (conclusions.conclude_fall(**SURE | {"converged": False}), "another fall may be more probable"),
    (
        conclusions.conclude_bifurcations([(0.0176694, 4), (0.0182, 8)], "slope", found=True),
        "At slope 0.0176694 a cycle of period 4 branches off",
    ),
    (
        conclusions.conclude_bifurcations([], "hip-stiffness", found=True),
        "does not double its period for any hip-stiffness",
    ),
    (conclusions.conclude_bifurcations([], "slope", found=False), "No gait of period one"),
    (conclusions.conclude_chart(0, 1), "of one kind: wider ranges"),
    (conclusions.conclude_chart(0, 2), "crises, or at curves that were missed"),
    (conclusions.conclude_chart(2, 3), "walker-jax bifurcation"),
    (conclusions.conclude_continuation([]), "another --over"),
    (
        conclusions.conclude_continuation(
            [{"number": k, "largest_fraction": share} for k, share in enumerate((0.1, 0.4))]
        ),
        "at any one value, 40.000%, converges to attractor 1: more --samples",
    ),
    (
        conclusions.conclude_sweep(
            [SWEPT | {"total_area": one, "foot_mass": one} for one in (0.1, 0.3)], ["foot_mass"]
        ),
        "largest at foot-mass 0.3",
    ),
    (conclusions.conclude_sweep([SWEPT], ["slope"]), "No basin"),
    (conclusions.conclude_sweep([SWEPT | {"total_area": 0.1}], ["slope"]), "one combination"),
    (
        conclusions.conclude_sweep([{"total_area": math.nan, "failed": 1}] * 2, ["slope"]),
        "Nothing could be computed",
    ),
    (conclusions.conclude_optimum(OPTIMUM), "--seed"),
    (conclusions.conclude_optimum(OPTIMUM | {"converged": False}), "before it converged"),
    (conclusions.conclude_optimum(OPTIMUM | {"at_bound": ["slope"]}), "bound of slope"),
    (
        conclusions.conclude_optimum(OPTIMUM | {"converged": False, "out_of_time": True}),
        "the same command goes on",
    ),
    (conclusions.conclude_proof(proved=True), "proofs.md"),
    (conclusions.conclude_proof(proved=False), "--levels"),
    (conclusions.conclude_kernel(0.004, 0.002), "2 times that of the passive basin."),
    (
        conclusions.conclude_kernel(0.004, 0.002),
        "In this window, as far as the grid tells, no con",
    ),
    (conclusions.conclude_kernel(0.004, 0.0), "than the kernel."),
    (conclusions.conclude_kernel(0.0, 0.0), "as far as the grid tells, no choice"),
]
HOW = {"at_border": False, "refined": False, "zoomed": False}


@pytest.mark.parametrize(("sentence", "part"), SAID)
def test_a_conclusion_is_a_sentence_in_words(sentence, part):
    assert part in sentence
    assert re.match("[A-Z0-9]", sentence) and sentence.endswith(".") and "\n" not in sentence
    assert not any(re.search(rf"\b{one.name}\b", sentence) for one in Outcome)
    assert {*re.findall(r"walker-jax (\w+)", sentence)} <= {*app.COMMANDS}
    known = {name for command in app.COMMANDS for name in options_of(command)}
    assert {*re.findall(r"--([a-z-]+)", sentence)} <= known


def options_of(command):
    return [
        name.lstrip("-")
        for one in known_options.read_command(command, "simplest").params
        for name in one.opts
    ]


@pytest.mark.parametrize(
    ("share", "how", "part"),
    [
        (0.0, {}, "where a gait is, and whether it is stable"),
        (1 / 40_000, {}, "Less than 0.01% of these starts"),
        (0.99996, {}, "More than 99.99% of these starts"),
        (1.0, {}, "All of these starts"),
        (0.0625, {}, "6.25% of these starts converge to an attractor: --levels 2"),
        (0.0625, {"at_border": True}, "the basin reaches the window's border: wider axes"),
        (0.0625, {"refined": True}, "walker-jax robustness"),
        (0.54, {"zoomed": True, "at_border": True}, "54.00% of these starts"),
    ],
)
def test_the_conclusion_of_a_basin(share, how, part):
    assert part in conclusions.conclude_basin(share, **HOW | how)


@pytest.mark.parametrize("artefact", [False, True])
def test_artefacts_alone_have_no_border(artefact):
    attractor = {"period": 1, "cells": 2, "area": 0.1, "artefact": artefact, "states": [[0.1, 0.2]]}
    answer = {"attractors": [attractor], "area": 0.1, "at_border": 2, "fates": {}}
    lines = "\n".join(basin_command.sizes_in_words(answer, "area", "", zoomed=False))
    assert ("reaches the border" in lines) == (not artefact)


def test_a_first_doubling_is_named_with_its_own_period():
    event = {"from": 2, "to": 4, "slope": 0.0176694, "state": [0.1, 0.2]}
    answer = {name: [] for name in (*bifurcation_command.TITLES, "stable_beyond")}
    answer |= {"doublings": [event], "lost": {"below": 0.018, "above": 0.019}}
    *_, last = bifurcation_command.bifurcations_in_words(answer, "slope", 3000, found=True)
    assert "At slope 0.0176694 a cycle of period 4 branches off" in last


def test_a_chart_without_curves_may_have_kinds_of_cells():
    answer = {"curves": [], "cells": {"period 1": 0.5, "fails": 0.5}}
    *_, last = chart_command.chart_in_words(answer, ["a", "b"])
    assert "the kinds of cells meet at crises" in last


def test_the_conclusion_of_a_boundary_needs_a_boundary():
    entropy = {"value": None, "error": None, "fractal": False, "crowded": None}
    answer = {"basin_entropy": 0.0, "boundary_entropy": entropy, "wada": [], "edges": []}
    *_, last = boundary_command.boundary_in_words(wj.SimplestWalker(0.004), answer)
    assert "No boundary between fates" in last


@pytest.mark.parametrize(
    ("options", "residual", "part"),
    [
        ([], 0.0, "all falls are like this one: --animate"),
        (["--way", "forward"], 0.0, "rough ground nearly all falls of this kind"),
        (["--tilt", "1e-4"], 0.0, "Under slight disturbances nearly all falls are like this one."),
        (["--push", "1e-4"], 0.0, "Under slight disturbances nearly all falls are like this one."),
        ([], 1e-3, "The search has not converged"),
        ([], math.nan, "The search has not converged"),
    ],
)
def test_the_conclusion_of_a_fall(run, monkeypatch, options, residual, part):
    fall = ProbableFall(
        1.0, np.zeros((1, 3)), np.zeros((1, 4)), Outcome.FORWARD, 1, np.ones(1), 1.0, residual
    )
    monkeypatch.setattr(wj, "most_probable_fall", lambda *_, **__: fall)
    code, text, _ = run("fall", *options)
    assert code == 0 and part in text


def test_commands_conclude_from_what_was_asked(run):
    """An end on rough ground is not explained, and a start that is not feasible is no model's."""
    code, text, _ = run("walk", "--ground", "0.1", "--strides", "20")
    assert code == 0 and "another --seed" in text and "walker-jax explain" not in text
    code, text, _ = run("explain", "--theta", "-0.1", "--thetadot", "-0.2")
    assert code == 0 and "This start is not feasible: walker-jax gait" in text


@pytest.mark.parametrize(
    ("command", "said"),
    [
        ("explore", "Walkers in space and other systems have no film"),
        ("explore", "Walkers in space have no tab of bifurcations"),
        ("fall", "Under slight disturbances nearly all falls are like this one"),
    ],
)
def test_helps_claim_no_more_than_is_so(command, said):
    assert said in " ".join((known_options.read_command(command, "simplest").help or "").split())

"""Answers end with a sentence: what they mean, and what to do next."""

import re

import pytest

from walker_jax.cli import app, conclusions, known_options
from walker_jax.systems.outcomes import Outcome

GAIT = {"period": 1}
SIZED = {"size": 0.002, "failure": "FORWARD"}
ROW = {"gait": GAIT, "least_disturbance": SIZED, "slope": 0.003}
OPTIMUM = {"out_of_time": False, "at_bound": []}
SAID = [
    (conclusions.conclude_walk(["STRIDE"] * 9), "all its strides: a larger --strides"),
    (conclusions.conclude_walk(["STRIDE", "FORWARD"]), "(falls forward) comes in stride 2"),
    (conclusions.conclude_explanation("STRIDE", []), "walker-jax walk"),
    (conclusions.conclude_explanation("BACKWARD", []), "(falls backward)"),
    (conclusions.conclude_explanation("STRIDE", ["wrong"]), "lines with !"),
    (conclusions.conclude_gaits(0, 2), "walker-jax bifurcation"),
    (conclusions.conclude_gaits(1, 1), "converge to it: walker-jax basin"),
    (conclusions.conclude_gaits(1, 4), "1 of these 4"),
    (conclusions.conclude_boundary(True), "--zoom"),
    (conclusions.conclude_boundary(None), "finer grid"),
    (conclusions.conclude_robustness([ROW], "slope"), "disturbance of 0.002 is enough"),
    (
        conclusions.conclude_robustness(
            [ROW, ROW | {"slope": 0.004, "least_disturbance": SIZED | {"size": 0.003}}], "slope"
        ),
        "0.003 in the worst direction, at slope 0.004",
    ),
    (conclusions.conclude_robustness([{"gait": None}], "slope"), "nothing to disturb"),
    (
        conclusions.conclude_robustness([ROW | {"least_disturbance": {"failure": None}}], "slope"),
        "--disturbances",
    ),
    (conclusions.conclude_fall(filmed=False), "--animate fall.gif"),
    (conclusions.conclude_fall(filmed=True), "like this one."),
    (conclusions.conclude_bifurcations([0.0150884, 0.0176], "slope"), "at slope 0.0150884"),
    (conclusions.conclude_bifurcations([], "hip-stiffness"), "for any hip-stiffness"),
    (conclusions.conclude_chart(0), "wider ranges"),
    (conclusions.conclude_chart(2), "walker-jax bifurcation"),
    (conclusions.conclude_continuation([]), "another --over"),
    (
        conclusions.conclude_continuation(
            [{"number": k, "largest_fraction": share} for k, share in enumerate((0.1, 0.4))]
        ),
        "attractor 1: more --samples",
    ),
    (
        conclusions.conclude_sweep(
            [{"total_area": one, "foot_mass": one} for one in (0.1, 0.3)], ["foot_mass"]
        ),
        "largest at foot-mass 0.3",
    ),
    (conclusions.conclude_sweep([{"total_area": 0.0}], ["slope"]), "No basin"),
    (conclusions.conclude_optimum(OPTIMUM), "--seed"),
    (conclusions.conclude_optimum(OPTIMUM | {"at_bound": ["slope"]}), "bound of slope"),
    (conclusions.conclude_optimum(OPTIMUM | {"out_of_time": True}), "goes on"),
    (conclusions.conclude_proof(proved=True), "proofs.md"),
    (conclusions.conclude_proof(proved=False), "--levels"),
    (conclusions.conclude_kernel(0.004, 0.002), "2 times that of the passive basin"),
    (conclusions.conclude_kernel(0.004, 0.0), "than the kernel."),
    (conclusions.conclude_kernel(0.0, 0.0), "wider range"),
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
        (0.0, {}, "No start in this window"),
        (0.0625, {}, "6.25% of these starts converge to an attractor: --levels 2"),
        (0.0625, {"at_border": True}, "widen its axes"),
        (0.0625, {"refined": True}, "walker-jax robustness"),
        (0.54, {"zoomed": True, "at_border": True}, "54.00% of these starts"),
    ],
)
def test_the_conclusion_of_a_basin(share, how, part):
    assert part in conclusions.conclude_basin(share, **HOW | how)

"""The most probable fall on the command line."""

import json

import numpy as np
import pytest

import walker_jax as wj
from walker_jax import Outcome, figures
from walker_jax.stability.probable_falls import ProbableFall


@pytest.fixture
def found(monkeypatch):
    """A fall that is given, and how it was asked for."""
    asked = []
    disturbances = np.array([[-1e-3, 0, 0], [2e-3, 0, 0]])
    states = np.array([[0.15, 0.3, -0.15, -0.01]] * 3)
    given = ProbableFall(
        12.5, disturbances, states, Outcome.FORWARD, 2, np.array([14.0, 12.5]), 1.0, 1e-12
    )
    monkeypatch.setattr(
        "walker_jax.most_probable_fall", lambda *args, **how: asked.append((args, how)) or given
    )
    return given, asked


def test_a_fall_is_told_and_drawn(run, tmp_path, found):
    fall, asked = found
    code, out, err = run("fall", "--slope", "0.009", "--strides", "2", "--figure", "fall.png")
    assert (code, err) == (0, "")
    assert "falls forward after 2 strides; action 12.5\n" in out
    assert f"on average: {fall.mean_strides():.4g}\n" in out
    assert [line.split() for line in out.splitlines()[3:6]] == [
        ["stride", "step"],
        ["1", "-0.001"],
        ["2", "0.002"],
    ]
    assert (tmp_path / "fall.png").read_bytes().startswith(b"\x89PNG")
    (((walker, deviations), how),) = asked
    assert float(walker.slope) == 0.009 and deviations == wj.Disturbance(2e-4, 0.0, 0.0)
    assert how == {"strides": 2, "outcome": None}


def test_a_fall_is_answered_as_json(run, found):
    fall, asked = found
    code, out, err = run("fall", "--push", "0.01", "--way", "backward", "--json")
    assert (code, err) == (0, "")
    answer = json.loads(out)
    assert answer["action"] == 12.5 and answer["outcome"] == "FORWARD"
    assert answer["disturbances"] == fall.disturbances.tolist()
    assert answer["mean_strides"] == pytest.approx(fall.mean_strides())
    ((_, deviations), how) = asked[0]
    assert deviations == wj.Disturbance(0.0, 0.0, 0.01) and how["outcome"] == Outcome.BACKWARD


@pytest.mark.parametrize(
    "arguments, reason",
    [
        (["--ground", "0"], "--ground must be above 0, not 0.0, unless --tilt or --push is given"),
        (["--push", "0.1", "--animate", "f.gif"], "--animate is for steps alone"),
        (["--ground", "nan"], "--ground must be at least 0, not nan"),
        (["--walker", "spatial"], "must be planar"),
        (["--figure", "fall.txt"], "--figure fall.txt must end in one of"),
    ],
)
def test_falls_are_refused_in_a_line(run, found, arguments, reason):
    code, out, err = run("fall", *arguments)
    assert (code, out) == (2, "") and err.count("\n") == 1 and reason in err
    assert found[1] == []


@pytest.mark.slow
def test_a_fall_is_filmed(run, tmp_path, monkeypatch):
    """With as many strides as the answer tells."""
    filmed, film = [], figures.film
    keep = lambda motion, *args, **how: filmed.append(motion) or film(motion, *args, **how)
    monkeypatch.setattr(figures, "film", keep)
    arguments = ["--walker", "spring", "--slope", "0.01", "--hip-stiffness", "0.2"]
    code, out, err = run("fall", *arguments, "--strides", "3", "--animate", "fall.gif")
    assert (code, err) == (0, "") and "falls forward after " in out
    assert (tmp_path / "fall.gif").read_bytes().startswith(b"GIF")
    (motion,) = filmed
    told = int(out.split("falls forward after ")[1].split()[0])
    assert motion["outcome"].values.tolist() == [Outcome.STRIDE] * told + [Outcome.FORWARD]

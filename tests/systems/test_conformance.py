"""The conformance set: this package against its numbers, and the numbers against closed forms."""

import math
import re
import sys
from itertools import pairwise
from typing import Any

import pytest
from reference import ROOT

FOLDER = ROOT / "benchmarks" / "conformance"
PAGE = ROOT / "docs" / "conformance.md"
sys.path.insert(0, str(FOLDER))
import formulas  # noqa: E402 (after the path to it)
import make  # noqa: E402 (after the path to it)
import run as table  # noqa: E402 (after the path to it)
import solvers  # noqa: E402 (after the path to it)

RUNS = [(name, i) for name in formulas.names() for i, _ in enumerate(formulas.read(name)["runs"])]
ours = solvers.SOLVERS["walker_jax"]


def read(name: str, i: int) -> tuple[dict[str, Any], dict[str, Any]]:
    system = formulas.read(name)
    return system, system["runs"][i]


def check(name: str, i: int) -> None:
    """This package has all events, and nine digits but for those by which the run amplifies."""
    system, run = read(name, i)
    slopes = [abs(float(one)) for row in run["derivatives"].values() for one in row.values()]
    lost = math.log10(max(1.0, *slopes))
    missed, times, states, derivatives = table.compare(ours(system, run), run)
    assert missed == 0
    assert min(times, states, derivatives) > 9 - lost


def test_this_package_has_the_events_and_numbers():
    """Of bounces; others of the set are tested in hybrid/ too."""
    check("ball", 0)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "i"), RUNS)
def test_this_package_has_all_events_and_numbers(name, i):
    check(name, i)


def test_bounces_are_those_of_the_closed_form():
    """Each bounce takes 2 v / g, with v the speed after the one before."""
    _, run = read("ball", 0)
    speed, times = math.sqrt(2), [float(one["time"]) for one in run["events"]]
    assert times[0] == pytest.approx(math.sqrt(2), abs=1e-15)
    for before, after in pairwise(times[:-1]):
        speed *= 0.75
        assert after - before == pytest.approx(2 * speed, abs=1e-14)


def test_walkers_walk_as_published():
    """Their first heel strikes are those of the gaits in tests/data."""
    strikes = lambda name, number: float(read(name, 0)[1]["events"][number]["time"])
    assert strikes("simplest_walker", 0) == pytest.approx(3.882463752851, abs=3e-8)
    assert strikes("kneed_walker", 0) == pytest.approx(0.348612000484, abs=1e-12)
    assert strikes("kneed_walker", 1) == pytest.approx(0.5643281659149, abs=1e-12)


def test_both_ways_compute_the_numbers_anew():
    """To all digits that are written."""
    system, run = read("thermostat", 0)
    apart = "the two ways differ by"
    found = make.compute("thermostat", system, run)
    assert float(found.pop(apart)) < 1e-30
    assert found == {name: one for name, one in run.items() if name != apart}


def test_numbers_in_which_the_two_ways_differ_are_not_written(monkeypatch):
    system, run = read("thermostat", 0)
    other = run | {"parameters": {"rate": "0.5000000000001"}}
    right = make.solve
    monkeypatch.setattr(make, "solve", lambda system, _: right(system, other))
    with pytest.raises(ArithmeticError, match=r"two ways differ by \S+e-1[0-9]"):
        make.compute("thermostat", system, run)


def test_every_run_has_its_numbers_and_its_row():
    """Numbers in which both ways agree to what the page says, and a row of the page's table."""
    page = PAGE.read_text()
    rows = dict(re.findall(r"^\| (\w+: [^|]+?) \| (\d+) \|", page, re.M))
    assert "1e-22" in page and float(make.AGREE) == 1e-22
    closed = 0
    for name in formulas.names():
        system = formulas.read(name)
        closed += system["runs"][0]["second way"] == "closed form"
        for run in system["runs"]:
            assert float(run["the two ways differ by"]) < 1e-22
            assert rows.pop(f"{name}: {run['name']}") == str(len(run["events"]))
            known = {"t", *system["variables"]}
            assert set(run["end"]) == known
            assert set(run["derivatives"]) == {*system["variables"], run["by"]}
            assert all(set(row) == known for row in run["derivatives"].values())
            assert run["events"][0]["mode"] == run["mode"]
    assert not rows
    assert f"in {closed} systems" in page and "Twenty-four systems" in page
    assert len(formulas.names()) == 24


def test_a_wrong_answer_has_few_digits():
    _, run = read("ball", 0)
    right = solvers.Answer(
        [(one["mode"], one["leads_to"], float(one["time"])) for one in run["events"]],
        {name: float(one) for name, one in run["end"].items()},
        {by: {one: float(x) for one, x in row.items()} for by, row in run["derivatives"].items()},
    )
    assert table.compare(right, run)[0] == 0 and min(table.compare(right, run)[1:]) > 15.5
    late = right._replace(events=[(a, b, t + 1e-6) for a, b, t in right.events])
    first = float(run["events"][0]["time"])  # above 1, so that errors are relative to it
    assert table.compare(late, run)[1] == pytest.approx(6 + math.log10(first), abs=1e-6)
    other = right._replace(events=right.events[:3])
    assert table.compare(other, run)[0] == len(run["events"]) - 3
    lost = right._replace(end=right.end | {"x": math.nan})
    assert table.compare(lost, run)[2] == 0

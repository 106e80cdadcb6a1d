"""The bar of a computation that was interrupted begins where that was."""

import io
import re
import time
from contextlib import contextmanager

import numpy as np
import pytest
from rich.console import Console
from timers import AtOnce

import walker_jax as wj
from walker_jax import storage
from walker_jax.execution import pieces, progress
from walker_jax.gaits import branches, search
from walker_jax.stability import boundaries, gait_robustness
from walker_jax.systems.outcomes import Outcome


@pytest.fixture
def shown(monkeypatch):
    """What is written to a terminal."""
    text = io.StringIO()
    terminal = Console(file=text, force_terminal=True, width=100)
    monkeypatch.setattr(progress, "progress_console", lambda wanted: terminal)
    return text


def test_a_bar_begins_with_what_was_done_and_ends_with_all(shown, monkeypatch):
    monkeypatch.setattr(progress, "Timer", AtOnce)
    assert [*progress.track("ab", "pieces", True, 10, done=8)] == ["a", "b"]
    parts = [int(part) for part in re.findall(r"(\d+)%", shown.getvalue())]
    assert parts[0] == 80 and parts[-1] == 100 and parts == sorted(parts)


@pytest.mark.parametrize("name", ["basin", "sweep", "viable"])
def test_a_run_that_is_resumed_shows_what_is_there(name, tmp_path, monkeypatch):
    grid = wj.Grid.sheared(theta=(0.05, 0.35, 8), sum=(-0.03, 0.01, 6))
    walker, out = wj.SimplestWalker(0.004), tmp_path / "a.zarr"
    monkeypatch.setattr("walker_jax.basins.methods.PIECE", 12)
    monkeypatch.setattr("walker_jax.control.images.TILE", (12, 12))
    monkeypatch.setattr("walker_jax.design.sweeps.measure_basin", lambda *_: {"area": 0.001})
    calls = {
        "basin": lambda: wj.basin(walker, grid, out=out),
        "sweep": lambda: wj.sweep(
            walker, {"slope": [0.004, 0.005, 0.006, 0.007]}, grid, levels=0, check=0, out=out
        ),
        "viable": lambda: wj.viable(walker, grid, {"slope": [0.004]}, bounds=False, out=out),
    }
    write, seen = storage.Pieces.write, []

    def interrupted(place, piece, values, *, done=False):
        if piece == 3:
            raise KeyboardInterrupt
        write(place, piece, values, done=done)

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(storage.Pieces, "write", interrupted)
        calls[name]()
    track = pieces.track
    keep = lambda things, label, wanted, *counts: seen.append(counts) or track(things, label, False)
    monkeypatch.setattr(pieces, "track", keep)
    calls[name]()
    assert seen == [(4, 3)]


def test_an_answer_at_once_shows_no_bar(shown):
    with progress.bar("basin", True, 2) as update:
        update(1)
        with progress.bar("cells", True):
            assert progress.current is not None
    assert progress.current is None and not shown.getvalue()


def test_a_bar_comes_after_its_delay_and_goes(shown, monkeypatch):
    monkeypatch.setattr(progress, "DELAY_SECONDS", 0.0)
    with progress.bar("basin", True, 2) as update:
        update(1)
        current = progress.current
        assert current is not None
        while not current.live.is_started:
            time.sleep(0.001)
    assert not current.live.is_started and "basin" in shown.getvalue()


def test_a_computation_within_another_adds_a_line_alone(shown, monkeypatch):
    monkeypatch.setattr(progress, "Timer", AtOnce)
    with progress.bar("basin", True):
        outer = progress.current
        assert outer is not None
        with progress.bar("cells", True, 4) as update:
            update(3)
            assert progress.current is outer and len(outer.tasks) == 2
            outer.refresh()
        assert len(outer.tasks) == 1
    assert progress.current is None
    text = re.sub(r"\x1b\[[\d;?]*[a-zA-Z]", "", shown.getvalue())
    assert "basin" in text and "75%" in text and " s" in text


def test_times_are_said_in_the_unit_that_suits_them():
    assert [*map(progress.in_words, (4.4, 89.0, 91.0, 3000.0, 7200.0))] == [
        *("4 s", "89 s", "2 min", "50 min", "2.0 h")
    ]


def test_nothing_is_shown_where_that_is_asked(monkeypatch):
    monkeypatch.setattr(progress, "quiet", False)
    monkeypatch.setattr(Console, "is_terminal", True)
    assert not progress.progress_console(True).quiet
    assert progress.progress_console(False).quiet
    progress.be_quiet()
    assert progress.progress_console(True).quiet


def test_robustness_says_what_it_is_at(monkeypatch):
    """Where there is nothing to measure: what comes first is enough to see."""
    labels = []
    bar = gait_robustness.bar
    monkeypatch.setattr(
        gait_robustness,
        "bar",
        lambda label, wanted: labels.append((label, wanted)) or bar(label, False),
    )
    grid = wj.Grid.sheared(theta=(0.05, 0.06, 3), sum=(-0.5, -0.45, 3))
    wj.robustness(wj.SimplestWalker(0.004), grid, levels=0, check=10, strides=3, progress=True)
    assert labels == [("search for a gait", True), ("basin", True)]


def test_a_boundary_says_what_it_is_at(monkeypatch):
    """Between regions whose edge states are given, as their search takes seconds."""
    seen = []
    fates = Outcome.FORWARD, Outcome.FORWARD
    state = boundaries.EdgeState("", None, np.zeros((1, 2)), fates, np.nan)
    monkeypatch.setattr(boundaries, "edge_state", lambda *_, **__: state)
    bar, track = boundaries.bar, boundaries.track
    monkeypatch.setattr(
        boundaries, "bar", lambda label, wanted: seen.append((label, wanted)) or bar(label, False)
    )
    monkeypatch.setattr(
        boundaries,
        "track",
        lambda things, label, wanted: (
            seen.append((label, wanted, len(things))) or track(things, label, False)
        ),
    )
    grid = wj.Grid.sheared(theta=(0.05, 0.35, 12), sum=(-0.04, 0.02, 10))
    data = wj.boundary(wj.SimplestWalker(0.004), grid, side=2, strides=20, progress=True)
    pairs = data.sizes["region_number"] * (data.sizes["region_number"] - 1) // 2
    edges = data.sizes["edge"]
    assert pairs >= edges > 0
    named = [("basin", True), ("edge states", True, pairs), ("stable manifolds", True, edges)]
    assert seen == named


def test_a_branch_says_how_much_of_its_interval_is_covered(monkeypatch):
    seen = []

    @contextmanager
    def bar(label, wanted, total=None, done=0):
        yield lambda completed: seen.append((label, wanted, total, completed))

    monkeypatch.setattr(branches, "bar", bar)
    walker = wj.SimplestWalker(0.0095)
    wj.continue_gait(walker, "slope", (0.009, 0.01), progress=True)
    shares = [one[-1] for one in seen]
    assert {one[:-1] for one in seen} == {("branch of gaits", True, 100)}
    assert shares == sorted(shares) and shares[0] == 0 and shares[-1] >= 99


def test_searches_show_progress_where_it_is_wanted(monkeypatch):
    seen = []
    bar = search.bar
    monkeypatch.setattr(search, "bar", lambda *words: seen.append(words) or bar("", False))
    region = wj.Grid.plain(theta=(0.19, 0.21, 2), thetadot=(-0.21, -0.19, 2))
    wj.find_gaits(wj.SimplestWalker(0.009), 1, region, progress=True)
    assert seen == [("searches for gaits", True)]

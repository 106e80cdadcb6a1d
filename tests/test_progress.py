"""The bar of a computation that was interrupted begins where that was."""

import io
import re

import pytest
from rich.console import Console

import walker_jax as wj
from walker_jax import storage
from walker_jax.basins import pieces
from walker_jax.design import sweeps
from walker_jax.execution import progress


def test_a_bar_begins_with_what_was_done_before_and_ends_with_all(monkeypatch):
    shown = io.StringIO()
    terminal = Console(file=shown, force_terminal=True, width=80)
    monkeypatch.setattr("walker_jax.execution.progress.progress_console", lambda wanted: terminal)
    assert [*progress.track("ab", "pieces", True, 10, done=8)] == ["a", "b"]
    parts = [int(part) for part in re.findall(r"(\d+)%", shown.getvalue())]
    assert parts[0] == 80 and parts[-1] == 100 and parts == sorted(parts)


@pytest.mark.parametrize("name", ["basin", "sweep"])
def test_a_run_that_is_resumed_shows_what_is_there(name, tmp_path, monkeypatch):
    module = {"basin": pieces, "sweep": sweeps}[name]
    grid = wj.Grid.sheared(theta=(0.05, 0.35, 8), sum=(-0.03, 0.01, 6))
    walker, out = wj.SimplestWalker(0.004), tmp_path / "a.zarr"
    monkeypatch.setattr("walker_jax.basins.pieces.PIECE", 12)
    monkeypatch.setattr("walker_jax.design.sweeps.measure_basin", lambda *_: {"area": 0.001})
    calls = {
        "basin": lambda: wj.basin(walker, grid, out=out),
        "sweep": lambda: wj.sweep(
            walker, {"slope": [0.004, 0.005, 0.006, 0.007]}, grid, levels=0, check=0, out=out
        ),
    }
    write, seen = storage.Pieces.write, []

    def interrupted(place, piece, values, *, done=False):
        if piece == 3:
            raise KeyboardInterrupt
        write(place, piece, values, done=done)

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(storage.Pieces, "write", interrupted)
        calls[name]()
    track = module.track
    keep = lambda things, label, wanted, *counts: seen.append(counts) or track(things, label, False)
    monkeypatch.setattr(module, "track", keep)
    calls[name]()
    assert seen == [(4, 3)]

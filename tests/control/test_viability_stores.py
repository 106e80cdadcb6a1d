"""Viability through a store: piece by piece, interrupted, killed, and by other processes."""

import signal
import subprocess
import sys

import numpy as np
import pytest
import xarray as xr
from interruptions import stop_writes

import walker_jax as wj
from walker_jax import storage
from walker_jax.control import images

GRID = wj.Grid.sheared(theta=(0.05, 0.45, 40), sum=(-0.05, 0.01, 48))
PUSHES = {"push_off": (0.0, 0.08, 9)}
WALKER = wj.PoweredWalker(0.004)


@pytest.fixture
def small_tiles(monkeypatch):
    """Four parts of the grid, of whole and of parts of rows, by five actions and by four."""
    monkeypatch.setattr(images, "TILE", (500, 2500))


@pytest.fixture(scope="module")
def at_once():
    return {bounds: wj.viable(WALKER, GRID, PUSHES, bounds=bounds) for bounds in (True, False)}


def same(found: xr.Dataset, wanted: xr.Dataset) -> bool:
    """Whether data sets are the same to the last bit, but for the request of a stored one."""
    return found.drop_attrs(deep=False).identical(wanted.drop_attrs(deep=False)) and (
        {name: value for name, value in found.attrs.items() if name != "request"} == wanted.attrs
    )


@pytest.mark.parametrize("bounds", [True, False])
def test_piece_by_piece_it_is_the_same(tmp_path, small_tiles, at_once, bounds):
    assert images.tile_shape(GRID.size, 9) == (480, 5)
    assert same(wj.viable(WALKER, GRID, PUSHES, bounds=bounds), at_once[bounds])
    path = tmp_path / "a.zarr"
    found = wj.viable(WALKER, GRID, PUSHES, bounds=bounds, out=path)
    assert same(found, at_once[bounds])
    assert [one.name for one in tmp_path.iterdir()] == ["a.zarr"]
    assert {one.name for one in path.iterdir() if one.is_dir()} == {*map(str, found.variables)}
    again = wj.viable(WALKER, GRID, PUSHES, bounds=bounds, out=path)
    assert same(again, at_once[bounds])


def test_interrupted_at_any_write_it_goes_on(tmp_path, small_tiles, at_once, monkeypatch):
    mapped, begun = images.map_tile, []

    def counted(task, cells, tile):
        begun.append(tile)
        return mapped(task, cells, tile)

    monkeypatch.setattr("walker_jax.control.viability.map_tile", counted)
    path, stops = tmp_path / "a.zarr", {0, 3, 7}
    written = stop_writes(monkeypatch, stops, arrays=2)
    while stops:
        with pytest.raises(KeyboardInterrupt):
            wj.viable(WALKER, GRID, PUSHES, out=path)
        there = storage.load(path)
        assert there is not None and there.attrs["unfinished"]
    assert same(wj.viable(WALKER, GRID, PUSHES, out=path), at_once[True])
    # each of eight, and again the one that was in flight at each of three interruptions
    assert (len(begun), len(set(begun)), sorted(written)) == (11, 8, [*range(8)])


KILLED = """
import os
import signal
import sys
from pathlib import Path
import jax
import walker_jax as wj
from walker_jax import storage
from walker_jax.control import images
jax.config.update("jax_enable_x64", True)
images.TILE = (500, 2500)
write = storage.Pieces.write
def counted(place, piece, values, done=False):
    write(place, piece, values, done=done)
    if piece == int(sys.argv[2]):
        os.kill(os.getpid(), signal.SIGKILL)
storage.Pieces.write = counted
grid = wj.Grid.sheared(theta=(0.05, 0.45, 40), sum=(-0.05, 0.01, 48))
wj.viable(wj.PoweredWalker(0.004), grid, {"push_off": (0.0, 0.08, 9)}, out=Path(sys.argv[1]))
"""


@pytest.mark.slow
def test_a_killed_run_goes_on_with_the_same_result(tmp_path, small_tiles, at_once, monkeypatch):
    """Killed, so that nothing is tidied up."""
    path, begun = tmp_path / "a.zarr", []
    run = subprocess.run([sys.executable, "-c", KILLED, str(path), "4"])
    assert run.returncode == -signal.SIGKILL
    mapped = images.map_tile
    monkeypatch.setattr(
        "walker_jax.control.viability.map_tile",
        lambda task, cells, tile: begun.append(tile) or mapped(task, cells, tile),
    )
    assert same(wj.viable(WALKER, GRID, PUSHES, out=path), at_once[True])
    assert len(begun) == 3
    assert [place.name for place in tmp_path.iterdir()] == ["a.zarr"]


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"actions": {"push_off": (0.0, 0.08, 8)}}, "actions push_off: "),
        ({"walker": wj.PoweredWalker(0.005)}, r"walker_slope: 0\.004, not 0\.005"),
        ({"grid": wj.Grid.sheared(theta=(0.05, 0.45, 40), sum=(-0.05, 0.02, 48))}, "axes sum: "),
        ({"bounds": False}, "bounds: true, not false"),
        ({"levels": 1}, "levels: 0, not 1"),
        ({"target": np.ones(GRID.shape, bool)}, "target: null, not "),
        ({"tolerance": 1e-9}, "tolerance: "),
    ],
)
def test_a_store_of_another_request_is_refused(tmp_path, small_tiles, monkeypatch, changed, said):
    asked = {"walker": WALKER, "grid": GRID, "actions": PUSHES}
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(storage.Pieces, "write", interrupt)
        wj.viable(**asked, out=tmp_path / "a.zarr")
    with pytest.raises(storage.StoreConflict, match=rf"holds another result \({said}") as error:
        wj.viable(**asked | changed, out=tmp_path / "a.zarr")
    assert "\n" not in str(error.value)


def interrupt(*_, **__):
    raise KeyboardInterrupt


def test_finer_levels_are_the_same_through_a_store(tmp_path, small_tiles, monkeypatch):
    wanted = wj.viable(WALKER, GRID, PUSHES, levels=1)
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr("walker_jax.control.viability.map_in_tiles", interrupt)  # at the finer level
        wj.viable(WALKER, GRID, PUSHES, levels=1, out=tmp_path / "a.zarr")
    monkeypatch.setattr("walker_jax.control.viability.map_tile", interrupt)  # all are there
    found = wj.viable(WALKER, GRID, PUSHES, levels=1, out=tmp_path / "a.zarr")
    assert same(found, wanted) and found["mapped"].size == 2


@pytest.mark.slow
def test_workers_find_the_same(tmp_path, small_tiles, at_once):
    found = wj.viable(WALKER, GRID, PUSHES, out=tmp_path / "a.zarr", cluster=2)
    assert same(found, at_once[True])
    wanted = wj.viable(WALKER, GRID, PUSHES, levels=1)
    assert same(
        wj.viable(WALKER, GRID, PUSHES, levels=1, out=tmp_path / "b.zarr", cluster=2), wanted
    )

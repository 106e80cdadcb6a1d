"""Runs that read a data set while another run writes, replaces or has left it."""

import shutil
from contextlib import ExitStack

import filelock
import numpy as np
import pytest
import xarray as xr

from walker_jax import storage
from walker_jax.storage import reading
from walker_jax.storage.damage import Damaged

REQUEST = {"command": "basin", "slope": 0.004}
DATA = xr.Dataset({"fate": ("x", np.arange(1, 6)), "area": 0.1}, coords={"x": np.linspace(0, 1, 5)})


def begun(path):
    """A data set in one piece, with an auxiliary array that its end removes."""
    arrays = {name: xr.Variable("x", np.zeros(5)) for name in ("value", "half")}
    axis = DATA[["x"]]
    return storage.open_pieces(path, REQUEST, axis, arrays, (5,), dict, aside=["half"])


def test_a_data_set_is_whole_to_those_who_read_while_it_ends(tmp_path, monkeypatch):
    path, check = tmp_path / "a.zarr", reading.check_metadata
    for ends in (("finished",), ("finished", "tidied")):
        with ExitStack() as run:
            place = run.enter_context(begun(path))
            place.write(0, {"value": np.arange(5.0)}, done=True)
            left = [*ends]

            def end(at, run=run, place=place, left=left):
                kept = check(at)
                match left and left.pop(0):
                    case "finished":
                        place.finish(DATA[["area"]])
                    case "tidied":
                        run.close()
                return kept

            with monkeypatch.context() as patch:
                patch.setattr(reading, "check_metadata", end)
                found = storage.open_dataset(path)
            assert left == [] and set(found.variables) == {"value", "x", "area"}
            assert found["value"].values.tolist() == [0, 1, 2, 3, 4]
        shutil.rmtree(path)


@pytest.mark.parametrize("other", [DATA * 10, DATA.rename(fate="label")])
def test_a_large_data_set_is_not_read_from_its_successor(tmp_path, monkeypatch, other):
    monkeypatch.setattr(reading, "LAZY_FROM_BYTES", 0)
    path = tmp_path / "a.zarr"
    storage.save(DATA, path, REQUEST)
    found = storage.load(path)
    assert found is not None and found["fate"][1:3].values.tolist() == [2, 3]
    storage.save(other, path, REQUEST, overwrite=True)
    with pytest.raises(storage.StoreConflict, match="replaced while it was read: load it again"):
        found["fate"].load()


def test_a_chunk_lost_after_loading_does_not_read_as_zeros(tmp_path, monkeypatch):
    monkeypatch.setattr(reading, "LAZY_FROM_BYTES", 0)
    path = tmp_path / "a.zarr"
    storage.save(DATA, path, REQUEST)
    found = storage.load(path)
    (path / "fate/c/0").unlink()
    with pytest.raises(Damaged, match="is damaged: fate/c/0 is missing"):
        assert found is not None and found["fate"].load()


@pytest.mark.parametrize("link", [False, True])
def test_the_old_data_set_is_loaded_after_a_kill_before_the_new(tmp_path, link):
    path, left = tmp_path / "a.zarr", tmp_path / ".a.zarr.walker-jax"
    written = storage.save(DATA, path, REQUEST)
    if link:
        (tmp_path / "link.zarr").symlink_to(path)
    left.mkdir()
    (left / "lock").touch()
    path.rename(left / "old")
    for _ in range(2):  # a reader leaves everything where it is
        found = storage.load(tmp_path / "link.zarr" if link else path)
        assert found is not None and found.identical(written) and not path.exists()
    found = storage.find(path, REQUEST)
    assert found is not None and found.identical(written)
    assert not left.exists()


def test_the_lock_of_another_user_is_told_as_theirs(tmp_path, monkeypatch):
    def refuse(lock):
        raise PermissionError(13, "Permission denied", lock.lock_file)

    monkeypatch.setattr(filelock.FileLock, "acquire", refuse)
    said = "a.zarr is reserved by a run of another user, dead or alive, in .*: wait, or give "
    with pytest.raises(storage.StoreConflict, match=said):
        storage.save(DATA, tmp_path / "a.zarr", REQUEST)

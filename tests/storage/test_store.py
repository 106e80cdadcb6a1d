import errno
import importlib.util
import os
import shutil
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from reference import ROOT
from zarr.storage import LocalStore

from walker_jax import storage
from walker_jax.checks import NotWritten
from walker_jax.storage import requests, runs
from walker_jax.storage.schema import SCHEMA_VERSION

REQUEST = {"command": "basin", "slope": 0.004}


@pytest.fixture
def data():
    return xr.Dataset(
        {"fate": ("x", np.arange(5, dtype=np.int8))}, coords={"x": np.linspace(0, 1, 5)}
    )


def test_the_same_request_finds_its_result(tmp_path, data):
    path = tmp_path / "a.zarr"
    assert storage.find(path, REQUEST) is None
    written = storage.save(data, path, REQUEST)
    found = storage.find(path, {"slope": 0.004, "command": "basin"})
    assert found is not None and found.identical(written)
    assert [p.name for p in tmp_path.iterdir()] == ["a.zarr"]
    there = xr.open_zarr(path, consolidated=False)
    assert there.attrs.pop("schema_version") == SCHEMA_VERSION and there.attrs.pop("checksums")
    assert there.identical(written)


def test_another_request_is_refused_unless_told_to_overwrite(tmp_path, data):
    path = tmp_path / "a.zarr"
    storage.save(data, path, REQUEST)
    with pytest.raises(storage.StoreConflict, match=r"a\.zarr holds another result"):
        storage.find(path, {**REQUEST, "slope": 0.005})
    assert storage.find(path, {**REQUEST, "slope": 0.005}, overwrite=True) is None
    assert storage.find(path, REQUEST) is not None  # nothing was touched
    storage.save(data * 2, path, {**REQUEST, "slope": 0.005}, overwrite=True)
    replaced = storage.load(path)
    assert replaced is not None and replaced.fate.values.tolist() == [0, 2, 4, 6, 8]
    assert [p.name for p in tmp_path.iterdir()] == ["a.zarr"]


@pytest.mark.parametrize("overwrite", [False, True])
def test_what_is_no_data_set_is_never_replaced(tmp_path, overwrite):
    for name in ("file", "folder", "damaged"):
        path = tmp_path / name
        if name == "file":
            path.write_text("mine")
        else:
            path.mkdir()
        if name == "damaged":
            (path / "zarr.json").write_text("{")
        with pytest.raises(storage.StoreConflict, match="is not a data set"):
            storage.find(path, REQUEST, overwrite=overwrite)
        with pytest.raises(storage.StoreConflict, match="is not a data set"), begun(path):
            pass
        assert path.exists()


def test_places_that_cannot_be_written(tmp_path, monkeypatch):
    with pytest.raises(ValueError, match="no folder"):
        storage.find(tmp_path / "none" / "a.zarr", REQUEST)
    monkeypatch.setattr(os, "access", lambda *_: False)
    with pytest.raises(ValueError, match="no permission"):
        storage.find(tmp_path / "a.zarr", REQUEST)


def test_a_failed_write_leaves_what_was_there(tmp_path, data, monkeypatch):
    path = tmp_path / "a.zarr"
    written = storage.save(data, path, REQUEST)
    monkeypatch.setattr(xr.Dataset, "to_zarr", lambda *_, **__: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        storage.save(data * 2, path, REQUEST, overwrite=True)
    found = storage.find(path, REQUEST)
    assert found is not None and found.identical(written)
    assert [p.name for p in tmp_path.iterdir()] == ["a.zarr"]


def test_a_picture_is_known_by_its_title(tmp_path):
    path = tmp_path / "a.png"
    storage.check_picture(path, REQUEST)
    path.write_bytes(b"x" + storage.signature(REQUEST).encode() + b"y")
    storage.check_picture(path, REQUEST)
    with pytest.raises(storage.StoreConflict, match=r"a\.png is something else"):
        storage.check_picture(path, {**REQUEST, "slope": 0.005})
    storage.check_picture(path, {**REQUEST, "slope": 0.005}, overwrite=True)


# Pieces


ROWS = np.arange(12.0).reshape(6, 2)


def axes():
    return xr.Dataset(coords={"x": np.arange(6.0), "y": [0.0, 1.0]}, attrs={"kind": "test"})


def begun(path, request=REQUEST, notes=lambda: {"a": 0.1}, **options):
    arrays = {
        "value": xr.Variable(("x", "y"), np.broadcast_to(-1.0, (6, 2)), {"unit": "m"}),
        "half": xr.Variable(("x",), np.broadcast_to(np.int8(0), 6)),
    }
    return storage.open_pieces(
        path, request, axes(), arrays, (4,), notes, aside=["half"], **options
    )


def write(place, piece):
    (rows,) = place.at(piece)
    half = np.ones(rows.stop - rows.start, np.int8)
    place.write(piece, {"value": ROWS[rows], "half": half}, done=True)


def test_pieces_are_written_one_by_one_and_make_a_whole(tmp_path, monkeypatch):
    path = tmp_path / "a.zarr"
    with begun(path) as place:
        assert (place.count, place.missing(), place.notes) == (2, [0, 1], {"a": 0.1})
        assert [place.at(i) for i in range(2)] == [(slice(0, 4),), (slice(4, 6),)]
        write(place, 1)
        assert place.missing() == [0]
        np.testing.assert_array_equal(place.read("value", 1), ROWS[4:])
        # anybody may look
        seen = xr.open_zarr(path, consolidated=False)
        np.testing.assert_array_equal(seen["value"], np.r_[np.full((4, 2), -1), ROWS[4:]])
        assert seen.attrs["kind"] == "test" and seen["value"].attrs == {"unit": "m"}
    with monkeypatch.context() as patch:  # nothing of an unfinished data set is read
        patch.setattr(xr.Dataset, "load", lambda *_: 1 / 0)
        assert storage.find(path, REQUEST) is None
    with begun(path, notes=lambda: 1 / 0) as place:
        assert place.missing() == [0] and place.notes == {"a": 0.1}
        write(place, 0)
        place.finish(axes().assign(sum=ROWS.sum()))
    found = storage.find(path, REQUEST)
    wanted = axes().assign(value=(("x", "y"), ROWS, {"unit": "m"}), sum=ROWS.sum())
    assert found is not None and found.drop_attrs(deep=False).identical(
        wanted.drop_attrs(deep=False)
    )
    assert found.attrs == {"kind": "test", "request": requests.canonical_json(REQUEST)}
    assert [p.name for p in tmp_path.iterdir()] == ["a.zarr"]
    assert sorted(p.name for p in path.iterdir() if p.is_dir()) == ["sum", "value", "x", "y"]


def test_a_piece_is_on_the_disk_before_it_counts_as_written(tmp_path, monkeypatch):
    """The file of each array and its entry in the folder, whenever the power fails."""
    happened, write_file, sync = [], LocalStore.set, os.fsync

    async def note_file(self, key, value):
        await write_file(self, key, value)
        happened.append(key)

    def note_sync(number):
        sync(number)
        happened.append(os.fstat(number).st_ino)

    monkeypatch.setattr(LocalStore, "set", note_file)
    monkeypatch.setattr(os, "fsync", note_sync)
    with begun(path := tmp_path / "a.zarr") as place:
        happened.clear()
        write(place, 1)
        counts = happened.index("written/c/1")
        for key in ("value/c/1/0", "half/c/1"):
            file, made = path / key, happened.index(key)
            for synced in (file, file.parent)[: 2 if os.name == "posix" else 1]:
                assert synced.stat().st_ino in happened[made:counts]


def test_another_request_may_not_go_on(tmp_path):
    path = tmp_path / "a.zarr"
    with begun(path) as place:
        write(place, 0)
    other = {**REQUEST, "slope": 0.005}
    with (
        pytest.raises(storage.StoreConflict, match=r"another result \(slope: 0\.004, not 0\.005\)"),
        begun(path, other),
    ):
        pass
    with pytest.raises(storage.StoreConflict, match="another result"):
        storage.find(path, other)
    with begun(path) as place:
        assert place.missing() == [1]


@pytest.mark.parametrize(
    ("there", "wanted", "said"),
    [
        ({"a": 1}, {"a": 2}, " (a: 1, not 2)"),
        ({"a": {"b": 1, "c": [1]}}, {"a": {"b": 1, "c": [2]}}, " (a c: [1], not [2])"),
        ({"a": 1}, {"a": 1, "b": "x"}, ' (b: none, not "x")'),
        ({"a": 1, "b": 2}, {"a": 1}, " (b: 2, not null)"),
        ({"a": 1}, {"a": 1}, ""),
    ],
)
def test_what_is_other_is_said(there, wanted, said):
    assert requests.first_difference(there, wanted) == said


def test_only_a_complete_result_may_be_of_another_version(tmp_path):
    attributes = {"request": requests.canonical_json({**REQUEST, "version": "0.1"})}
    wanted = {**REQUEST, "version": "0.2"}
    requests.check_request(tmp_path, attributes, wanted)
    with pytest.raises(storage.StoreConflict, match=r'\(version: "0.1", not "0.2"\)'):
        requests.check_request(tmp_path, attributes | {"unfinished": 1}, wanted)


def test_two_runs_may_not_write_at_once(tmp_path):
    path = tmp_path / "a.zarr"
    with begun(path) as place:
        write(place, 0)
        with (
            pytest.raises(storage.StoreConflict, match="is being written by another run"),
            begun(path),
        ):
            pass
        with pytest.raises(storage.StoreConflict, match="is being written by another run"):
            storage.save(axes(), path, REQUEST)
        assert storage.find(path, REQUEST) is None
    with begun(path) as place:
        assert place.missing() == [1]


def test_a_run_that_was_killed_holds_nothing(tmp_path):
    path = tmp_path / "a.zarr"
    with begun(path):
        pass
    program = (
        "import os, signal, sys, pathlib\n"
        "from walker_jax.storage import runs\n"
        "path = pathlib.Path(sys.argv[1])\n"
        "with runs.exclusive(path):\n"
        "    print('locked', flush=True)\n"
        "    sys.stdin.read()\n"
    )
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with subprocess.Popen([sys.executable, "-c", program, str(path)], **pipes) as other:
        assert other.stdout is not None and other.stdout.readline() == "locked\n"
        with pytest.raises(storage.StoreConflict), begun(path):
            pass
        other.kill()
        other.wait()
        with begun(path) as place:
            assert place.missing() == [0, 1]


def killed(kind, folder, every=1):
    """A run is killed at every so many operations on files, and gone on with."""
    program = ROOT / "tests" / "helpers" / "store_killed.py"
    command = [sys.executable, program, kind, folder, str(every)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0 and "0 not in order" in done.stdout, done.stdout + done.stderr
    return int(done.stdout.split()[2])


def test_killed_at_some_operations_on_files_a_run_loses_nothing(tmp_path):
    assert killed("pieces", tmp_path, 25) > 3


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["pieces", "overwrite", "save"])
def test_killed_at_any_operation_on_files_a_run_loses_nothing(tmp_path, kind):
    assert killed(kind, tmp_path) > 90


def test_what_is_overwritten_stands_until_the_next_is_begun(tmp_path):
    path = tmp_path / "a.zarr"
    storage.save(axes(), path, {"slope": 1})

    def interrupted():
        assert storage.load(path) is not None
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), begun(path, notes=interrupted, overwrite=True):
        pass
    assert storage.find(path, {"slope": 1}) is not None
    with begun(path, overwrite=True) as place:
        assert place.missing() == [0, 1]
    assert [p.name for p in tmp_path.iterdir()] == ["a.zarr"]


def test_another_run_may_have_finished_it_in_between(tmp_path):
    path = tmp_path / "a.zarr"
    with begun(path) as place:
        for i in place.missing():
            write(place, i)
        place.finish(axes())
    with pytest.raises(storage.StoreConflict, match="another run has just completed"), begun(path):
        pass
    assert storage.find(path, REQUEST) is not None
    assert sorted(p.name for p in path.iterdir() if p.is_dir()) == ["value", "x", "y"]


@pytest.mark.parametrize("request_", ["hello", "[1]", 5, '{"command": 1}'])
def test_a_data_set_of_others_may_have_a_request(tmp_path, data, request_):
    path = tmp_path / "a.zarr"
    data.assign_attrs(request=request_).to_zarr(path, consolidated=False)
    with pytest.raises(storage.StoreConflict, match="says no schema version"):
        storage.find(path, REQUEST)
    with pytest.raises(storage.StoreConflict, match="holds another result"):
        requests.check_request(path, {"request": request_}, REQUEST)


def test_a_data_set_of_others_is_never_replaced(tmp_path, data):
    path = tmp_path / "a.zarr"
    data.to_zarr(path, consolidated=False)
    for overwrite in (False, True):
        with pytest.raises(storage.StoreConflict, match="is not a data set"):
            storage.find(path, REQUEST, overwrite=overwrite)


def test_a_link_is_another_name_of_a_place(tmp_path, data):
    path, link = tmp_path / "a.zarr", tmp_path / "link.zarr"
    link.symlink_to("a.zarr")
    storage.save(data, link, REQUEST)
    assert link.is_symlink() and storage.find(path, REQUEST) is not None
    storage.save(data * 2, link, REQUEST, overwrite=True)
    found = storage.find(path, REQUEST)
    assert found is not None and found["fate"].values.tolist() == [0, 2, 4, 6, 8]
    with begun(path, overwrite=True):
        with (
            pytest.raises(storage.StoreConflict, match="is being written by another run"),
            begun(link),
        ):
            pass
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.zarr", "link.zarr"]


def test_a_result_may_be_read_where_nothing_can_be_written(tmp_path, data, monkeypatch):
    storage.save(data, tmp_path / "a.zarr", REQUEST)
    monkeypatch.setattr(os, "access", lambda *_: False)
    assert storage.find(tmp_path / "a.zarr", REQUEST) is not None
    with pytest.raises(storage.StoreConflict, match="holds another result"):
        storage.find(tmp_path / "a.zarr", {})
    with pytest.raises(ValueError, match="no permission"):
        storage.find(tmp_path / "a.zarr", {}, overwrite=True)


@contextmanager
def between_the_old_and_the_new(monkeypatch, happens):
    """Something happens when the old data set is out of the way and the new one not there yet."""
    rename = Path.rename

    def late(self, target):
        if self.name == "new":
            happens()
        return rename(self, target)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "rename", late)
        yield


def test_what_comes_in_the_way_is_left_and_so_is_the_new(tmp_path, data, monkeypatch):
    path = tmp_path / "a.zarr"
    storage.save(data, path, REQUEST)

    def other():
        path.mkdir()
        (path / "mine").touch()

    with between_the_old_and_the_new(monkeypatch, other):
        with pytest.raises(storage.StoreConflict, match="came in the way"):
            storage.save(data * 2, path, REQUEST, overwrite=True)
    assert (path / "mine").exists()
    kept = [storage.load(tmp_path / ".a.zarr.walker-jax" / name) for name in ("old", "new")]
    assert [one is not None for one in kept] == [True, True]
    (path / "mine").unlink()
    path.rmdir()
    found = storage.find(path, REQUEST)
    assert found is not None and found["fate"].values.tolist() == [0, 1, 2, 3, 4]


def test_what_has_come_while_it_was_computed_is_kept(tmp_path, data):
    path = tmp_path / "a.zarr"
    assert storage.find(path, REQUEST) is None
    storage.save(data, path, REQUEST)  # by another run
    found = storage.save(data * 2, path, REQUEST)
    assert found["fate"].values.tolist() == [0, 1, 2, 3, 4]
    with pytest.raises(storage.StoreConflict, match="holds another result"):
        storage.save(data, path, {**REQUEST, "slope": 0.005})
    mine = tmp_path / "mine"
    mine.mkdir()
    with pytest.raises(storage.StoreConflict, match="is not a data set"):
        storage.save(data, mine, REQUEST, overwrite=True)


def test_a_run_goes_on_with_the_blocks_that_it_was_begun_with(tmp_path, monkeypatch):
    path = tmp_path / "a.zarr"
    with begun(path) as place:
        write(place, 1)
    arrays = {"value": xr.Variable(("x", "y"), np.broadcast_to(-1.0, (6, 2)))}
    with storage.open_pieces(path, REQUEST, axes(), arrays, (2,), dict) as place:
        assert place.missing() == [0] and place.at(1) == (slice(4, 6),)


HOLDING = """
import os, sys
from pathlib import Path
from walker_jax import storage
from walker_jax.storage import runs
path, mark, held = Path(sys.argv[1]), sys.argv[2], 0
others = []  # of the first of them
for _ in range(2):
    others.append(os.fork())
    if others[-1] == 0:
        others = []
        break
while held < 30:
    try:
        with runs.exclusive(path):
            os.close(os.open(mark, os.O_CREAT | os.O_EXCL))  # not if another one holds it too
            held += 1
            os.unlink(mark)
    except storage.StoreConflict:
        pass
assert all(os.waitpid(other, 0)[1] == 0 for other in others)
"""


def test_no_two_processes_hold_a_place_at_once(tmp_path):
    """Three in a race for it, each until it has had it thirty times."""
    command = [sys.executable, "-c", HOLDING, str(tmp_path / "a.zarr"), str(tmp_path / "mark")]
    run = subprocess.run(command, capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    assert not [*tmp_path.iterdir()]


def test_a_place_that_one_run_rewrites_is_refused_to_others(tmp_path, data):
    path = tmp_path / "a.zarr"
    with storage.rewritable(path, REQUEST) as save:
        save(data)
        with pytest.raises(storage.StoreConflict, match="is being written by another run"):
            storage.save(data, path, REQUEST)
        written = save(data * 2)
        found = storage.find(path, REQUEST)
        assert found is not None and found.identical(written)
    assert [p.name for p in tmp_path.iterdir()] == ["a.zarr"]


def test_what_a_killed_run_left_beside_goes_with_the_next(tmp_path, data):
    path, left = tmp_path / "a.zarr", tmp_path / ".a.zarr.walker-jax"
    (left / "new" / "x").mkdir(parents=True)
    (left / "lock").touch()
    (kept := tmp_path / "kept").mkdir()
    (left / "link").symlink_to(kept)
    storage.save(data, path, REQUEST)
    assert {p.name for p in tmp_path.iterdir()} == {"a.zarr", "kept"}


def test_two_runs_may_not_begin_at_once(tmp_path, data):
    path = tmp_path / "a.zarr"
    with runs.exclusive(path):
        with (
            pytest.raises(storage.StoreConflict, match="is being written by another run"),
            begun(path),
        ):
            pass
        with pytest.raises(storage.StoreConflict, match="is being written by another run"):
            storage.save(data, path, REQUEST)
    assert list(tmp_path.iterdir()) == []


def test_a_piece_that_does_not_fit_on_the_disk_is_missing(tmp_path, monkeypatch):
    path = tmp_path / "a.zarr"
    with begun(path) as place:
        write(place, 0)
    put = LocalStore.set

    async def full(self, key, value):
        if "half/c" in key:
            raise OSError(errno.ENOSPC, "No space left on device")
        await put(self, key, value)

    with monkeypatch.context() as patch:
        patch.setattr(LocalStore, "set", full)
        with pytest.raises(NotWritten, match="No space"), begun(path) as place:
            write(place, 1)
    with begun(path) as place:
        assert place.missing() == [1]
        np.testing.assert_array_equal(place.read("value", 0), ROWS[:4])
        write(place, 1)
        place.finish(axes())
    found = storage.find(path, REQUEST)
    assert found is not None and (found["value"].values == ROWS).all()


def test_a_run_that_ended_but_for_tidying_is_tidied(tmp_path):
    path = tmp_path / "a.zarr"
    with begun(path) as place:
        write(place, 0)
        write(place, 1)
        place.finish(axes())
        left = Path(shutil.copytree(path, tmp_path / "killed" / path.name))
    (left / "value/c/0/0.1a2b.partial").write_bytes(b"half of")
    (left / "z").mkdir()
    assert {"half", "written"} <= {one.name for one in left.iterdir()}
    found = storage.load(left)  # these are not part of it
    assert found is not None and set(found.variables) == {"value", "x", "y"}
    left.with_name(f".{left.name}.walker-jax").mkdir()  # as a killed run leaves it
    for place in (path, left):
        found = storage.find(place, REQUEST)
        assert found is not None and set(found.variables) == {"value", "x", "y"}
        assert {one.name for one in place.iterdir()} == {"value", "x", "y", "zarr.json"}
        assert not [*place.rglob("*.partial")]
        assert [one.name for one in place.parent.iterdir() if one.name[0] == "."] == []


def test_places_read_only_even_to_root_and_names_too_long(tmp_path):
    for path in (Path("/proc/a.zarr"), tmp_path / ("n" * 300), tmp_path / ("n" * 250)):
        with pytest.raises(ValueError, match="cannot be written: ") as refusal:
            storage.find(path, REQUEST)
        assert "\n" not in str(refusal.value)
    assert list(tmp_path.iterdir()) == []


def test_an_interruption_between_old_and_new_loses_neither(tmp_path, data, monkeypatch):
    path = tmp_path / "a.zarr"
    storage.save(data, path, REQUEST)

    def interrupt():
        raise KeyboardInterrupt

    with between_the_old_and_the_new(monkeypatch, interrupt):
        with pytest.raises(KeyboardInterrupt):
            storage.save(data * 2, path, REQUEST, overwrite=True)
    assert [p.name for p in tmp_path.iterdir()] == ["a.zarr"]
    there = storage.load(path)
    assert there is not None and there.fate.values.tolist() == [0, 1, 2, 3, 4]


def test_a_data_set_goes_to_netcdf_as_it_is(tmp_path, data):
    path, file = tmp_path / "a.zarr", tmp_path / "a.nc"
    data["fate"].attrs = {"flag_values": [0, 1], "flag_meanings": "STRIDE FORWARD"}
    data["speed"], data.attrs["walker"] = np.nan, "SimplestWalker"
    written = storage.save(data, path, REQUEST | {"long": "x" * 100_000})
    assert storage.export(path, file).identical(written)
    with xr.open_dataset(file, engine="h5netcdf") as there:
        assert there.equals(written) and there.attrs == written.attrs
        assert {name: there[name].dtype for name in there} == {"fate": "int8", "speed": "float64"}
        assert there["fate"].attrs["flag_values"].tolist() == [0, 1]
    with pytest.raises(storage.StoreConflict, match=r"a\.nc exists"):
        storage.export(path, file)
    storage.save(data * 2, path, REQUEST, overwrite=True)
    storage.export(path, file, overwrite=True)
    with xr.open_dataset(file, engine="h5netcdf") as there:
        assert there["fate"].values.tolist() == [0, 2, 4, 6, 8]
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.nc", "a.zarr"]


def test_what_cannot_go_to_netcdf(tmp_path, data, monkeypatch):
    path, file = tmp_path / "a.zarr", tmp_path / "a.nc"
    with begun(path):
        pass
    for place, message in ((path, "is unfinished"), (tmp_path / "b.zarr", "is not a data set")):
        with pytest.raises(storage.StoreConflict, match=message):
            storage.export(place, file)
    storage.save(data, tmp_path / "b.zarr", REQUEST)
    path = tmp_path / "b.zarr"
    (tmp_path / "c.nc").mkdir()
    with pytest.raises(storage.StoreConflict, match=r"c\.nc exists"):
        storage.export(path, tmp_path / "c.nc", overwrite=True)
    with pytest.raises(ValueError, match="file must end in one of"):
        storage.export(path, tmp_path / "a.zarr", overwrite=True)
    with pytest.raises(ValueError, match="there is no folder"):
        storage.export(path, tmp_path / "none" / "a.nc")
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(ValueError, match="NetCDF takes h5netcdf"):
        storage.export(path, file)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.zarr", "b.zarr", "c.nc"]


@pytest.mark.parametrize("overwrite", [False, True])
def test_a_pipe_is_no_picture(tmp_path, overwrite):
    os.mkfifo(tmp_path / "p.png")
    with pytest.raises(storage.StoreConflict, match="is something else"):
        storage.check_picture(tmp_path / "p.png", REQUEST, overwrite=overwrite)

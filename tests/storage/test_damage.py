"""Damage to data sets on disk is found and named, or has no effect; what is damaged is replaced."""

import copy
import errno
import json
import shutil
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
import zarr
from reference import DATA
from zarr.codecs import Crc32cCodec, GzipCodec

import walker_jax as wj
from walker_jax import storage
from walker_jax.checks import NotWritten
from walker_jax.storage import reading, schema
from walker_jax.storage.damage import CHECKSUMS, VERSION, Damaged, is_own_dataset, name_damage

REQUEST = {"command": "basin", "slope": 0.004}
SIZES = {name: size for size, name in enumerate(("theta", "sum", "slope"), 3)}
PLACEHOLDERS = {"*grid": ("theta", "sum"), "*parameters": ("slope",), "?parameter": ("slope",)}
PIECES = 3


def draw(random: np.random.Generator, type: str, shape: tuple[int, ...]) -> np.ndarray:
    if type == "text":
        return random.choice(np.array(["", "theta", "ψ and φ"], object), shape)
    if type == "real":
        return random.choice([0.0, -0.0, np.nan, 0.1, np.pi, 1e-300], shape)
    if type == "boolean":
        return random.integers(0, 2, shape).astype(bool)
    return random.integers(-1, 9, shape).astype(np.int32)


def example(kind: str) -> xr.Dataset:
    """A data set of a kind, with all variables that one may have."""
    random = np.random.default_rng(0)
    found: dict[str, Any] = {}
    for name, one in schema.KINDS[kind].variables.items():
        dims = [part for dim in one.dims.split() for part in PLACEHOLDERS.get(dim, (dim,))]
        found[name] = dims, draw(random, one.type, tuple(SIZES.get(dim, 2) for dim in dims))
    axes: dict[str, Any] = {name: (name, np.linspace(0, 1, size)) for name, size in SIZES.items()}
    attributes = {name: f"some {name}" for name in schema.KINDS[kind].attributes}
    return xr.Dataset(axes | found, attrs=attributes | {"slope": 0.1, "n": [1, 2.5]})


ROWS = np.random.default_rng(0).normal(size=(2 * PIECES - 1, 3))
WORDS = np.array(["", "a", "bcd", "ψ", "e"], object)
AXES = xr.Dataset(coords={"x": np.arange(len(ROWS) * 1.0), "y": np.arange(3)}, attrs={"kind": "k"})
ENDS = AXES.assign(sum=ROWS.sum(), ends=("number", [1, 2]))


def resume(path: Path, stop: int = PIECES, **options: bool) -> xr.Dataset | None:
    """A data set computed in pieces; `stop` before one of them, or before anything is found."""
    found = storage.find(path, REQUEST, **options)
    if found is not None:
        return found
    arrays = {
        "value": xr.Variable(("x", "y"), np.broadcast_to(np.nan, ROWS.shape)),
        "label": xr.Variable(("x",), np.broadcast_to(np.int8(-1), len(ROWS))),
        "word": xr.Variable(("x",), np.broadcast_to(np.array(""), len(ROWS))),
        "half": xr.Variable(("x",), np.broadcast_to(np.int32(-1), len(ROWS))),
    }
    block, aside = (2,), ["half"]
    with storage.open_pieces(
        path, REQUEST, AXES, arrays, block, lambda: {"a": 0.1}, aside=aside, **options
    ) as place:
        assert place.notes == {"a": 0.1}
        for piece in place.missing():
            if piece >= stop:
                return None
            (rows,) = place.at(piece)
            half = np.arange(rows.start, rows.stop)
            values = {"value": ROWS[rows], "word": WORDS[rows], "half": half}
            place.write(piece, values, done=True)
        if stop < PIECES:
            return None
        for piece in range(PIECES):
            place.write(piece, {"label": place.read("half", piece) + 1})
        place.finish(ENDS)
    return storage.open_dataset(path)


def files_of(path: Path) -> list[Path]:
    return sorted(file for file in path.rglob("*") if file.is_file())


DAMAGE = {
    "flip": lambda content, at: content[:at] + bytes([content[at] ^ 4]) + content[at + 1 :],
    "cut": lambda content, at: content[:at],
    "empty": lambda content, at: b"",
    "lost": lambda content, at: None,
}


def damage(file: Path, how: str, at: float = 0.6) -> None:
    content = file.read_bytes()
    left = DAMAGE[how](content, int(at * len(content)))
    file.unlink() if left is None else file.write_bytes(left)


def saved(path: Path, **given: Any) -> xr.Dataset:
    data = xr.Dataset(
        {"fate": ("x", np.arange(5, dtype=np.int8)), "note": ("x", WORDS), "area": 0.1},
        coords={"x": np.linspace(0, 1, 5)},
    )
    return storage.save(data.assign(given), path, REQUEST, overwrite=True)


@pytest.mark.parametrize("change", [(b"attributes", b"Attributes"), (b'"group"', b'"froup"')])
def test_a_group_that_has_lost_its_attributes_is_damaged(tmp_path, change):
    path = tmp_path / "a.zarr"
    saved(path)
    file = path / "zarr.json"
    file.write_bytes(file.read_bytes().replace(*change))
    with pytest.raises(Damaged, match=r"is damaged: zarr\.json "):
        storage.find(path, REQUEST)
    assert storage.find(path, REQUEST, overwrite=True) is None


def changed_once(tree: Any) -> Iterator[Any]:
    """Yield copies of a tree of dictionaries and lists in which one value is another, or lost."""
    if not isinstance(tree, dict | list):
        yield f"another {tree}" if isinstance(tree, str) else 7.5
        return
    for place in tree if isinstance(tree, dict) else range(len(tree)):
        other = copy.copy(tree)
        del other[place]
        yield other
        for one in changed_once(tree[place]):
            other = copy.copy(tree)
            other[place] = one
            yield other


def test_every_entry_of_the_metadata_is_checked(tmp_path):
    """Also a number that is another one, with which everything can be read as before."""
    path, tried = tmp_path / "a.zarr", 0
    saved(path, fate=("x", np.arange(5), {"unit": "m"}))
    for part in ("zarr.json", "fate/zarr.json"):
        written = (path / part).read_text()
        trees = [*changed_once(json.loads(written))]
        if part == "zarr.json":
            tree = json.loads(written)
            for sums in changed_once(json.loads(tree["attributes"][CHECKSUMS])):
                attributes = tree["attributes"] | {CHECKSUMS: json.dumps(sums)}
                trees.append(tree | {"attributes": attributes})
        for tree in trees:
            (path / part).write_text(json.dumps(tree))
            with pytest.raises(Damaged, match=f"{part} is not as it|{part} cannot be|schema v"):
                storage.find(path, REQUEST)
        (path / part).write_text(written)
        tried += len(trees)
    assert storage.find(path, REQUEST) is not None and tried > 60


@pytest.mark.parametrize(
    ("attributes", "own"),
    [({"request": "{}"}, True), ({CHECKSUMS: "{}"}, True), ({VERSION: 1}, False)],
)
def test_either_attribute_of_a_group_shows_whose_it_is(tmp_path, attributes, own):
    path = tmp_path / "a.zarr"
    xr.Dataset({"fate": ("x", np.ones(5))}, attrs=attributes).to_zarr(path, consolidated=False)
    assert is_own_dataset(path) == own


@pytest.mark.parametrize("how", DAMAGE)
def test_damage_is_named_and_what_is_damaged_may_be_replaced(tmp_path, how):
    path = tmp_path / "a.zarr"
    written = saved(path)
    for name in [file.relative_to(path).as_posix() for file in files_of(path)]:
        damage(path / name, how)
        left = {file: file.read_bytes() for file in files_of(path)}
        with pytest.raises(Damaged, match="or overwrite to replace it") as refusal:
            storage.find(path, REQUEST)
        assert str(refusal.value).startswith(f"{path} is damaged: {name} ")
        with pytest.raises(Damaged, match=f"is damaged: {name} "):
            storage.load(path)
        with pytest.raises(Damaged, match=f"is damaged: {name} .*: the command that made it "):
            storage.export(path, tmp_path / "a.nc")
        assert storage.find(path, REQUEST, overwrite=True) is None
        assert left == {file: file.read_bytes() for file in files_of(path)}
        saved(path)
        found = storage.find(path, REQUEST)
        assert found is not None and found.identical(written)
    assert [place.name for place in tmp_path.iterdir()] == ["a.zarr"]


@pytest.mark.parametrize("link", [False, True])
def test_a_folder_of_others_with_the_name_of_scratch_is_left(tmp_path, link):
    theirs = tmp_path / ("theirs" if link else ".a.zarr.walker-jax")
    theirs.mkdir()
    (theirs / "old").touch()
    if link:
        (tmp_path / ".a.zarr.walker-jax").symlink_to(theirs)
    path = tmp_path / "a.zarr"
    assert storage.find(path, REQUEST) is None
    with pytest.raises(storage.StoreConflict, match="in the way: move it away"):
        saved(path)
    assert [one.name for one in theirs.iterdir()] == ["old"] and not path.exists()


def test_what_may_not_be_of_this_package_is_never_replaced(tmp_path):
    path = tmp_path / "a.zarr"
    saved(path)
    (path / "zarr.json").write_bytes(b"")
    assert storage.find(path, REQUEST, overwrite=True) is None
    for name in ("mine.txt", "fate/mine", "fate/c/x", "fate/d/0"):
        (path / name).parent.mkdir(exist_ok=True)
        (path / name).write_text("mine")
        with pytest.raises(storage.StoreConflict, match="is not a data set"):
            storage.find(path, REQUEST, overwrite=True)
        (path / name).unlink()
    (path / "link").symlink_to(tmp_path)
    with pytest.raises(storage.StoreConflict, match="is not a data set"):
        storage.find(path, REQUEST, overwrite=True)
    (path / "link").unlink()
    (path / "fate/c/0.1a2b.partial").write_bytes(b"half of")  # a chunk that was being written
    assert storage.find(path, REQUEST, overwrite=True) is None
    for number, compressors in enumerate(((), (Crc32cCodec(),), (GzipCodec(), Crc32cCodec()))):
        foreign = tmp_path / f"b{number}.zarr"
        data = xr.Dataset({"fate": ("x", np.ones(5), {}, {"compressors": compressors})})
        data.to_zarr(foreign, consolidated=False)
        for name in ("fate/c/0", "zarr.json", "fate/zarr.json"):
            damage(foreign / name, "cut")
            with pytest.raises(storage.StoreConflict, match="is not a data set"):
                storage.find(foreign, REQUEST, overwrite=True)


def test_what_may_not_be_read_is_not_damaged(tmp_path, monkeypatch):
    """It is another user's, or memory is short: the data set may be whole, and is not replaced."""
    path = tmp_path / "a.zarr"
    written = saved(path)
    for error in (PermissionError(errno.EACCES, "Permission denied"), MemoryError()):
        with pytest.raises(type(error)), name_damage(path, "it"):
            raise error
    with pytest.raises(Damaged, match="it is gone") as refusal, name_damage(path, "it", "is gone"):
        raise OSError(errno.EIO, "Input/output error")
    assert isinstance(refusal.value.__cause__, OSError)
    for name in [file.relative_to(path).as_posix() for file in files_of(path)]:
        with monkeypatch.context() as patch:
            refuse_to_read(path / name, patch)
            for overwrite in (False, True):
                with pytest.raises(storage.StoreConflict) as error:
                    storage.find(path, REQUEST, overwrite=overwrite)
                assert not isinstance(error.value, Damaged)
    found = storage.find(path, REQUEST)
    assert found is not None and found.identical(written)


def refuse_to_read(secret: Path, patch: pytest.MonkeyPatch) -> None:
    """As of a file of another user; a superuser may read every file."""
    read = Path.read_bytes

    def read_bytes(file: Path) -> bytes:
        if file == secret:
            raise PermissionError(errno.EACCES, "Permission denied", str(file))
        return read(file)

    patch.setattr(Path, "read_bytes", read_bytes)


@pytest.mark.parametrize("version", [None, 2])
def test_another_schema_is_refused_and_can_be_replaced(tmp_path, version):
    there = DATA / "basin-0.1.0.zarr"
    path = Path(shutil.copytree(there, tmp_path / "a.zarr"))
    group = zarr.open_group(path, mode="r+")
    attributes = {**group.attrs, VERSION: version}
    group.attrs.put({name: one for name, one in attributes.items() if one is not None})
    said = "says no schema version" if version is None else "has schema version 2"
    said = f"a.zarr {said}, and this package reads 1: give another out, or overwrite to replace it"
    with pytest.raises(storage.StoreConflict, match=said) as error:
        storage.find(path, {})
    assert "\n" not in str(error.value)
    with pytest.raises(storage.StoreConflict, match="and this package reads 1"):
        storage.load(path)
    with pytest.raises(storage.StoreConflict, match="and this package reads 1"):
        wj.basin(
            wj.SimplestWalker(0.004),
            wj.Grid.plain(theta=(0, 0.2, 2), thetadot=(-1, 0, 2)),
            out=path,
        )
    assert storage.find(path, {}, overwrite=True) is None


def test_a_large_data_set_is_checked_too(tmp_path, monkeypatch):
    monkeypatch.setattr(reading, "LAZY_FROM_BYTES", 0)
    path = tmp_path / "a.zarr"
    saved(path)
    damage(path / "fate/c/0", "flip")
    with pytest.raises(Damaged, match="is damaged: fate/c/0 is not as it was written"):
        storage.find(path, REQUEST)


def test_a_damaged_piece_is_computed_again(tmp_path):
    path = tmp_path / "a.zarr"
    wanted = resume(tmp_path / "b.zarr")
    assert wanted is not None and (wanted["label"] == np.arange(1, len(ROWS) + 1)).all()
    resume(path, stop=1)
    chunks = ["value/c/0/0", "label/c/0", "word/c/0", "half/c/0", "written/c/0"]
    assert all((path / name).exists() for name in chunks)
    for how, name in zip(["flip", "cut", "empty", "lost", "lost"], chunks, strict=True):
        again = Path(shutil.copytree(path, tmp_path / name.partition("/")[0]))
        damage(again / name, how)
        found = resume(again)
        assert found is not None and found.identical(wanted)
    for how, name in zip(
        DAMAGE, ["zarr.json", "value/zarr.json", "x/c/0", "x/zarr.json"], strict=True
    ):
        again = Path(shutil.copytree(path, tmp_path / how))
        damage(again / name, how)
        with pytest.raises(Damaged, match=f"is damaged: {name} .*, or overwrite to replace it"):
            resume(again)
        assert storage.find(again, REQUEST, overwrite=True) is None
    found = resume(again, overwrite=True)
    assert found is not None and found.identical(wanted)


def test_a_full_disk_is_named_and_the_same_again_resumes(tmp_path, monkeypatch):
    path, full = tmp_path / "a.zarr", []
    put = zarr_put()

    def refuse(file: Path, *args: Any, **options: Any) -> Any:
        if full and full[0] in file.as_posix():
            raise OSError(errno.ENOSPC, "No space left on device")
        return put(file, *args, **options)

    monkeypatch.setattr("zarr.storage._local._put", refuse)
    said = f"{path} cannot be written: No space left on device: run the same again"
    full.append("word/c/1")
    for overwrite, how in ((False, ""), (True, ", without overwrite,")):
        with pytest.raises(NotWritten) as failure:
            resume(path, overwrite=overwrite)
        assert str(failure.value) == f"{said}{how} to resume from {path}"
    full[0] = "new/zarr.json"
    with pytest.raises(NotWritten) as failure:
        saved(tmp_path / "b.zarr")
    assert str(failure.value) == said.replace("a.zarr", "b.zarr")
    full.clear()
    found = resume(path)
    assert found is not None and found["word"].values.tolist() == WORDS.tolist()
    assert [place.name for place in tmp_path.iterdir()] == ["a.zarr"]


def zarr_put() -> Any:
    from zarr.storage import _local

    return _local._put


# ------------------------------------------------------------------------------------------- audit


def tried(path: Path, name: str, wanted: xr.Dataset) -> str:
    """What comes of damage to a file: an error that names it, or the data set as it was."""
    try:
        found = resume(path)
    except Damaged as error:
        other_version = name == "zarr.json" and "and this package reads" in str(error)
        assert f"{path} is damaged: {name} " in str(error) or other_version, error
        return "named"
    assert found is not None
    found.attrs = {key: found.attrs.get(key) for key in wanted.attrs}  # one may have another name
    assert found.identical(wanted)
    return "without effect"


def audit(
    folder: Path, trials: int, kinds: Sequence[str] = tuple(schema.KINDS), seed: int = 1
) -> Counter:
    """Random damage to one file at a time, of stores of some kinds, finished or not."""
    random, count = np.random.default_rng(seed), Counter()
    stores = {kind: folder / kind for kind in kinds}
    wanted = {kind: storage.save(example(kind), path, REQUEST) for kind, path in stores.items()}
    whole = resume(folder / "in pieces")
    assert whole is not None
    stores["in pieces"], wanted["in pieces"] = folder / "in pieces", whole
    for stop in range(PIECES):
        name = f"after {stop} pieces"
        stores[name], wanted[name] = folder / name, whole
        resume(folder / name, stop=stop)
    before = folder / "before its end"
    resume(before, stop=PIECES - 1)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("walker_jax.storage.pieces.Pieces.finish", lambda *_: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            resume(before)
    stores["before its end"], wanted["before its end"] = before, whole
    names = [*stores]
    for _ in range(trials):
        kind, how = names[random.integers(len(names))], random.choice([*DAMAGE])
        path = stores[kind]
        file = random.choice([*map(str, files_of(path))])
        name = Path(file).relative_to(path).as_posix()
        finished = kind in schema.KINDS or kind == "in pieces"
        trial = path if finished else Path(shutil.copytree(path, folder / "trial"))
        content = (trial / name).read_bytes()
        at, bit = int(random.integers(len(content))), int(random.integers(8))
        left = DAMAGE[how](content, at)
        if how == "flip":
            left = content[:at] + bytes([content[at] ^ 1 << bit]) + content[at + 1 :]
        (trial / name).unlink() if left is None else (trial / name).write_bytes(left)
        try:
            came = tried(trial, name, wanted[kind])
        except BaseException:
            print(f"{kind}, {name}: {how} at {at}, bit {bit}")
            raise
        count["finished" if finished else "unfinished", how, came] += 1
        (trial / name).write_bytes(content) if finished else shutil.rmtree(trial)
    return count


def test_some_random_damage_is_named_or_without_effect(tmp_path):
    count = audit(tmp_path, 24, ["refined volume"])
    assert sum(count.values()) == 24 and len(count) > 4


@pytest.mark.slow
def test_random_damage_is_named_or_without_effect(tmp_path):
    count = audit(tmp_path, 10_000)
    print(*(f"{', '.join(what)}: {number}" for what, number in sorted(count.items())), sep="\n")
    assert count["finished", "flip", "named"] > 1000

"""Results on disk: labelled data sets as Zarr, written whole or not at all, or piece by piece.

A data set carries, in its attribute `request`, what was asked for, as JSON. The same request finds
its result again; any other is refused the place unless it is told to overwrite. One that is written
piece by piece carries an attribute `unfinished` until all of it is there; the same request goes on
with it. Each piece is a chunk of every array, and counts as written once its entry in the array
`written` is 1, which comes last.
"""

import hashlib
import importlib.util
import json
import math
import os
import shutil
import tempfile
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import filelock
import numpy as np

from walker_jax.checks import WrongUse

if TYPE_CHECKING:
    import xarray  # which takes half a second to load, and commands without a data set need not

LARGE = 2**28
"""Bytes from which on a data set is read when it is used, rather than at once."""
LOCK = "lock"
"""The file by which a run keeps others out of a folder."""
TRIES = 100
"""To take a lock that another run is just removing."""


class Occupied(WrongUse):
    """Something else stands where a result is to go: what it is, and the arguments that help."""

    def __str__(self):
        return ": ".join(self.args)


ELSEWHERE = "give another {}"
REPLACE = "give another {}, or overwrite to replace it"
RESUME = "run the same again"
"""What a note on an interruption begins with that says how its work is resumed."""


def find(path: Path, request: dict, *, overwrite: bool = False) -> "xarray.Dataset | None":
    """The result of `request` that stands at `path`, or None where it is still to be computed.

    Raises `Occupied` where something else stands there, unless `overwrite` is given and it is a
    data set; and `ValueError` where nothing can be written. What a killed run has left is put in
    order; else nothing is changed.
    """
    path = followed(path)
    with suppress(Occupied, OSError):  # of another run, or where one may only read
        if beside(path).exists():
            with held(path):
                pass
    data = standing(path)
    if data is not None and not overwrite:
        check_request(path, data.attrs, request)
        if not data.attrs.get("unfinished"):
            return data
    writable(path)
    if data is None and path.exists():
        raise Occupied(f"{path} exists and is not a data set", ELSEWHERE.format("out"))
    return None


def standing(path: Path) -> "xarray.Dataset | None":
    """The data set that stands at a place, if one does; of a whole one, nothing else."""
    try:
        if not (path / "zarr.json").is_file():
            return None
    except OSError:  # as of a name that is too long
        return None
    data = load(path)
    if data is None:  # again, as a run that ends removes arrays
        data = load(path)
    if data is None or data.attrs.get("unfinished") or "written" not in data:
        return data
    # a run ended here but for the last thing that it had to do
    with suppress(Occupied, OSError), held(path) as folder:
        tidy(path, folder)
    return data.drop_vars([*data["written"].attrs["aside"], "written"], errors="ignore")


def followed(path: Path) -> Path:
    """Where a link leads, so that one place has one name."""
    return path.resolve() if os.path.islink(path) else path


def check_request(path: Path, attributes: Mapping, request: dict) -> None:
    """Raises `Occupied` for the attributes of another result, and says what is other."""
    there = attributes.get("request")
    if there == canonical(request):
        return
    try:
        other = differences(json.loads(str(there)), json.loads(canonical(request)))
    except (TypeError, ValueError):  # nothing that was written here
        other = ""
    raise Occupied(f"{path} holds another result{other}", REPLACE.format("out"))


def differences(there: dict, wanted: dict, within: str = "") -> str:
    """The first thing in which what stands somewhere is not what is wanted, in words."""
    for name in sorted(there | wanted, key=lambda name: name != "command"):
        old, new = there.get(name), wanted.get(name)
        if isinstance(old, dict) and isinstance(new, dict) and old != new:
            return differences(old, new, f"{within}{name} ")
        if old != new:
            said = json.dumps(old) if name in there else "none"
            return f" ({within}{name}: {said}, not {json.dumps(new)})"
    return ""


def writable(path: Path) -> None:
    """Raises `ValueError` where no file can be made beside `path`."""
    folder = path.absolute().parent
    try:
        if not folder.is_dir():
            raise WrongUse(f"{path} cannot be written: there is no folder {folder}")
        if not os.access(folder, os.W_OK | os.X_OK):
            raise WrongUse(f"{path} cannot be written: no permission for the folder {folder}")
        beside(path).exists()  # refuses a name too long for that one's
        tempfile.TemporaryFile(dir=folder).close()  # refused on what is read only, also to root
    except OSError as error:
        raise WrongUse(f"{path} cannot be written: {error.strerror}") from None


def save(data: "xarray.Dataset", path: Path, request: dict) -> "xarray.Dataset":
    """Write a data set at `path`, in the place of any that stands there; returns it as written."""
    path, data = followed(path), data.assign_attrs(request=canonical(request))
    with held(path) as folder:
        data.to_zarr(folder / "new", consolidated=False, write_empty_chunks=True)
        put(folder, path)
    return data


def beside(path: Path) -> Path:
    """The hidden folder of the run that writes at `path`."""
    return path.absolute().with_name(f".{path.name}.walker-jax")


@contextmanager
def held(path: Path) -> Iterator[Path]:
    """Nobody else writes at `path` meanwhile. Gives a hidden folder beside it, removed at the end.

    What a killed run left there is put in order first. Raises `Occupied` while another run holds
    the place, which ends with its process, however that ends.
    """
    folder = beside(path)
    lock = taken(folder, path)
    try:
        restore(folder, path)
        mend(path)
        yield folder
    finally:
        try:
            restore(folder, path)
            shutil.rmtree(folder, ignore_errors=True)
        finally:
            lock.release()


def taken(folder: Path, path: Path) -> filelock.BaseFileLock:
    """The lock of the folder of `path`, which is made."""
    lock = filelock.FileLock(folder / LOCK, blocking=False)
    for _ in range(TRIES):
        try:
            folder.mkdir(exist_ok=True)
            lock.acquire()
            return lock
        except (FileNotFoundError, FileExistsError):  # another run is just removing it
            continue
        except (filelock.Timeout, PermissionError):  # a run of this user, or of another one
            raise Occupied(
                f"{path} is being written by another run", f"wait, or {ELSEWHERE.format('out')}"
            ) from None
    raise Occupied(f"{path} cannot be written: {folder} is in the way")


def put(folder: Path, path: Path) -> None:
    """Put the new data set in the folder at `path`, in the place of what stands there."""
    if path.exists():
        path.rename(folder / "old")
    (folder / "new").rename(path)
    restore(folder, path)


def restore(folder: Path, path: Path) -> None:
    """Put back what stood at `path` if nothing came in its place; remove what else there is."""
    old, new = folder / "old", folder / "new"
    if old.exists() and not path.exists():
        old.rename(path)
    if old.exists() and new.exists():
        raise Occupied(f"{path} came in the way of data sets that are in {folder}: move it away")
    for left in folder.iterdir():
        if left.is_dir() and not left.is_symlink():
            shutil.rmtree(left)
        elif left.name != LOCK:
            left.unlink()


def mend(path: Path) -> None:
    """Remove from a data set what Zarr was at when a run ended: files half written, no arrays."""
    if (path / "zarr.json").is_file():
        for left in [*path.rglob("*.partial")]:
            left.unlink()
        for array in path.iterdir():
            with suppress(OSError):  # which holds something
                array.rmdir()


@contextmanager
def resumable(
    path: Path, begun: Callable[[], bool] = lambda: True, *, overwrite: bool = False
) -> Iterator[None]:
    """What interrupts the work within carries a note that the same again resumes from `path`.

    `begun` is whether anything is there to resume from, `overwrite` whether that was given.
    """
    try:
        yield
    except Exception:
        raise
    except BaseException as interruption:
        if begun():
            how = ", without overwrite," if overwrite else ""
            interruption.add_note(f"{RESUME}{how} to resume from {path}")
        raise


@contextmanager
def draft_of(path: Path) -> Iterator[Path]:
    """A file that takes the place of `path` at the end, if all goes well, or is removed."""
    draft = path.with_name(f".new.{path.name}")
    try:
        yield draft
        draft.replace(path)
    finally:
        draft.unlink(missing_ok=True)


def write(path: Path, text: str) -> None:
    """Write a file at `path`, in the place of any that stands there, whole or not at all."""
    with draft_of(path) as draft:
        draft.write_text(text, encoding="utf-8")


def load(path: Path) -> "xarray.Dataset | None":
    """The data set at `path`, or None where it cannot be read."""
    try:
        return opened(path)
    except Exception:  # whatever is wrong with a foreign or damaged store
        return None


def group_at(path: Path, mode: Literal["r", "r+"]) -> Any:
    """The Zarr group at `path`."""
    import zarr  # which takes long to load, and only runs with a place on disk need it

    return zarr.open_group(path, mode=mode)


def opened(path: Path) -> "xarray.Dataset":
    """The data set at `path`, in memory; but one that is large is read when it is used."""
    import xarray

    with warnings.catch_warnings():  # of arrays that a run is about to begin
        warnings.filterwarnings("ignore", "Object at .* is not recognized")
        data = xarray.open_zarr(path, consolidated=False, chunks=None)
        if not data.attrs.get("unfinished"):
            for name, array in group_at(path, "r").arrays():
                if array.nchunks_initialized < array.nchunks:  # which would read as zeros
                    raise OSError(f"{path} is damaged: chunks of {name} are missing")
    return data if data.nbytes > LARGE else data.load()


class Pieces(NamedTuple):
    """A data set on disk whose arrays are written by pieces, blocks of their first axes."""

    path: Path
    folder: Path
    """Beside it."""
    group: Any
    shape: tuple[int, ...]
    """Of the axes that are cut."""
    block: tuple[int, ...]
    """How much of each is in a piece; less in the last ones."""
    notes: Any
    """What was noted when it was begun."""

    @property
    def counts(self) -> tuple[int, ...]:
        """How many pieces there are along each axis."""
        return pieces_along(self.shape, self.block)

    @property
    def count(self) -> int:
        """How many pieces there are."""
        return math.prod(self.counts)

    def place(self, piece: int) -> tuple[int, ...]:
        """Which piece along each axis it is."""
        return tuple(int(i) for i in np.unravel_index(piece, self.counts))

    def at(self, piece: int) -> tuple[slice, ...]:
        """Its part of the arrays."""
        ends = zip(self.place(piece), self.block, self.shape, strict=True)
        return tuple(slice(i * size, min((i + 1) * size, whole)) for i, size, whole in ends)

    def missing(self) -> list[int]:
        """Pieces that are not written yet."""
        return np.flatnonzero(self.array("written")[...] == 0).tolist()

    def array(self, name: str) -> Any:
        """One of the arrays; all its chunks are written, so that it is known which are missing."""
        return self.group[name].with_config({"write_empty_chunks": True})

    def read(self, name: str, piece: int) -> np.ndarray:
        """What an array holds of a piece."""
        return np.asarray(self.array(name)[self.at(piece)])

    def write(self, piece: int, values: Mapping[str, Any], *, done: bool = False) -> None:
        """Write a piece's parts of some arrays; the piece is written if these are all, `done`."""
        at, place = self.at(piece), self.place(piece)
        for name, value in values.items():
            array = self.array(name)
            part = [one.stop - one.start for one in at]
            array[at] = np.reshape(value, (*part, *array.shape[len(at) :]))
            chunk = *place, *[0] * (array.ndim - len(place))
            flush(self.path / name / array.metadata.encode_chunk_key(chunk))
        if done:
            self.array("written")[place] = 1

    def finish(self, data: "xarray.Dataset") -> None:
        """Add what is found at the end, and remove the arrays that were of use on the way."""
        attributes = dict(self.group.attrs)
        data.assign_attrs(attributes).to_zarr(
            self.path, mode="a", consolidated=False, write_empty_chunks=True
        )
        final = data.attrs | {"request": attributes["request"]}
        group_at(self.path, "r+").attrs.put(final)  # in one go: the data set is whole
        tidy(self.path, self.folder)


@contextmanager
def pieces(
    path: Path,
    request: dict,
    data: "xarray.Dataset",
    arrays: "Mapping[str, xarray.Variable]",
    block: tuple[int, ...],
    notes: Callable[[], Any],
    *,
    aside: Sequence[str] = (),
    overwrite: bool = False,
) -> Iterator[Pieces]:
    """A data set to be written piece by piece, begun, or gone on with where it is unfinished.

    **Arguments:**

    - `request`: by which it is known again.
    - `data`: what there is besides the arrays, from the beginning.
    - `arrays`: each the shape, and everywhere the value that it has where nothing is written yet.
      Their first axes, the same in all, are cut into pieces.
    - `block`: how much of each of these axes is in a piece; of one gone on with, as before.
    - `notes`: called once, when it is begun; what it returns, in terms of JSON, is kept until the
      end.
    - `aside`: arrays that are of use on the way only.
    - `overwrite`: whether to begin anew, in the place of what stands there.

    Nobody else writes to it meanwhile: raises `Occupied` where another process does, or something
    else stands there, and `ValueError` where nothing can be written.
    """
    path = followed(path)
    writable(path)
    with held(path) as folder:
        if overwrite or not path.exists():
            kept = {"request": canonical(request), "unfinished": 1, "notes": json.dumps(notes())}
            begin(folder / "new", data.assign_attrs(kept), arrays, block, aside)
            put(folder, path)
        try:
            group = group_at(path, "r+")
        except Exception as error:  # whatever is wrong with a foreign or damaged store
            raise Occupied(
                f"{path} exists and is not a data set", ELSEWHERE.format("out")
            ) from error
        check_request(path, group.attrs, request)
        if not group.attrs.get("unfinished"):
            raise Occupied(f"{path} has just been finished by another run: ask again to have it")
        name, array = next(iter(arrays.items()))
        shape, block = array.shape[: len(block)], group[name].chunks[: len(block)]
        with resumable(path, overwrite=overwrite):
            yield Pieces(path, folder, group, shape, block, json.loads(str(group.attrs["notes"])))


def begin(
    path: Path,
    data: "xarray.Dataset",
    arrays: "Mapping[str, xarray.Variable]",
    block: tuple[int, ...],
    aside: Sequence[str],
) -> None:
    """Make a store of pieces, none of them written."""
    data.to_zarr(path, consolidated=False, write_empty_chunks=True)
    group = group_at(path, "r+")
    for name, array in arrays.items():
        group.create_array(
            name,
            shape=array.shape,
            chunks=(*map(min, block, array.shape), *array.shape[len(block) :]),
            dtype=array.dtype,
            fill_value=array.values.flat[0],
            dimension_names=[str(dim) for dim in array.dims],
            attributes=dict(array.attrs),
        )
    count = pieces_along(next(iter(arrays.values())).shape, block)
    group.create_array(
        "written",
        shape=count,
        chunks=(1,) * len(count),
        dtype="int8",
        dimension_names=[f"piece{i}" for i in range(len(count))],
        attributes={"aside": list(aside)},
    )


def pieces_along(shape: Sequence[int], block: Sequence[int]) -> tuple[int, ...]:
    """How many blocks there are along each of the first axes of a shape."""
    return tuple(-(-whole // size) for whole, size in zip(shape, block, strict=False))


def tidy(path: Path, folder: Path) -> None:
    """Remove from a data set that is whole what was of use on the way."""
    if not (path / "written").exists():  # another run was faster
        return
    aside = group_at(path, "r")["written"].attrs["aside"]
    for name in (*aside, "written"):  # this one last: it says that there is something to do
        if (path / name).exists():
            (path / name).rename(folder / name)


def flush(file: Path) -> None:
    """Make sure that a file is on the disk, whatever happens next."""
    for place in (file, file.parent):
        try:
            number = os.open(place, os.O_RDONLY if place.is_dir() else os.O_RDWR)
        except PermissionError:  # folders cannot be opened on Windows
            continue
        try:
            os.fsync(number)
        finally:
            os.close(number)


def export(path: Path, file: Path, *, overwrite: bool = False) -> "xarray.Dataset":
    """Copy the data set at `path` to a NetCDF file; returns it.

    Raises `Occupied` where another file stands there, or `path` is no data set or is unfinished;
    `ValueError` where nothing can be written, or h5netcdf is not installed.
    """
    if None in map(importlib.util.find_spec, ("h5netcdf", "h5py")):
        raise WrongUse("NetCDF takes h5netcdf and h5py: pip install 'walker_jax[netcdf]'")
    writable(file)
    if file.exists() and not (overwrite and file.is_file()):
        raise Occupied(f"{file} exists", REPLACE.format("file"))
    data = load(path) if path.is_dir() else None
    if data is None:
        raise Occupied(f"{path} is not a data set")
    if data.attrs.get("unfinished"):
        raise Occupied(f"{path} is unfinished: the command that began it goes on with it")
    small = {name: {"zlib": True} for name in data.variables if data[name].dtype.kind in "iuf"}
    with draft_of(file) as draft:
        data.to_netcdf(draft, engine="h5netcdf", encoding=small)
    return data


def check_picture(
    path: Path, request: dict, *, overwrite: bool = False, argument: str = "figure"
) -> None:
    """Raises as `find` does where a picture of `request` cannot go; one of it may stand there.

    `argument` is the name of that by which the place was given.
    """
    writable(path)
    if not path.exists():
        return
    known = path.is_file() and (overwrite or signature(request).encode() in path.read_bytes())
    if not known:
        raise Occupied(f"{path} is something else", REPLACE.format(argument))


def signature(request: dict) -> str:
    """What a picture of `request` carries as its title, by which it is known again."""
    return f"walker-jax {hashlib.sha256(canonical(request).encode()).hexdigest()}"


def canonical(request: dict) -> str:
    return json.dumps(request, sort_keys=True)

"""Results that are written piece by piece, and resumed.

Such a data set has an attribute `unfinished` until it is complete; the same request resumes it.
Each piece is a chunk of every array. It counts as written once its entry in the array `written`,
which is set last, is 1.
"""

import json
import math
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from walker_jax.checks import NotWritten
from walker_jax.storage import damage, places
from walker_jax.storage.places import RESUME_HINT, StoreConflict, open_group, writing
from walker_jax.storage.requests import canonical_json, check_request
from walker_jax.storage.runs import exclusive, move_into_place

if TYPE_CHECKING:
    import xarray  # takes half a second to load, which commands without a data set avoid


@contextmanager
def resumable(
    path: Path, begun: Callable[[], bool] = lambda: True, *, overwrite: bool = False
) -> Iterator[None]:
    """Add a note to any interruption: the same call resumes the work from `path`.

    `begun` tells whether there is anything to resume from, `overwrite` whether it was given.
    """
    how = f"{RESUME_HINT}{', without overwrite,' if overwrite else ''} to resume from {path}"
    try:
        yield
    except NotWritten as failure:
        if not begun():
            raise
        raise NotWritten(failure.args[0], how, of="overwrite") from failure.__cause__
    except BaseException as interruption:
        if not isinstance(interruption, Exception) and begun():
            interruption.add_note(how)
        raise


class Pieces(NamedTuple):
    """A data set on disk whose arrays are written by pieces, blocks of their first axes."""

    path: Path
    group: Any
    shape: tuple[int, ...]
    """Shape of the axes that are cut."""
    block: tuple[int, ...]
    """Length of a piece along each of these axes; the last pieces may be shorter."""
    notes: Any
    """The notes made when it was begun."""
    names: tuple[str, ...]
    """Names of the arrays that are cut."""
    aside: tuple[str, ...]
    """Names of the auxiliary arrays, which are removed at the end."""

    @property
    def counts(self) -> tuple[int, ...]:
        """Number of pieces along each axis."""
        return tuple(map(lambda whole, size: -(-whole // size), self.shape, self.block))

    @property
    def count(self) -> int:
        """Number of pieces."""
        return math.prod(self.counts)

    def place(self, piece: int) -> tuple[int, ...]:
        """Return the number of a piece along each axis."""
        return tuple(int(i) for i in np.unravel_index(piece, self.counts))

    def at(self, piece: int) -> tuple[slice, ...]:
        """Return the slices of the arrays that a piece covers."""
        ends = zip(self.place(piece), self.block, self.shape, strict=True)
        return tuple(slice(i * size, min((i + 1) * size, whole)) for i, size, whole in ends)

    def missing(self) -> list[int]:
        """Return the pieces that are not written yet, or are damaged."""
        arrays = [self.array(name) for name in ("written", *self.names)]

        def is_there(array: Any, piece: int) -> bool:
            try:
                return damage.is_intact((self.path / self.chunk_path(array, piece)).read_bytes())
            except OSError:
                return False

        pieces = range(self.count)
        return [i for i in pieces if not all(is_there(array, i) for array in arrays)]

    def array(self, name: str) -> Any:
        """Return an array that writes even empty chunks, so that missing ones can be told."""
        return self.group[name].with_config({"write_empty_chunks": True})

    def read(self, name: str, piece: int) -> np.ndarray:
        """Read an array's part of a piece."""
        array = self.array(name)
        with damage.name_damage(self.path, self.chunk_path(array, piece)):
            return np.asarray(array[self.at(piece)])

    def chunk_path(self, array: Any, piece: int) -> str:
        """Return the relative path of the file with an array's part of a piece."""
        place = self.place(piece)
        return damage.chunk_path(array, (*place, *[0] * (array.ndim - len(place))))

    def write(self, piece: int, values: Mapping[str, Any], *, done: bool = False) -> None:
        """Write a piece's parts of some arrays; with `done`, the piece counts as written.

        Arrays without values then get chunks too, so that a missing chunk is known to be lost.
        """
        at = self.at(piece)
        names = (*values, *(self.names if done else ()))
        with writing(self.path):
            for name in dict.fromkeys(names):
                array = self.array(name)
                shape = *(one.stop - one.start for one in at), *array.shape[len(at) :]
                array[at] = np.reshape(values[name], shape) if name in values else array.fill_value
                sync_to_disk(self.path / self.chunk_path(array, piece))
            if done:
                self.array("written")[self.place(piece)] = 1

    def finish(self, data: "xarray.Dataset") -> None:
        """Add the data known only at the end. Auxiliary arrays go when the place is released."""
        kept, data = dict(self.group.attrs), data.copy()
        final, data.attrs = data.attrs | {"request": kept["request"]}, kept
        with writing(self.path):
            damage.write_dataset(data, self.path, "a")
            # In one go, which completes the data set.
            damage.seal(self.path, final, without=(*self.aside, "written"))


@contextmanager
def open_pieces(
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
    """Begin a data set to be written piece by piece, or resume an unfinished one.

    **Arguments:**

    - `request`: identifies the result.
    - `data`: everything besides the arrays, written at the beginning.
    - `arrays`: arrays of the final shape, with the values that stand for missing pieces. Their
      first axes, the same in all, are cut into pieces.
    - `block`: length of a piece along each of these axes; a resumed data set keeps its own.
    - `notes`: called once, at the beginning; its JSON result is kept until the end.
    - `aside`: names of auxiliary arrays, which are removed at the end.
    - `overwrite`: whether to begin anew, replacing what is there.

    The place is reserved meanwhile. Raises `StoreConflict` if another process writes there, or
    something else is there, and `ValueError` if nothing can be written.
    """
    path = places.resolve_link(path)
    places.check_writable(path)
    with exclusive(path) as folder:
        if overwrite or not path.exists():
            kept = {"request": canonical_json(request), "unfinished": 1}
            kept["notes"] = json.dumps(notes())
            with writing(path):
                create_store(folder / "new", data.assign_attrs(kept), arrays, block)
                move_into_place(folder, path)
        try:
            damage.check_metadata(path)
            group = open_group(path, "r+")
        except StoreConflict:
            raise
        except Exception as error:  # files written by other programs can fail in any way
            raise places.foreign(path) from error
        check_request(path, group.attrs, request)
        if not group.attrs.get("unfinished"):
            raise StoreConflict(f"another run has just completed {path}: run again to read it")
        noted, names = json.loads(str(group.attrs["notes"])), tuple(n for n in arrays if n in group)
        with resumable(path, overwrite=overwrite):
            first, axes = group[names[0]], len(block)
            shape, begun_with = first.shape[:axes], first.chunks[:axes]
            yield Pieces(path, group, shape, begun_with, noted, names, (*aside,))


def create_store(
    path: Path,
    data: "xarray.Dataset",
    arrays: "Mapping[str, xarray.Variable]",
    block: tuple[int, ...],
) -> None:
    """Create a store without any written piece."""
    damage.write_dataset(data, path)
    group = open_group(path, "r+")
    for name, array in arrays.items():
        group.create_array(
            name,
            shape=array.shape,
            chunks=(*map(min, block, array.shape), *array.shape[len(block) :]),
            dtype=str if array.dtype.kind == "U" else array.dtype,
            fill_value=array.values.flat[0],
            compressors=damage.codecs(),
            dimension_names=[str(dim) for dim in array.dims],
            attributes=dict(array.attrs),
        )
    count = group[next(iter(arrays))].cdata_shape[: len(block)]
    one_each: Any = {"shape": count, "chunks": (1,) * len(count), "dtype": "int8"}
    one_each["dimension_names"] = [f"piece{i}" for i in range(len(count))]
    group.create_array("written", compressors=damage.codecs(), **one_each)
    damage.seal(path)


def sync_to_disk(file: Path) -> None:
    """Make sure that a file is on disk, whatever happens next."""
    for place in (file, file.parent):
        try:
            number = os.open(place, os.O_RDONLY if place.is_dir() else os.O_RDWR)
        except PermissionError:  # folders cannot be opened on Windows
            continue
        try:
            os.fsync(number)
        finally:
            os.close(number)

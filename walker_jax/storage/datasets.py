"""Data sets that are found, read, and written whole or not at all."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from walker_jax.storage.damage import Damaged, seal, write_dataset
from walker_jax.storage.places import (
    ANOTHER_PLACE_OR_OVERWRITE,
    StoreConflict,
    check_writable,
    foreign,
    resolve_link,
    scratch_folder,
    writing,
)
from walker_jax.storage.requests import canonical_json, check_request
from walker_jax.storage.runs import exclusive, move_into_place, standing

if TYPE_CHECKING:
    import xarray  # takes half a second to load, which commands without a data set avoid


def find(path: Path, request: dict, *, overwrite: bool = False) -> "xarray.Dataset | None":
    """Return the result of `request` at `path`, or None if it is still to be computed.

    Raises `StoreConflict` if something else is there, unless `overwrite` is given and it is a data
    set of this package, damaged or not; and `ValueError` if nothing can be written there. Cleans up
    after a killed run; changes nothing else.
    """
    path = resolve_link(path)
    with suppress(StoreConflict, OSError):  # another run is writing, or the folder is read-only
        if scratch_folder(path).exists():
            with exclusive(path):
                pass
    return result_at(path, request, overwrite)


def result_at(path: Path, request: dict, overwrite: bool) -> "xarray.Dataset | None":
    """Return what `find` does, of a place where no killed run has left anything."""
    try:
        data = load(path)
    except Damaged as error:
        if not overwrite:
            hint = ANOTHER_PLACE_OR_OVERWRITE.format("out")
            raise Damaged(*error.args, hint, of="out overwrite") from error
        check_writable(path)
        return None
    if data is not None and not overwrite:
        check_request(path, data.attrs, request)
        if not data.attrs.get("unfinished"):
            return data
    check_writable(path)
    if data is None and path.exists():
        raise foreign(path)
    return None


def save(
    data: "xarray.Dataset", path: Path, request: dict, *, overwrite: bool = False
) -> "xarray.Dataset":
    """Write a data set at `path`, and return it as written.

    What has come there while it was computed is kept: the same result is returned, anything else
    raises `StoreConflict`, as in `find`.
    """
    with rewritable(path, request) as save_again:
        there = result_at(resolve_link(path), request, overwrite)
        return save_again(data) if there is None else there


@contextmanager
def rewritable(path: Path, request: dict) -> "Iterator[Callable[[xarray.Dataset], xarray.Dataset]]":
    """Reserve `path` for one run, and yield its `save`, which may be called repeatedly.

    Raises `StoreConflict` while another run writes there.
    """
    path = resolve_link(path)

    def save_again(data: "xarray.Dataset") -> "xarray.Dataset":
        data = data.assign_attrs(request=canonical_json(request))
        with writing(path):
            write_dataset(data, folder / "new")
            seal(folder / "new")
            move_into_place(folder, path)
        return data

    with exclusive(path) as folder:
        yield save_again


def load(path: Path) -> "xarray.Dataset | None":
    """Return the data set at `path`, or None if there is none; `Damaged` if it is damaged."""
    try:
        return open_dataset(path)
    except Damaged:
        raise
    except Exception:  # files written by other programs can fail in any way
        return None


def open_dataset(path: Path) -> "xarray.Dataset":
    """Open the data set at `path` in memory; a large or unfinished one is read when it is used.

    If another run replaces the data set in between, the new one is read; later, using what has not
    been read yet raises `StoreConflict`.
    """
    from walker_jax.storage.reading import edition, read_dataset

    while True:
        place = standing(path)
        before = place, edition(place)
        try:
            data = read_dataset(place)
            if before == (standing(path), edition(place)):
                return data
        except Exception:
            if before == (standing(path), edition(place)):
                raise

"""Results on disk: labelled data sets as Zarr, written whole or not at all, or piece by piece.

A data set carries, in its attribute `request`, what was asked for, as JSON. The same request finds
its result again; any other is refused the place unless it is told to overwrite. One that is written
piece by piece carries an attribute `unfinished` until all of it is there; the same request
resumes it. Each piece is a chunk of every array, and counts as written once its entry in the array
`written` is 1, which comes last.
"""

import importlib.util
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from walker_jax.checks import WrongUse
from walker_jax.storage.checksums import (
    check_chunks,
    check_metadata,
    seal,
    with_checksums,
)
from walker_jax.storage.damage import (
    CHECKSUMS,
    METADATA,
    VERSION,
    Damaged,
    is_own_array,
    name_damage,
)
from walker_jax.storage.places import (
    ANOTHER_PLACE,
    ANOTHER_PLACE_OR_OVERWRITE,
    StoreConflict,
    atomic_file,
    check_writable,
    exclusive,
    move_into_place,
    open_group,
    remove_arrays,
    resolve_link,
    scratch_folder,
    writing,
)
from walker_jax.storage.requests import canonical_json, check_request

if TYPE_CHECKING:
    import xarray  # which takes half a second to load, and commands without a data set need not


LAZY_FROM_BYTES = 2**28
"""Bytes from which on a data set is read when it is used, rather than at once."""


def find(path: Path, request: dict, *, overwrite: bool = False) -> "xarray.Dataset | None":
    """The result of `request` that stands at `path`, or None where it is still to be computed.

    Raises `StoreConflict` where something else stands there, unless `overwrite` is given and it is
    a data set of this package, damaged or not; and `ValueError` where nothing can be written.
    Puts in order what a killed run has left; changes nothing else.
    """
    path = resolve_link(path)
    with suppress(StoreConflict, OSError):  # of another run, or where one may only read
        if scratch_folder(path).exists():
            with exclusive(path):
                pass
    try:
        data = read_existing(path)
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
        raise StoreConflict(
            f"{path} exists and is not a data set", ANOTHER_PLACE.format("out"), of="out"
        )
    return None


def read_existing(path: Path) -> "xarray.Dataset | None":
    """The data set that stands at a place, if one does; what else is in a whole one is removed."""
    try:
        if not path.is_dir():
            return None
    except OSError:  # as of a name that is too long
        return None
    try:
        data = load(path)
    except Damaged:
        data = None
    if data is None:  # again, as a run that ends removes arrays
        data = load(path)
    whole = data is not None and not data.attrs.get("unfinished")
    if whole and is_own_array(path / "written"):
        # a run ended here but for the last thing that it had to do
        with suppress(StoreConflict, OSError), exclusive(path) as folder:
            kept = check_metadata(path)
            others = {place.name for place in path.iterdir() if is_own_array(place)} - {*kept}
            # this one last: it says that there is something to do
            remove_arrays(path, folder, sorted(others, key=lambda name: name == "written"))
    return data


def save(data: "xarray.Dataset", path: Path, request: dict) -> "xarray.Dataset":
    """Write a data set at `path`, in the place of any that stands there; returns it as written."""
    with rewritable(path, request) as save_again:
        return save_again(data)


@contextmanager
def rewritable(path: Path, request: dict) -> "Iterator[Callable[[xarray.Dataset], xarray.Dataset]]":
    """Reserve `path` for one run, and give its `save`, which may be called again and again.

    Raises `StoreConflict` while another run writes there.
    """
    path = resolve_link(path)

    def save_again(data: "xarray.Dataset") -> "xarray.Dataset":
        data = data.assign_attrs(request=canonical_json(request))
        with writing(path):
            with_checksums(data).to_zarr(
                folder / "new", consolidated=False, write_empty_chunks=True
            )
            seal(folder / "new")
            move_into_place(folder, path)
        return data

    with exclusive(path) as folder:
        yield save_again


def load(path: Path) -> "xarray.Dataset | None":
    """The data set at `path`, or None where there is none; `Damaged` where one is damaged."""
    try:
        return open_dataset(path)
    except Damaged:
        raise
    except Exception:  # whatever is wrong with what others have written
        return None


def open_dataset(path: Path) -> "xarray.Dataset":
    """The data set at `path`, in memory; a large or unfinished one is read when it is used."""
    import xarray

    kept = check_metadata(path)
    with name_damage(path, METADATA):
        group = open_group(path, "r")
    with (
        name_damage(path, "it"),
        warnings.catch_warnings(),
    ):  # of arrays that a run is about to begin
        warnings.filterwarnings("ignore", "Object at .* is not recognized")
        unfinished = bool(group.attrs.get("unfinished"))
        for name in kept:
            array = group[name]
            if not unfinished or array.metadata.dimension_names == (name,):  # which is read at once
                check_chunks(path, array)
        data = xarray.open_zarr(path, consolidated=False, chunks=None)
    data.attrs = {name: one for name, one in data.attrs.items() if name not in (CHECKSUMS, VERSION)}
    if unfinished:
        return data
    data = data.drop_vars(data.variables.keys() - kept)
    if data.nbytes > LAZY_FROM_BYTES:
        return data
    for name, variable in data.variables.items():
        with name_damage(path, str(name)):
            variable.load()
    return data


def export(path: Path, file: Path, *, overwrite: bool = False) -> "xarray.Dataset":
    """Copy the data set at `path` to a NetCDF file; returns it.

    Raises `StoreConflict` where another file stands there, or `path` is no data set, or is damaged
    or unfinished; `ValueError` where nothing can be written, or h5netcdf is not installed.
    """
    if None in map(importlib.util.find_spec, ("h5netcdf", "h5py")):
        raise WrongUse("NetCDF takes h5netcdf and h5py: pip install 'walker_jax[netcdf]'")
    check_writable(file)
    if file.exists() and not (overwrite and file.is_file()):
        hint = ANOTHER_PLACE_OR_OVERWRITE.format("file")
        raise StoreConflict(f"{file} exists", hint, of="overwrite")
    try:
        data = load(path) if path.is_dir() else None
    except Damaged as error:
        hint = "the command that made it replaces it with overwrite"
        raise Damaged(*error.args, hint, of="overwrite") from error
    if data is None:
        raise StoreConflict(f"{path} is not a data set", "give the place of one")
    if data.attrs.get("unfinished"):
        raise StoreConflict(f"{path} is unfinished: the command that began it resumes it")
    small = {name: {"zlib": True} for name in data.variables if data[name].dtype.kind in "iuf"}
    with atomic_file(file) as draft:
        data.to_netcdf(draft, engine="h5netcdf", encoding=small)
    return data

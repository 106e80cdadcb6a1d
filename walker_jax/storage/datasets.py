"""Results on disk: labelled data sets as Zarr, written whole or not at all, or piece by piece.

The attribute `request` of a data set holds, as JSON, what was asked for. The same request finds its
result again; any other request is refused the place, unless it is told to overwrite. `pieces` has
the data sets that are written piece by piece.
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
    name_damage,
)
from walker_jax.storage.places import (
    ANOTHER_PLACE,
    ANOTHER_PLACE_OR_OVERWRITE,
    StoreConflict,
    atomic_file,
    check_writable,
    open_group,
    resolve_link,
    scratch_folder,
    writing,
)
from walker_jax.storage.requests import canonical_json, check_request
from walker_jax.storage.runs import exclusive, move_into_place
from walker_jax.storage.tables import as_tex, table_of, write_mat

if TYPE_CHECKING:
    import xarray  # takes half a second to load, which commands without a data set avoid


FORMATS = ".nc", ".csv", ".tex", ".mat"
"""Endings of files to which data sets are copied."""
LAZY_FROM_BYTES = 2**28
"""Size (bytes) from which a data set is read when it is used, rather than at once."""


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
        raise StoreConflict(
            f"{path} exists and is not a data set", ANOTHER_PLACE.format("out"), of="out"
        )
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
            with_checksums(data).to_zarr(
                folder / "new", consolidated=False, write_empty_chunks=True
            )
            seal(folder / "new")
            move_into_place(folder, path)
        return data

    with exclusive(path) as folder:
        yield save_again


def load(path: Path) -> "xarray.Dataset | None":
    """Return the data set at `path`, or None if there is none; `Damaged` if it is damaged."""
    with suppress(Exception):  # a run that ends may just be removing arrays
        return open_dataset(path)
    try:
        return open_dataset(path)
    except Damaged:
        raise
    except Exception:  # files written by other programs can fail in any way
        return None


def open_dataset(path: Path) -> "xarray.Dataset":
    """Open the data set at `path` in memory; a large or unfinished one is read when it is used."""
    import xarray

    kept = check_metadata(path)
    with name_damage(path, METADATA):
        group = open_group(path, "r")
    with name_damage(path, "it"), warnings.catch_warnings():
        # Zarr warns of arrays that a run is about to begin.
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


def export(
    path: Path,
    file: Path,
    *,
    overwrite: bool = False,
    convert: "Callable[[xarray.Dataset], xarray.Dataset]" = lambda data: data,
    rows: str | None = None,
) -> "xarray.Dataset":
    """Copy the data set at `path` to a file, as its ending says, and return it.

    **Arguments:**

    - `file`: .nc, NetCDF; .mat, MATLAB; .csv or .tex, a table.
    - `convert`: is given the data set, and returns the one that is written, as in other units.
    - `rows`: the variable whose dimensions are the rows of a table, as in `table_of`.

    Raises `StoreConflict` if there is another file, or if `path` is not a data set, or a damaged or
    unfinished one; `ValueError` if nothing can be written, or h5netcdf is not installed.
    """
    if file.suffix not in FORMATS:
        raise WrongUse(f"file must end in one of {', '.join(FORMATS)}, not {file}", of="file")
    if file.suffix == ".nc" and None in map(importlib.util.find_spec, ("h5netcdf", "h5py")):
        raise WrongUse("NetCDF takes h5netcdf and h5py: pip install 'walker_jax[netcdf]'")
    check_writable(file)
    if file.exists() and not (overwrite and file.is_file()):
        hint = ANOTHER_PLACE_OR_OVERWRITE.format("file")
        raise StoreConflict(f"{file} exists", hint, of="overwrite")
    try:
        data = load(path)
    except Damaged as error:
        hint = "the command that made it replaces it with overwrite"
        raise Damaged(*error.args, hint, of="overwrite") from error
    if data is None:
        raise StoreConflict(f"{path} is not a data set", "give the place of one")
    if data.attrs.get("unfinished"):
        raise StoreConflict(f"{path} is unfinished: the command that began it resumes it")
    data = convert(data)
    with atomic_file(file) as draft:
        if file.suffix == ".nc":
            small = [name for name in data.variables if data[name].dtype.kind in "iuf"]
            encoding = {name: {"zlib": True} for name in small}
            data.to_netcdf(draft, engine="h5netcdf", encoding=encoding)
        elif file.suffix == ".mat":
            write_mat(data, draft)
        else:
            table = table_of(data, rows)
            csv = file.suffix == ".csv"
            lines = table.to_csv(index=False, lineterminator="\n") if csv else as_tex(table)
            draft.write_text(lines, encoding="utf-8")
    return data

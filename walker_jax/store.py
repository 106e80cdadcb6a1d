"""Results on disk: labelled data sets as Zarr, written whole or not at all.

A data set carries, in its attribute `request`, what was asked for, as JSON. The same request finds
its result again; any other is refused the place unless it is told to overwrite.
"""

import hashlib
import json
import os
import shutil
import tempfile
from pathlib import Path

import xarray as xr


class Occupied(ValueError):
    """Something else stands where a result is to go."""


def find(path: Path, request: dict, *, overwrite: bool = False) -> xr.Dataset | None:
    """The result of `request` that stands at `path`, or None where it is still to be computed.

    Raises `Occupied` where something else stands there, unless `overwrite` is given and it is a
    data set; and `ValueError` where nothing can be written. Nothing is changed.
    """
    writable(path)
    if not path.exists():
        return None
    data = load(path) if (path / "zarr.json").is_file() else None
    if data is None:
        raise Occupied(f"{path} exists and is not a data set: name another place")
    if overwrite:
        return None
    if data.attrs.get("request") == canonical(request):
        return data
    raise Occupied(f"{path} holds another result: name another place, or overwrite it")


def writable(path: Path) -> None:
    """Raises `ValueError` where no file can be made beside `path`."""
    folder = path.absolute().parent
    try:
        if not folder.is_dir():
            raise ValueError(f"{path} cannot be written: there is no folder {folder}")
        if not os.access(folder, os.W_OK | os.X_OK):
            raise ValueError(f"{path} cannot be written: no permission for the folder {folder}")
        (folder / f".{path.name}.{'x' * 8}").exists()  # refuses a name too long for a draft's
        tempfile.TemporaryFile(dir=folder).close()  # refused on what is read only, also to root
    except OSError as error:
        raise ValueError(f"{path} cannot be written: {error.strerror}") from None


def save(data: xr.Dataset, path: Path, request: dict) -> xr.Dataset:
    """Write a data set at `path`, in the place of any that stands there; returns it as written."""
    data = data.assign_attrs(request=canonical(request))
    draft = Path(tempfile.mkdtemp(prefix=f".{path.name}.", dir=path.absolute().parent))
    try:
        data.to_zarr(draft / "new", consolidated=False)
        if path.exists():
            path.rename(draft / "old")
        (draft / "new").rename(path)
    finally:
        if (draft / "old").exists() and not path.exists():
            (draft / "old").rename(path)  # interrupted in between
        shutil.rmtree(draft, ignore_errors=True)
    return data


def write(path: Path, text: str) -> None:
    """Write a file at `path`, in the place of any that stands there, whole or not at all."""
    draft = path.with_name(f".{path.name}.new")
    draft.write_text(text, encoding="utf-8")
    draft.replace(path)


def load(path: Path) -> xr.Dataset | None:
    """The data set at `path`, in memory, or None where it cannot be read."""
    try:
        with xr.open_zarr(path, consolidated=False) as data:
            return data.load()
    except Exception:  # whatever is wrong with a foreign or damaged store
        return None


def check_picture(path: Path, request: dict, *, overwrite: bool = False) -> None:
    """Raises as `find` does where a picture of `request` cannot go; one of it may stand there."""
    writable(path)
    if not path.exists():
        return
    known = path.is_file() and (overwrite or signature(request).encode() in path.read_bytes())
    if not known:
        raise Occupied(f"{path} is something else: name another place, or overwrite it")


def signature(request: dict) -> str:
    """What a picture of `request` carries as its title, by which it is known again."""
    return f"walker-jax {hashlib.sha256(canonical(request).encode()).hexdigest()}"


def canonical(request: dict) -> str:
    return json.dumps(request, sort_keys=True)

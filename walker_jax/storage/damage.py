"""Damaged data sets: how errors name them, and how those of this package are recognised.

A data set is recognised by the attributes of its group. If these are lost, the folder must hold
nothing but arrays, one of them as written by this package. Only a recognised data set may be
replaced.
"""

import json
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from walker_jax.storage.places import StoreConflict

CHECKSUMS, VERSION = "checksums", "schema_version"
"""The attributes of a group that hold digests of metadata, and the version of the tables."""
METADATA = "zarr.json"
FILE = re.compile(rf"([^/]+/)?{METADATA}|[^/]+/c(/\d+)*|.*\.partial")
"""Relative paths of the files of a data set, half-written ones included."""


class Damaged(StoreConflict):
    """A data set of this package is damaged or of another version; names the place and the part."""


def damaged(path: Path, part: str, why: str = "is not as it was written") -> Damaged:
    return Damaged(f"{path} is damaged: {part} {why}")


@contextmanager
def name_damage(path: Path, part: str, why: str = "cannot be read") -> Iterator[None]:
    """Turn errors of Zarr or a codec into `Damaged`, if `path` is a data set of this package."""
    try:
        yield
    except (StoreConflict, MemoryError, PermissionError):
        raise
    except Exception as error:
        if is_own_dataset(path):
            raise damaged(path, part, why) from error
        raise


def read_metadata(folder: Path) -> dict[str, Any]:
    """Read the metadata of a group or an array; `OSError` or `ValueError` if there are none."""
    found = json.loads((folder / METADATA).read_bytes())
    if not (isinstance(found, dict) and isinstance(found.setdefault("attributes", {}), dict)):
        raise ValueError
    return found


def is_own_dataset(path: Path) -> bool:
    """Return whether a folder is a data set of this package, damaged or not."""
    try:
        if {"request", CHECKSUMS} & read_metadata(path)["attributes"].keys():
            return True
    except (OSError, ValueError):
        pass
    return path.is_dir() and holds_arrays_alone(path)


def holds_arrays_alone(path: Path) -> bool:
    """Return whether a folder holds only parts of arrays, and metadata of one as written here."""
    for file in path.rglob("*"):
        name = file.relative_to(path).as_posix()
        if file.is_symlink() or not (file.is_dir() or FILE.fullmatch(name)):
            return False
    return any(is_own_array(folder) for folder in path.iterdir())


def is_own_array(folder: Path) -> bool:
    """Return whether a folder holds an array whose chunks are encoded as by this package."""
    try:
        used = [one["name"] for one in read_metadata(folder)["codecs"]]
    except (OSError, ValueError, KeyError, TypeError):
        return False
    return used[1:] == ["zstd", "crc32c"]

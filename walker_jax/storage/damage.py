"""Damaged data sets: how they are named, and which of them are known to be of this package.

One is known by the attributes of its group, or, where these are lost, if the folder holds arrays
alone, of which one is as they are written here. Only what is known may be replaced.
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
"""Relative paths of the files of a data set, those half written among them."""


class Damaged(StoreConflict):
    """A data set of this package is not as it is written now: its place, and the part concerned."""


def damaged(path: Path, part: str, why: str = "is not as it was written") -> Damaged:
    return Damaged(f"{path} is damaged: {part} {why}")


@contextmanager
def name_damage(path: Path, part: str, why: str = "cannot be read") -> Iterator[None]:
    """Raises `Damaged` for what Zarr or a codec raises, if `path` is a data set of this package."""
    try:
        yield
    except (StoreConflict, MemoryError, PermissionError):
        raise
    except Exception as error:
        if is_own_dataset(path):
            raise damaged(path, part, why) from error
        raise


def read_metadata(folder: Path) -> dict[str, Any]:
    """The metadata of a group or an array; `OSError` or `ValueError` if there are none."""
    found = json.loads((folder / METADATA).read_bytes())
    if not (isinstance(found, dict) and isinstance(found.setdefault("attributes", {}), dict)):
        raise ValueError
    return found


def is_own_dataset(path: Path) -> bool:
    """Whether a folder is known to be a data set of this package, damaged or not."""
    try:
        if {"request", CHECKSUMS} & read_metadata(path)["attributes"].keys():
            return True
    except (OSError, ValueError):
        pass
    return path.is_dir() and holds_arrays_alone(path)


def holds_arrays_alone(path: Path) -> bool:
    """Whether a folder holds parts of arrays alone, and of one the metadata as written here."""
    for file in path.rglob("*"):
        name = file.relative_to(path).as_posix()
        if file.is_symlink() or not (file.is_dir() or FILE.fullmatch(name)):
            return False
    return any(is_own_array(folder) for folder in path.iterdir())


def is_own_array(folder: Path) -> bool:
    """Whether a folder holds an array whose chunks are coded as those of this package are."""
    try:
        used = [one["name"] for one in read_metadata(folder)["codecs"]]
    except (OSError, ValueError, KeyError, TypeError):
        return False
    return used[1:] == ["zstd", "crc32c"]

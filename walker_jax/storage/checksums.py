"""Checksums of data sets, by which damage on the disk is found, and named.

Each chunk ends with its CRC-32C, which Zarr's codec of that name writes and checks. The attribute
`checksums` of the group holds a digest of the metadata of each array, and one of the group's own.
Data sets of earlier versions have none of these, and are read without.

A damaged data set may be replaced if it is known to be one of this package: by the attributes of
the group, or, where these are lost, if the folder holds arrays alone, of which one is as they are
written here.
"""

import functools
import hashlib
import json
import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from walker_jax.storage.places import StoreConflict

if TYPE_CHECKING:
    import xarray  # which takes half a second to load, and commands without a data set need not

ATTRIBUTE = "checksums"
METADATA = "zarr.json"
DIGEST_BYTES = 8
CRC_BYTES = 4
FILE = re.compile(rf"([^/]+/)?{METADATA}|[^/]+/c(/\d+)*|.*\.partial")
"""Relative paths of the files of a data set, those half written among them."""


class Damaged(StoreConflict):
    """A data set of this package is not as it was written: its place, and the part concerned."""


def damaged(path: Path, part: str, why: str = "is not as it was written") -> Damaged:
    return Damaged(f"{path} is damaged: {part} {why}")


@contextmanager
def naming(path: Path, part: str, why: str = "cannot be read") -> Iterator[None]:
    """Raises `Damaged` for what Zarr or a codec raises, if `path` is a data set of this package."""
    try:
        yield
    except (StoreConflict, MemoryError, PermissionError):
        raise
    except Exception as error:
        if is_own(path):
            raise damaged(path, part, why) from error
        raise


# ------------------------------------------------------------------------------------------ chunks


def with_checksums(data: "xarray.Dataset") -> "xarray.Dataset":
    """The same data set, to be written with a checksum for each chunk."""
    data = data.copy()
    for variable in data.variables.values():
        variable.encoding = {"compressors": codecs()}
    return data


def codecs() -> tuple:
    """What is done to the bytes of each chunk."""
    from zarr.codecs import Crc32cCodec, ZstdCodec

    return ZstdCodec(), Crc32cCodec()


def is_intact(chunk: bytes) -> bool:
    """Whether a chunk ends with its checksum."""
    import google_crc32c

    end = len(chunk) - CRC_BYTES
    return end >= 0 and google_crc32c.value(chunk[:end]) == int.from_bytes(chunk[end:], "little")


@functools.cache
def checked_store() -> type:
    """A store of Zarr's which names the chunk that is damaged; its codec does not know it."""
    from zarr.storage import LocalStore  # which takes long to load

    class CheckedStore(LocalStore):
        """Files of a data set, all of whose chunks have checksums."""

        def checked(self, key: str, found: Any) -> Any:
            if found is None or key.endswith(METADATA) or is_intact(found.to_bytes()):
                return found
            raise damaged(self.root, key)

        async def get(self, key: str, *args: Any, **kwargs: Any) -> Any:
            return self.checked(key, await super().get(key, *args, **kwargs))

        def get_sync(self, key: str, *args: Any, **kwargs: Any) -> Any:
            return self.checked(key, super().get_sync(key, *args, **kwargs))

    return CheckedStore


def open_group(path: Path, mode: Literal["r", "r+"], *, checked: bool) -> Any:
    """The Zarr group at `path`; damaged chunks are named if its chunks have checksums."""
    import zarr  # which takes long to load, and only runs with a place on disk need it

    return zarr.open_group(checked_store()(path) if checked else path, mode=mode)


def check_present(path: Path, arrays: Mapping[str, Any]) -> None:
    """Raises an error for arrays some of whose chunks are missing, which would read as zeros."""
    import numpy as np

    for name, array in arrays.items():
        if array.nchunks_initialized == array.nchunks:
            continue
        counts = map(lambda whole, size: -(-whole // size), array.shape, array.chunks)
        for place in np.ndindex(*counts):
            key = f"{name}/{array.metadata.encode_chunk_key(place)}"
            with naming(path, key, "is missing"):
                (path / key).stat()


# ---------------------------------------------------------------------------------------- metadata


def read_metadata(folder: Path) -> dict[str, Any]:
    """The metadata of a group or an array; `OSError` or `ValueError` if there are none."""
    found = json.loads((folder / METADATA).read_bytes())
    if not (isinstance(found, dict) and isinstance(found.setdefault("attributes", {}), dict)):
        raise ValueError
    return found


def digest(metadata: dict) -> str:
    words = json.dumps(metadata, sort_keys=True).encode()
    return hashlib.blake2b(words, digest_size=DIGEST_BYTES).hexdigest()


def seal(path: Path, attributes: dict | None = None, without: Iterable[str] = ()) -> None:
    """Give a group checksums of its metadata, and other attributes if there are any, in one go.

    Arrays `without` a checksum are about to be removed.
    """
    arrays = sorted({file.parent.name for file in path.glob(f"*/{METADATA}")} - {*without})
    sums = {name: digest(read_metadata(path / name)) for name in arrays}
    group = read_metadata(path)
    given = group["attributes"] if attributes is None else attributes
    known = json.loads(json.dumps(given))  # as it will be read
    sums = {"": digest(group | {"attributes": known | {ATTRIBUTE: sums}})} | sums
    open_group(path, "r+", checked=True).attrs.put(known | {ATTRIBUTE: json.dumps(sums)})


def check_metadata(path: Path) -> list[str] | None:
    """The arrays of a data set that have checksums; None if it is of an earlier version.

    Raises `Damaged` where metadata are not as they were written.
    """
    with naming(path, METADATA):
        found = read_metadata(path)
        attributes = found["attributes"]
        if ATTRIBUTE not in attributes:
            return None
        sums = json.loads(attributes[ATTRIBUTE])
        own = sums.pop("")
    if digest(found | {"attributes": attributes | {ATTRIBUTE: sums}}) != own:
        raise damaged(path, METADATA)
    for name, wanted in sums.items():
        with naming(path, f"{name}/{METADATA}"):
            if digest(read_metadata(path / name)) != wanted:
                raise damaged(path, f"{name}/{METADATA}")
    return [*sums]


def is_own(path: Path) -> bool:
    """Whether a folder is known to be a data set of this package, damaged or not."""
    try:
        return bool({"request", ATTRIBUTE} & read_metadata(path)["attributes"].keys())
    except (OSError, ValueError):
        return path.is_dir() and holds_arrays_alone(path)


def holds_arrays_alone(path: Path) -> bool:
    """Whether a folder holds parts of arrays alone, and of one the metadata as written here."""
    for file in path.rglob("*"):
        name = file.relative_to(path).as_posix()
        if file.is_symlink() or not (file.is_dir() or FILE.fullmatch(name)):
            return False
    return any(is_own_array(folder) for folder in path.iterdir())


def is_own_array(folder: Path) -> bool:
    try:
        used = [one["name"] for one in read_metadata(folder)["codecs"]]
    except (OSError, ValueError, KeyError, TypeError):
        return False
    return used[1:] == ["zstd", "crc32c"]

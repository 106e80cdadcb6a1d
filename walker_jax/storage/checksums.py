"""Checksums of data sets, by which damage on the disk is found, and named.

Each chunk ends with its CRC-32C, which Zarr's codec of that name writes and checks. The attribute
`checksums` of the group holds a digest of the metadata of each array, and one of the group's own.
Data sets of earlier versions have none of these, and are read without.
"""

import hashlib
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from walker_jax.storage.damage import CHECKSUMS, METADATA, damaged, naming, read_metadata

if TYPE_CHECKING:
    import xarray  # which takes half a second to load, and commands without a data set need not

DIGEST_BYTES = 8


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


def open_group(path: Path, mode: Literal["r", "r+"], *, checked: bool) -> Any:
    """The Zarr group at `path`; damaged chunks are named if its chunks have checksums."""
    import zarr  # which takes long to load, and only runs with a place on disk need it

    from walker_jax.storage.checked_store import CheckedStore

    return zarr.open_group(CheckedStore(path) if checked else path, mode=mode)


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
    sums = {"": digest(group | {"attributes": known | {CHECKSUMS: sums}})} | sums
    open_group(path, "r+", checked=True).attrs.put(known | {CHECKSUMS: json.dumps(sums)})


def check_metadata(path: Path) -> list[str] | None:
    """The arrays of a data set that have checksums; None if it is of an earlier version.

    Raises `Damaged` where metadata are not as they were written.
    """
    with naming(path, METADATA):
        found = read_metadata(path)
        attributes = found["attributes"]
        if CHECKSUMS not in attributes:
            return None
        sums = json.loads(attributes[CHECKSUMS])
        own = sums.pop("")
    if digest(found | {"attributes": attributes | {CHECKSUMS: sums}}) != own:
        raise damaged(path, METADATA)
    for name, wanted in sums.items():
        with naming(path, f"{name}/{METADATA}"):
            if digest(read_metadata(path / name)) != wanted:
                raise damaged(path, f"{name}/{METADATA}")
    return [*sums]

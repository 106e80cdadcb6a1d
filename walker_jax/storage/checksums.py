"""Checksums of data sets, which reveal damage on disk and name the damaged part.

Each chunk ends with its CRC-32C, which Zarr's codec of that name writes and checks. The attribute
`checksums` of the group holds a digest of the metadata of each array, and one of the group's own.
"""

import hashlib
import json
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import google_crc32c

from walker_jax.storage.damage import (
    CHECKSUMS,
    METADATA,
    VERSION,
    Damaged,
    damaged,
    name_damage,
    read_metadata,
)
from walker_jax.storage.places import open_group
from walker_jax.storage.schema import SCHEMA_VERSION

if TYPE_CHECKING:
    import xarray  # which takes half a second to load, and commands without a data set need not

DIGEST_BYTES = 8
CRC_BYTES = 4


# ------------------------------------------------------------------------------------------ chunks


def with_checksums(data: "xarray.Dataset") -> "xarray.Dataset":
    """Return the data set with an encoding that writes a checksum for each chunk."""
    data = data.copy()
    for variable in data.variables.values():
        variable.encoding = {"compressors": codecs()}
    return data


def codecs() -> tuple:
    """Return the codecs for the bytes of each chunk."""
    from zarr.codecs import Crc32cCodec, ZstdCodec

    return ZstdCodec(), Crc32cCodec()


def is_intact(chunk: bytes) -> bool:
    """Return whether a chunk ends with its checksum."""
    end = len(chunk) - CRC_BYTES
    return end >= 0 and google_crc32c.value(chunk[:end]) == int.from_bytes(chunk[end:], "little")


def check_chunks(path: Path, array: Any) -> None:
    """Raise `Damaged` if a chunk of an array is missing, or is not as it was written.

    A missing chunk would read as zeros. Zarr's codec finds altered chunks too, but does not name
    them.
    """
    import numpy as np

    for place in np.ndindex(*array.cdata_shape):
        key = f"{array.basename}/{array.metadata.encode_chunk_key(place)}"
        with name_damage(path, key, "is missing"):
            (path / key).stat()
        if not is_intact((path / key).read_bytes()):
            raise damaged(path, key)


# ---------------------------------------------------------------------------------------- metadata


def hash_metadata(metadata: dict) -> str:
    words = json.dumps(metadata, sort_keys=True).encode()
    return hashlib.blake2b(words, digest_size=DIGEST_BYTES).hexdigest()


def seal(path: Path, attributes: dict | None = None, without: Iterable[str] = ()) -> None:
    """Write checksums of a group's metadata, and other attributes if given, in one go.

    Arrays `without` a checksum are about to be removed.
    """
    arrays = sorted({file.parent.name for file in path.glob(f"*/{METADATA}")} - {*without})
    sums = {name: hash_metadata(read_metadata(path / name)) for name in arrays}
    group = read_metadata(path)
    given = group["attributes"] if attributes is None else attributes
    known = json.loads(json.dumps(given | {VERSION: SCHEMA_VERSION}))  # as it will be read back
    sums = {"": hash_metadata(group | {"attributes": known | {CHECKSUMS: sums}})} | sums
    open_group(path, "r+").attrs.put(known | {CHECKSUMS: json.dumps(sums)})


def check_metadata(path: Path) -> list[str]:
    """Return the arrays of a data set that have checksums.

    Raises `Damaged` if metadata are not as they were written, or have another schema.
    """
    with name_damage(path, METADATA):
        found = read_metadata(path)
        attributes = found["attributes"]
        version = attributes.get(VERSION)
        if version != SCHEMA_VERSION and "request" in attributes:
            said = "says no schema version" if version is None else f"has schema version {version}"
            raise Damaged(f"{path} {said}, and this package reads {SCHEMA_VERSION}")
        sums = json.loads(attributes[CHECKSUMS])
        own = sums.pop("")
    if hash_metadata(found | {"attributes": attributes | {CHECKSUMS: sums}}) != own:
        raise damaged(path, METADATA)
    for name, wanted in sums.items():
        with name_damage(path, f"{name}/{METADATA}"):
            if hash_metadata(read_metadata(path / name)) != wanted:
                raise damaged(path, f"{name}/{METADATA}")
    return [*sums]

"""Damaged data sets: how they are found, how errors name them, and which of them may be replaced.

Each chunk ends with its CRC-32C, which Zarr's codec of that name writes and checks. The attribute
`checksums` of the group holds a digest of the metadata of each array, and one of the group's own.

A data set of this package is recognised by the attributes of its group. If these are lost, the
folder must hold nothing but arrays, one of them as written by this package. Only a recognised data
set may be replaced.
"""

import hashlib
import json
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import google_crc32c

from walker_jax.storage.places import StoreConflict, open_group
from walker_jax.storage.requests import canonical_json
from walker_jax.storage.schema import SCHEMA_VERSION

if TYPE_CHECKING:
    import xarray  # which takes half a second to load, and commands without a data set need not

CHECKSUMS, VERSION = "checksums", "schema_version"
"""The attributes of a group that hold digests of metadata, and the version of the tables."""
METADATA = "zarr.json"
FILE = re.compile(rf"([^/]+/)?{METADATA}|[^/]+/c(/\d+)*|.*\.partial")
"""Relative paths of the files of a data set, half-written ones included."""
DIGEST_BYTES, CRC_BYTES = 8, 4


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


# ------------------------------------------------------------------------------------------ chunks


def codecs() -> tuple:
    """Return the codecs for the bytes of each chunk."""
    from zarr.codecs import Crc32cCodec, ZstdCodec

    return ZstdCodec(), Crc32cCodec()


def write_dataset(data: "xarray.Dataset", path: Path, mode: Any = "w-") -> None:
    """Write a data set with a checksum for each chunk, or add it to one; `seal` must follow."""
    data = data.copy()
    for variable in data.variables.values():
        variable.encoding = {"compressors": codecs()}
    data.to_zarr(path, mode=mode, consolidated=False, write_empty_chunks=True)


def is_intact(chunk: bytes) -> bool:
    """Return whether a chunk ends with its checksum."""
    end = len(chunk) - CRC_BYTES
    return end >= 0 and google_crc32c.value(chunk[:end]) == int.from_bytes(chunk[end:], "little")


def chunk_path(array: Any, place: tuple[int, ...]) -> str:
    """Return the path of a chunk of an array in its data set."""
    return f"{array.basename}/{array.metadata.encode_chunk_key(place)}"


def check_chunks(path: Path, array: Any) -> None:
    """Raise `Damaged` if a chunk of an array is missing, or is not as it was written."""
    import numpy as np

    for place in np.ndindex(*array.cdata_shape):
        key = chunk_path(array, place)
        with name_damage(path, key, "is missing"):
            (path / key).stat()
        if not is_intact((path / key).read_bytes()):
            raise damaged(path, key)


# ---------------------------------------------------------------------------------------- metadata


def read_metadata(folder: Path) -> dict[str, Any]:
    """Read the metadata of a group or an array; `OSError` or `ValueError` if there are none."""
    found = json.loads((folder / METADATA).read_bytes())
    if not (isinstance(found, dict) and isinstance(found.setdefault("attributes", {}), dict)):
        raise ValueError
    return found


def hash_metadata(metadata: dict, **attributes: Any) -> str:
    """Return a digest of metadata, with other attributes besides or instead of its own."""
    whole = metadata | {"attributes": metadata["attributes"] | attributes}
    words = canonical_json(whole).encode()
    return hashlib.blake2b(words, digest_size=DIGEST_BYTES).hexdigest()


def seal(path: Path, attributes: dict | None = None, without: Iterable[str] = ()) -> None:
    """Write checksums of a group's metadata, and other attributes if given, in one go.

    Arrays `without` a checksum are about to be removed.
    """
    arrays = sorted({file.parent.name for file in path.glob(f"*/{METADATA}")} - {*without})
    sums = {name: hash_metadata(read_metadata(path / name)) for name in arrays}
    group = read_metadata(path)
    known = group["attributes"] if attributes is None else attributes
    # As they will be read back.
    group["attributes"] = json.loads(json.dumps(known | {VERSION: SCHEMA_VERSION}))
    sums = {"": hash_metadata(group, checksums=sums)} | sums
    open_group(path, "r+").attrs.put(group["attributes"] | {CHECKSUMS: json.dumps(sums)})


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
    if hash_metadata(found, checksums=sums) != own:
        raise damaged(path, METADATA)
    for name, wanted in sums.items():
        with name_damage(path, f"{name}/{METADATA}"):
            if hash_metadata(read_metadata(path / name)) != wanted:
                raise damaged(path, f"{name}/{METADATA}")
    return [*sums]


# ------------------------------------------------------------------------------------- recognition


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

"""Reading of a data set: the arrays that have checksums, whose chunks must not change meanwhile.

This module loads xarray and Zarr, which takes half a second; `datasets` imports it to read.
"""

import warnings
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import xarray
import zarr
from zarr.storage import LocalStore

from walker_jax.storage import damage
from walker_jax.storage.damage import METADATA, check_metadata, name_damage
from walker_jax.storage.places import StoreConflict

LAZY_FROM_BYTES = 2**28
"""Size (bytes) from which a data set is read when it is used, rather than at once."""


def edition(path: Path) -> tuple[int, int] | None:
    """Identify what is at `path`, as whatever replaces or completes a data set writes metadata."""
    try:
        found = (path / METADATA).stat()
    except OSError:
        return None
    return found.st_ino, found.st_mtime_ns


class Reading(LocalStore):
    """The store of a data set: it has some arrays alone, and checks their chunks.

    Chunks of another edition are refused, damaged ones, and missing ones of `whole` arrays, which
    would read as zeros.
    """

    def __init__(self, path: Path, arrays: list[str]):
        super().__init__(path, read_only=True)
        self.edition, self.arrays, self.whole = edition(path), arrays, arrays

    async def list_dir(self, prefix: str) -> AsyncIterator[str]:
        for name in self.arrays if prefix == "" else ():
            yield name

    async def get(self, key: str, *args: Any, **options: Any) -> Any:
        content = await super().get(key, *args, **options)
        name, chunk, _ = key.partition("/c")
        if chunk:
            if edition(self.root) != self.edition:
                raise StoreConflict(f"{self.root} was replaced while it was read", "load it again")
            if content is None and name in self.whole:
                raise damage.damaged(self.root, key, "is missing")
            if content is not None and not damage.is_intact(content.to_bytes()):
                raise damage.damaged(self.root, key)
        return content


def read_dataset(path: Path) -> xarray.Dataset:
    """Return the data set at `path`; a large or unfinished one is read when it is used."""
    store = Reading(path, check_metadata(path))
    with name_damage(path, METADATA):
        group = zarr.open_group(store, mode="r")
        complete = not group.attrs.get("unfinished")
    with name_damage(path, "it"), warnings.catch_warnings():
        # Zarr warns of arrays that a run removes just now.
        warnings.filterwarnings("ignore", "Object at .* is not recognized")
        arrays: dict[str, Any] = {name: group[name] for name in store.arrays}
        if not complete:  # only coordinates need be whole
            along = {name: one.metadata.dimension_names for name, one in arrays.items()}
            store.whole = [name for name in along if along[name] == (name,)]
        data = xarray.open_zarr(store, consolidated=False, chunks=None)
    own = damage.CHECKSUMS, damage.VERSION
    data.attrs = {name: one for name, one in data.attrs.items() if name not in own}
    if complete and data.nbytes > LAZY_FROM_BYTES:
        for array in arrays.values():
            damage.check_chunks(path, array)
    elif complete:
        for name, variable in data.variables.items():
            with name_damage(path, str(name)):
                variable.load()
    return data

"""A store of Zarr's that names a damaged chunk, which Zarr's codec cannot: it does not know it.

Loading Zarr takes long, so this file is imported by those alone who open a data set.
"""

from typing import Any

import google_crc32c
from zarr.storage import LocalStore

from walker_jax.storage.damage import METADATA, damaged

CRC_BYTES = 4


def is_intact(chunk: bytes) -> bool:
    """Whether a chunk ends with its checksum."""
    end = len(chunk) - CRC_BYTES
    return end >= 0 and google_crc32c.value(chunk[:end]) == int.from_bytes(chunk[end:], "little")


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

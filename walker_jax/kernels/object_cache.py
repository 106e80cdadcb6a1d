"""An on-disk cache of machine code, so that processes share what one of them has compiled.

A file holds the code of one program, or the compressed source of a long one that may have to be
optimised later. Its name is a hash of all that the content depends on. It begins with a checksum of
name and content, so that a truncated, damaged or misnamed file is not loaded. Files are written
under a temporary name and then renamed, so any number of processes may share the folder. If the
folder cannot be read or written, or if others can write there, each process compiles its own
programs.
"""

import contextlib
import hashlib
import os
import tempfile
from collections.abc import Callable
from pathlib import Path

import platformdirs

from walker_jax.identity import Cache
from walker_jax.kernels.private_files import (
    FILE_MODE,
    is_private,
    make_private,
    read_private,
    warn_once,
)

VARIABLE = "WALKER_JAX_CACHE_DIR"
"""The environment variable that names the folder; if empty, no code is kept."""
MAX_BYTES = 2**28
"""Bytes above which the least recently used files of the folder are removed, about two thousand
programs; each process that writes may exceed it by one of `PARTS`."""
PARTS = 16
"""A process looks at the folder when it first writes there, and then after each so many-th part of
`MAX_BYTES`, as listing all files at every write would take 20 ms each time."""
SUFFIX = ".kernel"
"""Suffix of every file in the folder, temporary ones included."""
CHECKSUM_BYTES = 32
"""Length of the checksum at the start of a file: 256 bits, as for SHA-256."""
unseen: Cache = Cache()
"""Bytes that this process has written to a folder since it looked at it."""


def cache_folder() -> Path | None:
    """Return the folder of compiled programs: `VARIABLE`, or one in the user's cache folder.

    None if the variable is empty, or for a user without a home, as a number in a container may be.
    """
    folder = os.environ.get(VARIABLE)
    if folder is None:
        try:
            folder = platformdirs.user_cache_dir("walker-jax")
        except RuntimeError:
            return None
    return Path(folder) if folder else None


def private_folder(name: str, *, make: bool = False) -> Path | None:
    """Return a folder of compiled programs; None, with one warning, if others can write there."""
    folder = cache_folder()
    if folder is None:
        return None
    if make:
        make_private(folder / name)
    for place in (folder, folder / name):
        if not is_private(place.stat()):
            warn_once(f"compiled programs in {place} are")
            return None
    return folder / name


def load_or_compile(name: str, compile: Callable[[], bytes]) -> bytes:
    """Load the code of a name from disk, or compile it; a name stands for one code only."""
    code = recall(name)
    if code is None:
        code = compile()
        store(name, code)
    return code


def recall(name: str) -> bytes | None:
    """Read the code under a name from disk, if it is intact."""
    try:
        folder = private_folder("kernels")
        return read(folder / f"{name}{SUFFIX}") if folder else None
    except OSError:
        return None


def store(name: str, code: bytes) -> None:
    """Write code to disk if possible."""
    with contextlib.suppress(OSError):
        folder = private_folder("kernels", make=True)
        if folder:
            write(folder / f"{name}{SUFFIX}", code)


def checksum(path: Path, code: bytes) -> bytes:
    return hashlib.blake2b(path.name.encode() + code, digest_size=CHECKSUM_BYTES).digest()


def read(path: Path) -> bytes | None:
    """Read the code in a file; None if its checksum is wrong or others may have written it."""
    content = read_private(path)
    if content is None:
        return None
    code = content[CHECKSUM_BYTES:]
    if content[:CHECKSUM_BYTES] != checksum(path, code):
        return None
    with contextlib.suppress(OSError):
        os.utime(path)  # marks it as used now
    return code


def write(path: Path, code: bytes) -> None:
    handle, scratch = tempfile.mkstemp(SUFFIX, dir=path.parent)
    try:
        with open(handle, "wb") as file:
            file.write(checksum(path, code) + code)
        os.chmod(scratch, FILE_MODE)
        os.replace(scratch, path)
    except BaseException:
        os.unlink(scratch)
        raise
    unseen[path.parent] = unseen.get(path.parent, MAX_BYTES) + len(code)
    if unseen[path.parent] > MAX_BYTES // PARTS:
        unseen[path.parent] = 0
        remove_oldest(path.parent)


def remove_oldest(folder: Path) -> None:
    """Remove the least recently used files, temporary ones included, beyond `MAX_BYTES`."""
    files = []
    for path in folder.glob(f"*{SUFFIX}"):
        with contextlib.suppress(FileNotFoundError):  # another process removed it
            status = path.stat()
            files.append((status.st_mtime, status.st_size, path))
    total = 0
    for _, size, path in sorted(files, reverse=True):
        total += size
        if total > MAX_BYTES:
            path.unlink(missing_ok=True)

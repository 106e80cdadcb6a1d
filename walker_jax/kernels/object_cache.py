"""Machine code on disk, so that a process need not compile what another one has.

A file holds the code of one program, and is named by the hash of all that the code depends on. It
begins with a hash of name and code, so that a file that is truncated, broken or another program's
is not loaded. Files are written whole under another name and then renamed: any number of processes
may share the folder. A folder that cannot be read or written costs no more than the compilation.
"""

import contextlib
import hashlib
import os
import tempfile
from collections.abc import Callable
from pathlib import Path

import platformdirs

VARIABLE = "WALKER_JAX_CACHE_DIR"
"""The environment variable that names the folder; nothing is kept where it is empty."""
LARGEST = 2**28
"""Bytes that the folder may hold, some thousand programs; the ones not used for longest go."""
SUFFIX = ".kernel"
DIGEST = 32  # bytes


def cache_folder() -> Path | None:
    """Where compiled programs are kept: the user's cache folder, unless `VARIABLE` says another."""
    folder = os.environ.get(VARIABLE, platformdirs.user_cache_dir("walker-jax"))
    return Path(folder) if folder else None


def cached(name: str, compile: Callable[[], bytes]) -> bytes:
    """The code of that name, from disk or compiled; a name stands for one code only."""
    folder = cache_folder()
    path = folder / "kernels" / f"{name}{SUFFIX}" if folder else None
    code = read(path) if path else None
    if code is None:
        code = compile()
        if path:
            with contextlib.suppress(OSError):
                write(path, code)
    return code


def checksum(path: Path, code: bytes) -> bytes:
    return hashlib.blake2b(path.name.encode() + code, digest_size=DIGEST).digest()


def read(path: Path) -> bytes | None:
    """The code in a file, None if there is none or it is not what was written."""
    try:
        content = path.read_bytes()
    except OSError:
        return None
    code = content[DIGEST:]
    if content[:DIGEST] != checksum(path, code):
        return None
    with contextlib.suppress(OSError):
        os.utime(path)  # it is in use
    return code


def write(path: Path, code: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, scratch = tempfile.mkstemp(SUFFIX, dir=path.parent)
    try:
        with open(handle, "wb") as file:
            file.write(checksum(path, code) + code)
        os.replace(scratch, path)
    except BaseException:
        os.unlink(scratch)
        raise
    remove_oldest(path.parent)


def remove_oldest(folder: Path) -> None:
    """Keep the files used last, what a killed process left among them, within `LARGEST` bytes."""
    files = []
    for path in folder.glob(f"*{SUFFIX}"):
        with contextlib.suppress(FileNotFoundError):  # another process removed it
            status = path.stat()
            files.append((status.st_mtime, status.st_size, path))
    total = 0
    for _, size, path in sorted(files, reverse=True):
        total += size
        if total > LARGEST:
            path.unlink(missing_ok=True)

"""Places on disk: what stands there, who may write, and how a whole result replaces it."""

import os
import shutil
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Literal

import filelock

from walker_jax.checks import NotWritten, WrongPlace

LOCK_FILE = "lock"
"""The file by which a run keeps others out of a folder."""
LOCK_ATTEMPTS = 100
"""To take a lock that another run is just removing."""


class StoreConflict(WrongPlace):
    """Something else stands where a result is to go: what it is, and the arguments that help."""


ANOTHER_PLACE = "give another {}"
ANOTHER_PLACE_OR_OVERWRITE = "give another {}, or overwrite to replace it"
RESUME_HINT = "run the same again"
"""What a note on an interruption begins with that says how its work is resumed."""


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Raises `NotWritten` for what the system refuses while `path` is written."""
    try:
        yield
    except OSError as error:
        reason = error.strerror or error
        raise NotWritten(f"{path} cannot be written: {reason}", RESUME_HINT) from error


def resolve_link(path: Path) -> Path:
    """Where a link leads, so that one place has one name."""
    return path.resolve() if os.path.islink(path) else path


def check_writable(path: Path) -> None:
    """Raises `WrongPlace` where no file can be made beside `path`."""
    folder = path.absolute().parent
    try:
        if not folder.is_dir():
            raise WrongPlace(f"{path} cannot be written: there is no folder {folder}: make it")
        if not os.access(folder, os.W_OK | os.X_OK):
            raise WrongPlace(f"{path} cannot be written: no permission for the folder {folder}")
        with suppress(FileNotFoundError):
            scratch_folder(path).stat()  # refuses a name too long for that one's
        tempfile.TemporaryFile(dir=folder).close()  # refused on what is read only, also to root
    except OSError as error:
        raise WrongPlace(f"{path} cannot be written: {error.strerror}") from None


def scratch_folder(path: Path) -> Path:
    """The hidden folder of the run that writes at `path`."""
    return path.absolute().with_name(f".{path.name}.walker-jax")


@contextmanager
def exclusive(path: Path) -> Iterator[Path]:
    """Nobody else writes at `path` meanwhile. Gives a hidden folder beside it, removed at the end.

    Puts in order first what a killed run left there. Raises `StoreConflict` while another run holds
    the place, which ends with its process, however that ends.
    """
    folder = scratch_folder(path)
    lock = acquire_lock(folder, path)
    try:
        restore(folder, path)
        remove_partial_files(path)
        yield folder
    finally:
        try:
            restore(folder, path)
            shutil.rmtree(folder, ignore_errors=True)
        finally:
            lock.release()


def acquire_lock(folder: Path, path: Path) -> filelock.BaseFileLock:
    """The lock of the folder of `path`, which is made."""
    lock = filelock.FileLock(folder / LOCK_FILE, blocking=False)
    with writing(path):
        for _ in range(LOCK_ATTEMPTS):
            try:
                folder.mkdir(exist_ok=True)
                lock.acquire()
                return lock
            except (FileNotFoundError, FileExistsError):  # another run is just removing it
                continue
            except (filelock.Timeout, PermissionError):  # a run of this user, or of another one
                wait = f"wait, or {ANOTHER_PLACE.format('out')}"
                raise StoreConflict(
                    f"{path} is being written by another run", wait, of="out"
                ) from None
    raise StoreConflict(f"{path} cannot be written: {folder} is in the way: move it away")


def move_into_place(folder: Path, path: Path) -> None:
    """Put the new data set in the folder at `path`, in the place of what stands there."""
    if path.exists():
        path.rename(folder / "old")
    (folder / "new").rename(path)
    restore(folder, path)


def restore(folder: Path, path: Path) -> None:
    """Put back what stood at `path` if nothing came in its place; remove what else there is."""
    old, new = folder / "old", folder / "new"
    if old.exists() and not path.exists():
        old.rename(path)
    if old.exists() and new.exists():
        raise StoreConflict(
            f"{path} came in the way of data sets that are in {folder}: move it away"
        )
    for left in folder.iterdir():
        if left.is_dir() and not left.is_symlink():
            shutil.rmtree(left)
        elif left.name != LOCK_FILE:
            left.unlink()


def remove_partial_files(path: Path) -> None:
    """Remove from a data set what Zarr was at when a run ended: files half written, no arrays."""
    if (path / "zarr.json").is_file():
        for left in [*path.rglob("*.partial")]:
            left.unlink()
        for array in path.iterdir():
            with suppress(OSError):  # which holds something
                array.rmdir()


@contextmanager
def atomic_file(path: Path) -> Iterator[Path]:
    """A file that takes the place of `path` at the end, if all goes well, or is removed."""
    draft = path.with_name(f".new.{path.name}")
    try:
        with writing(path):
            yield draft
            draft.replace(path)
    finally:
        draft.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write a file at `path`, in the place of any that stands there, whole or not at all."""
    with atomic_file(path) as draft:
        draft.write_text(text, encoding="utf-8")


def open_group(path: Path, mode: Literal["r", "r+"]) -> Any:
    """The Zarr group at `path`."""
    import zarr  # which takes long to load, and only runs with a place on disk need it

    return zarr.open_group(path, mode=mode)


def remove_arrays(path: Path, folder: Path, names: Iterable[str]) -> None:
    """Move arrays of a data set to a folder that is about to be removed."""
    for name in names:
        if (path / name).exists():  # another run may have been faster
            (path / name).rename(folder / name)

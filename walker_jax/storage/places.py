"""Places on disk: their contents, the lock for writing, and the replacement by a whole result."""

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
"""The file with which a run locks a folder."""
LOCK_ATTEMPTS = 100
"""Attempts to take a lock that another run is just removing."""


class StoreConflict(WrongPlace):
    """The place of a result is taken; says by what, and which arguments help."""


ANOTHER_PLACE = "give another {}"
ANOTHER_PLACE_OR_OVERWRITE = "give another {}, or overwrite to replace it"
RESUME_HINT = "run the same again"
"""Beginning of a note on an interruption that says how to resume the work."""


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Turn errors of the operating system while `path` is written into `NotWritten`."""
    try:
        yield
    except OSError as error:
        reason = error.strerror or error
        raise NotWritten(f"{path} cannot be written: {reason}", RESUME_HINT) from error


def resolve_link(path: Path) -> Path:
    """Follow a link, so that one place has one name."""
    return path.resolve() if os.path.islink(path) else path


def absolute(path: Path) -> Path:
    """Return the whole path; raise `WrongPlace` if the working folder has been removed."""
    try:
        return path.absolute()
    except FileNotFoundError:
        raise WrongPlace(
            f"{path} cannot be found: the working folder is gone: change to another, or give a "
            "whole path"
        ) from None


def check_writable(path: Path) -> None:
    """Raise `WrongPlace` if no file can be made beside `path`."""
    folder = absolute(path).parent
    try:
        if not folder.is_dir():
            raise WrongPlace(f"{path} cannot be written: there is no folder {folder}: make it")
        if not os.access(folder, os.W_OK | os.X_OK):
            raise WrongPlace(f"{path} cannot be written: no permission for the folder {folder}")
        with suppress(FileNotFoundError):
            scratch_folder(path).stat()  # refuses a name too long for the scratch folder's
        tempfile.TemporaryFile(dir=folder).close()  # refused where it is read-only, also to root
    except OSError as error:
        raise WrongPlace(f"{path} cannot be written: {error.strerror}") from None


def scratch_folder(path: Path) -> Path:
    """Return the hidden folder of the run that writes at `path`."""
    return absolute(path).with_name(f".{path.name}.walker-jax")


@contextmanager
def exclusive(path: Path) -> Iterator[Path]:
    """Reserve `path`, and yield a hidden folder beside it, which is removed at the end.

    First cleans up after a killed run. Raises `StoreConflict` while another run holds the place;
    its lock ends with its process, however that ends.
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
    """Make the folder of the run that writes at `path`, and lock it."""
    lock = filelock.FileLock(folder / LOCK_FILE, blocking=False)
    with writing(path):
        for _ in range(LOCK_ATTEMPTS):
            try:
                folder.mkdir(exist_ok=True)
                lock.acquire()
                return lock
            except (FileNotFoundError, FileExistsError):  # another run is just removing it
                continue
            except (filelock.Timeout, PermissionError):  # a run of this user, or of another
                wait = f"wait, or {ANOTHER_PLACE.format('out')}"
                raise StoreConflict(
                    f"{path} is being written by another run", wait, of="out"
                ) from None
    raise StoreConflict(f"{path} cannot be written: {folder} is in the way: move it away")


def move_into_place(folder: Path, path: Path) -> None:
    """Move the new data set in the folder to `path`, replacing what is there."""
    if path.exists():
        path.rename(folder / "old")
    (folder / "new").rename(path)
    restore(folder, path)


def restore(folder: Path, path: Path) -> None:
    """Restore the old data set at `path` if none has replaced it; remove everything else."""
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
    """Remove what Zarr was writing to a data set when a run ended: partial files, empty arrays."""
    if (path / "zarr.json").is_file():
        for left in [*path.rglob("*.partial")]:
            left.unlink()
        for array in path.iterdir():
            with suppress(OSError):  # the folder is not empty
                array.rmdir()


@contextmanager
def atomic_file(path: Path) -> Iterator[Path]:
    """Yield a file that replaces `path` at the end if all goes well, and is removed otherwise."""
    draft = path.with_name(f".new.{path.name}")
    try:
        with writing(path):
            yield draft
            draft.replace(path)
    finally:
        draft.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write a file at `path`, replacing any that is there, whole or not at all."""
    with atomic_file(path) as draft:
        draft.write_text(text, encoding="utf-8")


def open_group(path: Path, mode: Literal["r", "r+"]) -> Any:
    """Open the Zarr group at `path`."""
    import zarr  # takes long to load, and only runs with a place on disk need it

    return zarr.open_group(path, mode=mode)


def remove_arrays(path: Path, folder: Path, names: Iterable[str]) -> None:
    """Move arrays of a data set to a folder that is about to be removed."""
    for name in names:
        if (path / name).exists():  # another run may have been faster
            (path / name).rename(folder / name)

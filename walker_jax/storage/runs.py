"""The run that writes at a place: its lock, and what it leaves there, a whole result or nothing."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import filelock

from walker_jax.storage.damage import check_metadata, is_own_array
from walker_jax.storage.places import (
    ANOTHER_PLACE,
    StoreConflict,
    resolve_link,
    scratch_folder,
    writing,
)

LOCK_FILE = "lock"
"""The file with which a run locks a folder."""
LOCK_ATTEMPTS = 100
"""Attempts to take a lock that another run is just removing."""
WAIT = f"wait, or {ANOTHER_PLACE.format('out')}"


@contextmanager
def exclusive(path: Path) -> Iterator[Path]:
    """Reserve `path`, and yield a hidden folder beside it, which is removed at the end.

    First cleans up after a killed run. Raises `StoreConflict` while another run holds the place;
    its lock ends with its process, however that ends.
    """
    folder = scratch_folder(path)
    lock = acquire_lock(folder, path)
    try:
        clean_up(folder, path)
        yield folder
    finally:
        try:
            with writing(path):
                clean_up(folder, path)
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
                if not folder.is_symlink() and is_scratch(folder):
                    lock.acquire()
                    return lock
            except (FileNotFoundError, FileExistsError):  # another run is just removing it
                continue
            except filelock.Timeout:
                raise StoreConflict(
                    f"{path} is being written by another run", WAIT, of="out"
                ) from None
            except PermissionError:
                raise StoreConflict(
                    f"{path} is reserved by a run of another user, dead or alive, in {folder}",
                    WAIT,
                    of="out",
                ) from None
    raise StoreConflict(f"{path} cannot be written: {folder} is in the way: move it away")


def is_scratch(folder: Path) -> bool:
    """Return whether a folder is a run's, which locks it before it puts anything in."""
    return not any(folder.iterdir()) or (folder / LOCK_FILE).exists()


def move_into_place(folder: Path, path: Path) -> None:
    """Move the new data set in the folder to `path`, replacing what is there."""
    if path.exists():
        path.rename(folder / "old")
    (folder / "new").rename(path)
    clean_up(folder, path)


def standing(path: Path) -> Path:
    """Return where the data set of `path` stands: aside, between two renames of a run."""
    old = scratch_folder(resolve_link(path)) / "old"
    return old if old.exists() and not path.exists() else path


def clean_up(folder: Path, path: Path) -> None:
    """Restore the old data set at `path` if none has replaced it; remove everything else.

    That includes partial files, and arrays without checksums: a run was just writing or removing
    them when it ended.
    """
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
    try:
        kept = check_metadata(path)
    except Exception:  # no data set of this package, or a damaged one
        return
    for partial in path.rglob("*.partial"):
        partial.unlink()
    for array in path.iterdir():
        if array.name not in kept and is_own_array(array):
            shutil.rmtree(array.rename(folder / array.name))  # at once, to those who read
        else:
            with suppress(OSError):  # the folder is not empty, or it is a file
                array.rmdir()

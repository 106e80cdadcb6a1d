"""Folders and files that no other user can have written to.

Loaded machine code is executed, so it is loaded only from files and folders that belong to this
user, and that neither the group nor others may write to. Access control lists are not checked.
Windows has neither user ids nor such modes, and nothing is refused there.
"""

import functools
import os
import warnings
from contextlib import suppress
from pathlib import Path

FOLDER_MODE, FILE_MODE = 0o700, 0o600
OTHERS_WRITE = 0o022


def is_own(status: os.stat_result) -> bool:
    return not hasattr(os, "geteuid") or status.st_uid == os.geteuid()


def is_private(status: os.stat_result) -> bool:
    """Return whether only this user can have written to a file or folder."""
    return not hasattr(os, "geteuid") or (is_own(status) and not status.st_mode & OTHERS_WRITE)


def make_private(folder: Path) -> None:
    """Make a folder and its missing parents, for this user alone."""
    if folder.is_dir():
        return
    make_private(folder.parent)
    with suppress(FileExistsError):  # another process was faster
        folder.mkdir(FOLDER_MODE)
        folder.chmod(FOLDER_MODE)  # the umask may have removed some of it


def read_private(path: Path) -> bytes | None:
    """Read a file; return None, with one warning, if others may have written to it."""
    with open(path, "rb") as file:
        if is_private(os.fstat(file.fileno())):
            return file.read()
    warn_once(f"some programs in {path.parent} are")
    return None


@functools.cache
def warn_once(places: str) -> None:
    """Warn, once for each place."""
    warnings.warn(
        f"{places} not used, as others can write them: own them, and chmod go-w, or remove them",
        RuntimeWarning,
        stacklevel=2,
    )

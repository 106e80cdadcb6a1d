"""Folders and files in which no other user can have written.

Machine code is executed when it is loaded, so it is loaded from such places alone: they belong to
this user, and neither the group nor others may write to them. Access control lists are not looked
at. Windows has neither users' numbers nor such modes, and nothing is refused there.
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
    """Whether only this user can have written to a file or a folder."""
    return not hasattr(os, "geteuid") or (is_own(status) and not status.st_mode & OTHERS_WRITE)


def make_private(folder: Path) -> None:
    """Make a folder, and those above it that are missing, for this user alone."""
    if folder.is_dir():
        return
    make_private(folder.parent)
    with suppress(FileExistsError):  # another process was faster
        folder.mkdir(FOLDER_MODE)
        folder.chmod(FOLDER_MODE)  # of which the umask may have taken something


def read_private(path: Path) -> bytes | None:
    """The content of a file; None, and a warning once, if others can have written to it."""
    with open(path, "rb") as file:
        if is_private(os.fstat(file.fileno())):
            return file.read()
    warn_of(f"some programs in {path.parent} are")
    return None


@functools.cache
def warn_of(places: str) -> None:
    """Warn, once of the same."""
    warnings.warn(
        f"{places} not used, as others can write them: own them, and chmod go-w, or remove them",
        RuntimeWarning,
        stacklevel=2,
    )

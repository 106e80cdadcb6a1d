"""Places on disk: whether they can be written, and files that are written whole."""

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Literal

from walker_jax.checks import NotWritten, WrongPlace


class StoreConflict(WrongPlace):
    """The place of a result is taken; says by what, and which arguments help."""


ANOTHER_PLACE = "give another {}"
ANOTHER_PLACE_OR_OVERWRITE = "give another {}, or overwrite to replace it"
RESUME_HINT = "run the same again"
"""Beginning of a note on an interruption that says how to resume the work."""


def foreign(path: Path) -> StoreConflict:
    """Return the refusal of a place that holds something of others."""
    return StoreConflict(
        f"{path} exists and is not a data set", ANOTHER_PLACE.format("out"), of="out"
    )


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
def atomic_file(path: Path) -> Iterator[Path]:
    """Yield a file that replaces `path` at the end if all goes well, and is removed otherwise."""
    path = resolve_link(path)
    draft = path.with_name(f".new.{os.getpid()}.{path.name}")
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

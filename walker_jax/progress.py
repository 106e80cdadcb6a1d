"""What a computation shows of its progress: on a terminal, where that is wanted."""

from collections.abc import Iterable
from typing import TypeVar

from rich.console import Console
from rich.progress import track

T = TypeVar("T")


def console(wanted: bool) -> Console:
    """Standard error, if it is a terminal and that is wanted; otherwise a quiet console."""
    terminal = Console(stderr=True)
    terminal.quiet = not (wanted and terminal.is_terminal)
    return terminal


def tracked(
    things: Iterable[T], label: str, progress: bool, total: int | None = None
) -> Iterable[T]:
    """The things, one after the other, with a progress bar."""
    shown = console(progress)
    return track(things, label, total, console=shown, disable=shown.quiet, transient=True)

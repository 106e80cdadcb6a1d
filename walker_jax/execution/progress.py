"""What a computation shows of its progress: on a terminal, on request."""

from collections.abc import Iterable, Iterator
from operator import length_hint
from typing import TypeVar

from rich.console import Console
from rich.progress import Progress

T = TypeVar("T")


def progress_console(wanted: bool) -> Console:
    """Standard error, if it is a terminal and `wanted`; otherwise a quiet console."""
    terminal = Console(stderr=True)
    terminal.quiet = not (wanted and terminal.is_terminal)
    return terminal


def track(
    things: Iterable[T], label: str, progress: bool, total: int | None = None, done: int = 0
) -> Iterator[T]:
    """The things, one after the other, with a progress bar.

    It begins where `done` of `total` were there before.
    """
    shown = progress_console(progress)
    with Progress(console=shown, disable=shown.quiet, transient=True) as bar:
        task = bar.add_task(label, total=total or length_hint(things) or None, completed=done)
        for thing in things:
            yield thing
            bar.advance(task)

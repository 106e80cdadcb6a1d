"""The progress of a computation, shown on a terminal, on request.

A computation within another adds a line to what the other one shows.
"""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from operator import length_hint
from typing import TypeVar

from rich.console import Console
from rich.progress import BarColumn, Progress, ProgressColumn, Task, TextColumn
from rich.text import Text

T = TypeVar("T")
SMOOTHING_SECONDS = 600.0
"""Time over which the speed is averaged that tells how much time is left."""
quiet = False
"""Whether nothing is shown in this process, even on request."""
current: Progress | None = None
"""What is shown at present."""


class Percentage(ProgressColumn):
    """The share that is done, where it is known."""

    def render(self, task: Task) -> Text:
        return Text("" if task.total is None else f"{task.percentage:>3.0f}%")


class Times(ProgressColumn):
    """The time that has passed, and the time that is left if the work goes on as fast."""

    def render(self, task: Task) -> Text:
        passed = in_words(task.elapsed or 0.0)
        left = task.time_remaining
        if task.total is None or left is None or not task.completed:
            return Text(passed)
        return Text(f"{passed}, about {in_words(left)} left")


def in_words(seconds: float) -> str:
    """A time in the largest unit that says it well."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def be_quiet() -> None:
    """Show nothing from now on, in this process."""
    global quiet
    quiet = True


def progress_console(wanted: bool) -> Console:
    """Standard error, if it is a terminal and `wanted`; otherwise a quiet console."""
    terminal = Console(stderr=True)
    terminal.quiet = quiet or not (wanted and terminal.is_terminal)
    return terminal


@contextmanager
def bar(
    label: str, progress: bool, total: int | None = None, done: int = 0
) -> Iterator[Callable[[int], None]]:
    """Show a bar while the work within lasts; gives the function that says how much is done.

    It begins where `done` of `total` were there before. Without a total it tells the time alone.
    """
    global current
    shown = progress_console(progress)
    if shown.quiet:
        yield lambda completed: None
        return
    if current is not None:
        with line(current, label, total, done) as update:
            yield update
        return
    columns = TextColumn("{task.description}", markup=False), BarColumn(), Percentage(), Times()
    period = SMOOTHING_SECONDS
    with Progress(*columns, console=shown, transient=True, speed_estimate_period=period) as current:
        try:
            with line(current, label, total, done) as update:
                yield update
        finally:
            current = None


@contextmanager
def line(
    shown: Progress, label: str, total: int | None, done: int
) -> Iterator[Callable[[int], None]]:
    """One line of what is shown."""
    task = shown.add_task(label, total=total, completed=done)
    try:
        yield lambda completed: shown.update(task, completed=completed)
    finally:
        shown.refresh()
        shown.remove_task(task)


def track(
    things: Iterable[T], label: str, progress: bool, total: int | None = None, done: int = 0
) -> Iterator[T]:
    """The things, one after the other, with a progress bar.

    It begins where `done` of `total` were there before.
    """
    with bar(label, progress, total or length_hint(things) or None, done) as update:
        for count, thing in enumerate(things, done + 1):
            yield thing
            update(count)

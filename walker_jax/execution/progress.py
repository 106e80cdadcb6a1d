"""The progress of a computation that takes longer than a second, shown on a terminal.

A nested computation adds a line to the display of the outer one.
"""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from operator import length_hint
from threading import Timer
from typing import TypeVar

from rich.console import Console
from rich.progress import BarColumn, Progress, ProgressColumn, Task, TextColumn
from rich.text import Text

T = TypeVar("T")
SMOOTHING_SECONDS = 600.0
"""Time over which the speed is averaged to estimate the time left."""
DELAY_SECONDS = 1.0
"""Time before anything is shown: an answer at once needs no bar."""
quiet = False
"""Whether this process shows nothing, even on request."""
current: Progress | None = None
"""The present display."""


class Percentage(ProgressColumn):
    """The completed share, where it is known."""

    def render(self, task: Task) -> Text:
        return Text("" if task.total is None else f"{task.percentage:>3.0f}%")


class Times(ProgressColumn):
    """The time that has passed, and the time that is left at the present speed."""

    def render(self, task: Task) -> Text:
        passed = in_words(task.elapsed or 0.0)
        left = task.time_remaining
        if task.total is None or left is None or not task.completed:
            return Text(passed)
        return Text(f"{passed}, about {in_words(left)} left")


def in_words(seconds: float) -> str:
    """Format a time in a suitable unit."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def be_quiet() -> None:
    """Show nothing from now on, in this process."""
    global quiet
    quiet = True


def progress_console(wanted: bool) -> Console:
    """Return standard error, if it is a terminal and `wanted`; otherwise a quiet console."""
    terminal = Console(stderr=True)
    terminal.quiet = quiet or not (wanted and terminal.is_terminal)
    return terminal


@contextmanager
def bar(
    label: str, progress: bool, total: int | None = None, done: int = 0
) -> Iterator[Callable[[int], None]]:
    """Show a bar during the work within; yield the function that sets the completed amount.

    It starts at `done` of `total`. Without a total it shows the time alone.
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
    current = Progress(*columns, console=shown, transient=True, speed_estimate_period=period)
    showing = Timer(DELAY_SECONDS, current.start)
    showing.daemon = True
    showing.start()
    try:
        with line(current, label, total, done) as update:
            yield update
    finally:
        showing.cancel()
        showing.join()
        if current.live.is_started:
            current.stop()
        current = None


@contextmanager
def line(
    shown: Progress, label: str, total: int | None, done: int
) -> Iterator[Callable[[int], None]]:
    """Show one line of the display."""
    task = shown.add_task(label, total=total, completed=done)
    try:
        yield lambda completed: shown.update(task, completed=completed)
    finally:
        shown.refresh()
        shown.remove_task(task)


def track(
    items: Iterable[T], label: str, progress: bool, total: int | None = None, done: int = 0
) -> Iterator[T]:
    """Yield the items, one after the other, with a progress bar.

    The bar starts at `done` of `total`.
    """
    with bar(label, progress, total or length_hint(items) or None, done) as update:
        for count, item in enumerate(items, done + 1):
            yield item
            update(count)

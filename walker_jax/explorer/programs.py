"""The programs of each kind of walker, compiled once, one kind after another."""

import asyncio
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from typing import Any

import numpy as np

from walker_jax.checks import WrongUse
from walker_jax.explorer import pictures, walks
from walker_jax.explorer.compile_times import CompileTimes
from walker_jax.explorer.lattice import Tile, home_of
from walker_jax.explorer.offers import Offer
from walker_jax.explorer.subjects import Subject

LEAST_LEFT = 1.0
"""Seconds left, at least, for a kind of walker that takes longer to compile than was estimated."""


class Lane:
    """One thread, which runs functions one after another, in the order of requests."""

    def __init__(self, name: str) -> None:
        self.thread = ThreadPoolExecutor(1, name)

    async def run(self, function: Callable, *arguments: Any) -> Any:
        """Return function(*arguments); a call that is cancelled while it waits never begins."""
        loop = asyncio.get_running_loop()
        return await loop.run_in_executor(self.thread, function, *arguments)


class Programs:
    """Programs that are compiled or waiting, and estimates of the time that is left."""

    def __init__(self) -> None:
        self.lane, self.times = Lane("compiling"), CompileTimes()
        self.tasks: dict[tuple[Offer, str], asyncio.Task] = {}
        self.begun: dict[Offer, float] = {}  # when what is being compiled began

    async def ready(self, subject: Subject) -> None:
        """Wait until the programs of a kind of walker are compiled; other requests go on."""
        key = subject.offer, subject.section
        if key not in self.tasks:
            self.tasks[key] = asyncio.create_task(self.compile(subject))
        try:
            await asyncio.shield(self.tasks[key])
        except Exception:  # for these parameters nothing compiles: the next request tries again
            self.tasks.pop(key, None)
            raise

    async def compile(self, subject: Subject) -> None:
        """Compile a kind of walker, after those that were asked for before."""
        first = not self.has(subject.offer)
        seconds = await self.lane.run(self.compile_timed, subject)
        if first:
            self.times.record(subject.offer, seconds)

    def compile_timed(self, subject: Subject) -> float:
        """Compile a kind of walker in this thread; return the seconds that this took."""
        start = self.begun[subject.offer] = time.monotonic()
        try:
            compile_programs(subject)
        finally:
            del self.begun[subject.offer]
        return time.monotonic() - start

    def has(self, offered: Offer) -> bool:
        """Return whether a kind of walker is compiled, for one of its planes at least."""
        return any(task.done() for (one, _), task in self.tasks.items() if one == offered)

    def seconds_left(self, subject: Subject) -> float | None:
        """Estimate the seconds until a kind of walker is compiled, with those waiting before it.

        The result is 0 if it is compiled, and None without an estimate.
        """
        if self.has(subject.offer):
            return 0.0
        asked = [one for one, _ in self.tasks if not self.has(one)]
        kinds = list(dict.fromkeys([*asked, subject.offer]))
        now, total = time.monotonic(), 0.0
        for one in kinds[: kinds.index(subject.offer) + 1]:
            estimate = self.times.estimate(one)
            if estimate is None:
                return None
            total += max(LEAST_LEFT, estimate - (now - self.begun.get(one, now)))
        return total


def compile_programs(subject: Subject) -> None:
    """Run once what pictures and walks need, so that they need not wait for the compiler."""
    gait = np.array(home_of(subject.offer, subject.section).gait)
    pictures.label_cells(subject, pictures.find_attractors(subject), [Tile(-3, 0, 0)])
    with suppress(WrongUse):  # a request for a walk will report it
        walks.follow(subject, gait, 1)

"""The programs of each kind of walker, compiled once, one kind after another."""

import asyncio
import math
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
        seconds = await self.lane.run(compile_programs, subject)
        if first:
            self.times.record(subject.offer, seconds)

    def has(self, offered: Offer) -> bool:
        """Return whether a kind of walker is compiled, for one of its planes at least."""
        return any(task.done() for (one, _), task in self.tasks.items() if one == offered)

    def seconds_left(self, subject: Subject) -> float | None:
        """Estimate the seconds until a kind of walker is compiled, with those waiting before it.

        The result is 0 if it is compiled, and None without an estimate.
        """
        if self.has(subject.offer):
            return 0.0
        waiting = [one for (one, _), task in self.tasks.items() if not task.done()]
        found = map(self.times.estimate, dict.fromkeys([*waiting, subject.offer]))
        total = sum(math.nan if one is None else one for one in found)
        return None if math.isnan(total) else total


def compile_programs(subject: Subject) -> float:
    """Run once what pictures and walks need, so that they need not wait for the compiler.

    Returns the seconds that this took.
    """
    start = time.monotonic()
    gait = np.array(home_of(subject.offer, subject.section).gait)
    pictures.label_cells(subject, pictures.find_attractors(subject), [Tile(-3, 0, 0)])
    with suppress(WrongUse):  # a request for a walk will report it
        walks.follow(subject, gait, 1)
    return time.monotonic() - start

"""Processes for what takes long, so that it blocks no picture, and can be given up.

A worker is a process of low priority with a JAX of its own. It works on one thing at a time, which
an interrupt ends; the worker stays, with what it has compiled. The first worker takes every job,
the others short ones: so nobody's bifurcation diagram keeps others from their gaits.
"""

import asyncio
import multiprocessing
import os
import signal
import sys
from collections import OrderedDict
from collections.abc import Callable, Generator, Hashable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import partial
from multiprocessing.connection import Connection
from types import FrameType
from typing import Any

import jax

from walker_jax.checks import ComputationFailed, WrongUse

WORKERS = 2
"""Processes: one for what is long, and one more for what is short."""
GRACE = 5.0
"""Seconds in which an interrupted worker must answer before it is killed."""
REMEMBERED = 64
"""Answers that are kept."""
MAX_WAITING = 64
"""Jobs that wait; more are refused."""
NICENESS = 10
"""By how much the priority of workers is lower than that of pictures."""
SAID = "said"
"""The kind of a failure whose message is for those who ask."""
SETTINGS = (
    "jax_enable_x64",
    "jax_compilation_cache_dir",
    "jax_persistent_cache_min_compile_time_secs",
)
"""Settings of JAX that workers take over."""


Told = Callable[[Any], object]
"""A function that is called with each part of a result."""


class Busy(Exception):
    """More is waiting than may."""


class Interrupted(BaseException):
    """The job was given up."""


class Failure(Exception):
    """An exception of a worker: its kind, `SAID` or its name, and the message."""


def serve(connection: Connection, settings: dict[str, Any]) -> None:
    """Work on jobs until the other end closes: the main function of a worker."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    hold_interrupts(False)
    sys.unraisablehook = quiet  # of an interrupt that comes while Python collects garbage
    if hasattr(os, "nice"):
        os.nice(NICENESS)
    for name, value in settings.items():
        jax.config.update(name, value)
    connection.send("ready")
    while True:
        try:
            function, arguments = connection.recv()
        except (EOFError, OSError):
            return
        except Exception as error:  # of a user's file that can be imported no more
            connection.send((SAID, f"the walker cannot be loaded: {type(error).__name__}: {error}"))
            continue
        connection.send(answer(function, arguments, connection))


def hold_interrupts(held: bool) -> None:
    """Keep interrupts from this thread and the processes that it starts, or let them come."""
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_BLOCK if held else signal.SIG_UNBLOCK, {signal.SIGINT})


def quiet(unraisable: Any) -> None:
    """Say nothing of an interrupt that nobody could catch: the next one follows."""
    if not isinstance(unraisable.exc_value, Interrupted):
        sys.__unraisablehook__(unraisable)


def answer(function: Callable, arguments: tuple, connection: Connection) -> tuple[str, Any]:
    """The result of a function, or how it fails; an interrupt ends it.

    Parts of the result, which a function yields before it returns, are sent as they come.
    """
    sending = False

    def give_up(number: int, frame: FrameType | None) -> None:
        if not sending:  # the next interrupt follows, and half a message is none
            raise Interrupted

    try:
        try:
            signal.signal(signal.SIGINT, give_up)
            parts = returned(function(*arguments))
            while True:
                try:
                    part = next(parts)
                except StopIteration as end:
                    return "done", end.value
                sending = True
                connection.send(("part", part))
                sending = False
        finally:
            signal.signal(signal.SIGINT, signal.SIG_IGN)
    except Interrupted:
        return "interrupted", None
    except (WrongUse, ComputationFailed) as error:
        return SAID, str(error)
    except Exception as error:
        return type(error).__name__, str(error)


def returned(result: Any) -> Generator[Any, None, Any]:
    """Parts of a result, and the result, of a function that yields, or of one that returns."""
    return (yield from result) if isinstance(result, Generator) else result


class Worker:
    """A process, started when it is first needed, and anew where it has died."""

    def __init__(self) -> None:
        self.thread = ThreadPoolExecutor(1, "worker")
        self.process: Any = None
        self.connection: Connection | None = None
        self.at_work = False

    async def run(self, function: Callable, *arguments: Any, told: Told) -> Any:
        """function(*arguments) in the process; a cancelled task interrupts it.

        `told` is called with all that a function yields before its result.
        """
        loop = asyncio.get_running_loop()
        tell = partial(loop.call_soon_threadsafe, told)
        job = loop.run_in_executor(self.thread, self.call, function, arguments, tell)
        try:
            state, result = await asyncio.shield(job)
        except asyncio.CancelledError:
            await self.give_up(job)
            raise
        if state != "done":
            raise Failure(state, result)
        return result

    async def give_up(self, job: asyncio.Future) -> None:
        """End the job, by an interrupt if the worker heeds it."""
        waited, step = 0.0, 0.1
        while not job.done() and waited < GRACE:  # again and again, as one may come too soon
            if self.at_work:  # and not while the process starts
                with suppress(ProcessLookupError):
                    os.kill(self.process.pid, signal.SIGINT)
                waited += step
            await asyncio.wait([job], timeout=step)
        if not job.done():
            self.stop_process()
        with suppress(Exception):
            await job

    def call(self, function: Callable, arguments: tuple, tell: Told) -> tuple[str, Any]:
        """Send the job and wait, and tell what comes before the result; in the worker's thread."""
        try:
            if self.process is None or not self.process.is_alive():
                self.start()
            assert self.connection is not None
            self.connection.send((function, arguments))
            self.at_work = True
            while (found := self.connection.recv())[0] == "part":
                tell(found[1])
            return found
        except (EOFError, OSError):
            self.process = None
            return SAID, "the process that computed this has died"
        finally:
            self.at_work = False

    def start(self) -> None:
        """Start the process, with this one's settings of JAX, and wait until it is ready."""
        context = multiprocessing.get_context("spawn")
        self.connection, other = context.Pipe()
        settings = {name: getattr(jax.config, name) for name in SETTINGS}
        self.process = context.Process(target=serve, args=(other, settings), daemon=True)
        hold_interrupts(True)  # also those of a terminal, until the process can heed them
        try:
            self.process.start()
        finally:
            hold_interrupts(False)
        other.close()
        self.connection.recv()  # that it is ready

    def stop_process(self) -> None:
        """End the process, whatever it is at."""
        if self.process is not None:
            self.process.kill()
            self.process.join()

    def stop(self) -> None:
        """End the process, and the thread that waits for it."""
        self.stop_process()
        if self.connection is not None:
            self.connection.close()
        self.thread.shutdown(wait=False, cancel_futures=True)


class Job:
    """Something to compute, for one who asks or several."""

    def __init__(self, function: Callable, arguments: tuple, long: bool):
        self.function, self.arguments, self.long = function, arguments, long
        self.askers = 0
        self.told: list[Told] = []
        self.parts: list[Any] = []
        self.result: asyncio.Future = asyncio.get_running_loop().create_future()
        self.task: asyncio.Task | None = None

    def tell(self, part: Any) -> None:
        """Tell all who ask of a part of the result."""
        self.parts.append(part)
        for told in self.told:
            told(part)


class Workers:
    """Workers, the jobs that wait for them, and the answers of late."""

    def __init__(self, count: int = WORKERS) -> None:
        self.all = [Worker() for _ in range(count)]
        self.idle = self.all[::-1]
        self.waiting: list[Job] = []
        self.jobs: dict[Hashable, Job] = {}
        self.answers: OrderedDict[Hashable, Any] = OrderedDict()

    async def ask(
        self,
        function: Callable,
        *arguments: Any,
        long: bool = False,
        keep: bool = True,
        told: Told | None = None,
    ) -> Any:
        """function(*arguments), from the answers of late, or from a worker.

        Two who ask for the same share a job. It ends when the last of them gives up. `told` is
        called with what a function yields before its result, from the first one on.
        """
        key = (function, arguments)
        if key in self.answers:
            self.answers.move_to_end(key)
            return self.answers[key]
        if key not in self.jobs:
            if len(self.waiting) >= MAX_WAITING:
                raise Busy
            self.jobs[key] = Job(function, arguments, long)
            self.waiting.append(self.jobs[key])
            self.assign()
        job = self.jobs[key]
        job.askers += 1
        if told is not None:
            for part in job.parts:
                told(part)
            job.told.append(told)
        try:
            result = await asyncio.shield(job.result)
        finally:
            if told is not None:
                job.told.remove(told)
            job.askers -= 1
            if job.askers == 0:
                self.drop(key, job)
        if keep:
            self.answers[key] = result
            while len(self.answers) > REMEMBERED:
                self.answers.popitem(last=False)
        return result

    def drop(self, key: Hashable, job: Job) -> None:
        """Forget a job for which nobody waits any more."""
        if self.jobs.get(key) is job:
            del self.jobs[key]
        if job in self.waiting:
            self.waiting.remove(job)
        if job.task is not None and not job.task.done():
            job.task.cancel()

    def assign(self) -> None:
        """Give waiting jobs to idle workers."""
        for worker in list(self.idle):
            fits = [job for job in self.waiting if not job.long or worker is self.all[0]]
            if fits:
                self.waiting.remove(fits[0])
                self.idle.remove(worker)
                fits[0].task = asyncio.create_task(self.work(worker, fits[0]))

    async def work(self, worker: Worker, job: Job) -> None:
        """Have a worker do a job, and then the next."""
        try:
            result = await worker.run(job.function, *job.arguments, told=job.tell)
            if not job.result.done():
                job.result.set_result(result)
        except asyncio.CancelledError:
            job.result.cancel()
        except Exception as error:
            if not job.result.done():
                job.result.set_exception(error)
                job.result.exception()  # seen, even where nobody waits for it any more
        finally:
            self.idle.append(worker)
            self.idle.sort(key=self.all.index, reverse=True)  # short jobs leave the first one free
            self.assign()

    def stop(self) -> None:
        """End all processes."""
        for worker in self.all:
            worker.stop()

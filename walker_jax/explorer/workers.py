"""Worker processes for long computations, which then block no picture and can be cancelled.

A worker is a process of low priority with a JAX of its own. It works on one job at a time. An
interrupt ends the job; the worker stays, with its compiled programs. The first worker takes every
job, the others only short ones, so that a bifurcation diagram does not delay gaits.
"""

import asyncio
import multiprocessing
import os
import signal
import sys
from asyncio import CancelledError
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
from walker_jax.execution.workers import hold_interrupts, interrupts_held

WORKERS = 2
"""Number of processes: one for all jobs, and one more for short jobs."""
GRACE = 5.0
"""Seconds within which an interrupted worker must answer; later it is killed."""
REMEMBERED = 64
"""Most results that are kept."""
MAX_WAITING = 64
"""Most waiting jobs; more are refused."""
NICENESS = 10
"""Niceness of workers, so that pictures come first."""
SAID = "said"
"""Kind of a failure whose message is shown to the user."""
INTERRUPTED = "interrupted"
SETTINGS = (
    "jax_enable_x64",
    "jax_compilation_cache_dir",
    "jax_persistent_cache_min_compile_time_secs",
)
"""Settings of JAX that workers take over."""


Told = Callable[[Any], object]
"""A function that is called with each part of a result."""


class Busy(Exception):
    """Too many jobs or pictures are waiting."""


class Interrupted(BaseException):
    """The job was cancelled."""


class Failure(Exception):
    """An exception of a worker: its kind, `SAID` or its name, and the message."""


def serve(connection: Connection, settings: dict[str, Any]) -> None:
    """Work on jobs until the other end closes: the main function of a worker."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    hold_interrupts(False)
    sys.unraisablehook = quiet  # for an interrupt while Python collects garbage
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
        except Exception as error:  # a user's file cannot be imported any more
            connection.send((SAID, f"the walker cannot be loaded: {type(error).__name__}: {error}"))
            continue
        connection.send(answer(function, arguments, connection))


def quiet(unraisable: Any) -> None:
    """Ignore an interrupt that could not be caught, as the next one follows."""
    if not isinstance(unraisable.exc_value, Interrupted):
        sys.__unraisablehook__(unraisable)


def answer(function: Callable, arguments: tuple, connection: Connection) -> tuple[str, Any]:
    """Return the result of a function, or how it fails; an interrupt ends it.

    If the function yields parts before its result, each part is sent as it comes.
    """
    sending = False

    def give_up(number: int, frame: FrameType | None) -> None:
        if not sending:  # a message must be sent whole; the next interrupt follows
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
        return INTERRUPTED, None
    except (WrongUse, ComputationFailed) as error:
        return SAID, str(error)
    except Exception as error:
        return type(error).__name__, str(error)


def returned(result: Any) -> Generator[Any, None, Any]:
    """Yield the parts that a function yields, if any, and return its result."""
    return (yield from result) if isinstance(result, Generator) else result


class Worker:
    """A process that starts when it is first needed, and again if it has died."""

    def __init__(self) -> None:
        self.thread = ThreadPoolExecutor(1, "worker")
        self.process: Any = None
        self.connection: Connection | None = None
        self.at_work = False

    async def run(self, function: Callable, *arguments: Any, told: Told) -> Any:
        """Return function(*arguments) from the process; to cancel the task interrupts it.

        `told` is called with each part that the function yields before its result.
        """
        loop = asyncio.get_running_loop()
        tell = partial(loop.call_soon_threadsafe, told)
        job = loop.run_in_executor(self.thread, self.call, function, arguments, tell)
        try:
            state, result = await asyncio.shield(job)
        except asyncio.CancelledError:
            await self.give_up(job)
            raise
        if state == INTERRUPTED:  # by a terminal's Ctrl-C, which reaches all processes
            raise CancelledError
        if state != "done":
            raise Failure(state, result)
        return result

    async def give_up(self, job: asyncio.Future) -> None:
        """End the job by interrupts, or end the process if these do not help."""
        waited, step = 0.0, 0.1
        while not job.done() and waited < GRACE:  # repeatedly, as an interrupt may come too soon
            if self.at_work:  # not while the process starts
                with suppress(ProcessLookupError):
                    os.kill(self.process.pid, signal.SIGINT)
                waited += step
            await asyncio.wait([job], timeout=step)
        if not job.done():
            self.stop_process()
        with suppress(Exception):
            await job

    def call(self, function: Callable, arguments: tuple, tell: Told) -> tuple[str, Any]:
        """Send the job, tell its parts, and wait for the result; in the worker's thread."""
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
        with interrupts_held():  # until the process can handle them, those of a terminal too
            self.process.start()
        other.close()
        self.connection.recv()  # the message that it is ready

    def stop_process(self) -> None:
        """Kill the process, whatever it is doing."""
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
    """A computation for one request, or for several that ask for the same."""

    def __init__(self, function: Callable, arguments: tuple, long: bool):
        self.function, self.arguments, self.long = function, arguments, long
        self.askers = 0
        self.told: list[Told] = []
        self.part: Any = None  # the last one, which holds all that was found so far
        self.result: asyncio.Future = asyncio.get_running_loop().create_future()
        self.task: asyncio.Task | None = None

    def tell(self, part: Any) -> None:
        """Pass a part of the result to all requests."""
        self.part = part
        for told in self.told:
            told(part)


class Workers:
    """Workers, the jobs that wait for them, and the recent results."""

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
        """Return function(*arguments), from the recent results or from a worker.

        Requests for the same share a job, which ends when the last of them is cancelled. `told` is
        called with each part that the function yields before its result, from the last one so far.
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
            if job.part is not None:
                told(job.part)
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
        """Drop a job for which no request waits any more."""
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
        """Have a worker do a job, then give it the next one."""
        try:
            result = await worker.run(job.function, *job.arguments, told=job.tell)
            if not job.result.done():
                job.result.set_result(result)
        except asyncio.CancelledError:
            job.result.cancel()
        except Exception as error:
            if not job.result.done():
                job.result.set_exception(error)
                job.result.exception()  # marks it as retrieved, even if no request waits for it
        finally:
            self.idle.append(worker)
            self.idle.sort(key=self.all.index, reverse=True)  # short jobs leave the first one free
            self.assign()

    def stop(self) -> None:
        """Stop all workers."""
        for worker in self.all:
            worker.stop()

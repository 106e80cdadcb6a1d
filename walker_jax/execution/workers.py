"""Pieces of a large computation, on this machine or on a Dask cluster.

A worker computes a piece with all devices, or all cores, that it may use, and sends back the
result. It writes nothing, and shares no disk with others. If a worker dies, others compute its
pieces again.
"""

import logging
import signal
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from multiprocessing import resource_tracker
from typing import Any

import jax

from walker_jax.checks import WrongUse, check_whole
from walker_jax.execution import tiles
from walker_jax.kernels.program import MODES

PIECES_PER_WORKER = 2
"""Pieces queued for each worker, so that it need not wait for the next."""
MAX_DEATHS = 10
"""Times that Dask may give up a piece, as it does when several workers have died over it."""
MAX_LOCAL_WORKERS = 1024
"""Most worker processes on this machine."""
CONNECT_SECONDS = 10
"""Seconds to wait for a scheduler."""
Compute = Callable[[Callable[[Any], Any], Sequence[Any]], Iterator[tuple[Any, Any]]]


def check_cluster(cluster: Any, out: Any) -> None:
    """Raise `WrongUse` for a cluster without a place for the pieces that it computes."""
    if cluster is not None and out is None:
        raise WrongUse(f"cluster={cluster!r} computes pieces of a store: out is required too")


@contextmanager
def open_workers(cluster: Any = None) -> Iterator[Compute]:
    """Yield a function that computes function(item) for each item; it yields both when done.

    The function must be picklable, and give the same result wherever it is computed; items are
    hashable.

    **Arguments:**

    - `cluster`: None to compute here, one after the other; a number of worker processes to start on
      this machine, which share its cores; the address of a Dask scheduler, such as
      "tcp://10.0.0.1:8786"; or a `dask.distributed.Client`, whose workers then keep the modes of
      this process.

    Raises `ValueError` for a cluster that cannot be reached, or where Dask is not installed.
    """
    if cluster is None:
        yield compute_here
        return
    submitted: dict[Any, Any] = {}
    with connect(cluster) as client:
        try:
            yield partial(compute_on_cluster, client, submitted)
        finally:
            if client is cluster:  # other clients end here
                client.cancel([*submitted])


def compute_here(function: Callable[[Any], Any], items: Sequence[Any]) -> Iterator[tuple[Any, Any]]:
    """Yield each item and its result, from this process."""
    for item in items:
        yield item, function(item)


def compute_on_cluster(
    client: Any, submitted: dict[Any, Any], function: Callable[[Any], Any], items: Sequence[Any]
) -> Iterator[tuple[Any, Any]]:
    """Yield each item and its result, from the workers of a Dask client."""
    from distributed import KilledWorker, as_completed

    waiting, deaths = list(items)[::-1], Counter()
    done = as_completed()

    def submit_more() -> None:
        """Submit as many items as the present workers need."""
        workers = max(1, len(client.scheduler_info(n_workers=-1)["workers"]))
        while waiting and len(submitted) < PIECES_PER_WORKER * workers:
            item = waiting.pop()
            future = client.submit(function, item, pure=False)
            submitted[future] = item
            done.add(future)

    submit_more()
    while submitted:
        future = next(done)
        item = submitted.pop(future)
        found = []
        try:
            found.append((item, future.result()))
        except KilledWorker:
            deaths[item] += 1
            if deaths[item] > MAX_DEATHS:
                raise
            waiting.append(item)
        submit_more()
        yield from found


@contextmanager
def connect(cluster: Any) -> Iterator[Any]:
    """Yield a client of a cluster, whose workers compute as this process does."""
    try:
        from distributed import Client, LocalCluster
    except ImportError:
        raise WrongUse("a cluster takes Dask: pip install 'walker_jax[distributed]'") from None
    modes = {mode: getattr(jax.config, mode) for mode in MODES}
    if isinstance(cluster, Client):
        cluster.register_worker_callbacks(partial(configure_worker, modes, None))
        yield cluster
        return
    local, workers, cores, address = None, None, None, cluster
    if not isinstance(cluster, str):
        workers = check_whole("cluster", cluster, most=MAX_LOCAL_WORKERS)
        cores = max(1, tiles.cores() // workers)
    try:
        if workers is not None:
            with interrupts_held():
                local = LocalCluster(
                    n_workers=workers,
                    threads_per_worker=1,
                    dashboard_address=":0",
                    silence_logs=logging.CRITICAL,  # of workers that are killed
                )
            address = local.scheduler_address
        try:
            client = Client(address, timeout=CONNECT_SECONDS)
        except (OSError, ValueError) as error:
            raise WrongUse(
                f"cluster {address} cannot be reached: {error}; start its scheduler, or give a "
                "number of workers"
            ) from None
        with client:
            client.register_worker_callbacks(partial(configure_worker, modes, cores))
            yield client
    finally:
        if local is not None:
            with interrupts_held():
                local.close()


@contextmanager
def interrupts_held() -> Iterator[None]:
    """Let interrupts wait; the threads and processes that start meanwhile never get any.

    Ctrl-C in a terminal goes to all processes, and only the first one knows how to end.
    """
    hold_interrupts(True)
    try:
        yield
    finally:
        hold_interrupts(False)


def hold_interrupts(held: bool) -> None:
    """Block interrupts in this thread and the processes that it starts, or unblock them."""
    if hasattr(signal, "pthread_sigmask"):  # not on Windows
        resource_tracker.ensure_running()  # which unblocks them, when a process first needs it
        signal.pthread_sigmask(signal.SIG_BLOCK if held else signal.SIG_UNBLOCK, {signal.SIGINT})


def configure_worker(modes: dict[str, Any], cores: int | None, dask_worker: Any) -> None:
    """Make a worker compute in the modes of another process, on a number of cores."""
    for mode, value in modes.items():
        jax.config.update(mode, value)
    tiles.limit_cores(cores)
    # Its profiler reads the frames of all threads. Before Python 3.12 that may deadlock during a
    # garbage collection.
    for name in ("profile", "profile-cycle"):
        if name in dask_worker.periodic_callbacks:
            dask_worker.periodic_callbacks[name].stop()

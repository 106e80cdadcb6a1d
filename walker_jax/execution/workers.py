"""Pieces of a large computation, here or on a Dask cluster.

A worker computes a piece with all devices, or all cores, that it may use, and sends back what it
found; it writes nothing, and needs no disk in common with others. One that dies costs the pieces
that it was at, which others compute again.
"""

import logging
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Any

import jax

from walker_jax.checks import WrongUse, check_whole
from walker_jax.execution import tiles
from walker_jax.execution.progress import track
from walker_jax.kernels.program import MODES
from walker_jax.storage.pieces import Pieces

PIECES_PER_WORKER = 2
"""Pieces that each worker has been given, so that it need not wait for the next."""
MAX_DEATHS = 10
"""Times that Dask may give a piece up, as it does when several workers have died over it."""
MAX_LOCAL_WORKERS = 1024
"""Worker processes on this machine, at most."""
CONNECT_SECONDS = 10
"""Seconds to wait for a scheduler."""
Compute = Callable[[Callable[[Any], Any], Sequence[Any]], Iterator[tuple[Any, Any]]]


def check_cluster(cluster: Any, out: Any) -> None:
    """Refuse a cluster without a place for the pieces that it computes."""
    if cluster is not None and out is None:
        raise WrongUse(f"cluster={cluster!r} computes pieces of a store: out is required too")


@contextmanager
def open_workers(cluster: Any = None) -> Iterator[Compute]:
    """Something that computes function(thing) for each thing: gives both, as they are done.

    The function may be pickled, and gives the same wherever it is computed; things are hashable.

    **Arguments:**

    - `cluster`: none to compute here, one after the other; a number of worker processes to start on
      this machine, which share its cores; the address of a Dask scheduler, such as
      "tcp://10.0.0.1:8786"; or a `dask.distributed.Client`, whose workers are left in the modes of
      this process.

    `ValueError` for a cluster that cannot be reached, or where Dask is not installed.
    """
    if cluster is None:
        yield compute_here
        return
    asked: dict[Any, Any] = {}
    with connect(cluster) as client:
        try:
            yield partial(compute_on_cluster, client, asked)
        finally:
            if client is cluster:  # others end here
                client.cancel([*asked])


def compute_here(
    function: Callable[[Any], Any], things: Sequence[Any]
) -> Iterator[tuple[Any, Any]]:
    """Each thing and its result, from this process."""
    for thing in things:
        yield thing, function(thing)


def compute_on_cluster(
    client: Any, asked: dict[Any, Any], function: Callable[[Any], Any], things: Sequence[Any]
) -> Iterator[tuple[Any, Any]]:
    """Each thing and its result, from the workers of a Dask client; those asked for meanwhile."""
    from distributed import KilledWorker, as_completed

    waiting, deaths = list(things)[::-1], Counter()
    done = as_completed()

    def ask_more() -> None:
        """As many as there are workers for by now."""
        workers = max(1, len(client.scheduler_info(n_workers=-1)["workers"]))
        while waiting and len(asked) < PIECES_PER_WORKER * workers:
            thing = waiting.pop()
            future = client.submit(function, thing, pure=False)
            asked[future] = thing
            done.add(future)

    ask_more()
    while asked:
        future = next(done)
        thing = asked.pop(future)
        found = []
        try:
            found.append((thing, future.result()))
        except KilledWorker:
            deaths[thing] += 1
            if deaths[thing] > MAX_DEATHS:
                raise
            waiting.append(thing)
        ask_more()
        yield from found


def missing_pieces(
    place: Pieces,
    each: Compute,
    function: Callable[[Any], Any],
    thing_of: Callable[[int], Any],
    label: str,
    progress: bool,
) -> Iterator[tuple[int, Any]]:
    """Each piece that a data set on disk lacks, and function(thing_of(piece)), as they are done."""
    number = {thing_of(piece): piece for piece in place.missing()}
    found, done = each(function, [*number]), place.count - len(number)
    for thing, values in track(found, label, progress, place.count, done):
        yield number[thing], values


@contextmanager
def connect(cluster: Any) -> Iterator[Any]:
    """A client of a cluster, whose workers compute as this process does."""
    try:
        from distributed import Client, LocalCluster
    except ImportError:
        raise WrongUse("a cluster takes Dask: pip install 'walker_jax[distributed]'") from None
    modes = {mode: getattr(jax.config, mode) for mode in MODES}
    if isinstance(cluster, Client):
        cluster.register_worker_callbacks(partial(configure_worker, modes, None))
        yield cluster
        return
    local, cores, address = None, None, cluster
    if not isinstance(cluster, str):
        workers = check_whole("cluster", cluster, most=MAX_LOCAL_WORKERS)
        cores = max(1, tiles.cores() // workers)
        local = LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            dashboard_address=":0",
            silence_logs=logging.CRITICAL,  # of workers that are interrupted, or killed
        )
        address = local.scheduler_address
    try:
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
            local.close()


def configure_worker(modes: dict[str, Any], cores: int | None, dask_worker: Any) -> None:
    """Let a worker compute in the modes of another process, on so many cores."""
    for mode, value in modes.items():
        jax.config.update(mode, value)
    tiles.limit_cores(cores)
    # Its profiler looks at the frames of all threads, over which Python before 3.12 may come to a
    # standstill when garbage is collected meanwhile.
    for name in ("profile", "profile-cycle"):
        if name in dask_worker.periodic_callbacks:
            dask_worker.periodic_callbacks[name].stop()

"""Pieces of a large computation, here or on a Dask cluster.

A worker computes a piece with all devices, or all cores, that it may use, and sends back what it
found; it writes nothing, and needs no disk in common with others. One that dies costs the pieces
that it was at, which others compute again.
"""

import os
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, TypeVar

import jax

from walker_jax import tiles
from walker_jax.progress import tracked

AHEAD = 2
"""Pieces that each worker has been given, so that it need not wait for the next."""
DEATHS = 100
"""Times that workers may die over one piece."""

PATIENCE = 10
"""Seconds to wait for a scheduler."""

Thing = TypeVar("Thing")


def each(
    function: Callable[[Thing], Any],
    things: Sequence[Thing],
    cluster: Any = None,
    *,
    label: str = "pieces",
    progress: bool = False,
) -> Iterator[tuple[Thing, Any]]:
    """(thing, function(thing)) for each thing, as they are done.

    **Arguments:**

    - `function`: may be pickled, and gives the same wherever it is computed.
    - `things`: hashable.
    - `cluster`: none to compute here, one after the other; a number of worker processes to start on
      this machine, which share its cores; the address of a Dask scheduler, such as
      "tcp://10.0.0.1:8786"; or a `dask.distributed.Client`.
    - `label`, `progress`: of a progress bar, on a terminal.

    `ValueError` for a cluster that cannot be reached, or where Dask is not installed.
    """
    if cluster is None:
        yield from ((thing, function(thing)) for thing in tracked(things, label, progress))
        return
    with client_of(cluster) as client:
        yield from tracked(on(client, function, things), label, progress, len(things))


def on(
    client: Any, function: Callable[[Thing], Any], things: Sequence[Thing]
) -> Iterable[tuple[Thing, Any]]:
    """Each thing and its result, from the workers of a Dask client."""
    from distributed import KilledWorker, as_completed

    waiting, deaths = list(things)[::-1], Counter()
    asked: dict[Any, Thing] = {}
    done = as_completed()

    def ask(thing: Thing) -> None:
        future = client.submit(function, thing, pure=False)
        asked[future] = thing
        done.add(future)

    workers = max(1, len(client.scheduler_info(n_workers=-1)["workers"]))
    while waiting and len(asked) < AHEAD * workers:
        ask(waiting.pop())
    while asked:
        future = next(done)
        thing = asked.pop(future)
        try:
            result = future.result()
        except KilledWorker:
            deaths[thing] += 1
            if deaths[thing] > DEATHS:
                raise
            ask(thing)
            continue
        if waiting:
            ask(waiting.pop())
        yield thing, result


@contextmanager
def client_of(cluster: Any) -> Iterator[Any]:
    """A client of a cluster, whose workers compute as this process does."""
    try:
        from distributed import Client, LocalCluster
    except ImportError:
        raise ValueError("a cluster takes Dask: pip install 'walker_jax[distributed]'") from None
    if isinstance(cluster, Client):
        cluster.register_plugin(as_here(None), name="walker-jax")
        yield cluster
        return
    local, cores, address = None, None, cluster
    if isinstance(cluster, int):
        if cluster < 1:
            raise ValueError(f"cluster must be at least 1 worker, not {cluster}")
        cores = max(1, (os.cpu_count() or 1) // cluster)
        local = LocalCluster(n_workers=cluster, threads_per_worker=1, dashboard_address=":0")
        address = local.scheduler_address
    try:
        try:
            client = Client(address, timeout=PATIENCE)
        except (OSError, ValueError) as error:
            raise ValueError(f"cluster {address} cannot be reached: {error}") from None
        with client:
            client.register_plugin(as_here(cores), name="walker-jax")
            yield client
    finally:
        if local is not None:
            local.close()


def as_here(cores: int | None) -> Any:
    """A plugin by which workers compute in the modes of this process, on so many cores."""
    from distributed import WorkerPlugin

    modes = {mode: getattr(jax.config, mode) for mode in tiles.MODES}

    class AsHere(WorkerPlugin):
        def setup(self, worker: Any) -> None:
            for mode, value in modes.items():
                jax.config.update(mode, value)
            tiles.limit_cores(cores)
            # Its profiler looks at the frames of all threads, over which Python before 3.12 may
            # come to a standstill when garbage is collected meanwhile.
            for name in ("profile", "profile-cycle"):
                if name in worker.periodic_callbacks:
                    worker.periodic_callbacks[name].stop()

    return AsHere()

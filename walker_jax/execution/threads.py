"""Independent computations side by side, each in a thread.

A kernel uses all cores by itself. Between kernels, in Python and NumPy, a computation uses one
core; another computation keeps the others busy meanwhile.
"""

from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from threading import Event
from typing import TypeVar

from walker_jax.execution.tiles import Stop, cores, stopping
from walker_jax.kernels.program import apply_settings, current_settings

Item = TypeVar("Item")
Result = TypeVar("Result")


def side_by_side(
    function: Callable[[Item], Result], items: Iterable[Item]
) -> Generator[Result, None, None]:
    """Yield function(item) for each item, in order, as many at a time as there are cores.

    If one raises, or the iterator is closed, the others stop before their next kernel.
    """
    settings, stop, outer = current_settings(), Event(), stopping.get()

    def as_here(item: Item) -> Result:
        stopping.set((*outer, stop))
        with apply_settings(settings):
            return function(item)

    with ThreadPoolExecutor(cores()) as pool:
        try:
            yield from pool.map(as_here, items)
        finally:
            stop.set()


@contextmanager
def stopped_when(is_over: Callable[[], bool]) -> Iterator[None]:
    """Stop what is computed within before its next kernel (`CancelledError`) once that holds."""
    token = stopping.set((*stopping.get(), Stop(is_over)))
    try:
        yield
    finally:
        stopping.reset(token)

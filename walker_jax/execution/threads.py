"""Independent computations side by side, each in a thread.

A kernel uses all cores by itself. What a computation does between kernels, in Python and NumPy, is
done by one core: another computation keeps the others busy meanwhile.
"""

from collections.abc import Callable, Generator, Iterable
from concurrent.futures import ThreadPoolExecutor
from threading import Event
from typing import TypeVar

from walker_jax.execution.tiles import cores, stopping
from walker_jax.kernels.program import apply_settings, current_settings

Thing = TypeVar("Thing")
Result = TypeVar("Result")


def side_by_side(
    function: Callable[[Thing], Result], things: Iterable[Thing]
) -> Generator[Result, None, None]:
    """function(thing) for each of the things, in their order, as many at a time as there are cores.

    Where one raises, or the iterator is closed, the others stop before their next kernel.
    """
    settings, stop, outer = current_settings(), Event(), stopping.get()

    def as_here(thing: Thing) -> Result:
        stopping.set((*outer, stop))
        with apply_settings(settings):
            return function(thing)

    with ThreadPoolExecutor(cores()) as pool:
        try:
            yield from pool.map(as_here, things)
        finally:
            stop.set()

"""The time that an optimisation may take.

The first value of the objective cannot be cut, with all that leads to it and all the programs that
it compiles. After it, work that has begun stops before its next kernel once the time is over, and
no measurement begins that would take longer than is left, if it takes as long as the last one of
its kind. For what follows the climbs there is a third more of the time that the first value left.
"""

import math
import threading
from collections.abc import Callable, Hashable, Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager
from time import perf_counter
from typing import TypeVar

from walker_jax.execution.threads import stopped_when

EXTRA = 1 / 3
"""What follows the climbs may take this share of the time that the first measurement left."""

Result = TypeVar("Result")


class Budget:
    """A number of seconds from now on, and how they are used up."""

    def __init__(self, seconds: float = math.inf):
        self.seconds, self.began = seconds, perf_counter()
        self.ends = self.began + seconds
        self.first: float | None = None
        """Seconds until the first value was known; None before."""
        self.first_made = threading.Event()
        self.took: dict[Hashable, float] = {}
        """Seconds of the last measurement of each kind."""
        self.ran_out = False
        """Whether anything was left out because no time was left."""

    def left(self) -> float:
        """Return the seconds left; all of them until the first value is known."""
        return math.inf if self.first is None else self.ends - perf_counter()

    def is_over(self) -> bool:
        """Return whether the time is over."""
        over = self.left() <= 0
        self.ran_out |= over
        return over

    def begin(self) -> None:
        """Note that the first value is known, if that is new."""
        if self.first is None:
            self.first = perf_counter() - self.began
        self.first_made.set()

    def extend(self) -> None:
        """Add the time for what follows the climbs."""
        extra = EXTRA * max(0.0, self.seconds - (self.first or 0.0))
        self.ends = self.began + self.seconds + extra

    def wait_for_first(self) -> None:
        """Wait for the first value, which other work would delay, if time is limited."""
        if self.seconds < math.inf:
            self.first_made.wait()

    @contextmanager
    def measuring(self, kind: Hashable) -> Iterator[None]:
        """Time a measurement; raise `CancelledError` if another one of its kind would not fit."""
        if self.took.get(kind, 0.0) > self.left():
            self.ran_out = True
            raise CancelledError
        first, begun = self.first is None, perf_counter()
        yield
        if not first:  # the first one compiles programs, others take less time
            self.took[kind] = perf_counter() - begun

    def try_in_time(self, work: Callable[[], Result], least: float = 0.0) -> Result | None:
        """Return what is computed; None if time is over before, or fewer than `least` are left."""
        if self.is_over() or self.left() < least:
            self.ran_out = True
            return None
        try:
            with stopped_when(self.is_over):
                return work()
        except CancelledError:
            if not self.ran_out:  # other work has failed
                raise
            return None

"""The memory of a program's arrays: those that are not needed at the same time share it.

The program of a transposed series makes thousands of arrays, and reads most of them soon after for
the last time. With a place of its own for each they would not fit in a processor's cache. Where an
array begins is known when the program is complete, so its text is written last.
"""

import bisect
from typing import Any

from walker_jax.kernels.memory import LONG

ALIGNMENT = 64


class Span:
    """The part of a program in which an array is needed, in steps of `Lifetimes`."""

    __slots__ = "begin", "first", "last", "size"

    def __init__(self, size: int, now: int):
        self.size, self.begin, self.last = -(-size // ALIGNMENT) * ALIGNMENT, now, now
        self.first: int | None = None
        """The byte of the memory where the array begins."""


class Distance:
    """An integer of LLVM: the byte where an array begins, and some more."""

    type = LONG

    def __init__(self, span: Span, more: int):
        self.span, self.more = span, more

    def get_reference(self) -> str:
        assert self.span.first is not None
        return str(self.span.first + self.more)


class Lifetimes:
    """The spans of all arrays, in the order in which they begin."""

    def __init__(self):
        self.spans: list[Span] = []
        self.now = 0

    def begin(self, size: int) -> Span:
        self.now += 1
        self.spans.append(Span(size, self.now))
        return self.spans[-1]

    def use(self, span: Span) -> None:
        span.last = self.now

    def begin_loop(self) -> int:
        """Return the step in which a loop begins."""
        self.now += 1
        return self.now

    def end_loop(self, begun: int) -> None:
        """Keep to its end what the turns of a loop use and did not make: the next one needs it."""
        for span in self.spans:
            if span.begin < begun <= span.last:
                span.last = self.now

    def place(self) -> int:
        """Give each array the first gap that holds it; return the size of the memory."""
        size, gaps, live = 0, [], []
        for span in self.spans:
            while live and live[0][0] < span.begin:
                release(gaps, live.pop(0)[1])
            found = next((i for i, (a, b) in enumerate(gaps) if b - a >= span.size), None)
            if found is None:
                span.first, size = size, size + span.size
            else:
                a, b = gaps.pop(found)
                span.first = a
                if b - a > span.size:
                    gaps.insert(found, (a + span.size, b))
            bisect.insort(live, (span.last, span), key=lambda one: one[0])
        return size


def release(gaps: list[tuple[int, int]], span: Any) -> None:
    """Add the bytes of an array to the gaps, joined with those beside it."""
    a, b = span.first, span.first + span.size
    i = bisect.bisect(gaps, (a, b))
    if i < len(gaps) and gaps[i][0] == b:
        b = gaps.pop(i)[1]
    if i and gaps[i - 1][1] == a:
        i, a = i - 1, gaps.pop(i - 1)[0]
    gaps.insert(i, (a, b))

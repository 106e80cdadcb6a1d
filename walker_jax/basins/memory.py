"""The memory of the machine, and a check that a computation fits it."""

import os

from walker_jax.checks import WrongUse


class TooLarge(WrongUse, MemoryError):
    """A computation needs more memory than this machine has."""


def check_memory(needed: int, subject: str, instead: str) -> None:
    """Raise `TooLarge` if a subject needs more bytes than there are, and say what to do instead."""
    memory = memory_of_machine()
    if needed > memory:
        raise TooLarge(
            f"{subject} {needed / 2**30:.1f} GiB of memory, and this machine has "
            f"{memory / 2**30:.1f} GiB: {instead}"
        )


def check_level(levels: int, level: int, count: int, each: int) -> None:
    """Raise `TooLarge` for a level of refinement with more cells than fit the memory."""
    subject = f"levels={levels}: level {level} follows {count} cells, which need"
    check_memory(count * each, subject, "lower levels")


def memory_of_machine() -> float:
    """Return the bytes of memory; infinite where the system does not say."""
    try:
        return float(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    except (AttributeError, ValueError):  # not a POSIX system
        return float("inf")

"""The numbers of a machine by name, each shared by both legs."""

from __future__ import annotations

from walker_jax.checks import WrongUse

NOTHING = 1e-12
"""Size below which a number of a file is taken for zero: rounding of places that coincide."""
ALIKE = 1e-9
"""Largest difference of numbers of like legs, over their size or 1."""


DIGITS = 15
"""Significant digits of a number, all that a file's decimals determine: the places of bodies, added
along the tree and subtracted again, have rounding errors beyond."""


class Ledger:
    """Collects the numbers of a file; those that are zero become part of the structure."""

    def __init__(self):
        self.numbers: dict[str, float] = {}
        self.seen: dict[str, tuple[float, int]] = {}

    def note(self, name: str, value: float, owner: int, part: str) -> str | None:
        """Note a number of a part; return its name, or None for zero.

        `owner` is the same number for both parts of a pair. Raises `WrongUse` where these differ,
        and where parts that are no pair have one name.
        """
        value = float(f"{value:.{DIGITS}g}")
        known, first = self.seen.setdefault(name, (value, owner))
        if first != owner:
            raise WrongUse(f"path has two parts with a number {name}: name them differently")
        if not abs(known - value) <= ALIKE * max(1.0, abs(known)):
            raise WrongUse(
                f"path must have two like legs: {name} of {part} is {value:g}, of the other leg "
                f"{known:g}"
            )
        if abs(known) <= NOTHING:
            return None
        self.numbers[name] = known
        return name

    def always(self, name: str, value: float) -> str:
        """Note a number that is a parameter even where it is zero."""
        self.numbers[name] = float(f"{value:.{DIGITS}g}")
        return name

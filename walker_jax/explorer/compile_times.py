"""Estimates of how long the programs of a walker, or of another system, take to compile."""

from walker_jax.explorer.offers import FAMILY, OTHERS, Offer

SECONDS = {
    "simplest": 3,
    "spring": 4,
    "point-foot": 8,
    "round-foot": 9,
    "upper-body": 12,
    "kneed": 33,
    "spatial": 60,
    "powered": 5,
    "powered-point-foot": 10,
    "powered-round-foot": 9,
    "powered-upper-body": 12,
    "henon": 1,
    "duffing": 3,
    "bouncing-ball": 1,
    "impact-oscillator": 2,
    "spring-biped": 9,
    "quadruped": 30,
    "hopper": 13,
    "torso-wheel": 10,
    "five-link-biped": 20,
}
"""Seconds on two cores, with nothing in the caches; see benchmarks/explorer_compiling.py."""


class CompileTimes:
    """Estimates from the table, scaled up by how much longer this machine has taken so far."""

    def __init__(self) -> None:
        self.expected, self.taken = 0.0, 0.0

    def record(self, offered: Offer, seconds: float) -> None:
        """Record how long the programs of an offer took, if the table has an estimate for it."""
        expected = expected_seconds(offered)
        if expected is not None:
            self.expected, self.taken = self.expected + expected, self.taken + seconds

    def estimate(self, offered: Offer) -> float | None:
        """Estimate the seconds that the programs of an offer take; None without an estimate.

        The scale is at least 1, as programs found in a cache say nothing about the others.
        """
        expected = expected_seconds(offered)
        scale = max(1.0, self.taken / self.expected) if self.expected else 1.0
        return None if expected is None else scale * expected


def expected_seconds(offered: Offer) -> int | None:
    """Return the seconds in the table; for a user's own class, those of the class it extends."""
    if offered.name in SECONDS:
        return SECONDS[offered.name]
    bases = offered.kind.__mro__ if isinstance(offered.kind, type) else ()
    names = {one.kind: name for name, one in (FAMILY | OTHERS).items()}
    return next((SECONDS[names[base]] for base in bases if names.get(base) in SECONDS), None)

"""Hybrid systems, which move through modes from their section back to it."""

import abc
from typing import Any

import numpy as np
from jaxtyping import Array, Float

from walker_jax.checks import WrongUse, short
from walker_jax.hybrid.modes import Mode
from walker_jax.systems.outcomes import Outcome, names_of_outcomes
from walker_jax.systems.system import System


class HybridSystem(System):
    """A system of modes of motion, such as flights and stances, or one period of a flow.

    A stride begins in the state of the first mode that `lift` returns. Each mode is followed to the
    guard that ends it, and its `reset` returns the state in which the next mode begins. The reset
    of the last mode leads back to the section, where `project` reads the coordinates. A guard leads
    to `Outcome.STRIDE` if the stride continues, and otherwise to a failure. `self.failure` returns
    the failures that the system names in `failures`.

    States may have any structure: trees of scalars or arrays, such as a `NamedTuple` of numbers.
    `systems.bouncing_ball` is a short example.
    """

    @abc.abstractmethod
    def modes(self) -> tuple[Mode, ...]:
        """Return the modes of a stride, in order."""

    @abc.abstractmethod
    def lift(self, x: Float[Array, " section"]) -> Any:
        """Return the state in which the stride from a point of the section begins."""

    @abc.abstractmethod
    def project(self, state: Any) -> Float[Array, " section"]:
        """Return the point of the section that belongs to a state on it."""


def check_outcomes(system: HybridSystem, *modes: Mode) -> None:
    """Refuse guards and conditions that lead to no `Outcome`, or to an unnamed failure."""
    known = names_of_outcomes(system.failures).keys()
    failures = known - {Outcome.STRIDE}
    for mode in modes:
        ends = [("guards", getattr(one, "leads_to", one), known) for one in mode.guards]
        for part in ("conditions", "at_end"):
            ends += [(part, getattr(one, "outcome", one), failures) for one in getattr(mode, part)]
        for part, outcome, allowed in ends:
            number = isinstance(outcome, int | np.integer) and not isinstance(outcome, bool)
            if not number or outcome not in allowed:
                raise WrongUse(
                    f"{part} of a mode of {system.label()} must lead to "
                    f"{'an Outcome' if part == 'guards' else 'a failure'}, not to "
                    f"{short(outcome)}: failure gives one by its name"
                )

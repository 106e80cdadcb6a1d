"""Systems that move through modes, from their section back to it."""

import abc
from typing import Any

from jaxtyping import Array, Float

from walker_jax.checks import WrongUse
from walker_jax.hybrid.modes import Mode
from walker_jax.systems.outcomes import Outcome
from walker_jax.systems.system import System


class HybridSystem(System):
    """A system of modes of motion: flights and stances, or one period of a flow.

    A stride begins in the state of the first mode that `lift` gives. Each mode is followed to the
    guard that ends it, and its `reset` gives the state in which the next one begins; that of the
    last one leads back to the section, where `project` reads the coordinates. A guard leads to
    `Outcome.STRIDE` where the stride goes on, and else to the failure that it is: `self.failure`
    gives those that the system names in `failures`.

    States are of any shape: trees of scalars or arrays, such as a `NamedTuple` of numbers.
    """

    @abc.abstractmethod
    def modes(self) -> tuple[Mode, ...]:
        """The modes of a stride, in order."""

    @abc.abstractmethod
    def lift(self, x: Float[Array, " section"]) -> Any:
        """The state in which the stride from a point of the section begins."""

    @abc.abstractmethod
    def project(self, state: Any) -> Float[Array, " section"]:
        """The point of the section of a state there."""


def check_outcomes(system: HybridSystem, *modes: Mode) -> None:
    """Refuse guards and conditions that lead to what no `Outcome` is."""
    for outcome in (one for mode in modes for one in mode.outcomes()):
        if int(outcome) not in Outcome.__members__.values():
            raise WrongUse(
                f"leads_to of a guard of {system.label()} must be an Outcome, not {outcome}: "
                "failure gives those of its own"
            )

"""Hybrid systems, which move through modes from their section back to it."""

import abc
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from walker_jax.hybrid.graphs import check_graph
from walker_jax.hybrid.modes import Mode
from walker_jax.integrators.roots import Scalar
from walker_jax.systems.outcomes import Outcome, names_of_outcomes
from walker_jax.systems.system import System


class HybridSystem(System):
    """A system of modes of motion, such as flights and stances, or one period of a flow.

    A stride begins in the state of the first mode that `lift` returns. Each mode is followed to the
    guard that ends it. The guard names where it leads: to another mode, to `SECTION`, or to a
    failure. Its `reset` returns the state in which the next mode begins. The reset of a guard that
    leads to the section returns a state like that of `lift`, of which `project` reads the
    coordinates. Failures are those that the system names in `failures`, or an `Outcome`'s.

    States may have any structure, another one in each mode: trees of numbers or arrays, such as a
    `NamedTuple` of numbers, but no lists. `systems.bouncing_ball` is a short example.
    """

    @abc.abstractmethod
    def modes(self) -> dict[str, Mode]:
        """Return the modes of a stride by name; the first one is where it begins."""

    def modes_on(self, step: Scalar) -> dict[str, Mode] | None:
        """Return the modes of a stride to ground that is higher by `step`, in the unit of length.

        None, the default, means that the system has no ground that could be raised.
        """
        return None

    @abc.abstractmethod
    def lift(self, x: Float[Array, " section"]) -> Any:
        """Return the state in which the stride from a point of the section begins."""

    @abc.abstractmethod
    def project(self, state: Any) -> Float[Array, " section"]:
        """Return the point of the section that belongs to a state on it."""

    def begin(self, state: Any) -> Any:
        """Return the state of the first mode, from a state on the section; by default the same."""
        return state

    def full_states(self) -> tuple[type, ...]:
        """Return kinds of states, `NamedTuple`s of numbers, in which a stride may begin too.

        By default a stride begins on the section alone.
        """
        return ()

    def launch(self, x: Float[Array, " coordinates"]) -> Any:
        """Return the state of the first mode in which the stride from x begins.

        x is on the section, or one of the `full_states`, which have another size.
        """
        start = self.begin(self.lift(x))
        is_truth = lambda y: jnp.issubdtype(jnp.result_type(y), jnp.bool_)  # which is no number
        return jax.tree.map(lambda y: y if is_truth(y) else jnp.asarray(y, x.dtype), start)

    def names_of_state(self) -> tuple[str, ...] | None:
        """Return the names of a state's numbers as a stride begins; None if it has none.

        By default they are those of the fields of a `NamedTuple`.
        """
        state = jax.eval_shape(self.launch, jnp.zeros(len(self.section)))
        return getattr(state, "_fields", None)

    def may_launch(self, x: Float[Array, " coordinates"], start: Any) -> Bool[Array, ""]:
        """Return whether a stride can begin at x, in the state `start` of the first mode."""
        return self.feasible(x)

    def shown(self, state: Any) -> Any:
        """Return a state of any mode as one of the first mode's kind, for `trajectory`.

        By default the states of all modes are of one kind.
        """
        return state

    def unit_of_time(self) -> Any:
        """Return a typical time, by which rates are compared with values; by default 1."""
        return 1.0


def failures_by_name(system: System) -> dict[str, int]:
    """Return the numbers of all failures to which guards and conditions may lead, by name."""
    return {
        name: int(outcome)
        for outcome, name in names_of_outcomes(system.failures).items()
        if outcome != Outcome.STRIDE
    }


def has_ground(system: System) -> bool:
    """Return whether a system walks on ground that may be higher or lower at each step."""
    return isinstance(system, HybridSystem) and system.modes_on(jnp.asarray(0.0)) is not None


def modes_of(system: HybridSystem, step: Scalar | None = None) -> dict[str, Mode]:
    """Return the modes of a system, checked; those on a step, if there is one."""
    modes: Any = system.modes() if step is None else system.modes_on(step)
    check_graph(system.label(), modes, {*failures_by_name(system)})
    return modes

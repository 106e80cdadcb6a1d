"""A return map with parameters: all that gaits, basins, stability and design need to know.

A system has a section, with names for its coordinates, and a rule that leads from one point of it
to the next. The walkers of the package are systems, and so is any map, any flow with a period, any
machine whose motion comes back to a section. What is called a stride is one application of the
rule; a gait is a periodic point; and a system fails where no next point is.
"""

import dataclasses
from typing import Any, ClassVar, TypeVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float

from walker_jax.checks import WrongUse
from walker_jax.grids import Grid
from walker_jax.integrators.roots import Scalar
from walker_jax.systems.outcomes import OWN, Outcome, Stride, make_stride

AnySystem = TypeVar("AnySystem", bound="System")


SHARED_FAILURES = tuple(
    one.name
    for one in Outcome
    if one not in (Outcome.STRIDE, Outcome.OUTSIDE, Outcome.UNDECIDED, Outcome.LEFT_GRID, *OWN)
)
"""Names of failures on the way that all systems may have."""


class System(eqx.Module):
    """A return map. Its fields are its parameters, scalars all, but for those that are static.

    Derive from it to define `advance`; from `HybridSystem` to define modes of motion instead; or
    make a `Map` of a function.
    """

    section: ClassVar[tuple[str, ...]]
    """Names of the coordinates."""
    failures: ClassVar[tuple[str, ...]] = ()
    """Names of failures of its own, up to four, such as "misses" or "hits_the_wall"."""

    def __check_init__(self):
        names, known = self.failures, Outcome.__members__
        words = isinstance(names, tuple) and all(isinstance(one, str) for one in names)
        if not words or not all(one.isidentifier() and one not in known for one in names):
            raise WrongUse(
                f"failures of {self.label()} must be a tuple of words that name no Outcome, "
                f"not {names!r}"
            )
        if len(set(names)) < len(names) or len(names) > len(OWN):
            raise WrongUse(
                f"failures of {self.label()} must be {len(OWN)} different words at most, "
                f"not {names!r}"
            )

    def __repr__(self):
        """The parameters' values, as far as each is one number; else their types and shapes."""
        code = {one.name for one in dataclasses.fields(self) if is_code(one)}
        values = {name: value for name, value in every_value(self).items() if name not in code}
        shown = (f"{name}={format_parameter(value)}" for name, value in values.items())
        return f"{self.label()}({', '.join(shown)})"

    def advance(self, x: Float[Array, " section"]) -> tuple[Any, Any, Any]:
        """The next point, of shape (section,), the `Outcome`, and the time that it takes.

        A pure JAX function of one point. `wj.stride` calls it, and gives `OUTSIDE` for a start that
        is not feasible, and `UNDECIDED` where a next point is not finite.
        """
        raise WrongUse(f"advance must be defined by {self.label()}, which has none")

    def failure(self, name: str) -> Outcome:
        """The `Outcome` of a failure: one of the system's own `failures`, or one that all share."""
        if name in self.failures:
            return OWN[self.failures.index(name)]
        if name not in SHARED_FAILURES:
            raise WrongUse(
                f"failure of {self.label()} must be one of "
                f"{', '.join([*self.failures, *SHARED_FAILURES])}, not {name!r}"
            )
        return Outcome[name]

    def label(self) -> str:
        """Its name in data sets, answers and errors."""
        return type(self).__name__

    def feasible(self, x: Float[Array, " section"]) -> Bool[Array, ""]:
        """Whether x is a point to begin from. By default wherever it is finite."""
        return jnp.all(jnp.isfinite(x))

    def margin(self, x: Float[Array, " section"]) -> Scalar | None:
        """By how much a stride from x succeeds: smooth, positive where it does, else not.

        Where it is zero the failure begins, and areas of basins have derivatives by it. By default
        none is known.
        """
        return None

    def gait_region(self) -> Grid:
        """The part of the section where gaits are searched for, in cells to search from."""
        raise WrongUse(
            f"guess or region must be given for {self.label()}, which has no gait_region"
        )

    def further_gait_region(self) -> Grid | None:
        """Where `find_gait` searches too if none in `gait_region` is stable. By default nowhere."""
        return None


def has_gait_region(system: System) -> bool:
    """Whether a system says where its gaits are to be searched for."""
    try:
        system.gait_region()
    except WrongUse:
        return False
    return True


def apply_map(walker: System, x: Float[Array, " section"]) -> Stride:
    """The next point of a system that says itself how it advances."""
    state, outcome, time = walker.advance(x)
    state = jnp.asarray(state)
    if state.shape != x.shape or state.dtype != x.dtype:
        raise WrongUse(
            f"advance of {walker.label()} must lead to {x.dtype} of shape {x.shape}, not to "
            f"{state.dtype} of shape {state.shape}"
        )
    finite = jnp.all(jnp.isfinite(state))
    known = jnp.asarray((outcome >= 0) & (outcome < OWN[0] + len(walker.failures)))
    decided = known & ((outcome != Outcome.STRIDE) | finite)
    outcome = jnp.where(decided, outcome, Outcome.UNDECIDED)
    outcome = jnp.where(walker.feasible(x), outcome, Outcome.OUTSIDE).astype(jnp.int8)
    return make_stride(state, outcome, jnp.asarray(time, x.dtype))


def code_field(**settings: Any) -> Any:
    """A static field of what is part of a system's code, such as a function that it is made of."""
    return eqx.field(static=True, metadata={"code": True}, **settings)


def is_code(field: dataclasses.Field) -> bool:
    """Whether a field is one of code."""
    return field.metadata.get("code", False)


def code_of(system: System) -> tuple[Any, ...]:
    """The values of a system's fields of code."""
    return tuple(getattr(system, one.name) for one in dataclasses.fields(system) if is_code(one))


def every_value(system: System) -> dict[str, Any]:
    """The values of all fields by name; of parameters in a dictionary by theirs."""
    values = {}
    for name, value in vars(system).items():
        values |= value if isinstance(value, dict) else {name: value}
    return values


def numbers_of(system: System) -> dict[str, Any]:
    """The parameters of a system, by name: its fields but for options, which are static."""
    options = {one.name for one in dataclasses.fields(system) if one.metadata.get("static")}
    return {name: value for name, value in every_value(system).items() if name not in options}


def check_single(system: System) -> None:
    """Refuse many systems, with arrays for parameters."""
    for name, value in numbers_of(system).items():
        if np.shape(value):
            raise WrongUse(f"{name} must be one number, not of shape {np.shape(value)}")


def format_parameter(value: Any) -> str:
    """A number as it is; of arrays, and of what JAX traces, the type and shape."""
    if not eqx.is_array_like(value):
        return repr(value)
    single = not isinstance(value, Tracer) and np.shape(value) == ()
    return str(np.asarray(value)[()]) if single else eqx.tree_pformat(value)

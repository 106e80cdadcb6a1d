"""Return maps with parameters: all that gaits, basins, stability and design need to know.

A system has a section, with names for its coordinates, and a rule that leads from one point of it
to the next. The walkers of the package are systems, and so is any map, any flow with a period, any
machine whose motion comes back to a section. A stride is one application of the rule, and a gait is
a periodic point. A system fails where there is no next point.
"""

import dataclasses
from collections.abc import Callable
from typing import Any, ClassVar, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float

from walker_jax.checks import FLOAT64_HINT, WrongUse, short, warn_once
from walker_jax.grids import Grid
from walker_jax.integrators.roots import Scalar
from walker_jax.systems.html_tables import html_table
from walker_jax.systems.outcomes import OUTCOMES, OWN, Outcome, Stride, make_stride
from walker_jax.systems.parameter import Parameter, description
from walker_jax.systems.trees import (
    PARAMETERS,
    dynamic_fields,
    functions_in,
    is_tree,
    leaves_in,
    leaves_of,
    settle,
    structure_of,
)

AnySystem = TypeVar("AnySystem", bound="System")


SHARED_FAILURES = tuple(
    one.name
    for one in Outcome
    if one not in (Outcome.STRIDE, Outcome.OUTSIDE, Outcome.UNDECIDED, Outcome.LEFT_GRID)
)
"""Names of failures during a stride that any system may have."""


class System(eqx.Module):
    """A return map; its fields are parameters, or static options.

    A parameter is a number, an array, or any tree of arrays, such as a network.

    ```python
    class Logistic(wj.System):
        r: float | jax.Array = 3.2
        section = ("x",)

        def advance(self, x):
            return self.r * x * (1 - x), wj.Outcome.STRIDE, 1.0
    ```

    Derive from it to define `advance`, or from `HybridSystem` to define modes of motion instead;
    or make a `Map` of a function.
    """

    section: ClassVar[tuple[str, ...]]
    """Names of the coordinates."""
    failures: ClassVar[tuple[str, ...]] = ()
    """Names of failures of its own, such as "misses" or "hits_the_wall"."""
    angles: ClassVar[tuple[str, ...]] = ()
    """Names of those coordinates that are angles (rad): a full turn more is the same point."""
    array_ranks: tuple[tuple[str, int], ...] = eqx.field(static=True, init=False, default=())
    """Ranks, in one system, of leaves that are no single numbers, by name: a leaf with further
    axes before these belongs to many systems."""

    spans: ClassVar[dict[str, tuple[float, float]]] = {}
    """Usual ranges of parameters, over which gaits are followed unless others are given."""

    def __check_init__(self):
        settle(self)
        names, known = self.failures, Outcome.__members__
        words = isinstance(names, tuple) and all(isinstance(one, str) for one in names)
        if not words or not all(one.isidentifier() and one not in known for one in names):
            raise WrongUse(
                f"failures of {self.label()} must be a tuple of words that name no Outcome, "
                f"not {names!r}"
            )
        if len(set(names)) < len(names) or len(names) > OUTCOMES - OWN:
            raise WrongUse(
                f"failures of {self.label()} must be {OUTCOMES - OWN} different words at most, "
                f"not {names!r}"
            )
        angles = self.angles
        if not isinstance(angles, tuple) or not all(one in self.section for one in angles):
            raise WrongUse(
                f"angles of {self.label()} must be a tuple of names out of "
                f"{', '.join(self.section)}, not {short(angles)}"
            )

        for name, value in statics_of(self).items():
            if not all(isinstance(one, STATIC) for one in as_tuple(value)):
                raise WrongUse(
                    f"{name} of {self.label()} is static, so it must be numbers or words, not "
                    f"{short(value)}: a function can be a method"
                )

    def __repr__(self):
        """Show the values of parameters that are single numbers, and the type of all others."""
        shown = (f"{name}={format_parameter(value)}" for name, value in shown_values(self).items())
        return f"{self.label()}({', '.join(shown)})"

    def _repr_html_(self) -> str:
        """Return a table of the parameters, with units and meanings, for notebooks."""
        fields = {one.name: one for one in dataclasses.fields(self)}
        rows = []
        for name, value in shown_values(self).items():
            one = description(fields[name], Parameter) if name in fields else None
            about = (one.unit, one.meaning) if one else ("", "")
            leaves = dict(leaves_in(name, value)) | functions_in(name, value)
            rows += [(leaf, format_parameter(of), *about) for leaf, of in leaves.items()]
        return html_table(self.label(), ("parameter", "value", "unit", "meaning"), rows)

    def advance(self, x: Float[Array, " section"]) -> tuple[Any, Any, Any]:
        """Return the next point, of shape (section,), the `Outcome`, and the duration.

        This is a pure JAX function of one point. `wj.stride` calls it, and returns `OUTSIDE` for a
        start that is not feasible, and `UNDECIDED` if the next point is not finite.
        """
        raise WrongUse(f"advance must be defined by {self.label()}, which has none")

    def failure(self, name: str) -> Outcome:
        """Return the `Outcome` of a failure: one of the system's `failures`, or a shared one."""
        if name in self.failures:
            return Outcome(OWN + self.failures.index(name))
        if name not in SHARED_FAILURES:
            raise WrongUse(
                f"failure of {self.label()} must be one of "
                f"{', '.join([*self.failures, *SHARED_FAILURES])}, not {name!r}"
            )
        return Outcome[name]

    def during_stride(self: AnySystem, x: Float[Array, " section"]) -> AnySystem:
        """Return the system during the stride from x: its parameters may depend on the start.

        That is feedback from stride to stride. By default a system stays as it is. From a full
        state, x has the section's coordinates (`project`).
        """
        return self

    def label(self) -> str:
        """Return the system's name in data sets, answers and errors."""
        return type(self).__name__

    def feasible(self, x: Float[Array, " section"]) -> Bool[Array, ""]:
        """Return whether a stride may begin at x; by default at any finite x."""
        return jnp.all(jnp.isfinite(x))

    def margin(self, x: Float[Array, " section"]) -> Scalar | None:
        """Return by how much a stride from x succeeds: a smooth number, positive if it does.

        The failure begins where it is zero, so it gives areas of basins their derivatives. By
        default none is known.
        """
        return None

    def picture(self) -> Any:
        """Return how walks are drawn (`walkers.pictures`); None, the default, if they are not."""
        return None

    def step_length(self, x: Float[Array, " section"], end: Callable[[], Any]) -> Scalar | None:
        """Return the length of a step of a gait at x; `end()` is the state at the stride's end.

        None, the default, means that the system makes no steps.
        """
        return None

    def driven_by_gravity(self) -> bool:
        """Return whether gravity alone does work: a step loses the energy that the slope gives.

        By default that is not known.
        """
        return False

    def motor_work(self, start: Any, end: Any) -> Scalar | None:
        """Return the work of motors in a step, per unit of weight, in the unit of length.

        The states are those just after a heel strike and just before the next. The method is called
        where `driven_by_gravity` is false. None, the default, means unknown.
        """
        return None

    def remarks(self) -> tuple[str, ...]:
        """Return lines that `wj.explain` adds to its report, such as limits of the model."""
        return ()

    def basin_region(self, gait: Callable[[], Float[Any, " section"] | None]) -> Grid | None:
        """Return the region in which the basin around a gait is measured, by default all.

        `gait()` is a state of the gait, or None where none is found.
        """
        return self.gait_region()

    def gait_region(self) -> Grid:
        """Return the part of the section to search for gaits, with one search from each cell."""
        raise WrongUse(
            f"guess or region must be given for {self.label()}, which defines no gait_region"
        )

    def further_gait_region(self) -> Grid | None:
        """Return where `find_gait` also searches if no gait in `gait_region` is stable, or None."""
        return None


def has_gait_region(system: System) -> bool:
    """Return whether a system defines a region to search for gaits."""
    try:
        system.gait_region()
    except WrongUse:
        return False
    return True


def apply_map(walker: System, x: Float[Array, " section"]) -> Stride:
    """Make a stride of a system that defines `advance`."""
    state, outcome, time = walker.advance(x)
    state = jnp.asarray(state)
    if state.shape != x.shape or state.dtype != x.dtype:
        raise WrongUse(
            f"advance of {walker.label()} must lead to {x.dtype} of shape {x.shape}, not to "
            f"{state.dtype} of shape {state.shape}"
        )
    finite = jnp.all(jnp.isfinite(state))
    known = jnp.asarray((outcome >= 0) & (outcome < OWN + len(walker.failures)))
    decided = known & ((outcome != Outcome.STRIDE) | finite)
    outcome = jnp.where(decided, outcome, Outcome.UNDECIDED)
    outcome = jnp.where(walker.feasible(x), outcome, Outcome.OUTSIDE).astype(jnp.int8)
    return make_stride(state, outcome, jnp.asarray(time, x.dtype))


def code_field(**settings: Any) -> Any:
    """Return a static field for part of a system's code, such as the function of a map."""
    return eqx.field(static=True, metadata={"code": True}, **settings)


def is_code(field: dataclasses.Field) -> bool:
    """Return whether a field holds code."""
    return field.metadata.get("code", False)


def code_of(system: System) -> tuple[Any, ...]:
    """Return the values of a system's fields of code, and the structures of its trees."""
    code = [getattr(system, one.name) for one in dataclasses.fields(system) if is_code(one)]
    trees = (getattr(system, one.name) for one in dynamic_fields(system) if not is_code(one))
    return *code, *filter(None, map(structure_of, trees))


STATIC = bool, int, float, str, np.generic, type(None)
"""Types of static values, which data sets name."""


def statics_of(system: System) -> dict[str, Any]:
    """Return the values of static fields by name, those of code excepted."""
    static = (one for one in dataclasses.fields(system) if one.metadata.get("static") and one.init)
    return {one.name: getattr(system, one.name) for one in static if not is_code(one)}


def as_tuple(value: Any) -> tuple:
    return value if isinstance(value, tuple) else (value,)


def fields_of(system: System) -> dict[str, Any]:
    """Return the values of all fields by name."""
    known = {one.name for one in dataclasses.fields(system)} - {"array_ranks"}
    return {name: value for name, value in vars(system).items() if name in known}


def shown_values(system: System) -> dict[str, Any]:
    """Return the values of all fields but code by name; the parameters of a map by their own."""
    code = {one.name for one in dataclasses.fields(system) if is_code(one)}
    values = {}
    for name, value in fields_of(system).items():
        own = name == PARAMETERS and isinstance(value, dict)
        values |= value if own else {name: value} if name not in code else {}
    return values


def numbers_of(system: System) -> dict[str, Any]:
    """Return the parameters of a system that are single numbers, by name."""
    ranks = dict(system.array_ranks)
    return {name: value for name, value in leaves_of(system).items() if name not in ranks}


def arrays_of(system: System) -> dict[str, Any]:
    """Return the arrays among the parameters of a system, by name."""
    ranks = dict(system.array_ranks)
    return {name: value for name, value in leaves_of(system).items() if name in ranks}


def check_single(system: System) -> None:
    """Refuse several systems in one, with further axes of their parameters."""
    ranks = dict(system.array_ranks)
    for name, value in leaves_of(system).items():
        if np.ndim(value) != (rank := ranks.get(name, 0)):
            expected = f"an array of rank {rank}" if rank else "one number"
            raise WrongUse(f"{name} must be {expected}, not of shape {np.shape(value)}")


def warn_if_rounded(system: System) -> None:
    """Warn of parameters that were rounded to float32 before float64 was turned on."""
    if jnp.result_type(float) != np.float64:
        return
    for name, value in leaves_of(system).items():
        if getattr(value, "dtype", None) == np.float32:
            single = np.size(value) == 1 and not isinstance(value, Tracer)
            given = f"{name} {float(value)!r}" if single else name
            warn_once(f"{given} has the seven digits of float32: {FLOAT64_HINT}")


def format_parameter(value: Any) -> str:
    """Format a number as it is, an array or traced value by its type and shape, a tree by size."""
    if is_tree(value) and (leaves := jax.tree.leaves(value)):
        return f"{type(value).__name__} of {sum(map(np.size, leaves))} numbers"
    if not eqx.is_array_like(value):
        return repr(value)
    single = not isinstance(value, Tracer) and np.shape(value) == ()
    return str(np.asarray(value)[()]) if single else eqx.tree_pformat(value)

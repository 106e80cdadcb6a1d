"""The attractors of any starts, and the label of one start, as a pure JAX function."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.typing import ArrayLike
from jaxtyping import Float

from walker_jax.basins.attractor import Attractor
from walker_jax.basins.attractor_search import attracts, survey
from walker_jax.basins.labels import EXTRA_STRIDES, Label
from walker_jax.basins.mapper import Mapper
from walker_jax.checks import (
    WrongUse,
    check_kind,
    check_precision,
    check_whole,
    numbers,
    refuses_tracers,
    short,
)
from walker_jax.integrators.integrator import AnySolver, integrator_of
from walker_jax.integrators.roots import Real
from walker_jax.kernels.primitive import nan_allowed
from walker_jax.systems.system import System, check_single
from walker_jax.walking.starts import prepare


@refuses_tracers("find them first, and give them to label as operands")
def find_attractors(
    system: System,
    starts: Float[ArrayLike, "n section"] | Sequence[Any],
    *,
    strides: int = 200,
    tolerance: Real | None = None,
    solver: AnySolver | None = None,
) -> list[Attractor]:
    """Find the attractors to which walkers converge from some starts.

    ```python
    walker = wj.SimplestWalker(0.004)
    grid = wj.Grid.sheared(theta=(0, 0.4, 30), sum=(-0.04, 0.01, 30))
    attractors = wj.find_attractors(walker, grid.centres(np.arange(grid.size)))
    attractors[0].period, attractors[0].states
    ```

    **Arguments:**

    - `system`: one system, with numbers for parameters.
    - `starts`: points of the section, as many as find every basin that matters.
    - `strides`: number of strides for which walkers are followed before the rest are examined.
    - `tolerance`, `solver`: of the integration, as in `stride`.

    **Returns** a list, by period, then by the angle of the first state; motions without a period
    come last. Each has its `states`, the `cloud` of points of a motion without a period, and its
    `period`, None for such a motion. They are operands of `label`, and tell the walks of several
    motions without a period apart by the points that these visit.

    Raises `ValueError` for starts that are no points of the section.
    """
    check_kind("system", system, System)
    check_single(system)
    x = numbers("starts", starts)
    if x.ndim != 2 or x.shape[1] != len(system.section):
        raise WrongUse(
            f"starts must be points of the section {system.section}, not {short(starts)}"
        )
    x = x.astype(jnp.result_type(float))
    check_precision(x.dtype)
    integrator = integrator_of(x.dtype, tolerance, solver)
    return list(survey(system, x, integrator, strides).mapper.attractors)


def label(
    system: System,
    attractors: Sequence[Attractor],
    start: Float[ArrayLike, " section"] | Sequence[Any],
    *,
    strides: int = 200,
    further: int = EXTRA_STRIDES,
    tolerance: Real | None = None,
    solver: AnySolver | None = None,
) -> Label:
    """Return what becomes of one start: how it fails, or the attractor that it converges to.

    It is a pure function for `jax.jit` and `jax.vmap`; the system and the attractors may be
    operands. Derivatives of the state are in forward mode.

    ```python
    walker = wj.SimplestWalker(0.004)
    attractors = wj.find_attractors(walker, [(0.2, -0.2), (0.15, -0.15)])
    found = wj.label(walker, attractors, (0.2, -0.2))
    found.fate, found.attractor, found.strides  # numbers of `Outcome`, attractor, strides
    ```

    **Arguments:**

    - `system`: one system, with numbers for parameters.
    - `attractors`: of `find_attractors`; a walk's attractor is its place among them. Cycles that
      JAX does not trace must attract walkers of this system.
    - `start`: a point of the section.
    - `strides`: number of strides for which the walker is followed.
    - `further`: further strides of a walker that is then undecided, to identify its cycle only.
    - `tolerance`, `solver`: of the integration, as in `stride`.

    Raises `ValueError` for a start that is no point of the section, and for attractors that do not
    attract.
    """
    strides, further = check_whole("strides", strides), check_whole("further", further, 0)
    own, x, integrator = prepare(system, start, tolerance, solver)
    if x.shape != (len(own.section),):
        raise WrongUse(f"start must be on the section {own.section}, not of shape {x.shape}")
    found = list(attractors) if isinstance(attractors, Sequence) else [attractors]
    if not all(isinstance(one, Attractor) for one in found):
        raise WrongUse(f"attractors must be those of find_attractors, not {short(attractors)}")
    if not any(isinstance(one, Tracer) for one in jax.tree.leaves((system, found, tolerance))):
        by = integrator_of(x.dtype, tolerance, solver)
        with jax.ensure_compile_time_eval():
            for one in found:
                if one.period and not attracts(system, np.asarray(one.states), by):
                    raise WrongUse(
                        "attractors must attract walkers of this system, unlike the cycle at "
                        f"{short(np.asarray(one.states[0]).tolist())}"
                    )
    found = jax.tree.map(jnp.asarray, found)
    with nan_allowed():
        return Mapper(own, found, integrator, strides, further)(x)

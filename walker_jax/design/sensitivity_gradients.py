"""The gait sensitivity norm, and its derivatives by parameters of the walker."""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from walker_jax.checks import check_kind, refuses_tracers
from walker_jax.gaits.cycles import Gait
from walker_jax.gaits.derivatives import gait_derivatives
from walker_jax.gaits.search import search_gait
from walker_jax.stability.sensitivity import DISTURBANCES, INDICATORS, respond_to
from walker_jax.walkers.model import Walker
from walker_jax.walkers.parameters import along_parameter, check_parameters
from walker_jax.walking.starts import prepare

ALL = tuple(DISTURBANCES.values()), tuple(INDICATORS.values())
"""All named disturbances and indicators, the defaults of `gait_sensitivity`."""


class SensitivityGradient(NamedTuple):
    """The gait sensitivity norm, and its derivatives by parameters of the walker."""

    norm: float
    """NaN without a gait of period one; infinite if that gait is not stable."""
    gradient: Float[np.ndarray, " parameters"]


@refuses_tracers("it gives derivatives itself, by the parameters named")
def sensitivity_gradient(
    walker: Walker,
    parameters: Sequence[str] = ("slope",),
    gait: Gait | None = None,
    *,
    tolerance: float | None = None,
) -> SensitivityGradient:
    """Compute the gait sensitivity norm, and its derivatives by parameters of the walker.

    ```python
    walker = wj.SimplestWalker(slope=0.004)
    found = wj.sensitivity_gradient(walker, ["slope"])
    found.norm, found.gradient
    ```

    d norm / dp is the derivative at a fixed state, plus the derivative by the state times that of
    the gait's state. Disturbances and indicators are the defaults of `gait_sensitivity`, each of
    unit size.

    Arguments and errors are those of `gait_measures`.
    """
    check_parameters(walker, parameters)
    gait = search_gait(walker, tolerance=tolerance) if gait is None else gait
    check_kind("gait", gait, Gait)
    if not gait.found or len(gait.states) != 1:
        return SensitivityGradient(np.nan, np.full(len(parameters), np.nan))
    checked, state, integrator = prepare(walker, gait.states[0], tolerance)
    norm = lambda walker, x: respond_to(walker, x, integrator, ALL).norm
    if not gait.stable:
        return SensitivityGradient(np.inf, np.full(len(parameters), np.nan))
    value, gradient = float(norm(checked, state)), []
    for name in parameters:
        change = gait_derivatives(walker, gait, name, tolerance=tolerance)
        way = along_parameter(checked, name), jnp.asarray(change.states[0], state.dtype)
        gradient.append(float(jax.jvp(norm, (checked, state), way)[1]))
    return SensitivityGradient(value, np.array(gradient))

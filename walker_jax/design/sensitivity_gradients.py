"""The gait sensitivity norm, and its derivatives by parameters of the walker."""

import jax
import jax.numpy as jnp
import numpy as np

from walker_jax.checks import check_kind
from walker_jax.design.measures import Measure
from walker_jax.gaits.cycles import Gait
from walker_jax.gaits.derivatives import gait_derivatives
from walker_jax.gaits.search import search_gait
from walker_jax.stability.sensitivity import DISTURBANCES, INDICATORS, respond_to
from walker_jax.walkers.choices import Choice, numbers_chosen
from walker_jax.walkers.model import Walker
from walker_jax.walkers.parameters import value_of, with_parameter
from walker_jax.walking.starts import prepare

ALL = tuple(DISTURBANCES.values()), tuple(INDICATORS.values())
"""All named disturbances and indicators, the defaults of `gait_sensitivity`."""


def sensitivity_gradient(
    walker: Walker,
    parameters: Choice = ("slope",),
    gait: Gait | None = None,
    *,
    tolerance: float | None = None,
) -> Measure:
    """Compute the gait sensitivity norm, and its derivatives by parameters of the walker.

    d norm / dp is the derivative at a fixed state, plus the derivative by the state times that of
    the gait's state. Disturbances and indicators are the defaults of `gait_sensitivity`, each of
    unit size.

    NaN without a gait of period one, and infinite if that gait is not stable.
    """
    parameters = numbers_chosen(walker, parameters)
    gait = search_gait(walker, tolerance=tolerance) if gait is None else gait
    check_kind("gait", gait, Gait)
    if not gait.found or len(gait.states) != 1:
        return Measure(np.nan, np.full(len(parameters), np.nan))
    checked, state, integrator = prepare(walker, gait.states[0], tolerance)
    norm = lambda walker, x: respond_to(walker, x, integrator, ALL).norm
    if not gait.stable:
        return Measure(np.inf, np.full(len(parameters), np.nan))
    value, gradient = float(norm(checked, state)), []
    for name in parameters:
        change = gait_derivatives(walker, gait, name, multipliers=False, tolerance=tolerance)
        along = lambda value, x, name=name: norm(with_parameter(checked, name, value), x)
        at = value_of(checked, name), state
        way = jnp.ones_like(at[0]), jnp.asarray(change.states[0], state.dtype)
        gradient.append(float(jax.jvp(along, at, way)[1]))
    return Measure(value, np.array(gradient))

"""The gait sensitivity norm: the response of a gait's indicators to disturbances.

Hobbelen and Wisse 2007, IEEE Trans. Robot. 23:1213-1224. To first order, with x the deviation of
the state just after heel strike, e the disturbances of a stride and g the indicators,

    x' = A x + B e,    g = C x + D e.

The norm is that of the response of g to a unit of each disturbance during one stride,

    sqrt(tr D'D + sum over k >= 0 of tr(B' A'^k C'C A^k B)).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from walker_jax.checks import WrongUse, check_kind, short
from walker_jax.gaits.cycles import Gait
from walker_jax.gaits.search import find_gait
from walker_jax.identity import FunctionByCode
from walker_jax.integrators.integrator import Integrator
from walker_jax.integrators.reductions import largest
from walker_jax.walkers.model import Scalar, State, Walker, check_planar
from walker_jax.walking.disturbed import Disturbance, follow_disturbed
from walker_jax.walking.starts import prepare

OneDisturbance = Callable[[Scalar], Disturbance]
"""The disturbance of a stride, from its size."""
Indicator = Callable[[Walker, State, State, Scalar], Scalar]
"""A measured quantity of a stride, from the walker, the full states just after the heel strikes at
its start and its end, and its duration."""


def length_indicator(walker: Walker, start: State, end: State, time: Scalar) -> Scalar:
    """Return how far the swing foot is ahead at heel strike, along the slope."""
    return walker.reach(walker.exchange_legs(end))


DISTURBANCES: dict[str, OneDisturbance] = {
    "step": lambda size: Disturbance(step=size),
    "slope": lambda size: Disturbance(slope=size),
    "push": lambda size: Disturbance(push=size),
}
INDICATORS: dict[str, Indicator] = {
    "time": lambda walker, start, end, time: time,
    "length": length_indicator,
    "speed": lambda walker, start, end, time: length_indicator(walker, start, end, time) / time,
}


class GaitSensitivity(NamedTuple):
    """The response of a gait to disturbances, and its norm."""

    norm: Float[Array, ""]
    """The norm: infinite for a gait that is not stable, NaN for one that was not found."""
    A: Float[Array, "full full"]
    """dx'/dx, of full states (theta, phi, thetadot, phidot)."""
    B: Float[Array, "full disturbances"]
    C: Float[Array, "indicators full"]
    D: Float[Array, "indicators disturbances"]
    terms: Float[Array, "indicators disturbances"]
    """Contribution of each pair to the square of the norm."""


def gait_sensitivity(
    walker: Walker,
    gait: Gait | None = None,
    disturbances: Sequence[str | OneDisturbance] = ("step", "slope", "push"),
    indicators: Sequence[str | Indicator] = ("time", "length", "speed"),
    *,
    tolerance: float | None = None,
) -> GaitSensitivity:
    """Compute the gait sensitivity norm of a gait of period one, and the matrices behind it.

    Works under JAX's transformations. Derivatives by parameters of the walker are right where the
    gait is differentiated too, `gait=wj.find_gait(walker, guess)`.

    ```python
    walker = wj.SimplestWalker(0.004)
    found = wj.gait_sensitivity(walker, disturbances=["step"], indicators=["time"])
    found.norm  # of the changes of step time, per height of a step
    ```

    **Arguments:**

    - `walker`: any planar walker.
    - `gait`: a gait of this walker; by default that of `find_gait`.
    - `disturbances`: of one stride, the fields of a `Disturbance`: "step", the height of the next
      foothold above the present one; "slope"; "push", a change of thetadot at the start; or
      functions that return a `Disturbance` from its size.
    - `indicators`: "time", of the stride; "length", of the step along the slope; "speed", one over
      the other; or functions of (walker, start, end, time), `State`s just after heel strike.
    - `tolerance`: of the integration, as in `stride`.

    Raises `ValueError` for other names, and for a gait of another period than one.
    """
    check_planar(walker)
    check_kind("disturbances", disturbances, Sequence)
    check_kind("indicators", indicators, Sequence)
    inputs = [look_up("disturbances", DISTURBANCES, one) for one in disturbances]
    outputs = [look_up("indicators", INDICATORS, one) for one in indicators]
    if not inputs or not outputs:
        raise WrongUse("disturbances and indicators must be one or more each, not none")
    gait = find_gait(walker, tolerance=tolerance) if gait is None else gait
    check_kind("gait", gait, Gait)
    if len(gait.states) != 1:
        raise WrongUse(f"gait must be of period one, not {len(gait.states)}")
    walker, state, integrator = prepare(walker, gait.states[0], tolerance)
    functions = tuple(map(FunctionByCode, inputs)), tuple(map(FunctionByCode, outputs))
    return respond_to(walker, state, integrator, functions)


@partial(jax.jit, static_argnums=3)
def respond_to(
    walker: Walker,
    state: Float[Array, " section"],
    integrator: Integrator,
    functions: tuple[tuple[OneDisturbance, ...], tuple[Indicator, ...]],
) -> GaitSensitivity:
    """Compute the matrices and the norm, for disturbances and indicators."""
    inputs, outputs = functions

    def disturbed(x, e):
        parts = zip(*(disturb(size) for disturb, size in zip(inputs, e, strict=True)), strict=True)
        total = [sum(jnp.asarray(value, x.dtype) for value in values) for values in parts]
        made = follow_disturbed(walker, x, Disturbance(*total), integrator)
        ends = walker.state(*made.state)
        return made.state, jnp.stack(
            [indicate(walker, walker.state(*x), ends, made.time) for indicate in outputs]
        )

    x, e = jnp.stack(walker.lift(state)), jnp.zeros(len(inputs), state.dtype)
    (A, B), (C, D) = jax.jacfwd(disturbed, (0, 1))(x, e)
    # X_i = sum of A'^k c c' A^k, for c' each row of C: the discrete Lyapunov equation.
    n = len(x)
    operator = jnp.eye(n * n, dtype=x.dtype) - jnp.kron(A.T, A.T)
    rows = jnp.stack([jnp.outer(c, c).reshape(-1) for c in C], axis=1)
    X = jnp.linalg.solve(operator, rows).T.reshape(len(outputs), n, n)
    terms = D**2 + jnp.einsum("ab,iac,cb->ib", B, X, B)
    size = largest(jnp.abs(jnp.linalg.eigvals(jax.lax.stop_gradient(A))))
    square = jnp.where(size < 1, jnp.sum(terms), jnp.where(size >= 1, jnp.inf, jnp.nan))
    return GaitSensitivity(jnp.sqrt(square), A, B, C, D, terms)


def look_up(what: str, table: dict[str, Any], name: Any) -> Any:
    """Return the function that a name stands for, or the one given in place of a name."""
    if callable(name):
        return name
    if not isinstance(name, str) or name not in table:
        raise WrongUse(f"{what} must be of {', '.join(table)}, not {short(name)}")
    return table[name]

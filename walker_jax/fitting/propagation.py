"""Errors of parameters carried on to what follows from them: gaits, multipliers, areas."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Float

from walker_jax.checks import WrongUse, check_confidence, check_kind, check_whole
from walker_jax.fitting.results import Fit, root_of

UNTRACEABLE = (
    WrongUse,
    jax.errors.ConcretizationTypeError,
    jax.errors.TracerArrayConversionError,
    jax.errors.TracerIntegerConversionError,
)
"""Errors of functions that JAX cannot trace."""


class Propagated(NamedTuple):
    """A result with its error; each field is shaped as the function's result, with further axes."""

    value: Any
    """Result for the fitted system."""
    error: Any
    """Standard deviation by the delta method: to first order in the errors of the parameters."""
    draws: Any
    """Results for systems with drawn parameters, along a first axis; none without draws."""

    def interval(self, confidence: float = 0.95) -> tuple[Any, Any]:
        """Return the ends of an interval that holds this share of the draws, NaN left out."""
        check_confidence(confidence)
        ends = (1 - confidence) / 2, (1 + confidence) / 2
        low, high = (
            jax.tree.map(lambda one, end=end: np.nanquantile(one, end, axis=0), self.draws)
            for end in ends
        )
        return low, high


def propagate(
    function: Callable[[Any], Any], fit: Fit, *, draws: int = 0, seed: int = 0
) -> Propagated:
    """Carry the errors of fitted parameters on to a function of the fitted system.

    ```python
    # found = wj.fit(...)
    # multipliers = wj.propagate(lambda walker: wj.find_gait(walker).multipliers, found)
    # multipliers.value, multipliers.error
    ```

    **Arguments:**

    - `function`: of a system, or of two that take turns; returns a real number, an array, or a tree
      of these. If JAX can trace it, its derivatives are exact, and all draws are one batched call.
      Otherwise they are central differences over one standard deviation along each principal axis
      of the errors, and draws are calls one by one.
    - `fit`: the result of `wj.fit`.
    - `draws`: number of systems whose parameters are drawn from the errors, within bounds.
    - `seed`: of the draws.

    **Returns** value, error and draws. A draw for which the function returns NaN, such as the gait
    of a walker without one, stays NaN. Parameters without information keep their values.
    """
    check_kind("fit", fit, Fit)
    check_whole("draws", draws, least=0)
    if not callable(function):
        raise WrongUse(f"function must be a function, not {function!r}", of="function")
    middle = np.array([*fit.parameters.values()])
    covariance = np.where(np.isfinite(fit.covariance), fit.covariance, 0)
    value = as_real(function(fit.system))
    flat, unflatten = ravel_pytree(value)
    of = lambda values: ravel_pytree(as_real(function(fit.with_parameters(values))))[0]
    axes = root_of(covariance)
    try:
        slopes = np.asarray(jax.jit(jax.jacfwd(of))(jnp.asarray(middle))) @ axes
        many = jax.jit(jax.vmap(of))
    except UNTRACEABLE:
        slopes = differences(of, middle, axes, flat.size)
        many = lambda values: np.array([of(one) for one in values])
    error = unflatten(jnp.asarray(np.sqrt(np.sum(slopes**2, axis=1))))
    found = np.asarray(many(fit.sample(draws, seed))) if draws else np.zeros((0, flat.size))
    to_numpy = lambda tree: jax.tree.map(np.asarray, tree)
    drawn = jax.vmap(unflatten)(jnp.asarray(found.reshape(draws, flat.size)))
    return Propagated(to_numpy(value), to_numpy(error), to_numpy(drawn))


def as_real(tree: Any) -> Any:
    """Return a result as arrays of float64; complex ones by their real and imaginary parts."""

    def real(leaf):
        leaf = jnp.asarray(leaf)
        both = jnp.stack([leaf.real, leaf.imag], axis=-1) if jnp.iscomplexobj(leaf) else leaf
        return both.astype(float)

    return jax.tree.map(real, tree)


def differences(
    of: Callable[[Any], Any],
    middle: Float[np.ndarray, " parameters"],
    axes: Float[np.ndarray, "parameters axes"],
    size: int,
) -> Float[np.ndarray, "values axes"]:
    """Return half the change of a function over two standard deviations along each axis."""
    columns = []
    for axis in axes.T:
        if not axis.any():
            columns.append(np.zeros(size))
            continue
        columns.append((np.asarray(of(middle + axis)) - np.asarray(of(middle - axis))) / 2)
    return np.stack(columns, axis=1)

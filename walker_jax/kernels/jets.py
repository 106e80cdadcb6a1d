"""`jax.experimental.jet` of a primitive that has a forward mode, by repeated derivatives."""

import math
from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
from jax.experimental.jet import zero_series
from jax.extend.core import Primitive


def push_series(primitive: Primitive, primals: Sequence, series: Sequence, **params):
    """Return the results of a primitive on curves x(t), at t = 0, and their Taylor coefficients.

    The k-th entry of a series is the k-th coefficient of x(t); the 0-th is its primal value.
    """

    def along(t):
        point = [curve(x, terms, t) for x, terms in zip(primals, series, strict=True)]
        return primitive.bind(*point, **params)

    results, *derivatives = derivatives_of(along, len(series[0]))(jnp.asarray(0.0))
    terms = [
        [row[i] / math.factorial(k) for k, row in enumerate(derivatives, 1)]
        if jnp.issubdtype(x.dtype, jnp.floating)
        else zero_series
        for i, x in enumerate(results)
    ]
    return results, terms


def curve(x, terms: Sequence, t):
    """Return x(t), which is constant unless it is real."""
    x = jnp.asarray(x)
    if not jnp.issubdtype(x.dtype, jnp.floating):
        return x
    return sum((c * (t**k).astype(x.dtype) for k, c in enumerate(terms, 1)), x)


def derivatives_of(function: Callable, order: int) -> Callable[..., list]:
    """Return a function of t that returns another's results and their derivatives to an order."""
    if order == 0:
        return lambda t: [function(t)]
    rate = lambda t: jax.jvp(function, (t,), (jnp.ones_like(t),))[1]
    return lambda t: [function(t), *derivatives_of(rate, order - 1)(t)]

"""Power series of softplus, and of `jnp.logaddexp`, by which JAX defines it.

JAX computes log(exp(x) + exp(y)) by max(x, y) and |x - y|, which have kinks where x = y; the
function itself has none. Its series follows from D z = D x / (1 + exp(y - x)) + D y / (1 + exp(x -
y)).
"""

from pathlib import Path

import jax
import jax.numpy as jnp
from jax import lax

from walker_jax.integrators.series import EQUATIONS, Series, solution
from walker_jax.kernels.jaxprs import called_function, enter

JAX_FOLDER = str(Path(jax.__file__).parent)


def custom_call_rule(expansion, equation, operands: list[Series]) -> list[Series]:
    """Expand a function with a derivative of its own: by its equations, unless it is logaddexp."""
    source = called_function(equation).jaxpr.debug_info.func_src_info
    if not (source.startswith("logaddexp at ") and JAX_FOLDER in source):
        return enter(expansion, equation, operands)
    share = lambda distance: solution(EQUATIONS["logistic"], lax.logistic, distance)

    def rate(z, x, Dx, y, Dy):
        return Dx * share(x - y) + Dy * share(y - x)

    return [solution(rate, jnp.logaddexp, *operands)]

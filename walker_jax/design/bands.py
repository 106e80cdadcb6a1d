"""Bands of parameters, over which derivatives are averaged."""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from walker_jax.checks import WrongUse, numbers, short
from walker_jax.systems.system import System
from walker_jax.walkers.parameters import check_parameter, check_parameters, with_parameter

MAX_BAND_HALVINGS = 20
"""Most halvings of a band on a side where the walker refuses the value."""


def check_bands(
    walker: System,
    parameters: Sequence[str],
    bands: Sequence[float] | Float[np.ndarray, " parameters"] | None,
) -> Float[np.ndarray, " parameters"]:
    """Return the half widths of bands, 1 if none are given; refuse wrong parameters and widths."""
    check_parameters(walker, parameters)
    widths = np.ones(len(parameters)) if bands is None else numbers("bands", bands)
    if widths.shape != (len(parameters),) or not np.all((widths > 0) & (widths < np.inf)):
        raise WrongUse(f"bands must be a number above 0 for each parameter, not {short(bands)}")
    return widths


def walkers_at_band_ends(walker: System, parameter: str, width: float) -> tuple[System, System]:
    """Return walkers with a parameter lower and higher by a width, or by less if refused."""
    value, ends = float(getattr(walker, parameter)), []
    for step in (-width, width):
        for _ in range(MAX_BAND_HALVINGS):
            try:
                check_parameter(walker, parameter, value + step)
                break
            except ValueError:
                step /= 2
        else:
            step = 0.0
        ends.append(with_parameter(walker, parameter, jnp.asarray(value + step)))
    return ends[0], ends[1]

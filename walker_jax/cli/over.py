"""The option --over: values of parameters."""

import math

from walker_jax.checks import WrongUse
from walker_jax.cli.options import read_numbers, refuse_again
from walker_jax.design.sweeps import MAX_COMBINATIONS
from walker_jax.walkers.parameters import space_decimals


def values_of(over: list[str]) -> dict[str, list[float]]:
    """The values of each parameter that --over names."""
    values: dict[str, list[float]] = {}
    for text in over:
        name, (low, high, count) = read_numbers("--over", "NAME=LO:HI:N", (float, float, int), text)
        if not low < high or count < 2 or not math.isfinite(high - low):
            raise WrongUse(f"--over {text} must have LO below HI, both finite, and N of 2 or more")
        refuse_again("--over", name, values)
        if count > MAX_COMBINATIONS:
            raise WrongUse(f"--over {text} must have N of at most {MAX_COMBINATIONS}")
        values[name] = space_decimals(low, high, count)
    return values

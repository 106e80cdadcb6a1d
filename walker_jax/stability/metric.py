"""The metric in which disturbances are measured, and the directions that they may have."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Float

from walker_jax.checks import WrongUse, check_kind, short
from walker_jax.walkers.model import Walker


def metric(
    walker: Walker, scale: Sequence[Any] | ArrayLike | None, along: Sequence[Any] | ArrayLike | None
) -> tuple[Float[np.ndarray, " section"], Float[np.ndarray, "rank section"]]:
    """The units of a walker's section, and an orthonormal basis, in these units, of `along`.

    Raises `ValueError` for a scale or vectors that do not fit the section.
    """
    check_kind("walker", walker, Walker)
    size = len(walker.section)
    unit = np.ones(size) if scale is None else numbers_or_none(scale)
    if unit.shape != (size,) or not np.all(np.isfinite(unit) & (unit > 0)):
        raise WrongUse(f"scale must be {size} positive numbers, not {short(scale)}")
    basis = np.eye(size) if along is None else np.atleast_2d(numbers_or_none(along))
    fits = basis.ndim == 2 and basis.shape[1] == size and bool(np.isfinite(basis).all())
    if not fits or np.linalg.matrix_rank(basis) != len(basis):
        raise WrongUse(f"along must be independent vectors of the section, not {short(along)}")
    return unit, np.linalg.qr((basis / unit).T)[0].T


def numbers_or_none(values: Any) -> Float[np.ndarray, "..."]:
    """An array of the numbers; NaN for other values."""
    try:
        return np.asarray(values, float)
    except (TypeError, ValueError):
        return np.array(np.nan)

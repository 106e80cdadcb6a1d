"""Polynomials by their roots."""

import numpy as np


def ascending(*roots, factor=(1.0,)):
    """Coefficients of factor(t) (t - r_1) (t - r_2) ..., constant term first."""
    return np.polymul(np.poly(roots), factor)[::-1]

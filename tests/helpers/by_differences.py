"""Strides of many walkers, their derivatives by differences, and gaits by these alone."""

import jax
import numpy as np

import walker_jax as wj


def stacked(walkers):
    """Many walkers of one kind as one, with arrays for parameters."""
    return jax.tree.map(lambda *leaves: np.stack(leaves), *walkers)


def strides(walkers, xs):
    """Strides, each of its own walker: compiled once for a kind."""
    return wj.strides(stacked(walkers), np.asarray(xs, float))


def composite(walkers, xs, period):
    """Each start after `period` strides, and how long they take."""
    time = np.zeros(len(xs))
    for _ in range(period):
        result = strides(walkers, xs)
        xs, time = result.state, time + result.time
    return xs, time


def differences(function, z, steps):
    """Derivatives of a function of many points, extrapolated to step 0 thrice (Richardson)."""
    scales = 0.5 ** np.arange(4)
    n = len(z)
    points = [
        z + sign * scale * step * axis
        for axis, step in zip(np.eye(n), steps, strict=True)
        for scale in scales
        for sign in (1, -1)
    ]
    values = np.asarray(function(np.array(points))).reshape(n, 4, 2, -1)
    table = (values[:, :, 0] - values[:, :, 1]) / (2 * scales[:, None] * steps[:, None, None])
    for factor in (4, 16, 64):
        table = (factor * table[:, 1:] - table[:, :-1]) / (factor - 1)
    return table[:, 0].T


def newton(walker, x, period=1, step=1e-4):
    """A cycle's first state (1, section), by Newton's iteration, and its multipliers.

    Derivatives are differences of strides: nothing is differentiated.
    """
    x = np.asarray(x, float)
    walk = lambda xs: composite([walker] * len(xs), xs, period)[0]
    for _ in range(8):
        jacobian = differences(walk, x, np.full(len(x), step))
        change = np.linalg.solve(jacobian - np.eye(len(x)), x - walk(x[None])[0])
        x = x + change
        if np.abs(change).max() < 1e-11:
            break
    return x[None], multipliers_of(differences(walk, x, np.full(len(x), step)))


def multipliers_of(jacobian):
    """Its eigenvalues, in the order of those of a gait."""
    values = np.linalg.eigvals(jacobian)
    return values[np.lexsort((-values.imag, -np.abs(values)))]


def assert_gait(gait, stride, step, tolerance):
    """The first state and the multipliers of a gait are those of `stride`, an independent one.

    Newton's iteration by `stride` alone would move the state by 1e-11 at most.
    """
    x = np.asarray(gait.states[0])
    jacobian = differences(lambda xs: np.array([stride(x) for x in xs]), x, np.full(len(x), step))
    change = np.linalg.solve(jacobian - np.eye(len(x)), x - stride(x))
    np.testing.assert_allclose(change, 0, atol=1e-11)
    found = gait.multipliers
    np.testing.assert_allclose(found, multipliers_of(jacobian), rtol=0, atol=tolerance)

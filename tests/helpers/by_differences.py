"""Strides of many walkers, their derivatives by differences, and gaits by these alone."""

import jax
import numpy as np

import walker_jax as wj
from walker_jax.walkers.parameters import parameters


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


def functions_of_modes(system, x):
    """Values of all functions in a graph of modes, one after the other, from x on.

    Fields, guards and resets are called in the states in which resets lead into the modes, which
    need not lie on any motion.
    """
    modes, values = system.modes(), []
    entered = {next(iter(modes)): system.lift(x)}
    for name in entered_in_order(modes):
        mode, state = modes[name], entered[name]
        values += jax.tree.leaves(mode.field(state))
        for guard in mode.guards:
            values.append(guard.value(state))
            after = guard.reset(state)
            if guard.leads_to == wj.SECTION:
                values += [*system.project(after)]
            elif guard.leads_to in modes:
                entered.setdefault(guard.leads_to, after)
    return jax.numpy.stack([jax.numpy.asarray(one, float) for one in values])


def entered_in_order(modes):
    """Names of modes, each after one that leads to it."""
    names = [next(iter(modes))]
    for name in names:
        names += [
            one.leads_to
            for one in modes[name].guards
            if one.leads_to in modes and one.leads_to not in names
        ]
    assert len(names) == len(modes) == len({*names})
    return names


def check_functions_of_modes(kind, x):
    """Derivatives of all functions by the start and all parameters are those of differences."""
    names = [one.name for one in parameters(kind)]
    values = np.array([float(getattr(kind(), name)) for name in names])
    every = jax.jit(lambda z: functions_of_modes(kind(*z[: len(names)]), z[len(names) :]))
    z = np.array([*values, *x])
    found = jax.jit(jax.jacfwd(every))(z)
    expected = differences(lambda many: np.stack([*map(every, many)]), z, np.full(len(z), 1e-3))
    assert np.isfinite(found).all() and np.abs(found).max() > 1
    np.testing.assert_allclose(found, expected, rtol=1e-8, atol=1e-8)


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

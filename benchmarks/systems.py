"""How long do basins of a map and of a flow take, against loops written by hand?

The systems are Hénon's map at a = 1.02, and Duffing's oscillator over periods of its force. Every
cell of a square grid is followed until it escapes, or is within 1e-6 of a known cycle, by

- `wj.basin(..., "direct")`, which also searches for the cycles;
- the loop over one start in JAX, `jax.jit(jax.vmap(...))`, for the map;
- the same loop written by hand in numba, parallel over cells: the map itself, and the classical
  Runge-Kutta method, with enough steps per period for the largest error of `wj.strides`, or for
  1e-8;
- `scipy.integrate.solve_ivp` by DOP853 in two processes, a sample of cells for one period, scaled.

Everything is compiled first. `times as long` is the ratio to the first row of the same job.

On two cores:

    Hénon, 1000 x 1000, 205 iterations a cell
    walker_jax                                       0.464 s     1.00 times as long
    jit(vmap(the loop over one start))               4.005 s     8.64 times as long
    numba, by hand                                   0.397 s     0.86 times as long
    cells that differ: 0
    Duffing, 60 x 60, 60 periods a cell
    walker_jax                                       0.452 s     1.00 times as long
    numba, by hand, 972 steps, error 1e-08           3.694 s     8.18 times as long
    numba, by hand, 7881 steps, error 2e-12         29.807 s    65.96 times as long
    scipy, DOP853, two processes, scaled           328.096 s   726.08 times as long

    python benchmarks/systems.py [CELLS ALONG A SIDE OF THE MAP [AND OF THE FLOW]]

Needs numba, which is not among the dependencies.
"""

import sys
import time
from concurrent.futures import ProcessPoolExecutor

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from numba import njit, prange  # pyright: ignore[reportMissingImports] (no dependency)
from scipy.integrate import solve_ivp

import walker_jax as wj

jax.config.update("jax_enable_x64", True)
A, B, DAMPING, FORCE = 1.02, 0.3, 0.15, 0.245
NEAR, MOST, FARTHEST = 1e-6, 1000, 10.0
REPEATS, SAMPLE = 3, 200


@njit(inline="always")
def nearest(x, y, targets):
    """The first target that a point is near; -1 for none."""
    for k in range(len(targets)):
        if abs(x - targets[k, 0]) < NEAR and abs(y - targets[k, 1]) < NEAR:
            return k
    return -1


@njit(parallel=True)
def henon_by_hand(x, y, targets, most):
    label = np.full(len(x), -1)
    for i in prange(len(x)):
        u, v = x[i], y[i]
        for _ in range(most):
            if nearest(u, v, targets) >= 0:
                label[i] = 0
                break
            if u * u + v * v > FARTHEST * FARTHEST:
                break
            u, v = 1 - A * u * u + v, B * u
    return label


@njit(inline="always")
def force(x, v, t):
    return x - x * x * x - DAMPING * v + FORCE * np.cos(t)


@njit(inline="always")
def period_by_hand(x, v, steps):
    h = 2 * np.pi / steps
    for i in range(steps):
        t = i * h
        k1, a1 = v, force(x, v, t)
        k2, a2 = v + h / 2 * a1, force(x + h / 2 * k1, v + h / 2 * a1, t + h / 2)
        k3, a3 = v + h / 2 * a2, force(x + h / 2 * k2, v + h / 2 * a2, t + h / 2)
        k4, a4 = v + h * a3, force(x + h * k3, v + h * a3, t + h)
        x, v = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4), v + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
    return x, v


@njit(parallel=True)
def periods_by_hand(x, v, steps):
    ends = np.empty((len(x), 2))
    for i in prange(len(x)):
        ends[i, 0], ends[i, 1] = period_by_hand(x[i], v[i], steps)
    return ends


@njit(parallel=True)
def duffing_by_hand(x, v, targets, owners, most, steps):
    label = np.full(len(x), -1)
    for i in prange(len(x)):
        u, w = x[i], v[i]
        for _ in range(most):
            k = nearest(u, w, targets)
            if k >= 0:
                label[i] = owners[k]
                break
            u, w = period_by_hand(u, w, steps)
    return label


def duffing(t, y):
    return [y[1], y[0] - y[0] ** 3 - DAMPING * y[1] + FORCE * np.cos(t)]


def period_by_scipy(x):
    span = 0, 2 * np.pi
    return solve_ivp(duffing, span, x, method="DOP853", rtol=1e-10, atol=1e-10).y[:, -1]


@jax.jit
@jax.vmap
def henon_by_vmap(x):
    """The loop over one start, as one would write it in JAX."""
    unfinished = lambda carry: (carry[1] < MOST) & (jnp.sum(carry[0] ** 2) < FARTHEST**2)
    near = lambda x: jnp.any(jnp.all(jnp.abs(x - TARGETS) < NEAR, axis=1))
    step = lambda x: jnp.stack([1 - A * x[0] ** 2 + x[1], B * x[0]])
    go = lambda carry: unfinished(carry) & ~near(carry[0])
    return lax.while_loop(go, lambda carry: (step(carry[0]), carry[1] + 1), (x, 0))


def least_time(job):
    """Of several, after one that compiles; and the result."""
    result, times = job(), []
    for _ in range(REPEATS):
        began = time.perf_counter()
        result = job()
        times.append(time.perf_counter() - began)
    return min(times), result


def report(name, seconds, first):
    print(f"    {name:44} {seconds:9.3f} s  {seconds / first:7.2f} times as long", flush=True)


def grid_of(names, side):
    return wj.Grid.plain(**dict.fromkeys(names, (-2, 2, side)))


def compare_maps(side):
    global TARGETS
    system, grid = wj.systems.HenonMap(A), grid_of("xy", side)
    first, data = least_time(lambda: wj.basin(system, grid, "direct", strides=MOST))
    print(f"Hénon, {side} x {side}, {float(data.strides.mean()):.0f} iterations a cell")
    report("walker_jax", first, first)
    TARGETS = data.states.values[0, :4]
    x = grid.centres(np.arange(grid.size))
    seconds, _ = least_time(lambda: jax.block_until_ready(henon_by_vmap(x)))
    report("jit(vmap(the loop over one start))", seconds, first)
    columns = np.ascontiguousarray(x[:, 0]), np.ascontiguousarray(x[:, 1])
    seconds, labels = least_time(lambda: henon_by_hand(*columns, TARGETS, MOST))
    report("numba, by hand", seconds, first)
    print("    cells that differ:", int((labels != data.attractor.values.ravel()).sum()))


def compare_flows(side):
    system, grid = wj.systems.DuffingOscillator(DAMPING, FORCE), grid_of("xv", side)
    first, data = least_time(lambda: wj.basin(system, grid, "direct", strides=MOST))
    mean = float(data.strides.mean())
    print(f"Duffing, {side} x {side}, {mean:.0f} periods a cell")
    report("walker_jax", first, first)
    some = np.random.default_rng(0).uniform(-2, 2, (SAMPLE, 2))
    exact = wj.strides(system, some, tolerance=1e-15).state
    error = np.abs(wj.strides(system, some).state - exact).max()
    columns = np.ascontiguousarray(some[:, 0]), np.ascontiguousarray(some[:, 1])
    states, periods = data.states.values, data.period.values
    targets = np.concatenate([one[:n] for one, n in zip(states, periods, strict=True)])
    owners = np.repeat(np.arange(len(periods)), periods)
    x = grid.centres(np.arange(grid.size))
    columns_of_grid = np.ascontiguousarray(x[:, 0]), np.ascontiguousarray(x[:, 1])
    for goal in (1e-8, error):
        steps = 50
        while np.abs(periods_by_hand(*columns, steps) - exact).max() > goal and steps < 20_000:
            steps = int(1.1 * steps)
        job = lambda steps=steps: duffing_by_hand(*columns_of_grid, targets, owners, MOST, steps)
        seconds, labels = least_time(job)
        report(f"numba, by hand, {steps} steps, error {goal:.0e}", seconds, first)
        shares = np.bincount(labels[labels >= 0], minlength=len(periods)) / len(labels)
    print(
        f"    error of walker_jax {error:.0e}; shares of cells: walker_jax "
        f"{(data.cells.values / grid.size).round(4)}, numba {shares.round(4)}"
    )
    with ProcessPoolExecutor(2) as pool:
        list(pool.map(period_by_scipy, some[:4]))
        began = time.perf_counter()
        list(pool.map(period_by_scipy, some, chunksize=20))
        seconds = (time.perf_counter() - began) / SAMPLE * mean * grid.size
    report("scipy, DOP853, two processes, scaled", seconds, first)


if __name__ == "__main__":
    sides = [int(one) for one in sys.argv[1:]] or [1000]
    compare_maps(sides[0])
    compare_flows(sides[-1])

"""What does the general method cost against closed forms, and what does each walker?

One stride from each of the 50,000 cells of the paper's grid (slope 0.004): by the simplest walker's
closed forms, and by the general method, from where the masses are, with feet of mass 1e-6; and by
the other walkers, with their usual parameters, from as many cells around their gaits. Each is
compiled first (seconds apart); repeats are interleaved. `times as long` is the ratio to the first
row in the same repeat (median, least and greatest). `error` is the largest difference, over all
cells whose next stride it changes no more than a hundred times, from strides at a tolerance of
1e-15: every walker is integrated at the same tolerance, 1e-12.

The answer: 2.4 to 3.2 times as long with point feet. Walkers with more masses, and more numbers to
a state, take longer: their series are cut at lower orders, and their strides are less alike.

    2 cores; jax 0.10.2; 50000 strides, 5 repeats
                            strides/s       times as long  compile   error  stride
    simplest, closed form     821,941             1 (1-1)      7.1   5e-13     44%
    point feet, 1e-6          331,453    2.41 (2.24-3.87)     17.7   5e-11     44%
    point feet, 0.01          255,427    3.19 (3.15-4.25)      0.3   6e-13     44%
    spring, 1                 628,919    1.28 (1.18-1.52)      4.4   4e-13     74%
    round feet                123,665    6.62 (6.06-7.05)     28.9   1e-12     51%
    upper body                 76,008      10.7 (10-12.2)     22.0   1e-13     43%

The error with feet of 1e-6 is what a mass matrix holds whose entries differ that much.
"""

import argparse
import os
import time

import jax
import numpy as np

import walker_jax as wj
from walker_jax.tiles import compact_order

WALKERS = {
    "simplest, closed form": wj.SimplestWalker(0.004),
    "point feet, 1e-6": wj.PointFootWalker(0.004, 1e-6),
    "point feet, 0.01": wj.PointFootWalker(0.004, 0.01),
    "spring, 1": wj.SpringWalker(0.004, 1.0),
    "round feet": wj.RoundFootWalker(0.004),
    "upper body": wj.UpperBodyWalker(0.004),
}
# (theta, thetadot, phidot) of gaits, around which the cells lie
GAITS = {"round feet": (0.1464, -0.2010, -0.0186), "upper body": (0.15, -0.2, -0.02)}


def cells(name: str) -> np.ndarray:
    """Starts in an order in which neighbours take equally long."""
    axes = {"theta": (0, 0.4, 200), "sum": (-0.04, 0.01, 250)}
    if name in GAITS:
        theta, thetadot, phidot = GAITS[name]
        middle = theta + thetadot
        axes = {"theta": (0, 2.5 * theta, 200), "sum": (middle - 0.07, middle + 0.05, 250)}
        axes["phidot"] = phidot
    grid = wj.Grid.sheared(**axes)
    return np.asarray(jax.vmap(grid.centre)(compact_order(grid.shape)))


def main():
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--repeats", type=int, default=5)
    args = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    starts, compiling, results, errors = {}, {}, {}, {}
    for name, walker in WALKERS.items():
        starts[name] = cells(name)
        begin = time.perf_counter()
        results[name] = wj.strides(walker, starts[name])
        compiling[name] = time.perf_counter() - begin
        exact = wj.strides(walker, starts[name], tolerance=1e-15)
        beside = wj.strides(walker, starts[name] + 1e-9)
        moved = np.abs(beside.state - exact.state).max(axis=1)
        gentle = moved < 1e-7
        errors[name] = np.abs(results[name].state - exact.state).max(axis=1)[gentle].max()

    rounds = []
    for _ in range(args.repeats):
        times = {}
        for name, walker in WALKERS.items():
            begin = time.perf_counter()
            wj.strides(walker, starts[name])
            times[name] = time.perf_counter() - begin
        rounds.append(times)

    count = len(next(iter(starts.values())))
    print(f"{os.cpu_count()} cores; jax {jax.__version__}; {count} strides, {args.repeats} repeats")
    print(f"{'':22}{'strides/s':>11}{'times as long':>20}{'compile':>9}{'error':>8}{'stride':>8}")
    for name in WALKERS:
        seconds = np.array([times[name] for times in rounds])
        ratio = seconds / np.array([times["simplest, closed form"] for times in rounds])
        spread = f"{np.median(ratio):.3g} ({ratio.min():.3g}-{ratio.max():.3g})"
        share = np.mean(results[name].outcome == wj.Outcome.STRIDE)
        print(
            f"{name:22}{count / np.median(seconds):11,.0f}{spread:>20}"
            f"{compiling[name]:9.1f}{errors[name]:8.0e}{share:8.0%}"
        )


if __name__ == "__main__":
    main()

"""What does the general method cost against closed forms, and what does each walker?

One stride is made from each of the 50,000 cells of the paper's grid (slope 0.004): by the simplest
walker's closed forms, and by the general method, from the positions of the masses, with feet of
mass 1e-6; and by the other walkers, with their usual parameters, from as many cells around their
gaits. Each is compiled first (its seconds are given apart); repeats are interleaved. `times as
long` is the ratio to the first row in the same repeat (median, least and greatest). Every walker is
integrated at a tolerance of 1e-12. `error` is the largest difference from strides at 1e-15, over
all cells whose stride amplifies a change no more than a hundred times.

The answer: the general method takes 2.3 times as long with point feet. Walkers with more masses,
and more numbers to a state, take up to five times as long.

    2 cores; jax 0.10.2; 50000 strides, 5 repeats
                            strides/s       times as long  compile   error  stride
    simplest, closed form   2,996,337             1 (1-1)      0.7   5e-13     44%
    point feet, 1e-6        1,227,152    2.39 (2.32-2.44)      2.8   5e-11     44%
    point feet, 0.01        1,255,918    2.34 (2.29-2.44)      0.0   6e-13     44%
    spring, 1               2,380,151    1.25 (1.17-1.34)      0.8   4e-13     74%
    round feet                820,101     3.5 (3.39-3.86)      3.8   8e-13     51%
    upper body                604,046    4.96 (4.56-5.59)      5.4   6e-13     43%

The error with feet of 1e-6 is rounding in a mass matrix with entries of such different sizes.
"""

import argparse
import os
import time

import jax
import numpy as np

import walker_jax as wj

jax.config.update("jax_enable_x64", True)  # before the walkers are made

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
    """Starts, row after row."""
    axes = {"theta": (0, 0.4, 200), "sum": (-0.04, 0.01, 250)}
    if name in GAITS:
        theta, thetadot, phidot = GAITS[name]
        middle = theta + thetadot
        axes = {"theta": (0, 2.5 * theta, 200), "sum": (middle - 0.07, middle + 0.05, 250)}
        axes["phidot"] = phidot
    grid = wj.Grid.sheared(**axes)
    return np.asarray(jax.vmap(grid.centre)(np.arange(grid.size)))


def main():
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--repeats", type=int, default=5)
    args = parser.parse_args()
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

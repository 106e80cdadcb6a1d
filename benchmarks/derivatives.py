"""What do derivatives of strides cost beside the strides, and how long is it to a first answer?

One stride, and a walk of ten, from 5000 starts about a gait, under `jax.jit(jax.vmap(...))`: the
final state, and its derivatives by start and slope together, three numbers for the simplest walker
and four for one on round feet. `jvp` is along one direction, `jacfwd` and `jacrev` are the whole
Jacobian, and `grad` is the gradient of the last angle alone. Repeats are interleaved; `times as
long` is the ratio to the stride, or the walk, in the same repeat (median, least and greatest).
`first` is the time to a first answer, with no machine code on disk: tracing, compiling and one run.
Rows that share a program compile it only once, in the first of them.

The answer: a derivative costs two or three strides, and a whole Jacobian about two for each
direction. Reverse mode costs the same, as it goes through no stride backwards. The derivative of a
stride is compiled once, in seconds, and serves all modes and any number of strides. The machine was
busy with other work, which doubles times.

    2 cores; jax 0.10.2; 5000 starts, 5 repeats

    simplest                us each         times as long     first
    stride                     1.85               1 (1-1)     1.8 s
    jvp                        3.00      1.61 (1.59-3.14)     3.3 s
    jacfwd                     9.65       5.3 (5.15-8.36)     0.1 s
    jacrev                     9.72       5.79 (5.18-8.7)     0.2 s
    grad                       9.82         5.71 (5-10.8)     0.1 s
    walk of 10                15.02               1 (1-1)     0.1 s
    jvp                       44.64       2.97 (2.8-3.17)     0.3 s
    jacfwd                   111.36       7.1 (5.15-9.27)     0.6 s
    jacrev                   105.97      7.06 (5.43-8.85)     0.7 s
    grad                     106.84      7.11 (6.57-8.31)     0.6 s

    round feet              us each         times as long     first
    stride                     4.33               1 (1-1)     7.5 s
    jvp                       10.28      2.38 (1.68-4.19)    17.0 s
    jacfwd                    37.62      9.48 (6.97-13.4)     0.4 s
    jacrev                    40.21      10.6 (8.82-12.1)     0.6 s
    grad                      36.54       9.3 (5.86-11.9)     0.3 s
    walk of 10                40.00               1 (1-1)     0.3 s
    jvp                      159.68       3.34 (1.3-4.17)     0.7 s
    jacfwd                   411.02      9.45 (4.32-13.4)     2.2 s
    jacrev                   399.14      9.98 (2.63-11.5)     3.0 s
    grad                     392.79      9.82 (3.17-12.8)     1.9 s
"""

import argparse
import os
import time
from collections.abc import Callable

os.environ["WALKER_JAX_CACHE_DIR"] = ""  # no machine code on disk

import jax
import jax.numpy as jnp
import numpy as np

import walker_jax as wj
from walker_jax.kernels.program import programs

STRIDES = 10


def ways(walker: type, strides: int) -> dict[str, Callable]:
    """Functions of a start and slope, in one array: strides, and their derivatives."""

    def state(z):
        x, walking = z[:-1], walker(z[-1])
        if strides == 1:
            return wj.stride(walking, x).state
        return wj.walk(walking, x, strides).states[-1]

    name = "stride" if strides == 1 else f"walk of {strides}"
    return {
        name: state,
        "jvp": lambda z: jax.jvp(state, (z,), (jnp.ones_like(z),))[1],
        "jacfwd": jax.jacfwd(state),
        "jacrev": jax.jacrev(state),
        "grad": jax.grad(lambda z: state(z)[0]),
    }


def timed(run: Callable, *args) -> float:
    start = time.perf_counter()
    jax.block_until_ready(run(*args))
    return time.perf_counter() - start


def main():
    parser = argparse.ArgumentParser(description="What derivatives of strides cost.")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--starts", type=int, default=5000)
    args = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    print(f"{cores} cores; jax {jax.__version__}; {args.starts} starts, {args.repeats} repeats")

    for title, walker in ("simplest", wj.SimplestWalker), ("round feet", wj.RoundFootWalker):
        gait = np.asarray(wj.find_gait(walker(0.009)).states[0])
        programs.clear()
        jax.clear_caches()
        near = np.append(gait, 0.009) * np.random.default_rng(0).uniform(
            0.9999, 1.0001, (args.starts, len(gait) + 1)
        )
        print(f"\n{title:22}{'us each':>9}{'times as long':>22}{'first':>10}")
        for strides in (1, STRIDES):
            runs = {name: jax.jit(jax.vmap(one)) for name, one in ways(walker, strides).items()}
            first = {name: timed(run, near) for name, run in runs.items()}
            rounds = [
                {name: timed(run, near) for name, run in runs.items()} for _ in range(args.repeats)
            ]
            plain, *_ = runs
            for name in runs:
                seconds = np.array([times[name] for times in rounds])
                ratio = np.sort(seconds / [times[plain] for times in rounds])
                spread = f"{ratio[len(ratio) // 2]:.3g} ({ratio[0]:.3g}-{ratio[-1]:.3g})"
                cost = 1e6 * np.median(seconds) / args.starts
                print(f"{name:22}{cost:9.2f}{spread:>22}{first[name]:8.1f} s", flush=True)


if __name__ == "__main__":
    main()

"""Do walks last as long as the stochastic cell map says, and how fast are strides on rough ground?

First, the mean number of strides until a fall of the simplest walker at slope 0.009, for normally
distributed steps and pushes of ever smaller standard deviation: by Monte Carlo, with its 95 %
interval, and by a stochastic cell map, with 1.96 standard errors. Then strides a second of walks on
rough ground, and on even ground in the same run, in processor time and as measured by a clock.
"""

import sys
import time

import jax
import numpy as np

import walker_jax as wj

SLOPE = 0.009
STEPS = 5.5e-4, 2.1e-4, 1.5e-4, 1.25e-4, 1.13e-4
PUSHES = 1.6e-3, 1.0e-3, 8e-4, 6.5e-4
MOST_STRIDES = 20_000_000
WALKS = 2000
SPEED_WALKS, SPEED_STRIDES = 40_000, 50


def main(part: str = "all") -> None:
    jax.config.update("jax_enable_x64", True)
    walker = wj.SimplestWalker(SLOPE)
    gait = wj.find_gait(walker)
    if part in ("all", "speed"):
        compare_speeds(walker, gait)
    if part in ("all", "steps"):
        compare_means(walker, gait, "step", STEPS)
    if part in ("all", "pushes"):
        compare_means(walker, gait, "push", PUSHES)


def compare_means(walker: wj.SimplestWalker, gait: wj.Gait, kind: str, sizes) -> None:
    print(f"{kind:>9}  Monte Carlo (95 %)            falls  cell map (95 %)                within")
    for size in sizes:
        ground = lambda key, size=size: wj.Disturbance(
            **{kind: size * jax.random.normal(key, dtype=float)}
        )
        limit = MOST_STRIDES // WALKS
        walks = wj.steps_to_fall(walker, ground, WALKS, jax.random.key(1), gait=gait, limit=limit)
        chain = wj.metastability(walker, ground, jax.random.key(2), gait=gait)
        mean, error = float(chain["mean_strides"]), 1.96 * float(chain["mean_strides_error"])
        low, high = mean - error, mean + error
        agree = low < walks.high and walks.low < high
        print(
            f"{size:9.3g}  {walks.mean:8.4g} ({walks.low:7.4g} to {walks.high:7.4g}) "
            f"{int(walks.ended.sum()):6}  {mean:8.4g} ({low:7.4g} to {high:7.4g})  "
            f"{'yes' if agree else 'no'}",
            flush=True,
        )


def compare_speeds(walker: wj.SimplestWalker, gait: wj.Gait) -> None:
    """Walks that do not fall, so that all make all strides."""
    starts = np.tile(gait.states[0], (SPEED_WALKS, 1))

    def even() -> int:
        states = starts
        for _ in range(SPEED_STRIDES):
            states = wj.strides(walker, states).state
        return SPEED_WALKS * SPEED_STRIDES

    def rough() -> int:
        walks = wj.steps_to_fall(
            walker, 5e-5, SPEED_WALKS, jax.random.key(0), gait=gait, limit=SPEED_STRIDES
        )
        return int(walks.strides.sum())

    print("ground  strides     cpu s  wall s  a second of the clock")
    for name, make in (("even", even), ("rough", rough)) * 3:
        if name not in (warm := vars(compare_speeds).setdefault("warm", set())):
            make()
            warm.add(name)
        cpu, wall = time.process_time(), time.perf_counter()
        count = make()
        cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
        print(f"{name:6}  {count:9,}  {cpu:6.2f}  {wall:6.2f}  {count / wall:10,.0f}", flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])

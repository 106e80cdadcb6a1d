"""Do walks last as long as the stochastic cell map says, and how fast are strides on rough ground?

First comes the mean number of strides until the simplest walker falls at slope 0.009, for normally
distributed steps of ever smaller standard deviation: by Monte Carlo, with its 95 % interval, and by
a stochastic cell map, with 1.96 standard errors. Then the same for pushes and slopes, and for other
walkers. Then the strides per second on rough ground, and on even ground in the same run, in
processor time and wall time. docs/accuracy-basins.md shows the results.

A stride on rough ground takes 1.1 us of processor time, 1.6 times one on even ground: 1.7 million
a second of wall time on two free cores.

    ground  strides     cpu s  wall s  a second of the clock
    even    2,000,000    1.36    0.74   2,714,708
    rough   2,000,000    2.22    1.16   1,730,119
"""

import sys
import time

import jax
import numpy as np

import walker_jax as wj

SLOPE = 0.009
GAINS = 3.37, 2.2
"""Of the slack angle of a hip spring: those that benchmarks/predictors.py finds for the norm."""
MOST_STRIDES = 20_000_000
WALKS = 2000
SPEED_WALKS, SPEED_STRIDES = 40_000, 50


def main(part: str = "all", seed: str = "1") -> None:
    jax.config.update("jax_enable_x64", True)
    walker = wj.SimplestWalker(SLOPE)
    if part in ("all", "speed"):
        compare_speeds(walker, wj.find_gait(walker))
    if part in ("all", "steps"):
        sizes = 5.5e-4, 2.1e-4, 1.5e-4, 1.25e-4, 1.1e-4
        compare_means([("simplest", walker, "step", size) for size in sizes], int(seed))
    if part in ("all", "others"):
        compare_means(other_cases(), int(seed))


def other_cases() -> list[tuple[str, wj.Walker, str, float]]:
    """Other disturbances and other walkers."""
    walker = wj.SimplestWalker(SLOPE)
    spring = wj.PoweredWalker(SLOPE, 1.0)
    fed = wj.Feedback(spring, wj.find_gait(spring), {"hip_angle": GAINS})
    return [
        ("simplest", walker, "push", 1.6e-3),
        ("simplest", walker, "push", 8e-4),
        ("simplest", walker, "slope", 1e-3),
        ("simplest", walker, "slope", 8e-4),
        ("hip spring of stiffness 1", spring, "step", 7e-4),
        ("the same with feedback", fed, "step", 2e-3),
        ("push-off 0.05 on level ground", wj.PoweredWalker(0.0, push_off=0.05), "step", 3e-4),
    ]


def compare_means(cases: list, seed: int) -> None:
    """Walks have the random key `seed`, the cell map the next."""
    heads = f"{'walker':30} disturbance     size"
    print(f"{heads}  walks (95 %)                  falls  cell map (95 %)                  within")
    for name, walker, kind, size in cases:
        ground = lambda key, kind=kind, size=size: wj.Disturbance(
            **{kind: size * jax.random.normal(key, dtype=float)}
        )
        gait = wj.find_gait(walker)
        limit = MOST_STRIDES // WALKS
        key, other = jax.random.key(seed), jax.random.key(seed + 1)
        walks = wj.steps_to_fall(walker, ground, WALKS, key, gait=gait, limit=limit)
        chain = wj.steps_to_fall(walker, ground, key=other, method="cells", gait=gait)
        mean, error = float(chain["mean_strides"]), 1.96 * float(chain["mean_strides_error"])
        low, high = mean - error, mean + error
        agree = low < walks.high and walks.low < high
        print(
            f"{name:30} {kind:11} {size:8.3g}  {walks.mean:8.4g} ({walks.low:8.4g} to "
            f"{walks.high:8.4g}) {int(walks.ended.sum()):6}  {mean:8.4g} ({low:8.4g} to "
            f"{high:8.4g})  {'yes' if agree else 'no'}",
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

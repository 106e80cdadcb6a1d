"""What does a stride in space cost?

A walker in space has ten variables and seven dimensions of starts, a planar one on round feet four
and three. Starts are spread by a tenth about the gait of each, all walk, and each is followed for
one stride. Processor time of both, in turn, in one run; a million starts take 1e6 times that of
one, over the cores.

    python benchmarks/space.py
"""

import time

import jax
import numpy as np

import walker_jax as wj

jax.config.update("jax_enable_x64", True)
COUNT, REPEATS, SPREAD = 40_000, 5, 0.02


def seconds_of(walker, starts) -> float:
    begun = time.process_time()
    wj.strides(walker, starts)
    return time.process_time() - begun


def main() -> None:
    walkers = {"in space": wj.SpatialWalker(), "round feet": wj.RoundFootWalker(0.02)}
    rng, starts = np.random.default_rng(0), {}
    for name, walker in walkers.items():
        gait = wj.find_gait(walker)
        x = np.asarray(gait.states[0])
        starts[name] = x * (1 + SPREAD * rng.uniform(-1, 1, (COUNT, len(x))))
        made = wj.strides(walker, starts[name]).outcome == wj.Outcome.STRIDE
        print(f"{name}: {made.mean():.3f} of {COUNT} starts make a stride")
    least = {name: np.inf for name in walkers}
    for _ in range(REPEATS):
        for name, walker in walkers.items():
            least[name] = min(least[name], seconds_of(walker, starts[name]))
    for name, seconds in least.items():
        each = seconds / COUNT
        print(f"{name}: {1e6 * each:.2f} us of processor time a stride, {1 / each:.0f} a second")
    print(f"ratio {least['in space'] / least['round feet']:.1f}")


if __name__ == "__main__":
    main()

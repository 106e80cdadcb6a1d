"""Is the most probable fall the least one, and do walks on rough ground last as long as it says?

The sequence of steps of least action that topples a walker is found for three walkers. `walk`
replays it, and none of 100,000 random sequences of 0.99 of its length topples the walker. Then the
law of large deviations, with its prefactor, gives the mean number of strides to a fall. It is
compared with importance sampling out to 1e12 strides, and with a stochastic cell map and simulated
walks where these have an answer.
"""

import sys
import time

import jax
import jax.numpy as jnp
import numpy as np

import walker_jax as wj
from walker_jax.checks import ComputationFailed
from walker_jax.stability.disturbed_falls import DisturbedWalks
from walker_jax.stability.gait_mapper import mapper_of_gait
from walker_jax.stability.probable_falls import ProbableFall

jax.config.update("jax_enable_x64", True)  # before the walkers are made
WALKERS = {
    "simplest": wj.SimplestWalker(0.004),
    "spring": wj.SpringWalker(0.01, 0.2),
    "push-off": wj.PoweredWalker(0.002, push_off=0.03),
    "round feet": wj.RoundFootWalker(0.01),
}
EXPONENTS = 3.0, 4.0, 5.5, 7.0, 9.0
"""action / deviation^2 of the grounds on which the law is compared."""
DIRECTIONS = 100_000
RARE = 5.0, 10.0, 15.0, 20.0, 26.0
"""The same, of those on which walks are drawn around the least sequence."""
DRAWN, BESIDE = 20_000, 0.6
"""Such walks; and the share of the least sequence, along it, from which on they count: other falls
are those that begin a stride before or later, which are as many."""
MOST_FOLLOWED = 6.0
"""Largest exponent at which walks are followed to their falls."""


def main(*names: str) -> None:
    for name in names or WALKERS:
        walker = WALKERS[name]
        begin = time.perf_counter(), time.process_time()
        fall = wj.most_probable_fall(walker)
        taken = time.perf_counter() - begin[0], time.process_time() - begin[1]
        print(f"{name}: action {fall.action:.10g}, residual {fall.residual:.1e}, flatness")
        print(f"  {fall.flatness:.6g}, {taken[0]:.0f} s, {taken[1]:.0f} of the processor")
        print("  actions", " ".join(f"{one:.6g}" for one in fall.actions))
        check_least(walker, fall)
        compare_rare(walker, fall)
        compare_law(walker, fall)


def check_least(walker: wj.Walker, fall: ProbableFall) -> None:
    """Replay the fall, and try sequences that are a little shorter."""
    strides = fall.strides + 1
    x = wj.find_gait(walker).states[0]
    for share in (0.99, 1 + 1e-8):
        steps = share * np.append(fall.disturbances[:, 0], np.zeros(strides))[:strides]
        outcomes = np.asarray(wj.walk(walker, x, strides, ground=steps).outcomes)
        print(f"  {share:.8g} of it: {wj.Outcome(int(outcomes[-1])).name} in stride {strides}")
    mapper = mapper_of_gait(walker, None, 200, None)
    start = np.stack(walker.lift(jnp.asarray(mapper.attractors[0].states[0])))
    count = len(fall.disturbances)
    walks = DisturbedWalks(mapper, start, np.array([1.0, 0.0, 0.0]), count, None)
    rays = np.random.default_rng(1).normal(size=(DIRECTIONS, count))
    rays *= 0.99 * np.sqrt(2 * fall.action) / np.linalg.norm(rays, axis=1, keepdims=True)
    near = fall.disturbances[:, 0] + 0.3 * rays  # and around the least sequence itself
    near *= 0.99 * np.sqrt(2 * fall.action) / np.linalg.norm(near, axis=1, keepdims=True)
    print(f"  of {DIRECTIONS:,} shorter ones {walks.fails(rays).sum()} fall,", end=" ")
    print(f"of as many beside it {walks.fails(near).sum()}")


def compare_rare(walker: wj.Walker, fall: ProbableFall) -> None:
    """The law, and its chances by importance sampling, out to where falls are never seen.

    Disturbances are drawn around the least sequence, and walks that fall count by how much less
    probable they are without that shift: the sum is right whatever the boundary's shape is.
    """
    mapper = mapper_of_gait(walker, None, 200, None)
    start = np.stack(walker.lift(jnp.asarray(mapper.attractors[0].states[0])))
    least = fall.disturbances[:, 0]
    walks = DisturbedWalks(mapper, start, np.array([1.0, 0.0, 0.0]), len(least), None)
    rng, found = np.random.default_rng(3), []
    print("  action/deviation^2     law    sampled  (1.96 errors)  slope/action")
    for exponent in RARE:
        deviation = float(np.sqrt(fall.action / exponent))
        w = least + deviation * rng.normal(size=(DRAWN, len(least)))
        along = w @ least / (2 * fall.action)
        counts = walks.fails(w) & (along > BESIDE)
        # The factor exp(-exponent), which all have, is left out: it would be rounded to nothing.
        chances = np.where(counts, np.exp(-2 * exponent * (along - 1)), 0)
        chance, error = chances.mean(), chances.std() / np.sqrt(DRAWN)
        found.append((1 / deviation**2, exponent - np.log(chance / deviation)))
        slope = np.diff(found[-2:], axis=0)[0] if len(found) > 1 else (1, np.nan)
        print(f"  {exponent:18.1f} {fall.mean_strides(deviation):11.5g}", end=" ")
        print(f"{np.exp(exponent) / chance:11.5g} ({1.96 * error / chance:6.1%})", end=" ")
        print(f"{slope[1] / slope[0] / fall.action:9.4f}", flush=True)


def compare_law(walker: wj.Walker, fall: ProbableFall) -> None:
    """Mean strides by the law, a cell map and walks; and slopes of their logarithms."""
    former = None
    print("  action/deviation^2         law    cell map  (1.96 errors)       walks  slope/action")
    for exponent in EXPONENTS:
        deviation = float(np.sqrt(fall.action / exponent))
        law, mean, error, walked = fall.mean_strides(deviation), np.nan, np.nan, np.nan
        if len(walker.section) == 2:
            try:
                chain = wj.steps_to_fall(walker, deviation, method="cells")
                mean, error = float(chain["mean_strides"]), float(chain["mean_strides_error"])
            except ComputationFailed:
                pass
        if exponent < MOST_FOLLOWED:
            walked = wj.steps_to_fall(walker, deviation, 400, jax.random.key(2)).mean
        known = mean if np.isfinite(mean) else walked
        # The chance goes with deviation exp(-action / deviation^2).
        now = np.log(known * deviation), 1 / deviation**2
        slope = np.nan if former is None else (now[0] - former[0]) / (now[1] - former[1])
        print(f"  {exponent:18.1f} {law:11.5g} {mean:11.5g} ({1.96 * error:11.3g})", end=" ")
        print(f"{walked:11.5g} {slope / fall.action:13.3f}", flush=True)
        former = now


if __name__ == "__main__":
    main(*sys.argv[1:])

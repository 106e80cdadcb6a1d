"""How long do walkers walk beyond the loss of walking, and by which law?

The script measures the mean life of the simplest walker over the slope, beyond the crisis near
0.019045, from starts on the former attractor. It fits laws (slope - crisis)^-exponent in windows of
slopes, and compares them with exponents from the multipliers of orbits that the attractor may meet.
It finds the chaotic saddle at some slopes, and the states, modulo a stride, from which walkers
fall, before and after the life drops near 0.0191.
"""

import sys
import time

import jax
import numpy as np

import walker_jax as wj
from walker_jax.integrators.integrator import Integrator
from walker_jax.walking.iteration import iterate, orbits

ATTRACTOR = 0.0188
STARTS, STRIDES = 2000, 20_000
SLOPES = 0.019052, 0.019056, 0.01906, 0.019066, 0.019074, 0.019084, 0.019096, 0.0191
FURTHER = 0.01911, 0.01912, 0.01913, 0.01914, 0.01916, 0.01918, 0.0192, 0.0193, 0.0194
LAST = 6
"""Strides before a fall whose states are shown."""


def main(count: str = str(STARTS)) -> None:
    jax.config.update("jax_enable_x64", True)
    begin = time.process_time()
    starts = starts_on_attractor(int(count))
    lives, errors = [], []
    print("slope      escape rate (95 %)             mean life  exponents          dimension")
    for slope in (*SLOPES, *FURTHER):
        walker = wj.SimplestWalker(slope)
        found = wj.transients(walker, starts, strides=STRIDES, tolerance=1e-10)
        lives.append(found.mean_life)
        errors.append(found.mean_life / np.sqrt(found.ended.sum()))
        print(
            f"{slope:.6f} {found.rate:.6f} ({found.low:.6f}, {found.high:.6f}) "
            f"{found.mean_life:10.1f}  {found.exponents[0]:.4f} {found.exponents[1]:.4f} "
            f"{found.dimension:10.4f}",
            flush=True,
        )
    slopes = np.array([*SLOPES, *FURTHER])
    lives, errors = np.array(lives), np.array(errors)
    for low, high in ((0.01905, 0.0191), (0.01905, 0.01914), (0.01905, 0.0194)):
        inside = (slopes > low) & (slopes <= high)
        law = wj.crisis_law(slopes[inside], lives[inside], errors[inside])
        print(f"slopes up to {high}: {law}")
    for period in (1, 2, 3):
        for gait in wj.find_gaits(wj.SimplestWalker(0.019045), period):
            sizes = np.abs(gait.multipliers)
            if sizes.max() > 1 > sizes.min() and sizes.prod() < 1:
                kinds = ("heteroclinic", "homoclinic")
                says = ", ".join(f"{one} {wj.crisis_exponent(sizes, one):.4f}" for one in kinds)
                print(f"period {period} at {gait.states[:, 0].round(5)}, {sizes}: {says}")
    for slope in (0.01908, 0.0191, 0.01914, 0.0192):
        show_falls(slope, starts)
    print(f"{time.process_time() - begin:.0f} s of the processor")


def starts_on_attractor(count: int) -> np.ndarray:
    """Starts on the chaotic attractor, before it is lost."""
    walker = wj.SimplestWalker(ATTRACTOR)
    gait = np.asarray(wj.find_gait(walker).states[0])
    near = gait + np.linspace(-1e-4, 1e-4, count)[:, None] * np.array([1.0, 0.0])
    end = iterate(walker, near, 300, Integrator(1e-10))
    return np.asarray(end.state)[end.outcome == wj.Outcome.STRIDE]


def show_falls(slope: float, starts: np.ndarray) -> None:
    """The mean theta of the last states before a fall, by the angle from which walkers fall."""
    walker, integrator = wj.SimplestWalker(slope), Integrator(1e-10)
    end = iterate(walker, starts, STRIDES, integrator)
    chosen = (end.outcome != wj.Outcome.STRIDE) & (end.strides > 20)
    lasts = []
    for start, life in zip(starts[chosen][:300], end.strides[chosen][:300], strict=True):
        begun = np.asarray(iterate(walker, start[None], int(life) - LAST, integrator).state)
        lasts.append(orbits(walker, begun, LAST, integrator)[0][0, :, 0])
    lasts = np.array(lasts)
    print(f"slope {slope}: theta of the last states, by the last but one")
    for low, high in ((0.0, 0.24), (0.24, 0.27), (0.27, 0.279), (0.279, 0.4)):
        some = lasts[(lasts[:, -2] >= low) & (lasts[:, -2] < high)]
        if len(some):
            print(f"  {len(some) / len(lasts):6.1%} {some.mean(axis=0).round(4)}")


if __name__ == "__main__":
    main(*sys.argv[1:])

"""Is the least disturbance the least, how long does it take, and at which slope is it largest?

The least disturbance of the simplest walker at ten slopes is compared with a polar grid about its
gait: 20,000 directions, and distances 0.02 % apart from 0.9 of the least disturbance outwards,
until a walker does not return. At nine slopes no point of the grid is nearer, and the nearest is
one step farther. At 0.0105, where the boundary is fractal, the grid meets a finger that is nearer
by 0.04 %. The least disturbance is largest at 0.0077. On two cores:

slope 0.001: 0.00192270 ..., FORWARD after 24, in 7.1 s; polar grid 1.00020 times as large
slope 0.0025: 0.00215421 ..., FORWARD after 20, in 3.6 s; polar grid 1.00020 times as large
slope 0.004: 0.00225617 ..., FORWARD after 18, in 5.2 s; polar grid 1.00020 times as large
slope 0.0055: 0.00231298 ..., FORWARD after 16, in 4.4 s; polar grid 1.00020 times as large
slope 0.0067: 0.00234150 ..., FORWARD after 16, in 5.6 s; polar grid 1.00020 times as large
slope 0.0076: 0.00235362 ..., FORWARD after 30, in 10.5 s; polar grid 1.00020 times as large
slope 0.009: 0.00225558 ..., FORWARD after 56, in 12.9 s; polar grid 1.00000 times as large
slope 0.0105: 0.00201157 ..., FORWARD after 37, in 2.4 s; polar grid 0.99960 times as large
slope 0.012: 0.00203159 ..., FORWARD after 34, in 15.2 s; polar grid 1.00020 times as large
slope 0.0145: 0.00103969 ..., FORWARD after 43, in 14.6 s; polar grid 1.00020 times as large
largest at slope 0.0077: 0.00235503
"""

import time

import jax
import numpy as np

import walker_jax as wj
from walker_jax.basins.attractor import Attractor
from walker_jax.basins.capture_boxes import with_capture_boxes
from walker_jax.basins.mapper import Mapper
from walker_jax.integrators.integrator import Integrator

SLOPES = 0.001, 0.0025, 0.004, 0.0055, 0.0067, 0.0076, 0.009, 0.0105, 0.012, 0.0145
SCAN = np.arange(0.0068, 0.00841, 0.0001)
DIRECTIONS, RINGS = 20_000, 2e-4


def brute_force(walker: wj.Walker, gait: wj.Gait, size: float) -> float:
    """The first distance on a fine polar grid at which a walker does not come back."""
    states = np.asarray(gait.states)
    mapper = with_capture_boxes(Mapper(walker, [Attractor(states)], Integrator(1e-12), 500))
    angles = 2 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    rays = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    for radius in np.arange(0.9, 1.01, RINGS) * size:
        if not mapper(states[0] + radius * rays).converged.all():
            return radius
    return np.inf


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    for slope in SLOPES:
        walker = wj.SimplestWalker(slope)
        gait = wj.find_gait(walker)
        begun = time.perf_counter()
        found = wj.least_disturbance(walker, gait)
        seconds = time.perf_counter() - begun
        ratio = brute_force(walker, gait, found.size) / found.size
        print(
            f"slope {slope}: {found.size:.8f} along {np.round(found.direction, 4)}, "
            f"{found.failure.name} after {found.strides}, in {seconds:.1f} s; "
            f"polar grid {ratio:.5f} times as large",
            flush=True,
        )
    sizes = [wj.least_disturbance(wj.SimplestWalker(slope)).size for slope in SCAN]
    for slope, size in zip(SCAN, sizes, strict=True):
        print(f"{slope:.4f} {size:.8f}")
    print(f"largest at slope {SCAN[np.argmax(sizes)]:.4f}: {max(sizes):.8f}")


if __name__ == "__main__":
    main()

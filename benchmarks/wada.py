"""Is the boundary of the simplest walker's basin Wada, common to walking and both ways to fall?

No, on no slope; but from about 0.0075 on a part of it is. On each slope the boundaries of merged
regions are compared on a grid of 1000 x 1000 cells and on coarser ones: more than half of a
boundary is far from another one, and this share grows on finer grids. Then the fates of 200 starts
are computed around points of the boundary, found by bisection, at distances from 1e-4 to 1e-10 of
the axes. Where walking and falling forward meet, no point has all three fates nearby. Where the two
falls meet, a tenth to a half of the points have them at all distances, from a slope of 0.0075 on;
on gentler slopes none has them at small distances. Walking and falling backward meet nowhere:
bisection between the two always ends at a layer of falls forward. Okamoto and others (2020) show
the origin of the fractal boundary.

slope 0.004: entropy 0.0172, of the boundary 0.563 +- 0.006; lacks 53% at 1000, 42% at 500, ...
  STRIDE/FORWARD: all three within 1e-4 ... 1e-10: 0.00 0.00 0.00 0.00 0.00 0.00 0.00
  FORWARD/BACKWARD: all three within 1e-4 ... 1e-10: 0.04 0.00 0.00 0.00 0.00 0.00 0.00
slope 0.007: entropy 0.0167, of the boundary 0.552 +- 0.006; lacks 58% at 1000, 46% at 500, ...
  FORWARD/BACKWARD: all three within 1e-4 ... 1e-10: 0.02 0.00 0.00 0.00 0.00 0.00 0.00
slope 0.0075: entropy 0.0166, of the boundary 0.550 +- 0.006; lacks 59% at 1000, 47% at 500, ...
  FORWARD/BACKWARD: all three within 1e-4 ... 1e-10: 0.01 0.00 0.00 0.03 0.11 0.08 0.06
slope 0.0078: entropy 0.0167, of the boundary 0.550 +- 0.006; lacks 58% at 1000, 47% at 500, ...
  FORWARD/BACKWARD: all three within 1e-4 ... 1e-10: 0.21 0.15 0.11 0.14 0.36 0.29 0.33
slope 0.009: entropy 0.0170, of the boundary 0.539 +- 0.006; lacks 64% at 1000, 51% at 500, ...
  STRIDE/FORWARD: all three within 1e-4 ... 1e-10: 0.00 0.00 0.00 0.00 0.00 0.00 0.00
  FORWARD/BACKWARD: all three within 1e-4 ... 1e-10: 0.41 0.27 0.17 0.34 0.41 0.45 0.44
slope 0.012: entropy 0.0184, of the boundary 0.528 +- 0.006; lacks 72% at 1000, 61% at 500, ...
  STRIDE/FORWARD: all three within 1e-4 ... 1e-10: 0.00 0.00 0.00 0.00 0.00 0.00 0.00
  FORWARD/BACKWARD: all three within 1e-4 ... 1e-10: 0.36 0.40 0.24 0.41 0.54 0.38 0.49
"""

import jax
import numpy as np

import walker_jax as wj
from walker_jax import Outcome
from walker_jax.basins.attractor_search import survey
from walker_jax.basins.mapper import Mapper
from walker_jax.integrators.integrator import Integrator

SLOPES = 0.004, 0.006, 0.007, 0.0075, 0.0078, 0.009, 0.012, 0.015, 0.018
WINDOW = {"theta": (0.01, 0.4), "sum": (-0.05, 0.03)}
CELLS, POINTS, STARTS, HALVINGS = 1000, 100, 200, 40
DISTANCES = 10.0 ** -np.arange(4, 11)
PAIRS = (Outcome.STRIDE, Outcome.FORWARD), (Outcome.FORWARD, Outcome.BACKWARD)
FATES = Outcome.STRIDE, Outcome.FORWARD, Outcome.BACKWARD


def share_with_all_fates(
    mapper: Mapper, grid: wj.Grid, fate: np.ndarray, pair: tuple[Outcome, Outcome]
) -> np.ndarray:
    """Share of points between two fates that have all three within each distance."""
    rng = np.random.default_rng(0)
    fate_at = lambda share: mapper(grid.points_at(share.reshape(-1, 2))).fate
    first = np.argwhere(np.isin(fate[:, :-1], pair) & np.isin(fate[:, 1:], pair))
    first = first[fate[:, :-1][tuple(first.T)] != fate[:, 1:][tuple(first.T)]]
    first = first[rng.integers(0, len(first), POINTS)]
    low, high = (first + 0.5) / CELLS, (first + np.array([0, 1]) + 0.5) / CELLS
    own = fate[tuple(first.T)]
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        same = (fate_at(middle) == own)[:, None]
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    meet = np.isin(fate_at(high), pair)  # and no third fate is between
    points = ((low + high) / 2)[meet]
    shares = []
    for distance in DISTANCES:
        near = points[:, None] + distance * rng.uniform(-1, 1, (len(points), STARTS, 2))
        found = fate_at(near).reshape(-1, STARTS)
        shares.append(np.all([(found == one).any(axis=1) for one in FATES], axis=0).mean())
    return np.array(shares)


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    grid = wj.Grid.sheared(**{name: (*ends, CELLS) for name, ends in WINDOW.items()})
    coarse = wj.Grid.sheared(**{name: (*ends, 200) for name, ends in WINDOW.items()})
    for slope in SLOPES:
        walker = wj.SimplestWalker(slope)
        starts = coarse.centres(np.arange(0, coarse.size, 4))
        mapper = survey(walker, starts, Integrator(1e-12), 300, boxes=True).mapper
        fate = mapper(grid.centres(np.arange(grid.size))).fate.reshape(grid.shape)
        label = np.where(np.isin(fate, FATES), fate, -1)
        entropy, merged = wj.fractals.basin_entropy(label), wj.fractals.merge_regions(label)
        lacks = ", ".join(
            f"{share:.0%} at {CELLS // spacing}"
            for spacing, share in zip(merged.spacings, merged.share, strict=True)
        )
        boundary = f"{entropy.boundary:.3f} +- {entropy.boundary_error:.3f}"
        print(
            f"slope {slope}: entropy {entropy.value:.4f}, of the boundary {boundary}; lacks {lacks}"
        )
        for pair in PAIRS:
            shares = share_with_all_fates(mapper, grid, fate, pair)
            words = " ".join(f"{one:.2f}" for one in shares)
            names = "/".join(one.name for one in pair)
            print(f"  {names}: all three within 1e-4 ... 1e-10: {words}", flush=True)


if __name__ == "__main__":
    main()

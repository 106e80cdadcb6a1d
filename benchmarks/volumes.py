"""Does the cost of a volume grow as the surface of the basin, and is the volume right?

The volumes are of the whole basin of the default walkers on round feet and with an upper body, in
three dimensions. First, volumes of one walker on ever finer grids, each in a process of its own:
processor seconds and peak memory grow like the cells that are followed, about fourfold a level, not
eightfold. Then volumes over slopes are compared with the same volume by random starts (basin
stability), with its 95 % interval; the derivative of a volume on ever finer grids with a
difference; and the change of the volume over the slopes with the integral of its derivative.

On two busy cores (docs/accuracy-basins.md; each level follows 4.5 times as many cells):

level      volume +- error      followed      runs    cpu s  wall s  peak MB (before)
    0 0.0272917 +- 3.3e-04        508032     19920      3.7     8.6      485 (477)
    1 0.0273712 +- 9.3e-05        540731    125910     11.6    18.1      515 (477)
    2 0.0272244 +- 2.9e-05       2518371    723116     41.7   124.1      781 (477)
    3 0.0272678 +- 1.6e-05      11347729   3918564    231.2   989.1     2023 (478)
walker     slope  volume +- error       by random starts (95 %)       apart
round-foot 0.005  0.028893 +- 0.000029  0.029509 (0.028938 to 0.030090)  +2.09
round-foot 0.010  0.027280 +- 0.000028  0.027668 (0.027116 to 0.028232)  +1.36
round-foot 0.020  0.024813 +- 0.000028  0.024999 (0.024474 to 0.025535)  +0.68
upper-body 0.005  0.020554 +- 0.000031  0.020415 (0.019942 to 0.020900)  -0.56
upper-body 0.020  0.018907 +- 0.000030  0.018866 (0.018411 to 0.019332)  -0.17
derivative by the foot radius
level 0: 0.1391 +- 0.0101
level 1: 0.1450 +- 0.0057
level 2: 0.1469 +- 0.0034
by a difference: 0.1489 +- 0.0010
"""

import resource
import subprocess
import sys
import time

import jax
import numpy as np

import walker_jax as wj
from walker_jax.basins.windows import grid_along, whole_section

WALKERS = {"round-foot": wj.RoundFootWalker, "upper-body": wj.UpperBodyWalker}
SLOPES = 0.005, 0.01, 0.02
NODES = 4
RADII = 0.18, 0.22
LEVELS, STARTS = 2, 2_000_000


def whole_grid(walker):
    axes = whole_section(walker)
    assert axes is not None
    return grid_along(axes)


def main(step: str = "all", levels: int = 3) -> None:
    jax.config.update("jax_enable_x64", True)
    if step == "level":
        measure_level(levels)
        return
    if step in ("all", "levels"):
        print(
            "level      volume +- error      followed      runs    cpu s  wall s  peak MB (before)"
        )
        for level in range(levels + 1):
            subprocess.run([sys.executable, __file__, "level", str(level)], check=True)
    if step in ("all", "slopes"):
        print("walker     slope  volume +- error       by random starts (95 %)       apart")
        for name, kind in WALKERS.items():
            for slope in SLOPES:
                compare(name, kind(slope))
    if step in ("all", "radius"):
        print("derivative by the foot radius")
        differentiate_by_radius()
    if step in ("all", "gradient"):
        print("walker     change of the volume over these slopes; integral of its derivative")
        for name, kind in WALKERS.items():
            integrate_gradient(name, kind)


def differentiate_by_radius() -> None:
    """Print the derivative of a volume on ever finer grids, and a difference of volumes."""
    walker = wj.RoundFootWalker(0.01)
    grid = whole_grid(walker)
    for level in range(LEVELS + 1):
        found = wj.measure(walker, "volume", ("foot_radius",), grid=grid, levels=level)
        print(
            f"level {level}: {found.gradient[0]:.4f} +- {found.gradient_error[0]:.4f}", flush=True
        )
    ends = [wj.refine(wj.RoundFootWalker(0.01, foot_radius=r), grid, LEVELS, seed=5) for r in RADII]
    low, high = (float(one.total_area) for one in ends)
    width = RADII[1] - RADII[0]
    error = np.linalg.norm([float(one.total_area_error) for one in ends]) / width
    print(f"by a difference: {(high - low) / width:.4f} +- {error:.4f}", flush=True)


def integrate_gradient(name: str, kind: type) -> None:
    """Print the change of a volume over the slopes, and the integral of its derivative."""
    low, high = SLOPES[0], SLOPES[-1]
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    slopes = (low + high) / 2 + (high - low) / 2 * nodes
    grid = whole_grid(kind(low))
    found = [
        wj.measure(kind(slope), "volume", ["slope"], grid=grid, levels=1, check=50_000)
        for slope in slopes
    ]
    rates = np.array([one.gradient[0] for one in found])
    errors = np.array([one.gradient_error[0] for one in found])
    share = weights * (high - low) / 2
    ends = [wj.refine(kind(slope), grid, LEVELS) for slope in (low, high)]
    change = float(ends[1].total_area - ends[0].total_area)
    error = np.linalg.norm([float(one.total_area_error) for one in ends])
    print(
        f"{name:10} {change:.6f} +- {error:.6f}; {share @ rates:.6f} +- "
        f"{np.linalg.norm(share * errors):.6f}, rates {np.round(rates, 4).tolist()}",
        flush=True,
    )


def measure_level(level: int) -> None:
    """Print what one level of refinement takes."""
    walker = wj.RoundFootWalker(0.01)
    grid = whole_grid(walker)
    wj.refine(walker, grid, 0, check=1000)  # compiles
    peak = lambda: resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    before, cpu, wall = peak(), time.process_time(), time.perf_counter()
    data = wj.refine(walker, grid, level)
    cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
    print(
        f"{level:5} {float(data.total_area):.7f} +- {float(data.total_area_error):.1e} "
        f"{int(data.followed[-1]):13} {data.sizes['run']:9} {cpu:8.1f} {wall:7.1f} "
        f"{peak():8.0f} ({before:.0f})",
        flush=True,
    )


def compare(name: str, walker: wj.Walker) -> None:
    """Print the volume of a basin by refinement, by random starts, and by a uniform grid."""
    grid = whole_grid(walker)
    data = wj.refine(walker, grid, LEVELS)
    volume, error = float(data.total_area), float(data.total_area_error)
    gait = wj.find_gait(walker)
    found = wj.basin_stability(walker, grid, gait, samples=STARTS, strides=200, seed=1)
    whole = grid.size * grid.cell_area
    share, low, high = (float(one) for one in (found.value, found.low, found.high))
    own = np.hypot(error, whole * (high - low) / 2 / 1.96)
    print(
        f"{name:10} {float(vars(walker)['slope']):.3f}  {volume:.6f} +- {error:.6f}  "
        f"{whole * share:.6f} ({whole * low:.6f} to {whole * high:.6f})  "
        f"{(whole * share - volume) / own:+.2f}  "
        f"periods {data.period.values.tolist()}, at border {int(data.at_border)}, "
        f"mistaken {int(data.mistaken)} of {int(data.checked)}",
        flush=True,
    )


if __name__ == "__main__":
    main(*sys.argv[1:2], levels=int(sys.argv[2]) if len(sys.argv) > 2 else 3)

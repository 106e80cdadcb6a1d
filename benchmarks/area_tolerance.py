"""Basins by strides of several tolerances: cells of another fate, and the time (three minutes)."""

import time

import jax

import walker_jax as wj
from walker_jax.basins.refinement import refine_cells
from walker_jax.basins.windows import default_region

jax.config.update("jax_enable_x64", True)

WALKERS = (
    wj.SimplestWalker(0.004),
    wj.SimplestWalker(0.0165),
    wj.SpringWalker(0.004, 1.0),
    wj.PointFootWalker(0.01),
    wj.RoundFootWalker(0.01),
    wj.UpperBodyWalker(0.01),
    wj.PoweredWalker(0.005, 2.0),
    wj.PoweredPointFootWalker(0.005),
    wj.PoweredRoundFootWalker(0.005),
)
TOLERANCES = 1e-12, 1e-9, 1e-7, 1e-6


def main() -> None:
    """Print a row for each walker: its area, and for each tolerance cells, errors and time."""
    print("cells that differ from those at 1e-12, of the area's errors, share of the time")
    for walker in WALKERS:
        grid = default_region(walker)
        assert grid is not None
        found, seconds = {}, {}
        for tolerance in TOLERANCES:
            for _ in range(2):  # compiled by the first
                begin = time.process_time()
                found[tolerance] = refine_cells(
                    walker,
                    grid,
                    2,
                    strides=200,
                    check=50_000,
                    seed=0,
                    tolerance=tolerance,
                    by_centres=True,  # as `optimise` does
                )
                seconds[tolerance] = time.process_time() - begin
        exact, slowest = found[TOLERANCES[0]], seconds[TOLERANCES[0]]
        row = f"{type(walker).__name__:24} {exact.area:.6g} +- {exact.area_error:.1g}"
        for tolerance in TOLERANCES[1:]:
            cells = int((found[tolerance].attractor != exact.attractor).sum())
            errors = (found[tolerance].area - exact.area) / exact.area_error
            row += f"; {tolerance:g}: {cells}, {errors:.2f}, {seconds[tolerance] / slowest:.2f}"
        print(row, flush=True)


if __name__ == "__main__":
    main()

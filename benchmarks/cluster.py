"""A basin through a store, by this process and by as many worker processes as there are cores.

    python benchmarks/cluster.py [rows]

Both use the same cores, one after the other, twice. The cluster takes longer because each worker
loads and compiles at its start, and because pieces are sent to and fro; two sizes of the basin
separate these costs.
"""

import os
import sys
import tempfile
import time
from pathlib import Path

import jax

import walker_jax as wj


def seconds(rows: int, cluster: int | None) -> float:
    """How long the basin takes on a grid of so many rows of 4000 cells."""
    grid = wj.Grid.sheared(theta=(0, 0.4, rows), sum=(-0.04, 0.01, 4000))
    walker = wj.SimplestWalker(0.004)
    with tempfile.TemporaryDirectory() as folder:
        start = time.perf_counter()
        wj.basin(walker, grid, "direct", out=Path(folder) / "a.zarr", cluster=cluster)
        return time.perf_counter() - start


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    rows, workers = int(sys.argv[1]) if len(sys.argv) > 1 else 8000, os.cpu_count() or 1
    seconds(100, None)  # compiles
    print(f"{'cells':>12} {'one process':>12} {f'{workers} workers':>12} {'ratio':>6}")
    for size in (rows // 4, rows, rows // 4, rows):
        plain, farmed = seconds(size, None), seconds(size, workers)
        print(f"{4000 * size:12,} {plain:12.1f} {farmed:12.1f} {farmed / plain:6.2f}", flush=True)


if __name__ == "__main__":
    main()

"""How do time and memory grow with the number of cells, and how long does a start take?

The one-stride map (the image of each cell's centre) is computed on ever finer grids over the
paper's window, in a process for each: strides per second, and peak memory beyond that of a process
with a map of a hundred cells. The result itself takes 4 bytes a cell. Then the command `walker-jax
basin` runs from a new cache directory, and again. `--figure` draws the first table; with
`--printed`, the one below, without a measurement.

The answer: strides per second do not fall, and memory is 12 bytes a cell.

           cells  seconds   strides/s     MiB  bytes a cell
          10,000    0.005   2,055,588       0           0.0
          99,856    0.044   2,284,136       0           1.3
       1,000,000    0.278   3,593,092      12          12.1
       9,998,244    3.031   3,298,879     114          12.0
     100,000,000   27.883   3,586,421    1148          12.0
    walker-jax basin: 4.6 s at first, 3.8 s again
"""

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

SIZES = 10**4, 10**5, 10**6, 10**7, 10**8


def measure(cells: int) -> dict:
    """In this process: seconds and bytes."""
    import resource

    import jax

    import walker_jax as wj
    from walker_jax.basins.methods import cell_map
    from walker_jax.integrators.integrator import Integrator

    jax.config.update("jax_enable_x64", True)
    walker = wj.SimplestWalker(0.004)
    side = round(cells**0.5)
    grid_of = lambda n, m: wj.Grid.sheared(theta=(0, 0.4, n), sum=(-0.04, 0.01, m))
    cell_map(walker, grid_of(10, 10), Integrator(1e-12))  # compiles
    peak = lambda: resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    before, start = peak(), time.perf_counter()
    image = cell_map(walker, grid_of(side, cells // side), Integrator(1e-12))
    seconds = time.perf_counter() - start
    return {"cells": image.size, "seconds": seconds, "bytes": peak() - before}


def starting(folder: str) -> float:
    """Seconds that the command takes, with its cache in a folder."""
    start = time.perf_counter()
    subprocess.run(
        [
            sys.executable,
            "-c",
            "from walker_jax.cli.main import main; main()",
            "basin",
            "--overwrite",
        ],
        cwd=folder,
        env={**os.environ, "XDG_CACHE_HOME": folder},
        check=True,
        stdout=subprocess.DEVNULL,
    )
    return time.perf_counter() - start


def main():
    parser = argparse.ArgumentParser(description="Time and memory, as work grows.")
    parser.add_argument("--largest", type=float, default=1e8, help="cells at most")
    parser.add_argument("--figure", type=Path, help="where a picture goes")
    parser.add_argument("--printed", action="store_true", help="draw the table of the header")
    parser.add_argument("--measure", type=int, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.measure:
        print(json.dumps(measure(args.measure)))
        return
    if args.printed:
        return draw(printed_rows(), args.figure)
    rows = []
    print(f"{'cells':>12}{'seconds':>9}{'strides/s':>12}{'MiB':>8}{'bytes a cell':>14}")
    for cells in SIZES:
        if cells > args.largest:
            break
        child = subprocess.run(
            [sys.executable, __file__, "--measure", str(cells)], check=True, capture_output=True
        )
        row = json.loads(child.stdout)
        rows.append(row)
        speed = row["cells"] / row["seconds"]
        print(
            f"{row['cells']:12,d}{row['seconds']:9.3f}{speed:12,.0f}{row['bytes'] / 2**20:8.0f}"
            f"{row['bytes'] / row['cells']:14.1f}"
        )
    with tempfile.TemporaryDirectory() as folder:
        first, again = starting(folder), min(starting(folder) for _ in range(3))
    print(f"walker-jax basin: {first:.1f} s at first, {again:.1f} s again")
    if args.figure:
        draw(rows, args.figure)


def printed_rows() -> list[dict]:
    """Return the rows of the table in the header."""
    table = re.findall(r"^ +([\d,]+) +([\d.]+) +[\d,]+ +(\d+) +[\d.]+$", __doc__ or "", re.M)
    return [
        {"cells": int(cells.replace(",", "")), "seconds": float(time), "bytes": int(size) * 2**20}
        for cells, time, size in table
    ]


def draw(rows: list[dict], path: Path) -> None:
    from matplotlib.figure import Figure

    from walker_jax.figures.style import BASINS, OTHERS, TITLE

    figure = Figure(figsize=(6.4, 4.2), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True)
    cells = [row["cells"] for row in rows]
    speeds = [row["cells"] / row["seconds"] / 1e6 for row in rows]
    above.plot(cells, speeds, "o-", color=BASINS[0])
    above.set(ylabel="millions a second", ylim=(0, 1.15 * max(speeds)))
    above.set_title("Strides per second", **TITLE)
    seen = [row for row in rows if row["bytes"] > 4 * row["cells"]]  # above the earlier peak
    peaks = [row["bytes"] / 2**20 for row in seen]
    below.plot([row["cells"] for row in seen], peaks, "o-", color=BASINS[0], label="peak")
    result = [4 * row["cells"] / 2**20 for row in rows]
    below.plot(cells, result, "--", color=OTHERS, label="the result itself")
    below.set(xscale="log", yscale="log", xlabel="cells", ylabel="MiB")
    below.set_title("Memory", **TITLE)
    below.legend(frameon=False)
    for ax in (above, below):
        ax.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=150)


if __name__ == "__main__":
    main()

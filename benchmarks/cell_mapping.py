"""How far is cell mapping from the truth, how does that shrink with the cell, and what is made up?

The simplest walker in the window of Schwab and Wisse (2001), Figure 4: first on ever finer grids at
slope 0.004, then on their own grid, near the slope at which they find that the basin vanishes. The
share of cells in which the methods differ is about proportional to the size of a cell. Above a
slope of 0.018, cell mapping misses the true basin, and from 0.0195 on shows only artefacts:

50 x 50: differ in 0.4400%, power of the cell -; ...
100 x 100: differ in 0.3000%, power of the cell 0.55; ...
200 x 200: differ in 0.1425%, power of the cell 1.07; ...
400 x 400: differ in 0.0813%, power of the cell 0.81; ...
800 x 800: differ in 0.0450%, power of the cell 0.85; ...
1600 x 1600: differ in 0.0214%, power of the cell 1.07; ...
slope 0.015 on 200 x 250: walks by cell mapping  2.15200%, directly  2.09400%; ...
slope 0.018 on 200 x 250: walks by cell mapping  1.01600%, directly  1.41000%; ...
slope 0.0185 on 200 x 250: walks by cell mapping  0.00000%, directly  1.31400%; ...
slope 0.019 on 200 x 250: walks by cell mapping  0.03600%, directly  1.18800%; ...
slope 0.0195 on 200 x 250: walks by cell mapping  0.03400%, directly  0.00000%; ...
slope 0.022 on 200 x 250: walks by cell mapping  0.00400%, directly  0.00000%; ...
"""

import jax
import numpy as np

import walker_jax as wj
from walker_jax.basins.computation import compare_methods

WINDOW = {"theta": (0.0, 0.4), "sum": (-0.04, 0.01)}
SIDES = 50, 100, 200, 400, 800, 1600
SLOPES = 0.015, 0.017, 0.018, 0.0185, 0.019, 0.0195, 0.02, 0.021, 0.022, 0.023


def row(slope: float, *shape: int) -> tuple[np.ndarray, str]:
    """The two methods on one grid; the cells in which they differ, and their numbers in words."""
    axes = {name: (*ends, count) for (name, ends), count in zip(WINDOW.items(), shape, strict=True)}
    grid = wj.Grid.sheared(**axes)
    found = compare_methods(wj.SimplestWalker(slope), grid)
    mapped, direct = found.mapped.values, found.direct.values
    share = lambda cells: f"{cells.mean():9.5%}"
    false = found.artefact.values
    words = (
        f"walks by cell mapping {share(mapped)}, directly {share(direct)}; "
        f"only by cell mapping {share(mapped & ~direct)}, only directly {share(direct & ~mapped)}; "
        f"{int(found.direct_attractors)} attractor(s), and {false.sum()} of cell mapping's own "
        f"of periods {sorted(set(found.period.values[false].tolist()))} with "
        f"{found['cells'].values[false].sum() / max(1, mapped.sum()):.1%} of what walks there"
    )
    return mapped != direct, words


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    before = None
    for side in SIDES:
        differs, words = row(0.004, side, side)
        part = differs.mean()
        power = f"{np.log2(before / part):.2f}" if before else "-"
        print(f"{side} x {side}: differ in {part:.4%}, power of the cell {power}; {words}")
        before = part
    for slope in SLOPES:
        print(f"slope {slope} on 200 x 250: {row(slope, 200, 250)[1]}", flush=True)


if __name__ == "__main__":
    main()

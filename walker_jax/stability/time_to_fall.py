"""Steps to a fall, by either of two independent methods: walks, or a stochastic cell map."""

from __future__ import annotations

from typing import Any, Literal, overload

import jax
import numpy as np
import xarray as xr

from walker_jax.checks import WrongUse, check_whole, refuses_tracers, short
from walker_jax.gaits.cycles import Gait
from walker_jax.stability.rough_ground import (
    RandomDisturbance,
    StepsToFall,
    mean_life,
    read_ground,
    read_key,
    start_of_walks,
    walk_disturbed,
)
from walker_jax.stability.stochastic_map import survival_of_cells
from walker_jax.systems.outcomes import Outcome
from walker_jax.walkers.model import Walker, check_planar

WALKS, WALKERS = 1000, 100_000
"""Number of walks, and of walkers in the cells of a map."""


@overload
def steps_to_fall(
    walker: Walker,
    ground: float | RandomDisturbance,
    n: int | None = None,
    key: Any = None,
    method: Literal["walks"] = "walks",
    *,
    gait: Gait | None = None,
    limit: int = 10_000,
    confidence: float = 0.95,
    tolerance: float | None = None,
) -> StepsToFall: ...


@overload
def steps_to_fall(
    walker: Walker,
    ground: float | RandomDisturbance,
    n: int | None = None,
    key: Any = None,
    *,
    method: Literal["cells"],
    gait: Gait | None = None,
    side: float = 0.8,
    repetitions: int = 4,
    tolerance: float | None = None,
) -> xr.Dataset: ...


@refuses_tracers()
def steps_to_fall(
    walker: Walker,
    ground: float | RandomDisturbance,
    n: int | None = None,
    key: Any = None,
    method: Literal["walks", "cells"] = "walks",
    *,
    gait: Gait | None = None,
    limit: int = 10_000,
    confidence: float = 0.95,
    side: float = 0.8,
    repetitions: int = 4,
    tolerance: float | None = None,
) -> StepsToFall | xr.Dataset:
    """Measure how many strides walkers make on rough ground until they fall, starting in a gait.

    By "walks" they are counted. Walks stop after `limit` strides, or where the outcome is
    `UNDECIDED`: no walker counts as fallen unless it is known to fall. For such walks, the mean
    assumes a constant chance to fall in each stride. That holds once a walk has forgotten its
    start: the chance then does not depend on the number of strides before. The interval is that of
    Clopper and Pearson for such a chance (1934, Biometrika 26:404-413). If all walks fall and are
    30 or more, it is the interval of the sample mean, for any distribution.

    By "cells" they follow from a stochastic cell map (Ulam's method), at a cost that hardly depends
    on how rare falls are. Numbers of strides jump as parameters change, so there is no derivative;
    `measure` of the sensitivity norm, the least disturbance and the most probable fall has one.

    ```python
    walks = wj.steps_to_fall(wj.SimplestWalker(0.004), 2e-4, n=100, limit=1000)
    walks.mean, walks.low, walks.high, walks.ended.mean()  # the share that fell
    data = wj.steps_to_fall(wj.SimplestWalker(0.004), 2e-4, 20_000, method="cells", repetitions=2)
    float(data.mean_strides), float(data.mean_strides_error)
    ```

    **Arguments:**

    - `walker`: any planar walker; for cells, one whose section has two coordinates.
    - `ground`: the standard deviation of normally distributed heights, in the unit of length. Or a
      function of a JAX random key, which returns the height of the next foothold above the present
      one, such as `lambda key: 0.001 * jax.random.normal(key)`, or a `Disturbance`.
    - `n`: number of walks, 1000 by default; or of walkers in all cells together, 100,000 by
      default, 12 or more in each, of which each makes 80 strides.
    - `key`: a JAX random key, `jax.random.key(0)` by default. Each stride of each walk has its own.
    - `method`: "walks" or "cells".
    - `gait`: walks start at its first state; that of `find_gait` by default.
    - `limit`: most strides of a walk; cells have none.
    - `confidence`: of the interval of walks.
    - `side`: of cells, in standard deviations of states along each direction.
    - `repetitions`: number of maps with other random numbers; their scatter gives the error.
    - `tolerance`: of the integration, as in `stride`.

    **Returns** `StepsToFall`; of cells a data set: `survival`, the chance not to fall in a stride
    of long walks; `mean_strides` to a fall, from the gait on; its standard error
    `mean_strides_error`, 1.96 of which make a 95 % interval, as by Student's t; `undecided`,
    strides without an answer, which do not count. The quasi-stationary distribution has the
    `chance` of each cell of the last repetition, its `centre` in theta, thetadot and, on rough
    ground, the gap phi - 2 theta, and the `edges` of all cells.

    Raises `ValueError` for a walker without a gait, and for arguments out of range;
    `ComputationFailed` where walks end too early for cells, or so rarely that there are more than a
    million cells.
    """
    if method not in ("walks", "cells"):
        raise WrongUse(f"method must be walks or cells, not {short(method)}")
    check_planar(walker)
    if method == "cells":
        how: Any = {"gait": gait, "side": side, "repetitions": repetitions, "tolerance": tolerance}
        return survival_of_cells(walker, ground, WALKERS if n is None else n, key, **how)
    n = check_whole("n", WALKS if n is None else n)
    check_whole("limit", limit)
    draw_one, keys = read_ground(ground), jax.random.split(read_key(key), n)
    start = start_of_walks(walker, gait, tolerance)
    states = np.broadcast_to(start, (n, len(start)))
    walks = walk_disturbed(walker, states, draw_one, keys, limit, tolerance)
    ended = ~np.isin(walks.outcome, (Outcome.STRIDE, Outcome.UNDECIDED))
    mean, low, high = mean_life(walks.strides, ended, confidence)
    return StepsToFall(mean, low, high, walks.strides, ended, walks.outcome)

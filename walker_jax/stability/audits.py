"""Audits of black boxes: how many disturbances they survive, and the least that was met of others.

Only strides are asked for, of many starts at once and of those alone that are not yet decided, as a
simulator may take seconds for each.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Float

from walker_jax.checks import (
    WrongUse,
    check_kind,
    check_number,
    numbers,
    refuses_tracers,
)
from walker_jax.robots.black_boxes import BlackBox, answer
from walker_jax.stability.rays import bisect_nearest
from walker_jax.stability.sampling import draw_from_ball, wilson_interval

HALVINGS = 30
"""Halvings of the segments on which failures are bracketed; 2^-30 of their length is left."""


class Audit(NamedTuple):
    """The result of an audit. It tells of the samples, and with confidence of their region."""

    returned: float
    """Share of sampled disturbances from which the black box returns to its gait."""
    low: float
    """Confidence interval of that share in the whole region, at 95 %, after Wilson."""
    high: float
    least: float
    """Size of the smallest disturbance found after which it does not return; infinite if none was.
    A smaller one may exist."""
    disturbance: Float[np.ndarray, " section"]
    """That disturbance; NaN if none was found."""
    pockets: int
    """Number of sampled failures behind which, on the same ray outwards, a larger disturbance is
    survived: they lie in a pocket or a finger, not beyond one edge."""
    strides: int
    """Strides that were simulated."""


@refuses_tracers()
def audit(
    box: BlackBox,
    state: Float[ArrayLike, " section"] | Sequence[Any],
    disturbances: float | int,
    *,
    scale: Float[ArrayLike, " section"] | Sequence[Any] | None = None,
    samples: int = 1000,
    strides: int = 50,
    within: float | int = 1e-3,
    seed: int = 0,
) -> Audit:
    """Sample disturbances of a gait of a black box, and search towards the gait from failures.

    ```python
    found = wj.audit(box, gait.states[0], 0.3, samples=200)
    found.returned, found.low, found.high, found.least
    ```

    Disturbances are drawn evenly from a ball. From each failure a bisection leads along its ray
    towards the gait, to where failures begin; the least of these is returned. It is an upper bound
    of the least disturbance, never a proof: a pocket that no sample meets stays unseen. With n
    samples that all return, the share of failures is below 3.8 / n with 95 % confidence.

    **Arguments:**

    - `box`: the black box.
    - `state`: a state of its gait of period one, to which it returns.
    - `disturbances`: radius of the ball.
    - `scale`: unit of length along each coordinate, by default 1.
    - `samples`: number of disturbances.
    - `strides`: number of strides in which the box may return.
    - `within`: distance from the gait, in these units, within which it has returned.
    - `seed`: of the random numbers.
    """
    check_kind("box", box, BlackBox)
    for name, value in (("disturbances", disturbances), ("within", within)):
        check_number(name, value)
        if not 0 < value < np.inf:
            raise WrongUse(f"{name} must be positive and finite, not {value}")
    centre, size = numbers("state", state), len(box.section)
    units = np.ones(size) if scale is None else numbers("scale", scale)
    for name, values in (("state", centre), ("scale", units)):
        if values.shape != (size,) or not np.isfinite(values).all():
            raise WrongUse(f"{name} must be {size} finite numbers, not {values.tolist()}")
    if not (units > 0).all():
        raise WrongUse(f"scale must be positive, not {units.tolist()}")
    judge = Judge(box, centre, units, strides, within)
    if not judge(np.zeros((1, size)))[0]:
        raise WrongUse("state must be of a gait: from it, the black box does not stay within reach")
    drawn = disturbances * draw_from_ball(np.random.default_rng(seed), samples, size)
    back = judge(drawn)
    low, high = wilson_interval(int(back.sum()), samples, 0.95)
    sizes = np.linalg.norm(drawn[~back], axis=1)
    if not len(sizes):
        return Audit(1.0, low, high, np.inf, np.full(size, np.nan), 0, judge.count)
    rays = drawn[~back] / sizes[:, None]
    pockets = int(judge(rays * disturbances).sum())
    fails = lambda disturbances: ~judge(disturbances)
    begin = bisect_nearest(fails, rays[None], sizes[None], sizes[None], [np.inf], HALVINGS, 1)[0]
    least = begin.argmin()
    at = begin[least] * rays[least] * units
    share = float(back.mean())
    return Audit(share, low, high, float(begin[least]), at, pockets, judge.count)


class Judge:
    """Tells whether a black box returns from disturbances, given in the units of `scale`."""

    def __init__(
        self, box: BlackBox, centre: np.ndarray, units: np.ndarray, most: int, near: float
    ):
        self.box, self.centre, self.units = box, centre, units
        self.most, self.near, self.count = most, near, 0

    def __call__(self, disturbances: np.ndarray) -> np.ndarray:
        states = self.centre + disturbances * self.units
        back, going = np.zeros(len(states), bool), np.arange(len(states))
        for _ in range(self.most):
            if not len(going):
                break
            ends, made = answer(self.box, states[going])
            self.count += len(going)
            states[going] = ends
            apart = np.linalg.norm((ends - self.centre) / self.units, axis=1)
            back[going] = made & (apart < self.near)
            going = going[made & ~back[going]]
        return back

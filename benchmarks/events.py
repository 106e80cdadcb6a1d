"""Is any event of a stride missed? Strides at the default tolerance against those at 1e-15.

At a tolerance of 1e-15 a step is about half as long, so an event hidden by one step shows in the
other. Each stride has random parameters over the walker's ranges and a random start. An outcome
counts as different if no start within 1e-9 has it at 1e-15; nearer to a boundary the two may differ
by rounding. Per family: strides; the share with a heel strike; strides with another outcome; those
near a boundary; those whose states differ by more than 1e-6; the largest difference of all others;
processor time.

    family                  made      to strike, differ, near, off, largest, time
    simplest             10000000 strides   9%   0   0   0   1e-09   41 s
    spring               10000000 strides  67%   0   0   0   1e-08  105 s
    point-foot           10000000 strides   6%   0   0   0   4e-10  108 s
    powered              10000000 strides  51%   0   0   0   6e-11   78 s
    round-foot           10000000 strides  22%   0   0   0   8e-10  176 s
    upper-body           10000000 strides  12%   0   0   0   2e-10  205 s
    kneed                10000000 strides  43%   0   0   0   2e-10  576 s
    powered-point-foot   10000000 strides  42%   0   0   0   1e-09  232 s
    powered-round-foot   10000000 strides  55%   0   0   0   9e-10  309 s
    powered-upper-body   10000000 strides  53%   0   0   0   1e-10  414 s
    spatial              10000000 strides  37%   0   0   0   2e-11 1582 s
    simplest on steps    10000000 strides   7%   0   0   0   1e-08   58 s
    powered on steps     10000000 strides  50%   0   0   0   2e-09  109 s
    kneed on steps       10000000 strides  41%   0   0   0   5e-11  635 s

    python benchmarks/events.py [STRIDES [FAMILY ...]]
"""

import sys
import time
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from search_regions import FAMILIES

import walker_jax as wj
from walker_jax.execution.tiles import map_cells
from walker_jax.integrators.integrator import integrator_of
from walker_jax.walking.stride import follow_stride

jax.config.update("jax_enable_x64", True)
FINE, NEAR, AT_ONCE = 1e-15, 1e-9, 100_000
ON_STEPS, ROUGH = " on steps", 0.02
"""Names of families on rough ground, and the standard deviation of its steps, in legs."""
ALL = FAMILIES | {
    "simplest": (wj.SimplestWalker, 0, {"slope": (0.001, 0.05)}),
    "spatial": (wj.SpatialWalker, 0, {"slope": (0.06, 0.08), "hip_width": (0.28, 0.34)}),
}


def starts(kind: type, count: int, rng: np.random.Generator) -> np.ndarray:
    """About what walkers do: a step, the speed that takes the leg about upright, any swing."""
    if kind is wj.SpatialWalker:
        gait = np.array([0.098, 0.164, 0.333, -0.315, -0.047, -0.508, -0.602])
        return gait * (1 + rng.normal(0, 0.2, (count, 7)))
    theta = rng.uniform(0.02, 0.7, count)
    columns = [theta, -theta * rng.uniform(0.6, 2.0, count)]
    if len(kind.section) == 3:
        columns.append(-theta * rng.uniform(-0.5, 2.5, count))
    return np.stack(columns, axis=1)


def make_strides(walkers: Any, xs: np.ndarray, steps: np.ndarray | None, fine: bool) -> wj.Stride:
    """Strides on even ground, or each to a foothold that is higher by its step."""
    tolerance = FINE if fine else None
    if steps is None:
        return wj.strides(walkers, xs, tolerance=tolerance)
    integrator = integrator_of(xs.dtype, tolerance).in_dtype(xs.dtype)
    many = jax.tree.map(lambda leaf: np.broadcast_to(leaf, (len(xs),)), walkers)
    return map_cells(follow_stride, (many, xs, integrator, steps), (True, True, False, True))


def survey(name: str, strides: int) -> None:
    """One row of the table, and the first strides that differ."""
    kind, _, ranges = ALL[name.removesuffix(ON_STEPS)]
    rng, began = np.random.default_rng(7), time.process_time()
    differ = near = off = made = 0
    largest, examples = 0.0, []
    for _ in range(-(-strides // AT_ONCE)):
        drawn = {key: rng.uniform(bounds[0], bounds[1], AT_ONCE) for key, bounds in ranges.items()}
        walkers = jax.vmap(lambda values, kind=kind: kind(**values))(drawn)
        xs = starts(kind, AT_ONCE, rng)
        steps = rng.normal(0, ROUGH, AT_ONCE) if name.endswith(ON_STEPS) else None
        usual = make_strides(walkers, xs, steps, fine=False)
        fine = make_strides(walkers, xs, steps, fine=True)
        for i in np.flatnonzero(usual.outcome != fine.outcome):
            one = jax.tree.map(lambda leaf, i=i: leaf[i] if jnp.ndim(leaf) else leaf, walkers)
            beside = xs[i] + NEAR * rng.uniform(-1, 1, (64, xs.shape[1]))
            same = None if steps is None else np.repeat(steps[i], len(beside))
            if usual.outcome[i] in make_strides(one, beside, same, fine=True).outcome:
                near += 1
            else:
                differ += 1
                examples.append((one, xs[i].tolist(), usual.outcome[i], fine.outcome[i]))
        both = (usual.outcome == 0) & (fine.outcome == 0)
        errors = np.abs(usual.state - fine.state)[both].max(axis=1)
        off += int((errors > 1e-6).sum())
        largest = max(largest, errors[errors <= 1e-6].max())
        made += int(both.sum())
    total = AT_ONCE * -(-strides // AT_ONCE)
    print(
        f"    {name:20}{total:9} strides {made / total:4.0%} {differ:3} {near:3} {off:3}  "
        f"{largest:6.0e} {time.process_time() - began:4.0f} s",
        flush=True,
    )
    for example in examples[:3]:
        print("       ", *example)


if __name__ == "__main__":
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 1_000_000
    rough = [one + ON_STEPS for one in ("simplest", "powered", "kneed")]
    for family in sys.argv[2:] or [*ALL, *rough]:
        survey(family, count)

"""Policies: actions as a function of the state."""

from collections.abc import Callable
from functools import partial
from typing import Any, overload

import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Array, Bool, Float, Int32

from walker_jax.basins.computation import check_grid
from walker_jax.basins.volumes import grid_of
from walker_jax.checks import WrongUse, check_kind, short
from walker_jax.control.actions import Actions
from walker_jax.control.images import Task, bytes_of_cell, map_in_tiles
from walker_jax.control.least_effort import effort_of, find_least_effort
from walker_jax.control.longest_walks import choose_nodes, find_longest
from walker_jax.control.steered import Steered, steer
from walker_jax.controlled_maps import Points
from walker_jax.execution.workers import compute_here
from walker_jax.grids import Grid
from walker_jax.integrators.integrator import integrator_of
from walker_jax.stability.rough_ground import RandomDisturbance, read_ground
from walker_jax.storage.schema import check_dataset
from walker_jax.systems.outcomes import names_in
from walker_jax.systems.system import System, check_single, numbers_of
from walker_jax.walkers.model import Walker, check_planar

OBJECTIVES = "fewest-strides", "least-effort", "steps-to-fall"


@overload
def Policy(
    walker: Walker, data: xr.Dataset, objective: str = ..., *, ground: Any = ...
) -> Walker: ...


@overload
def Policy(
    walker: System, data: xr.Dataset, objective: str = ..., *, ground: Any = ...
) -> System: ...


def Policy(
    walker: System,
    data: xr.Dataset,
    objective: str = "fewest-strides",
    *,
    ground: float | RandomDisturbance | None = None,
) -> System:
    """Return the system with the best action of `viable` chosen before each stride.

    ```python
    walker = wj.PoweredWalker(slope=0.004)
    grid = wj.Grid.sheared(theta=(0, 0.4, 100), sum=(-0.04, 0.01, 125))
    policy = wj.Policy(walker, wj.viable(walker, grid, {"push_off": (0, 0.1, 17)}))
    ```

    In a cell with an action, parameters are interpolated linearly along each axis between the
    centres of that cell and of neighbours with actions, so they have derivatives. Elsewhere they
    are the system's own.

    The result is a system like any other, with the parameters of `walker`; its basin, robustness
    and other properties are computed as usual. The policy of a walker is a walker, on rough ground
    too: it acts by the section's coordinates, and does not know the disturbances to come.

    **Arguments:**

    - `walker`: the walker that `viable` was given, or one with other parameters; target, kernel and
      actions are those of `data` in both cases.
    - `data`: the result of `viable`.
    - `objective`: "fewest-strides" into the target, as in `data`; "least-effort" on the way there,
      the sum of squared deviations of parameters from the walker's own values, in units of the
      range of actions; or "steps-to-fall", the most strides, on average, until a fall on rough
      `ground`. The first two take no action in the target and outside the kernel, so a walker in
      the target converges to its attractor. The third acts in the whole kernel.
    - `ground`: as in `steps_to_fall`, which computes how long the policy lasts there.

    Raises `ValueError` for any other data set, section or objective, for "steps-to-fall" without
    `ground` or for `ground` without it, and for `ground` with a system that is not a planar walker.
    """
    check_kind("walker", walker, System)
    if isinstance(walker, Steered):
        raise WrongUse(f"walker must be one without a policy, not a {walker.label()}")
    check_single(walker)
    check_kind("data", data, xr.Dataset)
    check_dataset(data, "viability")
    section, names = names_in(data, "section"), names_in(data, "actions")
    if section != tuple(walker.section):
        raise WrongUse(
            f"data must be of the section {', '.join(walker.section)}, not of {', '.join(section)}"
        )
    for name in {*names} - {*numbers_of(walker)}:
        raise WrongUse(f"walker must have the parameter {name}, which the actions set")
    if objective not in OBJECTIVES:
        raise WrongUse(f"objective must be one of {', '.join(OBJECTIVES)}, not {short(objective)}")
    if ground is not None and objective != "steps-to-fall":
        raise WrongUse(f"ground is for the objective steps-to-fall, not for {objective}")
    data = whole_grid(data)
    values = np.stack([data[name].values for name in names], axis=-1)
    actions = Actions(tuple(names), values, -1)  # -1, as the walker's own action is not needed
    if objective == "fewest-strides":
        action = data["action"].values
    elif objective == "least-effort":
        action = least_effort_actions(walker, data, actions)
    elif ground is None:
        raise WrongUse(f"ground is required for {objective}")
    else:
        action = longest_walk_actions(check_planar(walker), data, actions, read_ground(ground))
    choose = interpolate_actions(grid_of(data), action, actions.values)
    return steer(walker, tuple(names), choose)


def whole_grid(data: xr.Dataset) -> xr.Dataset:
    """Return the data set with its axes in the order of the grid; refuse one with missing cells."""
    grid = grid_of(data)
    for name, low, high, count in zip(grid.names, grid.lower, grid.upper, grid.counts, strict=True):
        centres = low + (high - low) * (np.arange(count) + 0.5) / count
        if not np.allclose(data[name].values, centres, rtol=0, atol=1e-6 * (high - low) / count):
            raise WrongUse(f"data must have all cells along {name}, as viable returns them")
    return data.transpose(*grid.names, ...)


def least_effort_actions(
    walker: System, data: xr.Dataset, actions: Actions
) -> Int32[np.ndarray, "*shape"]:
    """Return the actions of least effort; those of `data` where no path leads into the target."""
    grid = grid_of(data)
    each = bytes_of_cell(len(actions.values), len(grid.names), bounds=False)
    check_grid(walker, grid, "cell-map", each, kind="viability")
    task = Task(walker, actions, integrator_for(data), grid, grid, bounds=False)
    points = Points(map_in_tiles(task, None, compute_here, "strides", progress=False).image)
    known, target = data["action"].values, data["capture"].values == 0
    action, _ = find_least_effort(points, target.ravel(), effort_of(walker, actions))
    action = action.reshape(grid.shape)
    return np.where(action >= 0, action, known)


def longest_walk_actions(
    walker: Walker, data: xr.Dataset, actions: Actions, ground: RandomDisturbance
) -> Int32[np.ndarray, "*shape"]:
    """Return the actions of the longest walks on rough ground."""
    grid, kernel, nodes = grid_of(data), data["viable"].values.ravel(), choose_nodes(ground)
    if not kernel.any():
        raise WrongUse("data must have viable cells for steps-to-fall: its kernel is empty")
    d = len(grid.names)
    each = (4 * d * len(actions.values) + 80 * 2**d) * len(nodes.weights)
    check_grid(walker, grid, "cell-map", each * int(kernel.sum()) // grid.size)
    action, _ = find_longest(walker, grid, actions, kernel, nodes, integrator_for(data))
    return action.reshape(grid.shape)


def integrator_for(data: xr.Dataset) -> Any:
    """Return the integrator with which a kernel was computed."""
    return integrator_of(jnp.result_type(float), float(data.attrs["tolerance"]))


def interpolate_actions(
    grid: Grid,
    action: Int32[np.ndarray, "*shape"],
    values: Float[np.ndarray, "m parameters"],
) -> Callable[[Array, Array], Array]:
    """Return a function of a point and of the system's own parameters that interpolates actions.

    It returns the values between cells with actions, and the system's own elsewhere.
    """
    return partial(values_between, grid, values[action.ravel()], action >= 0)


def values_between(
    grid: Grid,
    flat: Float[np.ndarray, "n parameters"],
    has: Bool[np.ndarray, "*shape"],
    x: Float[Array, " section"],
    own: Float[Array, " parameters"],
) -> Any:
    """Interpolate values at a point between cells that have some; elsewhere return the own ones."""
    counts, d = np.array(has.shape), has.ndim
    steps = np.append(np.cumprod(counts[:0:-1])[::-1], 1).astype(np.int32)
    to = lambda values: jnp.asarray(values, x.dtype)
    values, acting = to(flat), jnp.asarray(has.ravel())
    cell = grid.cell(x)
    u = jnp.where(cell >= 0, grid.position(x).astype(x.dtype), 0.5)
    held = (cell >= 0) & acting[cell]
    first = jnp.floor(u - 0.5)
    share = u - 0.5 - first
    total, weight = jnp.zeros_like(own), jnp.zeros((), x.dtype)
    for corner in np.ndindex(*(2,) * d):
        place = first.astype(jnp.int32) + jnp.asarray(corner, jnp.int32)
        there = jnp.clip(place, 0, jnp.asarray(counts - 1, jnp.int32))
        number = (there * steps).sum()
        near = jnp.prod(jnp.where(jnp.asarray(corner) == 1, share, 1 - share))
        near = jnp.where(acting[number], near, 0)
        total = total + near * values[number]
        weight = weight + near
    return jnp.where(held, total / jnp.where(held, weight, 1), own)

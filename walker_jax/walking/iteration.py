"""The stride function over many starts, and its iteration over many strides.

One function, `walk_on`, iterates a walk: until a failure, until it is within reach of a target, or
for a number of strides. `iterate` does that for many starts at once. Two other functions return
every state: `orbits`, for many starts, and `walk`, for one that JAX may trace.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Int

from walker_jax.checks import WrongUse, array, check_kind, check_whole, refuses_tracers
from walker_jax.execution.tiles import map_cells, route_here
from walker_jax.integrators.integrator import AnySolver, Integrator, integrator_of
from walker_jax.integrators.reductions import largest
from walker_jax.integrators.roots import Real
from walker_jax.kernels.primitive import nan_allowed, vary_together
from walker_jax.systems.angles import Turns, difference, turns_of
from walker_jax.systems.hybrid_system import HybridSystem
from walker_jax.systems.outcomes import Outcome, Stride, Walk, nan_unless
from walker_jax.systems.system import AnySystem, System
from walker_jax.systems.trees import (
    in_dtype,
    is_many,
    leaves_of,
    map_leaves,
    own_shape,
    select,
    with_static_functions,
)
from walker_jax.walkers.parameters import Parameter, described_by, with_values
from walker_jax.walking.scan import scan_strides
from walker_jax.walking.starts import as_floating, check_ground, check_size, prepare
from walker_jax.walking.stride import follow_stride

ROUNDS = 4, 16, 64
"""Number of strides in each round of an iteration; the last number holds for all later rounds. Only
unfinished walks enter the next round. Most starts on a grid around a basin fail within four
strides."""
SINGLE_STRIDES, MANY_WALKS = 32, 5000
"""On a CPU, rounds have one stride up to this many strides, while at least this many walks go on.
In a longer round the lanes of a kernel wait for the longest walk, half of the time or more. Most
walks end early, and a round of few walks takes about as long as its start."""
ROUNDS_OF_MAPS = 256, 1024
"""The same for systems that define their own maps: a stride takes less time than a call."""
ROUNDS_ON_GPU = 64, 1024
"""The same for kernels on a GPU: a warp of threads waits for its longest walk, but it takes longer
to bring the cells to the host, sort them and bring them back."""
RECORDED = 16
"""Strides whose states one call returns. More strides save no time, as a call already takes much
longer than its start, and take longer to compile."""
MAX_COMPILED_TARGETS = 32
"""Largest number of targets of a compiled walk: it takes 3 s to compile for 32, 18 s for 128. With
more targets, the host tests them after each stride."""


class Targets(NamedTuple):
    """Ends of walks: the states x with |frame (x - state)| < 1 in all coordinates."""

    states: Float[Any, "m section"]
    frames: Float[Any, "m section section"]


def distances(x: Float[Array, "..."], targets: Targets, turns: Turns = None) -> Float[Array, " m"]:
    """Return the distance of a state from each target, which is within reach below 1."""
    apart = difference(x[None], targets.states, turns)
    return largest(jnp.abs(jnp.sum(targets.frames * apart[:, None], axis=2)), axis=1)


class WalkEnd(NamedTuple):
    """The end of a walk, and its reason: arrays of JAX or of NumPy."""

    state: Float[Any, "*starts section"]
    """NaN after a failure."""
    outcome: Int[Any, "*starts"]
    """`Outcome` of the last stride; `STRIDE` if none was made."""
    strides: Int[Any, "*starts"]
    """Number of completed strides."""
    target: Int[Any, "*starts"]
    """Number of the target that was reached, the nearest of several; -1 for none."""


@refuses_tracers("within them use jax.vmap(lambda x: wj.stride(walker, x))(xs)")
def strides(
    walker: System,
    xs: Float[ArrayLike, "n coordinates"] | Sequence[Any],
    *,
    tolerance: Real | None = None,
    solver: AnySolver | None = None,
    progress: str | None = None,
) -> Stride:
    """Make one stride from each of n starts, on all devices and cores.

    ```python
    starts = [(0.2, -0.2), (0.2, -0.25), (0.3, -0.3)]
    ends = wj.strides(wj.SimplestWalker(0.004), starts)
    ends.outcome, ends.state  # arrays over the starts
    ```

    Results are NumPy arrays; other arguments are those of `stride`. The walker's parameters are
    numbers, or arrays of n, as `jax.vmap(RoundFootWalker)(slopes)` makes them: every start then has
    its own walker. It is fastest where neighbours in `xs` are close on the section. `progress` is
    the label of a progress bar, shown on a terminal only.
    """
    return for_each_start(follow_stride, walker, xs, tolerance, solver, progress)


def for_each_start(
    function: Callable,
    walker: System,
    xs: Float[ArrayLike, "n coordinates"] | Sequence[Any],
    tolerance: Real | None = None,
    solver: AnySolver | None = None,
    progress: str | None = None,
    name: str = "xs",
) -> Any:
    """Compute function(walker, x, integrator) for n starts, and one walker or n; NumPy arrays."""
    check_kind("walker", walker, System)
    xs = array(name, xs)
    if xs.dtype.kind not in "fiub":
        raise WrongUse(f"{name} must be real numbers, not of type {xs.dtype}")
    if xs.ndim != 2:
        raise WrongUse(f"{name} must have shape (n, coordinates), not {xs.shape}")
    check_size(walker, name, xs.shape, rank=2)
    dtype = xs.dtype if np.issubdtype(xs.dtype, np.floating) else float
    xs = xs.astype(jax.dtypes.canonicalize_dtype(dtype), copy=False)
    integrator = integrator_of(xs.dtype, tolerance, solver).in_dtype(xs.dtype)
    walker, many = as_arrays(walker, len(xs), xs.dtype)
    return map_cells(function, (walker, xs, integrator), (many, True, False), progress=progress)


def as_arrays(walker: AnySystem, n: int, dtype) -> tuple[AnySystem, bool]:
    """Return one walker, or n of them, with parameters of one dtype, and whether there are n.

    Parameters of another dtype would be compiled anew.
    """
    walker = with_static_functions(walker)
    many = is_many(walker)
    if many:
        check_parameter_arrays(walker, n)
        return broadcast_parameters(walker, n, dtype), many
    return in_dtype(walker, dtype), many


def broadcast_parameters(walker: AnySystem, n: int, dtype) -> AnySystem:
    """Return a walker, or n of them, with n of every parameter."""
    shape = lambda leaf, rank: (n, *own_shape(leaf, rank))
    walker = in_dtype(walker, dtype)
    return map_leaves(lambda leaf, rank: np.broadcast_to(leaf, shape(leaf, rank)), walker)


def with_parameters(
    walker: AnySystem, parameters: Sequence[str], values: Float[np.ndarray, "n parameters"]
) -> AnySystem:
    """Return n walkers, each with its own values of some parameters, unchecked."""
    walkers = broadcast_parameters(walker, len(values), values.dtype)
    return with_values(walkers, zip(parameters, values.T, strict=True))


def check_parameter_arrays(walker: System, n: int) -> None:
    """Raise `WrongUse` for parameters that are not for one walker or for n, or out of range."""
    ranks = dict(walker.array_ranks)
    for name, values in leaves_of(walker).items():
        shape, rank = np.shape(values), ranks.get(name, 0)
        if shape[: len(shape) - rank] not in ((), (n,)) or len(shape) < rank:
            one = f"an array of rank {rank}" if rank else "one number"
            raise WrongUse(f"{name} must be {one} or {n}, not of shape {shape}")
    for one in described_by(walker, Parameter):
        values = getattr(walker, one.name)
        for value in (np.min(values), np.max(values)) if np.size(values) else ():
            one._replace(shape=()).convert(value)


def walk(
    walker: System,
    x: Float[ArrayLike, " section"] | Sequence[Any],
    n: int,
    *,
    ground: Float[ArrayLike, " n"] | Sequence[Any] | None = None,
    tolerance: Real | None = None,
    solver: AnySolver | None = None,
) -> Walk:
    """Make n strides, one after the other, from x on the section.

    ```python
    walker = wj.SimplestWalker(0.004)
    made = wj.walk(walker, (0.2, -0.2), 20)
    made.states, made.outcomes, made.times  # 21 states, 20 outcomes and step times
    ```

    Other arguments are those of `stride`. `ground` makes the ground rough: it is the `step` of each
    stride, the height of its foothold above the one before, in the unit of length. States are then
    full states, just after heel strike.
    """
    check_whole("n", n)
    walker, x, integrator = prepare(walker, x, tolerance, solver)
    check_on_section(walker, x)
    if ground is None:
        with nan_allowed():
            return follow_walk(walker, x, n, integrator)
    check_ground(walker)
    steps = as_floating(ground, "ground").astype(x.dtype)
    if steps.shape != (n,):
        raise WrongUse(f"ground must be {n} heights, of shape ({n},), not {steps.shape}")
    if not isinstance(steps, Tracer) and not np.isfinite(np.asarray(steps)).all():
        raise WrongUse("ground must be finite heights")
    with nan_allowed():
        return follow_walk(walker, x, n, integrator, steps)


def check_on_section(walker: System, x: Float[Array, " coordinates"]) -> None:
    """Refuse a start that is no point of the section."""
    if x.shape != (len(walker.section),):
        raise WrongUse(f"x must be on the section {walker.section}, not of shape {x.shape}")


@partial(jax.jit, static_argnums=2)
def follow_walk(
    walker: System,
    x: Float[Array, " section"],
    n: int,
    integrator: Integrator,
    ground: Float[Array, " n"] | None = None,
) -> Walk:
    """Follow n strides; on rough ground, each onto its own height above the last."""
    walker, start = vary_together((walker, x))
    step = lambda x, _: follow_stride(walker, x, integrator)
    if isinstance(walker, HybridSystem) and ground is not None:
        x = jnp.stack(jax.tree.leaves(walker.lift(start)))
        start = nan_unless(walker.feasible(start), x)
        step = lambda x, i: follow_stride(walker, x, integrator, ground[i])
    _, made = scan_strides(step, start, n, record=lambda stride: stride)
    return Walk(jnp.concatenate([x[None], made.state]), made.outcome, made.time)


def walk_on(
    walker: System,
    x: Float[Array, " section"],
    targets: Targets,
    limit: Int[Array, ""],
    integrator: Integrator,
) -> WalkEnd:
    """Walk on until a failure, until a target is reached, or for a number of strides."""
    apart = lambda walk: distances(walk.state, targets, turns_of(walker))
    step = lambda x, _: follow_stride(walker, x, integrator)
    end, _ = scan_strides(step, x, limit, stop=lambda walk: jnp.any(apart(walk) < 1))
    away = apart(end)
    nearest = jnp.argmin(away).astype(jnp.int32)
    return WalkEnd(*end, jnp.where(jnp.any(away < 1), nearest, -1))


def iterate(
    walker: System,
    starts: Float[np.ndarray, "n section"],
    limit: int,
    integrator: Integrator,
    targets: Targets | None = None,
    *,
    progress: str | None = None,
) -> WalkEnd:
    """Run `walk_on` from each of n starts, on all devices and cores; NumPy arrays.

    The walker's parameters may be arrays of n. Walks continue in rounds, each of the unfinished
    walks. `progress` is the label of a progress bar.
    """
    (n, size), turns = starts.shape, turns_of(walker)
    walker, many = as_arrays(walker, n, starts.dtype)
    integrator = integrator.in_dtype(starts.dtype)
    end = WalkEnd(
        starts.copy(), np.zeros(n, np.int8), np.zeros(n, np.int32), np.full(n, -1, np.int32)
    )
    for_host = targets if targets and len(targets.states) > MAX_COMPILED_TARGETS else None
    if for_host:
        end.target[:] = nearest_target(starts, for_host, turns)
    compiled = pad_to_power_of_two(None if for_host else targets, size, starts.dtype)
    active, done, moves = np.flatnonzero(end.target < 0), 0, isinstance(walker, HybridSystem)
    first = (ROUNDS_ON_GPU if route_here() else ROUNDS) if moves else ROUNDS_OF_MAPS
    rounds = itertools.chain(first, itertools.repeat(first[-1]))
    in_lanes = moves and jax.local_devices()[0].platform == "cpu"
    while len(active) and done < limit:
        single = in_lanes and done < SINGLE_STRIDES and len(active) >= MANY_WALKS
        count = 1 if for_host or single else min(next(rounds), limit - done)
        here = active if len(active) < n else slice(None)  # a slice copies nothing
        part = map_cells(
            walk_on,
            (select(walker, here), end.state[here], compiled, np.int32(count), integrator),
            (many, True, False, False, False),
            progress=progress and f"{progress}: from stride {done + 1} on, {len(active)} walkers",
        )
        if for_host:
            part = part._replace(target=nearest_target(part.state, for_host, turns))
        end.state[here], end.outcome[here] = part.state, part.outcome
        end.target[here] = part.target
        end.strides[here] += part.strides
        active, done = active[(part.outcome == Outcome.STRIDE) & (part.target < 0)], done + count
    return end


def pad_to_power_of_two(targets: Targets | None, size: int, dtype) -> Targets:
    """Repeat targets up to a power of two, so that few programs are compiled.

    Of equal targets the first is the nearest. Without targets the result is one that no state
    reaches.
    """
    if targets is None or len(targets.states) == 0:
        return Targets(np.full((1, size), np.nan, dtype), np.zeros((1, size, size), dtype))
    number = np.arange(1 << (len(targets.states) - 1).bit_length()) % len(targets.states)
    return Targets(*(np.asarray(values, dtype)[number] for values in targets))


def nearest_target(
    x: Float[np.ndarray, "n section"], targets: Targets, turns: Turns = None
) -> Int[np.ndarray, " n"]:
    """Return the number of the nearest target within reach of each state; -1 for none."""
    number, smallest = np.full(len(x), -1, np.int32), np.ones(len(x), x.dtype)
    for i, (state, frame) in enumerate(zip(*targets, strict=True)):
        distance = np.abs(difference(x, state, turns) @ frame.T).max(axis=1)
        number[distance < smallest], smallest = i, np.fmin(distance, smallest)
    return number


def orbits(
    walker: System,
    starts: Float[np.ndarray, "n section"],
    count: int,
    integrator: Integrator,
) -> tuple[Float[np.ndarray, "n states section"], Int[np.ndarray, " n"]]:
    """Return all states of `count` strides from each of n starts, and the last outcomes.

    States after a failure are NaN. The walker's parameters may be arrays of n.
    """
    n, size = starts.shape
    walker, many = as_arrays(walker, n, starts.dtype)
    integrator = integrator.in_dtype(starts.dtype)
    states = np.full((n, count + 1, size), np.nan, starts.dtype)
    states[:, 0], outcome, active = starts, np.zeros(n, np.int8), np.arange(n)
    for done in range(0, count, RECORDED):
        if len(active) == 0:
            break
        more = min(RECORDED, count - done)
        some = select(walker, active), states[active, done], np.int32(more)
        part, ends, _ = map_cells(record_walk, (*some, integrator), (many, True, False, False))
        states[active, done + 1 : done + 1 + more], outcome[active] = part[:, :more], ends
        active = active[ends == Outcome.STRIDE]
    return states, outcome


def record_walk(
    walker: System, x: Float[Array, " section"], limit: Int[Array, ""], integrator: Integrator
) -> tuple[Float[Array, "strides section"], Int[Array, ""], Float[Array, " strides"]]:
    """Return the states of `RECORDED` strides, NaN from the end on, the last outcome, and times."""

    def step(known: tuple, number: Int[Array, ""]) -> Stride:
        x, states, times = known
        made = follow_stride(walker, x, integrator)
        states, times = states.at[number].set(made.state), times.at[number].set(made.time)
        return made._replace(state=(made.state, states, times))

    states = jnp.full((RECORDED, *x.shape), jnp.nan, x.dtype)
    end, _ = scan_strides(step, (x, states, states[:, 0]), limit)
    return end.state[1], end.outcome, end.state[2]

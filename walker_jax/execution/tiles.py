"""A function of one cell over millions of them: kernels, tiles, devices, cores, progress.

On a CPU a function becomes a kernel, which works on a few cells at once (`kernels`); on a GPU too,
where kernels run there. XLA maps any other function over tiles of cells, and any function on other
accelerators. On a CPU a tile is small enough to stay in the cache, and ends when its own slowest
cell does; on a GPU it is large enough to fill the card. Either way the results are the same to the
last bit, however many cores or devices share the work.
"""

import functools
import math
import os
from collections.abc import Callable
from concurrent.futures import CancelledError, ThreadPoolExecutor
from contextvars import ContextVar
from threading import Event
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.sharding import Mesh
from jax.sharding import PartitionSpec as P
from jaxtyping import Int, PyTree

from walker_jax.checks import WrongUse
from walker_jax.execution.progress import bar
from walker_jax.kernels.gpu import Route, ptx_for, route_in_use
from walker_jax.kernels.primitive import kernel_p
from walker_jax.kernels.program import (
    MAX_PROGRAMS,
    Program,
    apply_settings,
    current_settings,
    program_of,
)
from walker_jax.kernels.program_cache import user_code_states

# Cells in a tile, and tiles in a call: a call should take much longer than it takes to make.
CALL_SHAPES = {"cpu": (1024, 8), "gpu": (2**17, 1), "tpu": (2**17, 1)}
SMALL_CALL_SHAPE = (64, 8)
"""The same, where there are few cells for a CPU."""
KERNEL_CALL_CELLS = (512, 2**15)
"""Fewest and most cells that a core processes by a kernel without a break."""
GPU_CALL_CELLS = (2**15, 2**20)
"""The same for a GPU. An H100 processes 33,792 at once, so fewer cells take as long."""
GPU_SQUARE = 64
"""Cells that a GPU computes in two warps, each of which ends with its slowest cell."""


# A library may set these for its own calls. 512-bit vectors where the processor has them; elsewhere
# they change little: strides and their Jacobians take 0.94 to 1.01 times as long by jax 0.10, 0.12.
# And the older of XLA's two ways to emit a fusion, which jax 0.12 no longer has: by jax 0.10 it
# takes 1.1 to 1.2 times as long for these two, but it does not repeat common parts of derivatives
# of derivatives, or of long expressions, which are then a hundred times as fast.
COMPILER_OPTIONS = {
    "cpu": {"xla_cpu_prefer_vector_width": 512, "xla_cpu_use_fusion_emitters": False}
}


def map_cells(
    function: Callable[..., PyTree],
    args: tuple[PyTree, ...],
    mapped: tuple[bool, ...] = (False, True),
    *,
    progress: str | None = None,
) -> PyTree[np.ndarray]:
    """Compute function(*args) for every cell, on all devices and all cores of a CPU.

    An interrupt waits for the cells in progress. Neighbours are processed together, so cells that
    take equally long should be neighbours.

    **Arguments:**

    - `function`: of one cell. It is compiled once for a function and for shapes, so give one
      defined at the top of a module, not a new closure each time.
    - `args`: PyTrees of arrays.
    - `mapped`: for each of them, whether it has the cells along the first axis of its arrays, any
      number of them; others are the same for all cells. By default the second of two.
    - `progress`: label of a progress bar, shown on a terminal only; not for up to 512 cells that a
      kernel computes, on one core.

    **Returns** a PyTree of NumPy arrays with the cells along their first axis.
    """
    args = tuple(
        jax.tree.map(np.asarray, arg) if each else arg
        for arg, each in zip(args, mapped, strict=True)
    )
    pairs = list(zip(args, mapped, strict=True))
    shared = [arg for arg, each in pairs if not each]
    cells = [arg for arg, each in pairs if each]
    sizes = {leaf.shape[0] for leaf in jax.tree.leaves(cells)}
    if len(sizes) != 1:
        raise WrongUse(f"args must hold cells in arrays of one length, not of {sorted(sizes)}")
    (n,) = sizes
    if any(stop.is_set() for stop in stopping.get()):
        raise CancelledError
    devices = jax.local_devices()
    platform, route = devices[0].platform, route_here()
    if platform == "cpu" or route:
        operands, structure = jax.tree.flatten(args)
        each = [each for arg, each in pairs for _ in jax.tree.leaves(arg)]
        avals = [abstract_value(x, one) for x, one in zip(operands, each, strict=True)]
        program, results = program_of(function, structure, avals)
        found = None
        if route and ptx_for(program, each, route):
            found = run_on_gpus(program, operands, each, n, progress)
        elif not route and program.compiled is not None:
            found = run_kernel(program, operands, each, n, progress)
        if found is not None:
            return jax.tree.unflatten(results, found)
    few = platform == "cpu" and n <= math.prod(SMALL_CALL_SHAPE)
    tile, tiles = SMALL_CALL_SHAPE if few else CALL_SHAPES.get(platform, CALL_SHAPES["gpu"])
    call = tile * tiles * len(devices)
    states = user_code_states(function, jax.tree.structure(args))
    run = compile_call(function, states, mapped, platform, tile, tiles)

    def work(start: int, stop: int) -> PyTree[np.ndarray]:
        """Compute at most one call, in which each device has an equal share of the cells."""
        chunk = jax.tree.map(lambda leaf: pad(leaf[start:stop], call), cells)
        left = stop - start - tile * tiles * np.arange(len(devices))
        done = run(shared, chunk, -(-np.clip(left, 0, tile * tiles) // tile))
        return jax.tree.map(lambda leaf: np.array(leaf[: stop - start]), jax.device_get(done))

    if n <= call and progress is None:  # needs no threads
        return work(0, n)
    first = work(0, 0)  # compiles only, without any tile
    results = jax.tree.map(lambda leaf: np.empty((n, *leaf.shape[1:]), leaf.dtype), first)

    def put(start: int, stop: int) -> None:
        for result, leaf in zip(*map(jax.tree.leaves, (results, work(start, stop))), strict=True):
            result[start:stop] = leaf

    # Two calls at a time for an accelerator, so that it need not wait for the host.
    run_in_threads(put, n, call, cores() if platform == "cpu" else 2, progress)
    return results


def run_in_threads(
    work: Callable[[int, int], None], n: int, call: int, workers: int, progress: str | None
) -> None:
    """Call work(start, stop) for n cells, `call` of them at a time, in as many threads."""
    starts = range(0, n, call)
    settings = current_settings()

    def work_as_here(start: int, stop: int) -> None:
        with apply_settings(settings):
            work(start, stop)

    with (
        bar(progress or "", progress is not None, n) as update,
        ThreadPoolExecutor(workers) as pool,
    ):
        pending = [pool.submit(work_as_here, start, min(start + call, n)) for start in starts]
        try:
            for start, future in zip(starts, pending, strict=True):
                future.result()
                update(min(start + call, n))
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise


core_limit: int | None = None


class Stop(NamedTuple):
    """A reason to stop, asked before each kernel; an `Event` is another."""

    is_set: Callable[[], bool]


stopping: ContextVar[tuple[Event | Stop, ...]] = ContextVar("stopping", default=())
"""Any of these events stops the computation of this thread, before its next kernel."""


def limit_cores(most: int | None) -> None:
    """Limit the cores of a CPU that `map_cells` uses, in this process."""
    global core_limit
    core_limit = most


def cores() -> int:
    """Return the number of processor cores that this process may use."""
    number = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return min(number or 1, core_limit or number or 1)


def run_kernel(
    program: Program, operands: list, mapped: list[bool], n: int, progress: str | None
) -> list[np.ndarray]:
    """Compute the cells' results by a kernel, on all cores."""
    assert program.compiled is not None
    run, results = program.compiled.bind(operands, mapped, n)
    workers = cores()
    least, most = KERNEL_CALL_CELLS
    # Several calls for each core, so that all end at about the same time.
    call = min(most, max(least, -(-n // (4 * workers))))
    if n <= least:  # needs neither threads nor a bar
        run(0, n)
    else:
        run_in_threads(run, n, call, workers, progress)
    return results


def route_here() -> Route | None:
    """Return the route by which kernels run on the devices of this process, if these are GPUs."""
    return route_in_use() if jax.local_devices()[0].platform == "gpu" else None


def run_on_gpus(
    program: Program, operands: list, mapped: list[bool], n: int, progress: str | None
) -> list[np.ndarray]:
    """Compute the cells' results by a kernel, on all GPUs, in calls of a power of two of cells."""
    least, most = GPU_CALL_CELLS
    devices = len(jax.local_devices())
    call = devices * min(most, max(least, 1 << (-(-n // devices) - 1).bit_length()))
    run = compile_kernel_call(program, tuple(map(int, mapped)))
    given = [np.asarray(x, aval.dtype) for x, aval in zip(operands, program.operands, strict=True)]
    results = [np.empty((n, *aval.shape), aval.dtype) for aval in program.results]

    def put(start: int, stop: int) -> None:
        pairs = zip(given, mapped, strict=True)
        found = run(*(pad(x[start:stop], call) if each else x for x, each in pairs))
        for result, part in zip(results, jax.device_get(found), strict=True):
            result[start:stop] = part[: stop - start]

    if 0 < n <= call and progress is None:
        put(0, n)
    else:
        run_in_threads(put, n, call, 2, progress)  # two at a time, as for XLA's calls
    return results


@functools.lru_cache(MAX_PROGRAMS)
def compile_kernel_call(program: Program, mapped: tuple[int, ...]) -> Callable:
    """Return the jitted function of the arrays of a call, whose cells the GPUs share equally."""
    mesh, each = Mesh(np.array(jax.local_devices()), ("devices",)), P("devices")
    specs = tuple(each if one else P() for one in mapped)
    run = lambda *operands: kernel_p.bind(*operands, program=program, mapped=mapped)
    return jax.jit(jax.shard_map(run, mesh=mesh, in_specs=specs, out_specs=each, check_vma=False))


def abstract_value(leaf: Any, each: bool) -> jax.ShapeDtypeStruct:
    """Return the type of a leaf, and its shape in one cell."""
    plain = type(leaf) in (bool, int, float, complex)
    dtype = jax.dtypes.canonicalize_dtype(
        type(leaf) if plain else leaf.dtype, allow_extended_dtype=True
    )
    weak = plain or getattr(leaf, "weak_type", False)
    return jax.ShapeDtypeStruct(
        np.shape(leaf)[1:] if each else np.shape(leaf), dtype, weak_type=weak
    )


def pad(values: np.ndarray, size: int) -> np.ndarray:
    """Pad values to `size` with copies of the last, which no tile waits for."""
    if len(values) == size:
        return values
    last = values[-1:] if len(values) else np.zeros_like(values, shape=(1, *values.shape[1:]))
    return np.concatenate([values, np.repeat(last, size - len(values), axis=0)])


@functools.lru_cache(MAX_PROGRAMS)
def compile_call(
    function: Callable,
    states: tuple,
    mapped: tuple[bool, ...],
    platform: str,
    tile: int,
    tiles: int,
) -> Callable:
    """Return the jitted function of (shared, cells of one call, how many tiles each device does).

    There is one for each of the `states` of the code that it runs.
    """

    def run(shared, cells, count):
        blocks = jax.tree.map(lambda leaf: leaf.reshape(tiles, tile, *leaf.shape[1:]), cells)

        def of_cell(cell):
            parts = {True: iter(cell), False: iter(shared)}
            return function(*(next(parts[each]) for each in mapped))

        one = jax.vmap(of_cell)
        like = jax.eval_shape(one, jax.tree.map(lambda leaf: leaf[0], blocks))
        empty = jax.tree.map(lambda leaf: jnp.zeros((tiles, *leaf.shape), leaf.dtype), like)

        def advance(i, results):
            result = one(jax.tree.map(lambda leaf: leaf[i], blocks))
            return jax.tree.map(lambda all, new: all.at[i].set(new), results, result)

        results = lax.fori_loop(0, count[0], advance, empty)
        return jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), results)

    # One program for all devices, which are independent of each other.
    mesh, each = Mesh(np.array(jax.local_devices()), ("devices",)), P("devices")
    shares = jax.shard_map(
        run, mesh=mesh, in_specs=(P(), each, each), out_specs=each, check_vma=False
    )
    return jax.jit(shares, compiler_options=options_for(platform))


def options_for(platform: str) -> dict:
    """Return the compiler's options for a platform, without those that this XLA lacks."""
    options = COMPILER_OPTIONS.get(platform, {}).items()
    return {name: value for name, value in options if has_option(name, value)}


@functools.cache
def has_option(name: str, value: Any) -> bool:
    """Return whether XLA accepts an option, by a trial: an unknown one stops the compilation."""
    try:
        jax.jit(lambda: 0, compiler_options={name: value}).lower().compile()
    except jax.errors.JaxRuntimeError:
        return False
    return True


def order_of_cells(shape: tuple[int, ...]) -> Int[np.ndarray, " n"]:
    """Return flat indices of a grid's cells, in the order in which to give them to `map_cells`.

    Neighbours are together in a unit that waits for its slowest cell: a tile, or two warps of
    threads.
    """
    if jax.local_devices()[0].platform != "cpu":
        return compact_order(shape, GPU_SQUARE if route_here() else CALL_SHAPES["gpu"][0])
    size = math.prod(shape)
    return np.arange(size, dtype=np.int32 if size < 2**31 else np.int64)


def compact_order(
    shape: tuple[int, ...], tile: int = CALL_SHAPES["gpu"][0]
) -> Int[np.ndarray, " n"]:
    """Return flat indices of a grid's cells, in an order that keeps a tile's cells close together.

    The grid is cut into cubes of about `tile` cells, one after the other.
    """
    side = max(1, round(tile ** (1 / len(shape))))
    sides = [min(side, count) for count in shape]
    padding = [(0, -count % side) for count, side in zip(shape, sides, strict=True)]
    size = int(np.prod(shape))
    indices = np.arange(size, dtype=np.int32 if size < 2**31 else np.int64).reshape(shape)
    indices = np.pad(indices, padding, constant_values=-1)
    split = [
        part
        for count, side in zip(indices.shape, sides, strict=True)
        for part in (count // side, side)
    ]
    axes = [*range(0, 2 * len(shape), 2), *range(1, 2 * len(shape), 2)]
    indices = indices.reshape(split).transpose(axes).ravel()
    return indices[indices >= 0]

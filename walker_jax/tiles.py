"""A function of one cell over millions of them: tiles, devices, cores, progress.

Cells are worked through in tiles. On a CPU a tile is small enough to stay in the cache, and ends
when its own slowest cell does, whatever the others need; on a GPU it is large enough to fill the
card. A tile is the same on every machine of a kind, so the results are too, to the last bit,
however many cores or devices share the work.
"""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Int, PyTree
from rich.console import Console
from rich.progress import Progress

# Cells in a tile, and tiles in a call: a call should take much longer than it takes to make.
TILE = {"cpu": (1024, 8), "gpu": (2**17, 1), "tpu": (2**17, 1)}

# A library may set these for its own calls: 512-bit vectors where the processor has them.
COMPILER_OPTIONS = {"cpu": {"xla_cpu_prefer_vector_width": 512}}
# The older of XLA's two ways to emit a fusion: a few per cent slower, but it does not repeat what
# derivatives of derivatives have in common, which makes them a hundred times as fast.
NESTED_OPTIONS = {"cpu": {**COMPILER_OPTIONS["cpu"], "xla_cpu_use_fusion_emitters": False}}


def over_cells(
    function: Callable[[Any, PyTree], PyTree],
    shared: PyTree,
    cells: PyTree,
    *,
    progress: str | None = None,
    tile: int | None = None,
    nested: bool = False,
) -> PyTree[np.ndarray]:
    """function(shared, cell) for every cell, on all devices of the process and all cores of a CPU.

    **Arguments:**

    - `function`: of what the cells share and of one cell. It is compiled once for a function and
      for shapes, so give one defined at the top of a module, not a new closure each time.
    - `shared`: a PyTree, the same for all cells.
    - `cells`: a PyTree of arrays with the cells along their first axis, any number of them.
      Neighbours share a tile: cells that take equally long should be neighbours, as
      `compact_order` makes them.
    - `progress`: what to call the work in a progress bar, shown on a terminal only.
    - `tile`: cells in a call on a CPU, where the usual number is too many: for few cells, or where
      each takes long or needs much memory.
    - `nested`: whether the function holds derivatives of derivatives.

    **Returns** a PyTree of NumPy arrays with the cells along their first axis.
    """
    cells = jax.tree.map(np.asarray, cells)
    sizes = {leaf.shape[0] for leaf in jax.tree.leaves(cells)}
    if len(sizes) != 1:
        raise ValueError(f"cells must hold arrays of one length, not of {sorted(sizes)}")
    (n,) = sizes
    devices = jax.local_devices()
    platform = devices[0].platform
    size, tiles = TILE.get(platform, TILE["gpu"])
    tile, tiles = (tile, 1) if tile and platform == "cpu" else (size, tiles)
    call = tile * tiles
    run = _compiled(function, platform, tile, tiles, nested)
    if 0 < n <= call and progress is None:  # one call, and no threads for it
        chunk = jax.tree.map(lambda leaf: _filled(leaf, call), cells)
        done = run(shared, chunk, -(-n // tile))
        return jax.tree.map(lambda leaf: np.array(leaf[:n]), jax.device_get(done))

    first = jax.tree.map(lambda leaf: np.zeros((call, *leaf.shape[1:]), leaf.dtype), cells)
    shares = [(device, jax.device_put(shared, device)) for device in devices]
    # Compiles on every device, and works through no tile.
    like = [run(share, jax.device_put(first, device), 0) for device, share in shares]
    results = jax.tree.map(lambda leaf: np.empty((n, *leaf.shape[1:]), leaf.dtype), like[0])

    def work(start: int, worker: int):
        device, share = shares[worker % len(shares)]
        count = min(call, n - start)
        chunk = jax.tree.map(lambda leaf: _filled(leaf[start : start + count], call), cells)
        done = run(share, jax.device_put(chunk, device), -(-count // tile))
        for result, leaf in zip(jax.tree.leaves(results), jax.tree.leaves(done), strict=True):
            result[start : start + count] = np.asarray(leaf)[:count]

    starts = range(0, n, call)
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    workers = max(len(devices), cores or 1) if platform == "cpu" else len(devices)
    console = Console(stderr=True)
    hidden = progress is None or not console.is_terminal
    with (
        Progress(console=console, disable=hidden, transient=True) as bar,
        ThreadPoolExecutor(workers) as pool,
    ):
        task = bar.add_task(progress or "", total=n)
        pending = [pool.submit(work, start, i) for i, start in enumerate(starts)]
        try:
            for start, future in zip(starts, pending, strict=True):
                future.result()
                bar.update(task, completed=min(start + call, n))
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
    return results


def _filled(values: np.ndarray, size: int) -> np.ndarray:
    """values made up to `size` with copies of the last, which no tile waits for."""
    missing = size - len(values)
    return np.concatenate([values, np.repeat(values[-1:], missing, axis=0)]) if missing else values


_cache: dict = {}


def _compiled(function: Callable, platform: str, tile: int, tiles: int, nested: bool) -> Callable:
    """The jitted function of (shared, cells of one call, number of tiles to work through)."""
    key = function, platform, tile, tiles, nested
    if key not in _cache:

        def run(shared, cells, count):
            blocks = jax.tree.map(lambda leaf: leaf.reshape(tiles, tile, *leaf.shape[1:]), cells)
            one = jax.vmap(partial(function, shared))
            like = jax.eval_shape(one, jax.tree.map(lambda leaf: leaf[0], blocks))
            empty = jax.tree.map(lambda leaf: jnp.zeros((tiles, *leaf.shape), leaf.dtype), like)

            def advance(i, results):
                result = one(jax.tree.map(lambda leaf: leaf[i], blocks))
                return jax.tree.map(lambda all, new: all.at[i].set(new), results, result)

            results = lax.fori_loop(0, count, advance, empty)
            return jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), results)

        options = NESTED_OPTIONS if nested else COMPILER_OPTIONS
        _cache[key] = jax.jit(run, compiler_options=options.get(platform))
    return _cache[key]


def compact_order(shape: tuple[int, ...], tile: int = TILE["cpu"][0]) -> Int[np.ndarray, " n"]:
    """Flat indices of a grid's cells, in an order in which a tile's cells lie close together.

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

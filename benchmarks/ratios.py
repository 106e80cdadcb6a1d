"""Ways to compute the same thing, timed in turn: for the benchmarks that have peers in one run."""

import importlib
import os
import time
from collections.abc import Callable
from importlib.metadata import version
from typing import Any

import jax
import numpy as np


def optional(name: str) -> Any:
    """Return a module, or None where it is not installed."""
    try:
        return importlib.import_module(name)
    except ImportError:
        return None


def versions(*names: str) -> str:
    """Return the number of cores, and the versions of those modules that are installed."""
    there = (name for name in ("jax", *names) if optional(name))
    return f"{os.cpu_count()} cores; " + ", ".join(f"{name} {version(name)}" for name in there)


def timed(run: Callable) -> tuple[Any, float, float]:
    """Return the result of a call, its seconds, and those of all processors together."""
    begin, processor = time.perf_counter(), time.process_time()
    result = jax.block_until_ready(run())
    return result, time.perf_counter() - begin, time.process_time() - processor


def compare(
    ways: dict[str, Callable],
    each: dict[str, int],
    repeats: int,
    unit: str = "us",
    notes: Callable[[Any], str] = lambda result: "",
) -> dict[str, Any]:
    """Call each way once, then `repeats` times in turn; print a table, and return the results.

    `each` is by how many the processor time of a way is divided. `times as long` is the ratio of
    these times to that of the first way in the same repeat: median, least and greatest. `notes` is
    printed beside.
    """
    results, first = {}, {}
    for name, run in ways.items():
        results[name], first[name], _ = timed(run)
    rounds = [{name: timed(run)[2] for name, run in ways.items()} for _ in range(repeats)]
    base = np.array([times[next(iter(ways))] for times in rounds]) / each[next(iter(ways))]
    print(f"{'':34}{unit + ' each':>11}{'times as long':>20}{'first':>8}")
    for name in ways:
        seconds = np.array([times[name] for times in rounds]) / each[name]
        low, middle, high = np.quantile(seconds / base, [0, 0.5, 1])
        scaled = np.median(seconds) * {"us": 1e6, "ms": 1e3}[unit]
        print(f"{name:34}{scaled:11.4g}{f'{middle:.3g} ({low:.3g}-{high:.3g})':>20}", end="")
        print(f"{first[name]:6.1f} s{notes(results[name])}", flush=True)
    return results

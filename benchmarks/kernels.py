"""How fast are kernels of functions that have nothing to do with walking, beside JAX and Numba?

The functions of docs/kernels.md: three that call diffrax, for oscillators, projectiles and balls
(events, and a loop of them); an ensemble of oscillators with adaptive steps by hand, Kepler's
equation by Newton's iteration, and a fractal of Newton's iteration. `vmap` is
`jax.jit(jax.vmap(f))` of the same function, and `batches` is `jax.lax.map` with batches of a
thousand cells, so that fewer wait for the slowest. Numba's loops are written by hand, number by
number, and run on all cores. Each is called once before, with no code on disk (`first`, in
seconds); repeats are interleaved. `times as long` is the ratio to the kernel in the same repeat
(median, least and greatest), `processor` that of processor times. `error` is the largest difference
from the kernel's results. JAX solves the equations of the fractal by a call of LAPACK for each
cell; `Cramer` is a function without it.

The answer, by processor times: where cells differ much, as in the ensemble, a kernel takes a
seventh of the time of `vmap`, half of that of batches, and a fifth of Numba's, whose loops work on
one cell at a time. If sines and cosines take most of the time, as for Kepler's equation, the four
are alike: kernels call the C library for one cell after the other, and XLA's sines are faster.
LAPACK's calls for 2 x 2 matrices make `vmap` of the fractal 170 times as slow as a kernel.

The solves by diffrax take a kernel a 10th to a 37th of the processor time of `vmap`, and a sixth
or less of that of batches. They are of another day, when others used the machine: trust
`processor`.

    2 cores; jax 0.10.2, Numba 0.68.1; 3 repeats
                               cells       ms       times as long  processor   first    error
    oscillators, kernel       10,000    855.3             1 (1-1)          1   11.65    0e+00
    oscillators, vmap         10,000  11203.3    15.9 (6.71-16.6)       37.1   26.93    2e+01
    oscillators, batches      10,000   6300.9    7.97 (3.52-8.94)       6.63   24.49    2e+01
    projectiles, kernel       10,000     57.6             1 (1-1)          1   10.32    0e+00
    projectiles, vmap         10,000   1821.6     31.6 (30.5-278)       10.5   38.13    7e-14
    projectiles, batches      10,000   1003.0     16.6 (11.9-201)       5.85   76.49    7e-14
    balls, kernel              2,000    266.8             1 (1-1)          1   24.33    0e+00
    balls, vmap                2,000   4314.8    10.4 (4.77-47.8)       34.9   60.84    2e-11
    balls, batches             2,000    787.3     5.03 (1.9-68.8)       37.9   46.57    2e-11

(The numbers of steps of an oscillator, up to 3228, differ by 17.)

    2 cores; jax 0.10.2, Numba 0.68.1; 7 repeats
                               cells       ms       times as long  processor   first    error
    ensemble, kernel          10,000    526.3             1 (1-1)          1    0.68    0e+00
    ensemble, vmap            10,000   2713.6    6.37 (3.81-8.09)       6.94    2.88    2e-11
    ensemble, batches         10,000    933.3    2.03 (1.33-2.84)       2.09    1.45    2e-11
    ensemble, Numba           10,000   3034.8    6.58 (4.48-7.41)       5.35    4.08    2e-11
    root, kernel           1,000,000    189.0             1 (1-1)          1    0.44    0e+00
    root, vmap             1,000,000    343.3     1.99 (1.2-2.42)       1.88    1.55    0e+00
    root, batches          1,000,000    184.0   0.947 (0.639-1.8)       0.93    0.72    0e+00
    root, Numba            1,000,000    233.8   1.19 (0.868-1.71)       1.23    1.01    1e-15
    fractal, kernel          250,000     15.2             1 (1-1)          1    0.96    0e+00
    fractal, vmap            250,000   3623.3       238 (149-450)        171    5.07    0e+00
    fractal, batches         250,000   2329.8      211 (82.3-265)       98.3    4.46    0e+00
    fractal, vmap, Cramer    250,000     54.9    3.68 (2.52-9.04)       3.48    0.50    0e+00
    fractal, Numba           250,000     40.8    2.69 (1.04-4.66)        1.8    0.80    0e+00
"""

import argparse
import ast
import importlib
import os
import re
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

os.environ["WALKER_JAX_CACHE_DIR"] = ""  # which is read at the first kernel

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

try:
    numba = importlib.import_module("numba")
except ImportError:
    numba = None

PAGE = Path(__file__).parent.parent / "docs" / "kernels.md"
BY_NUMBA = """
import math

import numpy as np
from numba import njit, prange


@njit(error_model="numpy")
def oscillate(stiffness, until, tolerance):
    t, x, v, h, steps = 0.0, 2.0, 0.0, 1e-3, 0
    while t < until and steps < 100_000:
        h = min(h, until - t)
        x1, v1 = v, stiffness * (1 - x * x) * v - x
        xa, va = x + h * x1 / 2, v + h * v1 / 2
        x2, v2 = va, stiffness * (1 - xa * xa) * va - xa
        xb, vb = x + h * 3 / 4 * x2, v + h * 3 / 4 * v2
        x3, v3 = vb, stiffness * (1 - xb * xb) * vb - xb
        xn = x + h * (2 * x1 + 3 * x2 + 4 * x3) / 9
        vn = v + h * (2 * v1 + 3 * v2 + 4 * v3) / 9
        x4, v4 = vn, stiffness * (1 - xn * xn) * vn - xn
        ex = h * (-5 * x1 + 6 * x2 + 8 * x3 - 9 * x4) / 72
        ev = h * (-5 * v1 + 6 * v2 + 8 * v3 - 9 * v4) / 72
        size = max(abs(ex), abs(ev)) / tolerance
        if size <= 1:
            t, x, v = t + h, xn, vn
        h *= min(max(0.9 * max(size, 1e-10) ** (-1 / 3), 0.2), 5.0)
        steps += 1
    return x, v, steps


@njit(parallel=True, error_model="numpy")
def ensemble(stiffness):
    ends, counts = np.empty((len(stiffness), 2)), np.empty(len(stiffness), np.int64)
    for i in prange(len(stiffness)):
        ends[i, 0], ends[i, 1], counts[i] = oscillate(stiffness[i], 10.0, 1e-8)
    return ends, counts


@njit(parallel=True, error_model="numpy")
def root(mean, eccentricity):
    result = np.empty_like(mean)
    for i in prange(len(mean)):
        found, change, turns = math.pi, math.inf, 0
        while abs(change) > 1e-14 and turns < 100:
            miss = found - eccentricity[i] * math.sin(found) - mean[i]
            change = miss / (1 - eccentricity[i] * math.cos(found))
            found -= change
            turns += 1
        result[i] = found
    return (result,)


@njit(parallel=True, error_model="numpy")
def fractal(starts):
    roots, counts = np.empty(len(starts), np.int64), np.empty(len(starts), np.int64)
    for i in prange(len(starts)):
        x, y, turns = starts[i, 0], starts[i, 1], 0
        while turns < 100:
            u, v = x**3 - 3 * x * y**2 - 1, 3 * x**2 * y - y**3
            if u * u + v * v <= 1e-20:
                break
            a, b = 3 * x**2 - 3 * y**2, -6 * x * y
            size = a * a + b * b
            x, y = x - (a * u - b * v) / size, y - (a * v + b * u) / size
            turns += 1
        roots[i] = 0 if x > 0 else (1 if y > 0 else 2)
        counts[i] = turns
    return roots, counts
"""


def functions() -> dict[str, Callable]:
    """The kernels of the page, of which none has been called, by the titles of their programs."""
    found = {}
    for title, source in re.findall(r"<!-- (.*?) -->\n```python\n(.*?)```", PAGE.read_text(), re.S):
        kinds = ast.Import, ast.ImportFrom, ast.FunctionDef, ast.Assign
        body: list[ast.stmt] = [one for one in ast.parse(source).body if isinstance(one, kinds)]
        (*_, function) = [one for one in body if isinstance(one, ast.FunctionDef)]
        names: dict[str, Any] = {"__name__": "page"}
        before = body[: body.index(function) + 1]
        exec(compile(ast.Module(before, []), PAGE.name, "exec"), names)
        found[title.removeprefix("an ").removeprefix("a ")] = names[function.name]
    del found["reason"]
    return found


def newton_by_cramer(start):
    """The function of the fractal, without a call of LAPACK for each cell."""

    def cube(x, y):
        return x**3 - 3 * x * y**2 - 1, 3 * x**2 * y - y**3

    def going(state):
        x, y, turns = state
        u, v = cube(x, y)
        return (u * u + v * v > 1e-20) & (turns < 100)

    def step(state):
        x, y, turns = state
        u, v = cube(x, y)
        a, b = 3 * x**2 - 3 * y**2, -6 * x * y
        size = a * a + b * b
        return x - (a * u - b * v) / size, y - (a * v + b * u) / size, turns + 1

    x, y, turns = lax.while_loop(going, step, (*start, 0))
    return jnp.where(x > 0, 0, jnp.where(y > 0, 1, 2)), turns


def cells(name: str) -> tuple[np.ndarray, ...]:
    """The arguments of all cells."""
    if name == "oscillators":
        return (np.geomspace(0.01, 300.0, 10_000),)
    if name == "projectiles":
        return np.linspace(0.1, 1.5, 10_000), np.full(10_000, 0.5)
    if name == "balls":
        return np.linspace(0.1, 2.0, 2000), np.tile(np.linspace(0.3, 0.9, 10), 200)
    if name == "ensemble":
        return (np.linspace(0.0, 20.0, 10_000),)
    if name == "root":
        mesh = np.meshgrid(np.linspace(0.01, 3, 1000), np.linspace(0, 0.99, 1000))
        return mesh[0].ravel(), mesh[1].ravel()
    side = np.linspace(-1.5, 1.5, 500)
    return (np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2),)


def ways(name: str, function: Callable, by_hand: Callable | None) -> dict[str, Callable]:
    """The function for all cells, in each way."""
    plain = vars(function)["of_one_cell"]
    mapped = {"ensemble": lambda f: lambda one: f(one, 10.0)}.get(name, lambda f: f)
    each, alone = mapped(function), mapped(plain)
    batches = lambda *xs: lax.map(lambda x: alone(*x), xs, batch_size=1000)
    found = {
        "kernel": jax.jit(jax.vmap(each)),
        "vmap": jax.jit(jax.vmap(alone)),
        "batches": jax.jit(batches),
    }
    if name == "fractal":
        found["vmap, Cramer"] = jax.jit(jax.vmap(newton_by_cramer))
    return found | ({"Numba": by_hand} if by_hand else {})


def difference(one: Any, other: Any) -> float:
    """The largest difference of numbers."""
    pairs = zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True)
    return max(float(np.abs(np.asarray(a, float) - np.asarray(b, float)).max()) for a, b in pairs)


def main():
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--repeats", type=int, default=7)
    args = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    by_hand: dict[str, Any] = {}
    if numba is not None:
        exec(BY_NUMBA, by_hand)
    versions = f"jax {jax.__version__}, Numba {getattr(numba, '__version__', 'is not there')}"
    print(f"{os.cpu_count()} cores; {versions}; {args.repeats} repeats")
    print(f"{'':22}{'cells':>10}{'ms':>9}{'times as long':>20}{'processor':>11}", end="")
    print(f"{'first':>8}{'error':>9}")
    for name, function in functions().items():
        given = cells(name)
        calls = ways(name, function, by_hand.get(name))
        first, results, rounds = {}, {}, []
        for way, call in calls.items():
            begin = time.perf_counter()
            results[way] = jax.block_until_ready(call(*given))
            first[way] = time.perf_counter() - begin
        for _ in range(args.repeats):
            times = {}
            for way, call in calls.items():
                begin, processor = time.perf_counter(), time.process_time()
                jax.block_until_ready(call(*given))
                times[way] = time.perf_counter() - begin, time.process_time() - processor
            rounds.append(times)
        for way in calls:
            seconds = np.array([times[way] for times in rounds])
            ratio = seconds / np.array([times["kernel"] for times in rounds])
            low, middle, high = np.quantile(ratio[:, 0], [0, 0.5, 1])
            print(
                f"{name + ', ' + way:22}{len(given[0]):10,}{1e3 * np.median(seconds[:, 0]):9.1f}"
                f"{f'{middle:.3g} ({low:.3g}-{high:.3g})':>20}{np.median(ratio[:, 1]):11.3g}"
                f"{first[way]:8.2f}{difference(results[way], results['kernel']):9.0e}"
            )


if __name__ == "__main__":
    main()

"""Which integrator, of which order, costs least at the same accuracy?

On one core, repeats interleaved, after compilation. First the paper's 50,000 strides by Taylor
series of several orders, by kernels, and by XLA in tiles of 1024 cells with vectors of 512 and 256
bits. Then a swing alone, followed for a time of 3 from 8192 starts that lie close together: by
`follow_mode` to a time on a clock, and by Runge-Kutta methods in `diffeqsolve`, with XLA's sines
and with the package's. Rows without `kernel` are by XLA in the same tiles. Each method runs at
several tolerances, or numbers of constant steps. A column gives the time at which the largest error
is the column's.

The answer: orders 10 to 16 are alike; a kernel takes a fifth of the time of XLA's tiles, and
compiles sooner; in kernels, Taylor series take a quarter to a fourteenth of the time of
Runge-Kutta.
The two tables are of different runs, the second on a slower day: trust ratios alone.

    Strides, by Taylor series: us each
    largest error                         1e-08    1e-09    1e-10  compile
    order 8                                0.82     1.07     1.39    0.3 s
    order 10                               0.42     0.51     0.62    0.5 s
    order 12                               0.39     0.45     0.52    0.5 s
    order 14                               0.43     0.48     0.54    0.7 s
    order 16                               0.38     0.41     0.46    0.5 s
    XLA, 512 bits                          2.04     2.33     2.67    2.7 s
    XLA, 256 bits                          2.43     2.78     3.18    2.5 s

    Swings for a time of 3: us each
    largest error                         1e-08    1e-10    1e-12  compile
    follow_mode, kernel                    0.97     1.18     1.55    0.6 s
    diffeqsolve, Dopri8, kernel            3.91     5.47     8.22    1.2 s
    diffeqsolve, Dopri8                    9.25    13.55    19.89    3.5 s
    diffeqsolve, Dopri8, our sines         5.33     7.88    11.76    4.2 s
    diffeqsolve, Dopri8, constant          4.88     8.37    15.46    2.8 s
    diffeqsolve, Tsit5, kernel             4.26     8.77    21.16    0.9 s
    diffeqsolve, Tsit5                    11.20    20.96    49.98    3.5 s
    diffeqsolve, Tsit5, our sines          5.46    11.32    30.01    4.2 s
    diffeqsolve, Tsit5, constant           8.43    18.21    49.42    2.6 s
"""

import argparse
import inspect
import os
import time
from collections.abc import Callable
from contextlib import nullcontext
from functools import partial
from unittest.mock import patch

if hasattr(os, "sched_setaffinity"):  # one core, before JAX counts them
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})

import diffrax
import jax
import jax.numpy as jnp
import numpy as np

import walker_jax as wj
from walker_jax.execution.tiles import CALL_SHAPES, COMPILER_OPTIONS, compact_order, map_cells
from walker_jax.hybrid.following import follow_mode
from walker_jax.hybrid.modes import SECTION, Guard, Mode
from walker_jax.integrators.expansion import with_fast_sincos
from walker_jax.integrators.integrator import Method
from walker_jax.integrators.taylor_steps import SERIES_ORDER, Taylor
from walker_jax.kernels.program import Program
from walker_jax.walking.starts import prepare
from walker_jax.walking.stride import follow_stride

DTYPE = jnp.dtype("float64")
SWING = 3.0


def main():
    parser = argparse.ArgumentParser(description="Integrators at the same accuracy, on one core.")
    parser.add_argument("--repeats", type=int, default=3)
    args = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    of_strides(args.repeats)
    of_one_swing(args.repeats)


def by_xla():
    """Meanwhile no function that is new gets a kernel."""
    return patch.object(Program, "compiled", None)


def timed(run: Callable):
    start = time.perf_counter()
    result = run()
    return time.perf_counter() - start, result


def compare(ways: dict, error: Callable, cells: int, repeats: int, targets: list[float]):
    """Print microseconds per cell of every way where its largest error is each of `targets`.

    A way is a function of a setting, and its settings, the first of which compiles it. Time is
    interpolated between them (logarithms of both). Repeats are interleaved.
    """
    compiling, runs = {}, {}
    for name, (run, settings) in ways.items():
        compiling[name], _ = timed(partial(run, settings[0]))
        runs |= {(name, setting): partial(run, setting) for setting in settings}
    errors = {key: error(run()) for key, run in runs.items()}
    rounds = [{key: timed(run)[0] for key, run in runs.items()} for _ in range(repeats)]
    print(f"{'largest error':34}" + "".join(f"{target:9.0e}" for target in targets) + "  compile")
    for name, (_, settings) in ways.items():
        keys = sorted(((name, setting) for setting in settings), key=errors.__getitem__)
        seconds = np.array([np.median([times[key] for times in rounds]) for key in keys])
        logs = np.log([errors[key] for key in keys]), np.log(1e6 * seconds / cells)
        costs = np.exp(np.interp(np.log(targets), *logs, left=np.nan, right=np.nan))
        print(f"{name:34}" + "".join(f"{cost:9.2f}" for cost in costs), end="")
        print(f"{compiling[name] - np.median(seconds):7.1f} s", flush=True)


def of_strides(repeats: int):
    """The paper's strides, by orders of the series and widths of the processor's vectors."""
    walker = wj.SimplestWalker(0.004)
    grid = wj.Grid.sheared(theta=(0, 0.4, 200), sum=(-0.04, 0.01, 250))
    xs = np.asarray(jax.vmap(grid.centre)(compact_order(grid.shape, CALL_SHAPES["cpu"][0])))

    unjitted = inspect.unwrap(follow_stride)  # or its trace would serve every order

    def way(order, width=None):
        def one(shared, x):
            return unjitted(*prepare(shared[0], x, shared[1]))

        def run(tolerance):
            # Looked at when `one` is compiled, that is in its first call.
            SERIES_ORDER[DTYPE] = order
            COMPILER_OPTIONS["cpu"] = options | {"xla_cpu_prefer_vector_width": width}
            with by_xla() if width else nullcontext():
                return map_cells(one, ((walker, tolerance), xs))

        return run

    usual, options = SERIES_ORDER[DTYPE], COMPILER_OPTIONS["cpu"]
    tolerances = [1e-9, 1e-10, 1e-11, 1e-12, 1e-13]
    exact = way(16)(1e-15).state
    orders = 8, 10, 12, 14, 16
    ways = {f"order {order}": (way(order), tolerances) for order in orders}
    ways |= {f"XLA, {bits} bits": (way(usual, bits), tolerances) for bits in (512, 256)}
    targets = [1e-8, 1e-9, 1e-10]
    print("Strides, by Taylor series: us each")
    compare(ways, lambda result: np.nanmax(np.abs(result.state - exact)), len(xs), repeats, targets)
    SERIES_ORDER[DTYPE], COMPILER_OPTIONS["cpu"] = usual, options


def of_one_swing(repeats: int):
    """The swing alone, without events: the equations followed for a time of 3."""
    walker = wj.SimplestWalker(0.004)
    grid = wj.Grid.sheared(theta=(0.1, 0.3, 128), sum=(-0.03, 0.0, 64))
    xs = np.asarray(jax.vmap(grid.centre)(compact_order(grid.shape, CALL_SHAPES["cpu"][0])))

    def way(one, xla=True):
        def run(setting):
            with by_xla() if xla else nullcontext():
                return map_cells(one, ((walker, setting), xs))

        return run

    def by_mode(shared, x):
        walker, tolerance = shared

        def field(state):  # with a clock too slow to count in the error
            return walker.vector_field(state[0]), jnp.full((), 1 / 64)

        mode = Mode(field, (Guard(lambda state: state[1] - SWING / 64, SECTION),))
        method = Method(field, Taylor(SERIES_ORDER[DTYPE]), tolerance)
        start = walker.lift(x), jnp.zeros(())
        return jnp.stack(follow_mode(mode, start, jnp.asarray(True), method).state[0])

    def by_diffrax(solver, adaptive=True, sines=False, xla=True):
        def one(shared, x):
            walker, setting = shared
            field = with_fast_sincos(walker.vector_field) if sines else walker.vector_field
            if adaptive:
                controller = diffrax.PIDController(rtol=setting, atol=setting)
            else:
                controller = diffrax.ConstantStepSize()

            solution = diffrax.diffeqsolve(
                diffrax.ODETerm(lambda t, y, args: field(y)),
                solver,
                t0=0.0,
                t1=SWING,
                dt0=None if adaptive else SWING / setting,
                y0=walker.lift(x),
                stepsize_controller=controller,
                max_steps=16384,
                adjoint=diffrax.ForwardMode(),
                throw=False,
            )
            assert solution.ys is not None
            return jnp.stack([leaf[-1] for leaf in solution.ys])

        return way(one, xla)

    exact = by_diffrax(diffrax.Dopri8(), adaptive=False)(400.0)
    tolerances = [10.0**-k for k in range(6, 14)]
    tsit5, dopri8 = diffrax.Tsit5(), diffrax.Dopri8()
    ways = {
        "follow_mode, kernel": (way(by_mode, xla=False), tolerances),
        "diffeqsolve, Dopri8, kernel": (by_diffrax(dopri8, xla=False), tolerances),
        "diffeqsolve, Dopri8": (by_diffrax(dopri8), tolerances),
        "diffeqsolve, Dopri8, our sines": (by_diffrax(dopri8, sines=True), tolerances),
        "diffeqsolve, Dopri8, constant": (by_diffrax(dopri8, False), [4.0, 6.0, 8.0, 12.0, 16.0]),
        "diffeqsolve, Tsit5, kernel": (by_diffrax(tsit5, xla=False), tolerances),
        "diffeqsolve, Tsit5": (by_diffrax(tsit5), tolerances),
        "diffeqsolve, Tsit5, our sines": (by_diffrax(tsit5, sines=True), tolerances),
        "diffeqsolve, Tsit5, constant": (by_diffrax(tsit5, False), [16.0, 32.0, 64.0, 128.0]),
    }
    targets = [1e-8, 1e-10, 1e-12]
    print("\nSwings for a time of 3: us each")
    compare(ways, lambda states: np.max(np.abs(states - exact)), len(xs), repeats, targets)


if __name__ == "__main__":
    main()

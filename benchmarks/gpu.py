"""How many strides a second does an accelerator make, and are they those of a processor?

`jax.jit(jax.vmap(wj.stride))` gets the same starts on the first device that JAX finds and on the
processor, where it becomes a kernel. Starts are resident on the device, and results stay there. The
script compares outcomes, next states of successful strides, and derivatives by the start
(`jax.jacfwd`). Then `wj.basin` follows a million cells directly, on the first device alone: run the
script again with `JAX_PLATFORMS=cpu` for the processor.

On a GPU each row has a second one, `kernel`, with the same by kernels (`WALKER_JAX_KERNELS=gpu`);
so has the basin. Then come a sweep of a thousand basins, the strides of the tests' reference map,
and an ensemble that others have timed, the Lorenz systems of GPUODEBenchmarks: t from 0 to 1, start
(1, 0, 0), r from 0 to 21, adaptive steps of Tsit5 with tolerances of 1e-8, in float32. For
8,388,608 of them the published times are 48.8 ms (MPGOS), 69.5 (DiffEqGPU) and 2,611 (diffrax), on
a V100. `--registers 96 128 168 255` and `--threads 32 64 128` try other
programs of kernels. Kernels have not been run on a GPU yet: the table below is of XLA.

The answer: the same strides, for the simplest walker six times as many as 16 cores make, and no
more than they make for walkers with mass on their legs, whose programs XLA splits into many passes
over the card's memory. XLA compiles for a GPU in 10 s to a minute, and a kneed walker in more than
6 minutes; the programs of a basin in 24 s. `outcomes` counts those that differ; then come the
median and the largest difference of the next states, where strides amplify rounding most.

    16 cores; NVIDIA H100 80GB HBM3; jax 0.11.2; 1048576 strides, cpu | gpu
    walker      dtype    what         compile s              per second   ratio  outcomes   largest
    simplest    float64  stride      0.8 | 12.4  9,450,714 |  56,920,981     6.0         0    3e-12
    simplest    float64  jacobian    1.4 | 31.7  2,521,806 |   4,305,693     1.7         0    1e-08
    simplest    float32  stride      0.3 |  5.3 44,277,454 | 185,764,442     4.2         3    4e-03
    simplest    float32  jacobian    0.8 | 13.7 12,632,603 |  69,900,859     5.5         0    3e+00
    point feet  float64  stride      1.4 | 43.2  3,976,423 |   9,258,137     2.3         0    1e-12
    point feet  float32  stride      1.6 | 27.3 13,667,213 |  16,724,686     1.2         1    5e-04
    round feet  float64  stride      1.6 | 35.9  2,766,044 |   2,429,279     0.9         0    2e-14
    round feet  float64  jacobian    5.7 | 73.1    564,546 |     191,973     0.3         0    4e-11
    round feet  float32  stride      1.8 | 36.6 11,303,861 |  22,994,560     2.0         0    7e-06
    upper body  float64  stride      2.1 | 53.0  1,718,532 |   1,405,916     0.8         0    3e-13
    upper body  float32  stride      3.2 | 57.4  6,850,280 |  10,426,695     1.5         0    5e-04
    basin, 1000 x 1000 cells on gpu: first 26.6 s, then 0.65 s
    basin, 1000 x 1000 cells on cpu: first 2.2 s, then 0.42 s; the same tally

A basin is followed in rounds of a few strides, and the host sorts the cells between rounds. On a
GPU this sorting takes the time, not the strides. Calls of 32,768 or 131,072 cells took 0.65 s,
262,144 cells 0.72 s, a million 1.7 s.
"""

import argparse
import os
import statistics
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import diffrax
import jax
import jax.numpy as jnp
import numpy as np

import walker_jax as wj
from walker_jax.execution import tiles
from walker_jax.kernels import gpu, launcher, machine, ptx
from walker_jax.kernels import program as of_program
from walker_jax.systems.outcomes import Outcome

jax.config.update("jax_enable_x64", True)  # before the walkers are made

WALKERS = {
    "simplest": wj.SimplestWalker(0.004),
    "spring": wj.SpringWalker(0.004, 1.0),
    "point feet": wj.PointFootWalker(0.004, 0.1),
    "round feet": wj.RoundFootWalker(0.01),
    "upper body": wj.UpperBodyWalker(0.02),
    "knees": wj.KneedWalker(0.05),
}
"""Each at a slope where it walks."""
MAP = Path(__file__).parents[1] / "tests" / "data" / "strides_slope_0.004.npz"


@contextmanager
def kernels(on: bool) -> Iterator[None]:
    """Kernels on GPUs, or XLA alone there."""
    before = os.environ.pop(machine.VARIABLE, None)
    if on:
        os.environ[machine.VARIABLE] = "gpu"
    try:
        yield
    finally:
        os.environ.pop(machine.VARIABLE, None)
        if before is not None:
            os.environ[machine.VARIABLE] = before


def ways() -> list[bool]:
    """By XLA, and by kernels where there is a GPU for them."""
    return [False, True] if jax.devices()[0].platform == "gpu" else [False]


def starts_about(walker: wj.Walker, count: int) -> np.ndarray:
    """So many starts, up to a tenth of each coordinate away from a gait: (count, d)."""
    with jax.default_device(jax.devices("cpu")[0]):
        gait = np.asarray(wj.find_gait(walker).states)[0]
    away = np.random.default_rng(0).uniform(-0.1, 0.1, (count, len(gait)))
    return gait * (1 + away)


def one_stride(walker: wj.Walker, x: jax.Array):
    result = wj.stride(walker, x)
    return result[0], result[1]


def jacobian(walker: wj.Walker, x: jax.Array) -> jax.Array:
    return jax.jacfwd(lambda x: one_stride(walker, x)[0])(x)


def time_on(device: Any, function: Callable, xs: np.ndarray, repeats: int):
    """Seconds of compiling and of a call (median), and the result as NumPy arrays."""
    xs_there = jax.device_put(xs, device)
    begin = time.perf_counter()
    run = jax.jit(jax.vmap(lambda x: function(x))).lower(xs_there).compile()
    result = jax.block_until_ready(run(xs_there))
    compiling = time.perf_counter() - begin
    seconds = []
    for _ in range(repeats):
        begin = time.perf_counter()
        result = jax.block_until_ready(run(xs_there))
        seconds.append(time.perf_counter() - begin)
    return compiling, statistics.median(seconds), jax.tree.map(np.asarray, result)


def compare_strides(
    names: list[str], jacobians: list[str], count: int, repeats: int, dtypes: list[str]
) -> None:
    here, there = jax.devices("cpu")[0], jax.devices()[0]
    print(f"{count} strides, {here.platform} | {there.platform}")
    print(f"{'walker':12}{'dtype':9}{'what':11}{'compile s':>15}{'per second':>27}", end="")
    print(f"{'ratio':>8}{'outcomes':>10}{'median':>9}{'largest':>9}")
    for name in names:
        found = starts_about(WALKERS[name], count)
        for dtype in dtypes:
            compare_walker(name, found.astype(dtype), "stride", here, there, repeats)
            if name in jacobians:
                compare_walker(name, found.astype(dtype), "jacobian", here, there, repeats)


def compare_walker(name: str, xs: np.ndarray, what: str, here, there, repeats: int) -> None:
    """A row for XLA on the first device beside the processor, and one for kernels."""
    one = partial({"stride": one_stride, "jacobian": jacobian}[what], WALKERS[name])
    slow, seconds, of_here = time_on(here, one, xs, repeats)
    outcomes = one_stride_outcomes(name, xs)
    for by_kernel in ways():
        with kernels(by_kernel):
            fast, seconds_there, of_there = time_on(there, one, xs, repeats)
        values, others, differ = of_here, of_there, 0
        going = outcomes == Outcome.STRIDE
        if what == "stride":
            (values, _), (others, ends) = of_here, of_there
            differ = int((outcomes != ends).sum())
            going &= ends == Outcome.STRIDE
        size = 1 if what == "stride" else np.maximum(1, abs(values[going]))
        error = (abs(values[going] - others[going]) / size).reshape(going.sum(), -1)
        worst = error.max(axis=1)
        rates = f"{len(xs) / seconds:,.0f} | {len(xs) / seconds_there:,.0f}"
        label = {"stride": "kernel", "jacobian": "its jac."}[what] if by_kernel else what
        print(f"{name:12}{xs.dtype!s:9}{label:11}{slow:6.1f} | {fast:6.1f}{rates:>27}", end="")
        print(f"{seconds / seconds_there:8.1f}{differ:10}", end="")
        print(f"{np.median(worst):9.0e}{worst.max():9.0e}", flush=True)


def one_stride_outcomes(name: str, xs: np.ndarray) -> np.ndarray:
    """Outcomes on the processor."""
    with jax.default_device(jax.devices("cpu")[0]):
        many = jax.jit(jax.vmap(partial(one_stride, WALKERS[name])))
        return np.asarray(many(xs)[1])


def compare_with_map() -> None:
    """Strides of the tests' reference map, on the first device."""
    with np.load(MAP) as data:
        theta, total = np.meshgrid(data["theta"], data["sum"], indexing="ij")
        starts = np.stack([theta, total - theta], axis=-1).reshape(-1, 2)
        outcome = data["outcome"].ravel()
        following = np.stack([data["next_theta"], data["next_velocity"]], -1).reshape(-1, 2)
    for by_kernel in ways():
        with kernels(by_kernel):
            _, _, (states, ends) = time_on(
                jax.devices()[0], partial(one_stride, WALKERS["simplest"]), starts, 1
            )
        walks = (outcome == Outcome.STRIDE) & (ends == Outcome.STRIDE)
        error = np.abs(states[walks] - following[walks]).max()
        print(f"reference map{', kernel' * by_kernel}: {np.sum(outcome != ends)} of ", end="")
        print(f"{len(outcome)} outcomes differ, next states by {error:.0e}", flush=True)


def time_basin(side: int, repeats: int) -> None:
    walker = WALKERS["simplest"]
    grid = wj.Grid.sheared(theta=(0.0, 0.7854, side), sum=(-0.7, 0.05, side))
    seconds = []
    for _ in range(repeats + 1):
        begin = time.perf_counter()
        found = wj.basin(walker, grid, method="direct")
        seconds.append(time.perf_counter() - begin)
    platform = jax.devices()[0].platform
    fates, counts = np.unique(np.asarray(found.fate), return_counts=True)
    tally = dict(zip(fates.tolist(), counts.tolist(), strict=True))
    first, later = seconds[0], statistics.median(seconds[1:])
    print(f"{side} x {side} cells on {platform}: first {first:.1f} s, then {later:.2f} s; {tally}")


def time_sweep(count: int) -> None:
    """Basins of so many slopes, of 100 x 100 cells each."""
    slopes = np.linspace(0.001, 0.015, count)
    grid = wj.Grid.sheared(theta=(0.0, 0.4, 100), sum=(-0.05, 0.02, 100))
    for by_kernel in ways():
        with kernels(by_kernel):
            begin = time.perf_counter()
            found = wj.sweep(WALKERS["simplest"], {"slope": slopes}, grid, levels=0, check=0)
        seconds = time.perf_counter() - begin
        area = float(np.nansum(found["area"]))
        print(f"sweep of {count} basins{', kernel' * by_kernel}: {seconds:.1f} s; ", end="")
        print(f"their areas together {area:.6f}", flush=True)


class Lorenz(wj.System):
    """Lorenz' system, from (1, 0, 0) as a point, to t = 1."""

    r: Any
    section = ("x", "y", "z")

    def advance(self, x):
        def rate(t, y, r):
            a, b, c = y
            return jnp.stack([10 * (b - a), r * a - b - a * c, a * b - 8 / 3 * c])

        solution = diffrax.diffeqsolve(
            *(diffrax.ODETerm(rate), diffrax.Tsit5(), 0.0, 1.0, 1e-3, x, self.r),
            stepsize_controller=diffrax.PIDController(rtol=1e-8, atol=1e-8),
            adjoint=diffrax.ForwardMode(),
            throw=False,
        )
        assert solution.ys is not None
        return solution.ys[-1], jnp.asarray(Outcome.STRIDE, jnp.int8), jnp.ones_like(x[0])


def time_lorenz(count: int, repeats: int) -> None:
    start = jnp.asarray([1.0, 0.0, 0.0], jnp.float32)
    end = lambda r: wj.stride(Lorenz(r), start).state
    with jax.enable_x64(False):
        r = np.linspace(0, 21, count, dtype=np.float32)
        for by_kernel in ways():
            with kernels(by_kernel):
                compiling, seconds, found = time_on(jax.devices()[0], end, r, repeats)
            print(
                f"{count} Lorenz systems{', kernel' * by_kernel}: {1e3 * seconds:.1f} ms, ", end=""
            )
            print(f"{compiling:.1f} s to compile; the last ends at {found[-1]}", flush=True)


def try_choices(registers: list[int], threads: list[int], count: int, repeats: int) -> None:
    """Strides by kernels that have other numbers of registers, and of threads in a block."""
    for most in registers or [ptx.REGISTERS]:
        for block in threads or [ptx.THREADS]:
            ptx.REGISTERS = most
            ptx.THREADS = launcher.THREADS = gpu.THREADS = block
            of_program.programs.clear()
            for name, walker in WALKERS.items():
                xs = starts_about(walker, count)
                with kernels(True):
                    _, seconds, _ = time_on(
                        jax.devices()[0], partial(one_stride, walker), xs, repeats
                    )
                rate = f"{count / seconds:,.0f}"
                print(
                    f"{most} registers, blocks of {block}: {name:12}{rate:>15} a second", flush=True
                )


def main() -> None:
    parser = argparse.ArgumentParser(description="Strides on an accelerator.")
    parser.add_argument("--count", type=int, default=2**20, help="starts of each walker")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--side", type=int, default=1000, help="cells along a side of the basin")
    parser.add_argument("--tile", type=int, nargs="*", help="cells of a call of XLA, not ours")
    parser.add_argument("--basins", type=int, default=1000, help="basins of the sweep")
    parser.add_argument("--lorenz", type=int, default=2**23, help="Lorenz systems")
    parser.add_argument("--walkers", nargs="*", default=list(WALKERS), choices=list(WALKERS))
    parser.add_argument("--jacobians", nargs="*", default=["simplest"], choices=list(WALKERS))
    parser.add_argument("--dtypes", nargs="*", default=["float64", "float32"])
    parser.add_argument("--registers", type=int, nargs="*", default=[], help="of kernels' threads")
    parser.add_argument("--threads", type=int, nargs="*", default=[], help="of kernels' blocks")
    args = parser.parse_args()
    device = jax.devices()[0]
    print(f"{os.cpu_count()} cores; {device.device_kind}; jax {jax.__version__}", flush=True)
    if True in ways():
        with kernels(True):
            print(f"kernels are {gpu.in_words()}", flush=True)
    if args.registers or args.threads:
        return try_choices(args.registers, args.threads, args.count, args.repeats)
    if args.side:
        for tile in args.tile or [tiles.CALL_SHAPES["gpu"][0]]:
            tiles.CALL_SHAPES["gpu"] = tile, 1
            print(f"basin, calls of {tile} cells: ", end="")
            with kernels(False):
                time_basin(args.side, args.repeats)
        if True in ways():
            print("basin, kernel: ", end="")
            with kernels(True):
                time_basin(args.side, args.repeats)
    compare_with_map()
    compare_strides(args.walkers, args.jacobians, args.count, args.repeats, args.dtypes)
    if args.basins:
        time_sweep(args.basins)
    if args.lorenz:
        time_lorenz(args.lorenz, args.repeats)


if __name__ == "__main__":
    main()

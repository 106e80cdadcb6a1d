"""How many strides a second does an accelerator make, and are they those of a processor?

`jax.jit(jax.vmap(wj.stride))` gets the same starts on the first device that JAX finds and on the
processor, where it becomes a kernel. Starts are resident on the device, and results stay there. The
script compares outcomes, next states of successful strides, and derivatives by the start
(`jax.jacfwd`). Then `wj.basin` follows a million cells directly, on the first device alone: run the
script again with `JAX_PLATFORMS=cpu` for the processor.

On a GPU each row by XLA (`WALKER_JAX_KERNELS=cpu`) has a second one, `kernel`; so has the basin.
XLA takes minutes to compile: `--without-xla` leaves it out. Then come a sweep of basins, the
strides of the tests' reference map, and an ensemble that others have timed, the Lorenz systems of
GPUODEBenchmarks: t from 0 to 1, start (1, 0, 0), r from 0 to 21, adaptive steps of Tsit5 with
tolerances of 1e-8, in float32. For 8,388,608 of them the published times are 48.8 ms (MPGOS), 69.5
(DiffEqGPU) and 2,611 (diffrax), on a V100. `--registers 168 208 255` and `--threads 64 128 256` try
other programs of kernels, in float64.

The answer: the same strides, 16 to 33 times as many as 16 cores make. `outcomes` counts those that
differ, and `largest` is the largest difference of the next states, where strides amplify rounding
most; the script prints the median too. Of the 50,000 strides of the reference map no outcome
differs.

    16 cores; NVIDIA H100 80GB HBM3; jax 0.11.2; 1048576 strides, cpu | gpu
    walker      dtype    what       compile s                    per second  ratio  outcomes largest
    simplest    float64  kernel     1.3 |  1.5  11,702,312 |    363,658,307   31.1         0   3e-13
    simplest    float64  its jac.   2.0 |  2.0   3,880,853 |    112,004,483   28.9         0   4e-11
    simplest    float32  kernel     0.6 |  0.7  46,061,739 |  1,497,747,471   32.5         0   1e-02
    simplest    float32  its jac.   0.8 |  1.0  14,393,156 |    430,190,673   29.9         0   5e-01
    spring      float64  kernel     0.9 |  1.5  11,532,981 |    350,528,663   30.4         0   3e-15
    spring      float32  kernel     0.5 |  0.7  44,766,946 |  1,182,293,381   26.4         0   2e-04
    point feet  float64  kernel     1.9 |  1.8   4,432,926 |    115,731,168   26.1         0   2e-13
    point feet  float32  kernel     2.1 |  1.7  14,960,387 |    351,968,818   23.5         0   3e-04
    round feet  float64  kernel     2.1 |  2.2   2,686,702 |     85,593,841   31.9         0   6e-15
    round feet  float32  kernel     1.7 |  2.4   9,459,666 |    307,443,763   32.5         0   7e-06
    upper body  float64  kernel     4.1 |  2.9   1,704,797 |     29,360,004   17.2         0   1e-13
    upper body  float32  kernel     2.1 |  2.6   6,831,311 |    131,949,348   19.3         0   3e-05
    knees       float64  kernel     8.7 |  8.3   1,557,021 |     24,754,402   15.9         0   1e-14
    simplest    float64  stride     0.1 | 14.3  11,428,371 |     28,546,657    2.5         0   6e-11
    basin, kernel: 1000 x 1000 cells on gpu: first 4.8 s, then 0.16 s
    8388608 Lorenz systems, kernel: 16.3 ms, 1.4 s to compile

The rows are of several runs on two such machines. Those of the simplest walker by kernels, the
basin and the Lorenz systems had blocks of 64 threads, the others of 256, also of the spring walker,
which now has blocks of 64. The last stride is by XLA. An earlier version of the package made 57
million of these by XLA, and 9.3 (point feet), 2.4 (round feet) and 1.4 million (upper body) in
float64, after compiling for 36 to 53 s, and for more than 6 minutes with knees; its basin took
26.6 s, then 0.65 s.

A profile of the simplest walker with 64 threads: the units for float64 are busy half of the time.
Of a warp's 32 threads 19 are at work, as starts are in no order here, and eight warps are too few
to hide all waiting. The basin has 1.1 million strides, for which the card takes 3 ms at the rate
above; the rest is the host's work.
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
from walker_jax.kernels import gpu, machine, ptx
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
    if not on:
        os.environ[machine.VARIABLE] = "cpu"
    jax.clear_caches()  # programs know nothing of the setting
    try:
        yield
    finally:
        os.environ.pop(machine.VARIABLE, None)
        if before is not None:
            os.environ[machine.VARIABLE] = before


by_xla = True


def ways() -> list[bool]:
    """By XLA, unless it is left out, and by kernels where there is a GPU for them."""
    return [False] * by_xla + [True] * (jax.devices()[0].platform == "gpu")


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


def try_choices(
    names: list[str], registers: list[int], threads: list[int], count: int, repeats: int
) -> None:
    """Strides by kernels that have other numbers of registers, and of threads in a block."""
    for most in registers or [ptx.REGISTERS]:
        for block in threads or [ptx.THREADS[1]]:
            ptx.REGISTERS, ptx.THREADS = most, (block, block)
            of_program.programs.clear()
            for name in names:
                walker = WALKERS[name]
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
    parser.add_argument("--basins", type=int, default=20, help="basins of the sweep")
    parser.add_argument("--lorenz", type=int, default=2**23, help="Lorenz systems")
    parser.add_argument("--walkers", nargs="*", default=list(WALKERS), choices=list(WALKERS))
    parser.add_argument("--jacobians", nargs="*", default=["simplest"], choices=list(WALKERS))
    parser.add_argument("--dtypes", nargs="*", default=["float64", "float32"])
    parser.add_argument("--without-xla", action="store_true", help="by kernels alone on a GPU")
    parser.add_argument("--registers", type=int, nargs="*", default=[], help="of kernels' threads")
    parser.add_argument("--threads", type=int, nargs="*", default=[], help="of kernels' blocks")
    args = parser.parse_args()
    global by_xla
    by_xla = not args.without_xla
    device = jax.devices()[0]
    if args.without_xla and device.platform != "gpu":
        parser.error(f"--without-xla leaves nothing to compare on a {device.platform}")
    print(f"{os.cpu_count()} cores; {device.device_kind}; jax {jax.__version__}", flush=True)
    if True in ways():
        with kernels(True):
            print(f"kernels are {gpu.in_words()}", flush=True)
    if args.registers or args.threads:
        return try_choices(args.walkers, args.registers, args.threads, args.count, args.repeats)
    if args.side:
        for tile in (args.tile or [tiles.CALL_SHAPES["gpu"][0]]) * by_xla:
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

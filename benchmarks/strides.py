"""How long do 50,000 strides take, against diffrax as one would use it by itself?

One stride from the centre of every cell of the paper's grid at a slope of 0.004, by
`walker_jax.strides` (cells in `compact_order`, and row after row) and by a jitted and vmapped
`diffrax.diffeqsolve` with real-valued events and a root finder, its tolerance set for a largest
error below 1e-8. Each way is compiled first, repeats are interleaved, and `times as long` is
the ratio to the first row in the same repeat (median, least and greatest). `error` is the largest
of the next state; `wrong` counts the outcomes that are not those of the tests' reference.

The answer: about 0.06 s on two cores, where the faster of diffrax's solvers takes 8 s, a hundred
times as long, at an error twenty times as large. `lax.map` in batches of 1000 instead of `vmap`
halves that. What diffrax gets wrong are strides that end at theta < 0.004, taken for falls:
the foot clears the floor ahead too briefly for steps of that length.

    2 cores, AMD EPYC; jax 0.10.2, diffrax 0.7.2; 50000 strides, 5 repeats
                                      seconds strides/s        times as long  compile   error wrong
    walker_jax                          0.064   783,932              1 (1-1)      3.2   2e-10     0
    walker_jax, row after row           0.093   539,411     1.38 (1.25-1.54)      0.0   2e-10     0
    walker_jax, 1e-11                   0.057   878,679  0.803 (0.766-0.933)      0.0   3e-09     0
    vmap(diffeqsolve), Dopri8, 1e-12    7.707     6,487       117 (97.1-123)      5.5   5e-09     8
    the same, batches of 1000           3.416    14,636     51.2 (29.5-54.2)      5.4   5e-09     9
    vmap(diffeqsolve), Tsit5, 1e-11     9.512     5,256        143 (106-156)      5.4   5e-09     1
"""

import argparse
import os
import platform
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import optimistix

import walker_jax as wj
from walker_jax.stride import Outcome
from walker_jax.tiles import compact_order

SLOPE = 0.004
REFERENCE = Path(__file__).parents[1] / "tests" / "data" / "strides_slope_0.004.npz"


def plain(solver: diffrax.AbstractAdaptiveSolver, tolerance: float) -> Callable:
    """One stride by diffrax's own means: (next state, outcome) of a point of the section.

    Two solves: to the turning point of the swing, where h = phi - 2 theta is least, and on to
    heel strike. One alone misses more of the walkers that clear the floor for less than a step.
    Only what needs a root is a real-valued event. Where a condition is masked its value is
    positive, so that it rises through zero nowhere but where it is meant to.
    """

    def field(t, y, args):
        theta, phi, thetadot, phidot = y
        thetaddot = jnp.sin(theta - SLOPE)
        phiddot = jnp.sin(phi) * (thetadot**2 - jnp.cos(theta - SLOPE)) + thetaddot
        return thetadot, phidot, thetaddot, phiddot

    def turns(t, y, args, **kwargs):
        _, phi, thetadot, phidot = y
        return jnp.where(phi < 0, phidot - 2 * thetadot, 1.0)

    def strikes(t, y, args, **kwargs):
        theta, phi, _, _ = y
        return jnp.where(theta < 0, phi - 2 * theta, 1.0)

    def falls(t, y, args, **kwargs):
        theta, _, thetadot, _ = y
        return (thetadot >= 0) | (theta <= -np.pi / 2)

    def follow(condition, t0, t1, y):
        solution = diffrax.diffeqsolve(
            diffrax.ODETerm(field),
            solver,
            t0,
            t1,
            dt0=None,
            y0=y,
            stepsize_controller=diffrax.PIDController(rtol=tolerance, atol=tolerance),
            event=diffrax.Event(
                [condition, falls],
                root_finder=optimistix.Newton(rtol=1e-12, atol=1e-12),
                direction=[True, None],
            ),
            max_steps=16384,
            adjoint=diffrax.ForwardMode(),
            throw=False,
        )
        assert solution.ts is not None and solution.ys is not None
        y = tuple(leaf[-1] for leaf in solution.ys)
        return solution.ts[-1], y, jnp.array(solution.event_mask)

    def stride(x):
        theta, thetadot = x
        feasible = (theta > 0) & (theta < np.pi / 4) & (thetadot < 0)
        thetadot = jnp.where(feasible, thetadot, -1.0)
        start = theta, 2 * theta, thetadot, (1 - jnp.cos(2 * theta)) * thetadot
        t, turning, (turned, fell) = follow(turns, 0.0, 200.0, start)
        above = turned & (turning[1] < 2 * turning[0])
        end = jnp.where(above, 200.0, t)  # nothing to do for the others
        _, (theta, _, thetadot, _), (struck, fell_later) = follow(strikes, t, end, turning)

        fallen = jnp.where(thetadot >= 0, Outcome.BACKWARD, Outcome.FORWARD)
        outcome = jnp.where(fell | fell_later, fallen, Outcome.UNDECIDED)
        outcome = jnp.where(turned & ~above, Outcome.FORWARD, outcome)
        outcome = jnp.where(above & struck, Outcome.STRIDE, outcome)
        outcome = jnp.where(feasible, outcome, Outcome.OUTSIDE)
        following = jnp.stack([-theta, jnp.cos(2 * theta) * thetadot])
        return jnp.where(outcome == Outcome.STRIDE, following, jnp.nan), outcome

    return stride


def main():
    parser = argparse.ArgumentParser(description="50,000 strides, against plain diffrax.")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument(
        "--quick",
        action="store_true",
        help="a sixteenth of the cells, once: a trial, no measurement",
    )
    args = parser.parse_args()
    jax.config.update("jax_enable_x64", True)

    thin = slice(None, None, 4 if args.quick else 1)
    with np.load(REFERENCE) as data:
        theta, total = np.meshgrid(data["theta"][thin], data["sum"][thin], indexing="ij")
        names = "next_theta", "next_velocity", "outcome"
        *states, outcomes = (data[name][thin, thin].ravel() for name in names)
    xs = np.stack([theta.ravel(), (total - theta).ravel()], axis=1)
    order = compact_order(theta.shape)
    walker = wj.SimplestWalker(SLOPE)

    def of_project(cells, tolerance=None):
        wj.strides(walker, xs[:1], tolerance=tolerance)  # compiles, unless done before
        return lambda: wj.strides(walker, xs[cells], tolerance=tolerance)[:2]

    def of_diffrax(solver, tolerance, batch=None):
        one = plain(solver, tolerance)
        if batch is None:
            run = jax.jit(jax.vmap(one))
        else:
            run = jax.jit(lambda xs: jax.lax.map(one, xs, batch_size=batch))
        return partial(run.lower(xs).compile(), xs)

    dopri8, tsit5 = diffrax.Dopri8(), diffrax.Tsit5()
    everything = np.arange(len(xs))
    ways = {
        "walker_jax": (order, partial(of_project, order)),
        "walker_jax, row after row": (everything, partial(of_project, everything)),
        "walker_jax, 1e-11": (order, partial(of_project, order, 1e-11)),
        "vmap(diffeqsolve), Dopri8, 1e-12": (everything, partial(of_diffrax, dopri8, 1e-12)),
        "the same, batches of 1000": (everything, partial(of_diffrax, dopri8, 1e-12, 1000)),
        "vmap(diffeqsolve), Tsit5, 1e-11": (everything, partial(of_diffrax, tsit5, 1e-11)),
    }

    def timed(run):
        start = time.perf_counter()
        result = jax.block_until_ready(run())
        return time.perf_counter() - start, result

    compiling, runs, accuracy = {}, {}, {}
    for name, (cells, prepare) in ways.items():
        compiling[name], runs[name] = timed(prepare)
        state, outcome = runs[name]()
        both = (outcomes[cells] == Outcome.STRIDE) & (outcome == Outcome.STRIDE)
        error = np.abs(np.asarray(state).T - [column[cells] for column in states])[:, both].max()
        accuracy[name] = error, int(np.sum(outcome != outcomes[cells]))
    repeats = 1 if args.quick else args.repeats
    rounds = [{name: timed(run)[0] for name, run in runs.items()} for _ in range(repeats)]

    print(
        f"{os.cpu_count()} cores, {processor()}; jax {jax.__version__}, "
        f"diffrax {diffrax.__version__}; {len(xs)} strides, {repeats} repeats"
    )
    print(f"{'':33}{'seconds':>8}{'strides/s':>10}{'times as long':>21}", end="")
    print(f"{'compile':>9}{'error':>8}{'wrong':>6}")
    for name in ways:
        seconds = np.array([times[name] for times in rounds])
        ratio = seconds / np.array([times["walker_jax"] for times in rounds])
        spread = f"{np.median(ratio):.3g} ({ratio.min():.3g}-{ratio.max():.3g})"
        median, (error, off) = np.median(seconds), accuracy[name]
        print(
            f"{name:33}{median * 50_000 / len(xs):8.3f}{len(xs) / median:10,.0f}{spread:>21}"
            f"{compiling[name]:9.1f}{error:8.0e}{off:6d}"
        )


def processor() -> str:
    """The name of the processor, where the system tells."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    names = [line.split(":")[1].strip() for line in lines if line.startswith("model name")]
    return (names or [platform.processor()])[0]


if __name__ == "__main__":
    main()

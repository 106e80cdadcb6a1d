"""How long do 50,000 strides, and a basin followed directly, take with other integrators?

One stride is made from the centre of every cell of the paper's grid at a slope of 0.004, by

- `walker_jax.strides`, at a tolerance that makes the largest error less than 1e-8, and at its own;
- `jax.jit(jax.vmap(...))` of `walker_jax.stride`, as in a program of one's own;
- heyoka, adaptive Taylor series with events, in batches of several sizes, on all cores, by
  processes that are started before; a stride calls one or two of its callbacks, which are Python
  functions;
- a jitted and vmapped `diffrax.diffeqsolve` with real-valued events and a root finder, all cells at
  once and a thousand at a time;
- `scipy.integrate.solve_ivp` with events, for a sample, on one core.

Tolerances are such that the largest error of a next state is below 1e-8 and above 1e-9 or so. Each
method is compiled first, repeats are interleaved, and `times as long` is the ratio to the first row
in the same repeat (median, least and greatest). `wrong` counts outcomes that differ from the tests'
reference. Then comes a heavier job: walkers from a million cells of the same window, each followed
until it falls or is within 1e-6 of the gait, by this project and by heyoka.

The answer: 18 to 26 ms on two cores, a tenth of heyoka's time and less than a hundredth of what
diffrax alone takes.

    2 cores, Intel Xeon; jax 0.10.2, diffrax 0.7.2, heyoka 7.13.2; 50000 strides, 5 repeats
                                      seconds strides/s       times as long  compile   error wrong
    walker_jax, 1e-11                   0.026 1,902,679             1 (1-1)      0.8   9e-09     0
    walker_jax, 1e-12, its own          0.027 1,859,873   1.02 (0.901-1.52)      0.0   8e-10     0
    jit(vmap(stride)), 1e-11            0.018 2,849,792 0.683 (0.635-0.765)      0.0   9e-09     0
    heyoka, batches of 8, 1e-11         0.333   149,940    12.6 (9.02-16.6)      3.2   3e-09     0
    heyoka, batches of 16, 1e-11        0.254   196,710      10.3 (7.23-12)      0.6   3e-09     0
    heyoka, batches of 32, 1e-11        0.249   200,816      9.75 (7.35-12)      0.9   3e-09     0
    vmap(diffeqsolve), Dopri8, 1e-12    8.819     5,669       335 (287-409)      6.0   5e-09     8
    the same, batches of 1000           4.439    11,264       176 (132-220)      6.1   5e-09     9
    vmap(diffeqsolve), Tsit5, 1e-11    11.007     4,543       465 (334-575)      5.4   5e-09     1
    scipy, DOP853, 1e-11, one core    127.754       391 4,861 (3,789-7,767)      0.0   3e-10     1

    A basin of 1000 x 1000 cells, followed directly; 3 repeats
                                      seconds strides/s       times as long    walk
    walker_jax, 1e-11                    1.47  1,882,950              1 (1-1)   60392
    heyoka, batches of 16, 1e-11        14.04    196,902      9.4 (8.91-9.67)   60392
"""

import argparse
import importlib
import os
import platform
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import optimistix
from scipy.integrate import solve_ivp

import walker_jax as wj
from walker_jax.systems.outcomes import Outcome

heyoka: Any = importlib.import_module("heyoka")  # of the extra [bench] alone: no types of it

SLOPE = 0.004
GAIT = 0.1534717, -0.1561099  # roughly; each way comes to its own digits of it
REFERENCE = Path(__file__).parents[1] / "tests" / "data" / "strides_slope_0.004.npz"
LONGEST = 200.0  # no stride takes longer


def after_strike(theta, thetadot):
    """The next state on the section, from that at heel strike, (18) and (21)."""
    return np.stack([-theta, np.cos(2 * theta) * thetadot], axis=-1)


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
        t, turning, (turned, fell) = follow(turns, 0.0, LONGEST, start)
        above = turned & (turning[1] < 2 * turning[0])
        end = jnp.where(above, LONGEST, t)  # nothing to do for the others
        _, (theta, _, thetadot, _), (struck, fell_later) = follow(strikes, t, end, turning)

        fallen = jnp.where(thetadot >= 0, Outcome.BACKWARD, Outcome.FORWARD)
        outcome = jnp.where(fell | fell_later, fallen, Outcome.UNDECIDED)
        outcome = jnp.where(turned & ~above, Outcome.FORWARD, outcome)
        outcome = jnp.where(above & struck, Outcome.STRIDE, outcome)
        outcome = jnp.where(feasible, outcome, Outcome.OUTSIDE)
        following = jnp.stack([-theta, jnp.cos(2 * theta) * thetadot])
        return jnp.where(outcome == Outcome.STRIDE, following, jnp.nan), outcome

    return stride


class Heyoka:
    """Strides by heyoka's adaptive Taylor integrator, `size` of them side by side."""

    def __init__(self, size: int, tolerance: float):
        names = "theta", "phi", "thetadot", "phidot"
        theta, phi, thetadot, phidot = heyoka.make_vars(*names)
        thetaddot = heyoka.sin(theta - SLOPE)
        phiddot = heyoka.sin(phi) * (thetadot**2 - heyoka.cos(theta - SLOPE)) + thetaddot
        fate, ends, done = [0] * size, np.zeros((4, size)), [True] * size

        # A batch goes on until the last of its walkers is done.
        def ended(lane: int, outcome: int) -> bool:
            if not done[lane]:
                done[lane], fate[lane] = True, outcome
                self.left -= 1
            return self.left > 0

        def strikes(integrator, sign, lane):
            if not done[lane] and state[0, lane] < 0:
                ends[:, lane] = state[:, lane]
                return ended(lane, Outcome.STRIDE)
            return self.left > 0

        def stops(integrator, sign, lane):
            return ended(lane, Outcome.BACKWARD)

        def is_down(integrator, sign, lane):
            return ended(lane, Outcome.FORWARD)

        rising, falling = heyoka.event_direction.positive, heyoka.event_direction.negative
        event = heyoka.t_event_batch
        self.integrator = heyoka.taylor_adaptive_batch(
            [(theta, thetadot), (phi, phidot), (thetadot, thetaddot), (phidot, phiddot)],
            np.zeros((4, size)),
            tol=tolerance,
            t_events=[
                event(phi - 2 * theta, callback=strikes, direction=rising),
                event(thetadot, callback=stops, direction=rising),
                event(theta + np.pi / 2, callback=is_down, direction=falling),
            ],
        )
        self.left = 0
        self.size, self.fate, self.ends, self.done = size, fate, ends, done
        self.state = state = self.integrator.state

    def __call__(self, xs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Next states and outcomes."""
        following, outcomes = np.full((len(xs), 2), np.nan), np.zeros(len(xs), np.int8)
        for start in range(0, len(xs), self.size):
            x = xs[start : start + self.size]
            count = len(x)
            theta, thetadot = np.concatenate([x, np.tile(x[-1], (self.size - count, 1))]).T
            feasible = (theta > 0) & (theta < np.pi / 4) & (thetadot < 0)
            phidot = (1 - np.cos(2 * theta)) * thetadot
            self.state[:] = theta, 2 * theta, thetadot, phidot
            self.integrator.set_time(0.0)
            self.integrator.reset_cooldowns()
            self.done[:] = (~feasible).tolist()
            self.fate[:] = [Outcome.UNDECIDED if one else Outcome.OUTSIDE for one in feasible]
            self.left = int(feasible.sum())
            if self.left:
                self.integrator.propagate_until(LONGEST)
            outcomes[start : start + count] = self.fate[:count]
            ends = after_strike(self.ends[0], self.ends[2])
            following[start : start + count] = ends[:count]
        following[outcomes != Outcome.STRIDE] = np.nan
        return following, outcomes


_integrators: dict = {}


def by_heyoka(size: int, tolerance: float, xs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """In a process of its own, whose integrator is compiled at the first call."""
    if (size, tolerance) not in _integrators:
        _integrators[size, tolerance] = Heyoka(size, tolerance)
    return _integrators[size, tolerance](xs)


def shared_out(pool: ProcessPoolExecutor, cores: int, size: int, tolerance: float, xs: np.ndarray):
    """Strides by heyoka in several processes, pieces small enough for all to end together."""
    pieces = np.array_split(xs, min(8 * cores, max(1, len(xs) // 64)))
    done = list(pool.map(partial(by_heyoka, size, tolerance), pieces))
    return np.concatenate([one for one, _ in done]), np.concatenate([two for _, two in done])


def by_scipy(xs: np.ndarray, tolerance: float) -> tuple[np.ndarray, np.ndarray]:
    """Strides by solve_ivp, one after the other."""

    def field(t, y):
        theta, phi, thetadot, phidot = y
        thetaddot = np.sin(theta - SLOPE)
        phiddot = np.sin(phi) * (thetadot**2 - np.cos(theta - SLOPE)) + thetaddot
        return thetadot, phidot, thetaddot, phiddot

    def strikes(t, y):
        return y[1] - 2 * y[0] if y[0] < 0 else 1.0  # as above

    def stops(t, y):
        return y[2]

    def is_down(t, y):
        return y[0] + np.pi / 2

    for event in (strikes, stops, is_down):
        event.__dict__["terminal"] = True
    strikes.__dict__["direction"] = 1
    following, outcomes = np.full((len(xs), 2), np.nan), np.zeros(len(xs), np.int8)
    kinds = Outcome.STRIDE, Outcome.BACKWARD, Outcome.FORWARD
    for i, (theta, thetadot) in enumerate(xs):
        if not (0 < theta < np.pi / 4 and thetadot < 0):
            outcomes[i] = Outcome.OUTSIDE
            continue
        start = theta, 2 * theta, thetadot, (1 - np.cos(2 * theta)) * thetadot
        events = strikes, stops, is_down
        found = solve_ivp(
            field, (0, LONGEST), start, "DOP853", events=events, rtol=tolerance, atol=tolerance
        )
        (which,) = (k for k, times in enumerate(found.t_events) if len(times))
        outcomes[i] = kinds[which]
        if kinds[which] == Outcome.STRIDE:
            following[i] = after_strike(found.y[0, -1], found.y[2, -1])
    return following, outcomes


def followed(strides: Callable, xs: np.ndarray) -> tuple[np.ndarray, int]:
    """The fate of every start, and strides made: to a fall, or to within 1e-6 of a gait."""
    gait = strides(np.array([GAIT]))[0]
    for _ in range(60):
        gait = strides(gait)[0]
    fate, cells, made = np.zeros(len(xs), np.int8), np.arange(len(xs)), 0
    while len(cells):
        made += len(cells)
        xs, outcomes = strides(xs)
        fate[cells] = outcomes
        going = (outcomes == Outcome.STRIDE) & (np.abs(xs - gait).max(axis=1) > 1e-6)
        cells, xs = cells[going], xs[going]
    return fate, made


def timed(run: Callable):
    start = time.perf_counter()
    result = jax.block_until_ready(run())
    return time.perf_counter() - start, result


def spread(seconds: list[float], first: list[float]) -> str:
    ratio = np.array(seconds) / np.array(first)
    shown = [f"{one:.3g}" if one < 999 else f"{one:,.0f}" for one in sorted(ratio)]
    return f"{shown[len(shown) // 2]} ({shown[0]}-{shown[-1]})"


def main():
    parser = argparse.ArgumentParser(description="50,000 strides, against other integrators.")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--sample", type=int, default=200, help="strides by scipy")
    parser.add_argument("--side", type=int, default=1000, help="cells along a side of the basin")
    args = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    cores = cores or 1

    with np.load(REFERENCE) as data:
        theta, total = np.meshgrid(data["theta"], data["sum"], indexing="ij")
        names = "next_theta", "next_velocity", "outcome"
        *states, outcomes = (data[name].ravel() for name in names)
    xs = np.stack([theta.ravel(), (total - theta).ravel()], axis=1)
    states = np.stack(states, axis=1)
    walker = wj.SimplestWalker(SLOPE)
    some = np.sort(np.random.default_rng(0).choice(len(xs), args.sample, replace=False))

    def of_project(tolerance):
        wj.strides(walker, xs[:1])  # compiles
        return lambda: wj.strides(walker, xs, tolerance=tolerance)[:2]

    def of_stride(tolerance):
        one = lambda x: wj.stride(walker, x, tolerance=tolerance)[:2]
        return partial(jax.jit(jax.vmap(one)).lower(xs).compile(), xs)

    def of_diffrax(solver, tolerance, batch=None):
        one = plain(solver, tolerance)
        if batch is None:
            run = jax.jit(jax.vmap(one))
        else:
            run = jax.jit(lambda xs: jax.lax.map(one, xs, batch_size=batch))
        return partial(run.lower(xs).compile(), xs)

    with ProcessPoolExecutor(cores, mp_context=get_context("spawn")) as pool:

        def of_heyoka(size, tolerance):
            run = partial(shared_out, pool, cores, size, tolerance, xs)
            run()
            return run

        dopri8, tsit5 = diffrax.Dopri8(), diffrax.Tsit5()
        ways = {
            "walker_jax, 1e-11": partial(of_project, 1e-11),
            "walker_jax, 1e-12, its own": partial(of_project, None),
            "jit(vmap(stride)), 1e-11": partial(of_stride, 1e-11),
            **{
                f"heyoka, batches of {size}, 1e-11": partial(of_heyoka, size, 1e-11)
                for size in (8, 16, 32)
            },
            "vmap(diffeqsolve), Dopri8, 1e-12": partial(of_diffrax, dopri8, 1e-12),
            "the same, batches of 1000": partial(of_diffrax, dopri8, 1e-12, 1000),
            "vmap(diffeqsolve), Tsit5, 1e-11": partial(of_diffrax, tsit5, 1e-11),
            "scipy, DOP853, 1e-11, one core": lambda: partial(by_scipy, xs[some], 1e-11),
        }
        compiling, runs, accuracy, share = {}, {}, {}, {}
        for name, prepare in ways.items():
            compiling[name], runs[name] = timed(prepare)
            cells = some if name.startswith("scipy") else np.arange(len(xs))
            state, outcome = map(np.asarray, runs[name]())
            both = (outcomes[cells] == Outcome.STRIDE) & (outcome == Outcome.STRIDE)
            error = np.abs(state - states[cells])[both].max()
            accuracy[name] = error, int(np.sum(outcome != outcomes[cells]))
            share[name] = len(xs) / len(cells)
        rounds = [
            {name: share[name] * timed(run)[0] for name, run in runs.items()}
            for _ in range(args.repeats)
        ]

        print(
            f"{cores} cores, {processor()}; jax {jax.__version__}, diffrax {diffrax.__version__}, "
            f"heyoka {heyoka.__version__}; {len(xs)} strides, {args.repeats} repeats"
        )
        print(f"{'':33}{'seconds':>8}{'strides/s':>10}{'times as long':>20}", end="")
        print(f"{'compile':>9}{'error':>8}{'wrong':>6}")
        first = [times["walker_jax, 1e-11"] for times in rounds]
        for name in ways:
            seconds = [times[name] for times in rounds]
            median, (error, off) = np.median(seconds), accuracy[name]
            print(
                f"{name:33}{median:8.3f}{len(xs) / median:10,.0f}{spread(seconds, first):>20}"
                f"{compiling[name]:9.1f}{error:8.0e}{off:6d}"
            )

        side = args.side
        grid = wj.Grid.sheared(theta=(0, 0.4, side), sum=(-0.04, 0.01, side))
        starts = np.asarray(jax.jit(jax.vmap(grid.centre))(np.arange(grid.size)))
        ours = lambda xs: wj.strides(walker, xs, tolerance=1e-11)[:2]
        theirs = partial(shared_out, pool, cores, 16, 1e-11)
        both = {"walker_jax, 1e-11": ours, "heyoka, batches of 16, 1e-11": theirs}
        repeats = {name: [] for name in both}
        for strides in both.values():
            followed(strides, starts[:: side // 2])  # compiles
        for _ in range(3):
            for name, strides in both.items():
                repeats[name].append(timed(lambda strides=strides: followed(strides, starts)))
        print(f"\nA basin of {side} x {side} cells, followed directly; 3 repeats")
        print(f"{'':33}{'seconds':>8}{'strides/s':>10}{'times as long':>20}{'walk':>8}")
        for name, results in repeats.items():
            seconds = [one for one, _ in results]
            first = [one for one, _ in repeats["walker_jax, 1e-11"]]
            fate, made = results[0][1]
            walk = int((fate == Outcome.STRIDE).sum())
            median = np.median(seconds)
            print(
                f"{name:33}{median:8.2f}{made / median:11,.0f}{spread(seconds, first):>21}{walk:8d}"
            )


def processor() -> str:
    """The name of the processor, where the system tells."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    names = [line.split(":")[1].strip() for line in lines if line.startswith("model name")]
    return (names or [platform.processor()])[0]


if __name__ == "__main__":
    main()

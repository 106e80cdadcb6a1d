"""How large could the basin be? Passive, with a spring, with feedback, and with any control.

The systems are the simplest walker with push-off, with a motor that turns a spring in its hip, and
with both; a walker on round feet with push-off; and the spring-mass runner with its angle of
attack. All areas of a system are of the same window:

- `passive`: area of the basin without actions, by cell mapping;
- `spring`: area of the largest basin with a spring, in the hip of a walker or the leg of a runner,
  with the best of 41 stiffnesses;
- `constant`: area of the largest basin with the same action at every stride;
- `linear`: area of the largest basin with linear feedback from the state within the same limits,
  parameters c + K x, by differential evolution of c and K from the best constant action on;
- `1`, `2`: area of states that lead into the passive basin within this many strides (1- and 2-step
  capturable);
- `kernel`: area of the viability kernel, from which some choice of actions goes on for ever, and
  its bounds by the images of whole cells;
- `policy`, `effort`: area of the basin of `Policy`, with the fewest strides and with the least
  effort, followed directly;
- `strides`: the most strides that the policy of fewest strides takes into the passive basin.

The best of each kind is searched for on coarser grids.

Then come strides to a fall on rough ground, for given standard deviations of steps, with 95 %
intervals: by 10,000 walks (100,000 in the first row) of at most 300 strides, of the passive walker,
of the one with that linear feedback, and of the one with the policy of the most steps to a fall,
from a grid half as fine. These begin in the passive gait; those of the last column begin where the
policy leads to on even ground.

Then the convergence of areas with the grid. Last comes a kernel of a million cells and 64 actions,
with its strides alone for comparison: on two cores 31.6 s without bounds, 85.4 s with bounds, and
0.4 s; and bounds on grids with the same finest cells that begin coarser.
"""

import argparse
import os
import time
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import differential_evolution

import walker_jax as wj
from walker_jax import figures
from walker_jax.systems.outcomes import names_in

jax.config.update("jax_enable_x64", True)  # before the walkers are made

PUSH, HIP = {"push_off": (0.0, 0.1, 33)}, {"hip_angle": (-0.8, 0.0, 33)}
BOTH = {"hip_angle": (-0.8, 0.0, 33), "push_off": (0.0, 0.1, 4)}
EVEN = {"hip_angle": (-0.8, 0.0, 9), "push_off": (0.0, 0.1, 9)}
"""Of both motors too, for rough ground."""
SPRING = {"hip_stiffness": 2.0}
WINDOW = {"theta": (0.0, 0.8, 400), "sum": (-0.4, 0.05, 450)}
CASES = {
    "simplest 0.004, push-off": (wj.PoweredWalker(0.004), PUSH, WINDOW, 5e-4, 100_000),
    "simplest 0.009, push-off": (wj.PoweredWalker(0.009), PUSH, WINDOW, 5e-4, 10_000),
    "simplest 0.004, spring 2, angle": (
        wj.PoweredWalker(0.004, **SPRING),
        HIP,
        WINDOW,
        1e-3,
        10_000,
    ),
    "simplest 0.004, both": (wj.PoweredWalker(0.004, **SPRING), BOTH, WINDOW, 1e-3, 10_000),
    "simplest 0.009, both": (wj.PoweredWalker(0.009, **SPRING), BOTH, WINDOW, None, 0),
    "round feet 0.004, push-off": (
        wj.PoweredRoundFootWalker(0.004),
        {"push_off": (0.0, 0.1, 9)},
        {"theta": (0.0, 0.5, 50), "sum": (-0.3, 0.05, 70), "phidot": (-0.6, 0.3, 30)},
        1e-3,
        10_000,
    ),
    "runner, angle": (
        wj.systems.SpringMassRunner(),
        {"angle": (0.8, 1.5, 141)},
        {"apex": (0.7, 2.2, 3000)},
        None,
        0,
    ),
}
STIFFNESSES = {"hip_stiffness": (0.0, 20.0), "hip_spring": (0.0, 1.0), "stiffness": (10.0, 60.0)}
LIMIT = 300


class FeedbackRunner(wj.System):
    """The runner with linear feedback from the height of its apex to its angle of attack."""

    angle: float
    angle_per_apex: float
    section = ("apex",)

    def advance(self, x):
        angle = jnp.clip(self.angle + self.angle_per_apex * (x[0] - 1), 0.8, 1.5)
        return wj.stride(wj.systems.SpringMassRunner(angle=angle), x)[:3]

    def gait_region(self):
        return wj.systems.SpringMassRunner().gait_region()


def main():
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--only", default="", help="rows whose labels begin with this")
    parser.add_argument("--picture", help="a file to draw the simplest walker with both motors in")
    parser.add_argument("--without-convergence", action="store_true")
    parser.add_argument("--without-speed", action="store_true")
    args = parser.parse_args()
    if args.picture:
        return draw(args.picture)
    names = "passive spring constant linear 1 2 kernel at-least at-most policy effort strides"
    print(f"{'':32}{''.join(f'{name:>10}' for name in names.split())}")
    rough = []
    for label, (walker, actions, axes, ground, walks) in CASES.items():
        if not label.startswith(args.only):
            continue
        grid, coarse = make_grid(axes), make_grid(axes, 0.25 if len(axes) == 2 else 0.5)
        data = wj.viable(walker, grid, actions)
        steered = linear_feedback(walker, data, grid, coarse)
        print_areas(label, walker, data, steered, grid, coarse)
        if ground is not None:
            chosen = EVEN if actions is BOTH else actions
            half = wj.viable(walker, make_grid(axes, 0.5), chosen, bounds=False)
            rough.append((label, ground, walks, walker, steered, half))
    titles = f"{'ground':>8}{'passive':>24}{'linear':>24}{'policy':>24}{'policy, settled':>28}"
    print(f"\n{'strides to a fall':32}{titles}")
    for label, *about in rough:
        print(f"{label:32}{lives(*about)}", flush=True)
    if not args.without_convergence:
        converge()
    if not args.without_speed:
        measure()
        measure_levels()


def draw(path: str) -> None:
    """The basins of the fourth row within each other."""
    walker, actions, axes, *_ = CASES["simplest 0.004, both"]
    grid, coarse = make_grid(axes), make_grid(axes, 0.25)
    data = wj.viable(walker, grid, actions)
    basins = {
        "best spring alone": wj.basin(
            max(with_springs(walker), key=lambda one: area(one, coarse)), grid
        ),
        "linear feedback": wj.basin(linear_feedback(walker, data, grid, coarse), grid),
        "policy": wj.basin(wj.Policy(walker, data), grid, "direct"),
    }
    figures.capturability(data, basins).figure.savefig(path, dpi=150)


def make_grid(axes: dict, finer: float = 1) -> wj.Grid:
    make = wj.Grid.sheared if "sum" in axes else wj.Grid.plain
    return make(**{name: (low, high, int(n * finer)) for name, (low, high, n) in axes.items()})


def lives(ground, walks, walker, steered, data) -> str:
    """Strides to a fall of a walker, with feedback, and with a policy from two starts."""
    policy: Any = wj.Policy(walker, data, "steps-to-fall", ground=ground)
    gait = wj.find_gait(walker)
    settled = gait._replace(states=wj.walk(policy, gait.states[0], 200).states[-1:])
    words = f"{ground:8g}"
    for one, start in ((walker, gait), (steered, gait), (policy, gait), (policy, settled)):
        key = jax.random.key(45)
        life = wj.steps_to_fall(one, ground, walks, key, gait=start, limit=LIMIT)
        words += f"{f'{life.mean:.5g} ({life.low:.5g}, {life.high:.5g})':>24}"
    return words


def print_areas(label, walker, data, steered, grid, coarse) -> None:
    """A row of the table."""
    capture, about = data["capture"].values, data.attrs
    actions = [with_action(walker, data, k) for k in range(data.sizes["action_number"])]
    spring, constant = (
        max(area(one, grid) for one in sorted(tried, key=lambda one: area(one, coarse))[-4:])
        for tried in (with_springs(walker), actions)
    )
    within = [float(((capture >= 0) & (capture <= n)).sum() * grid.cell_area) for n in (1, 2)]
    row = [about["target_area"], spring, constant, area(steered, grid), *within]
    row += [about["area"], about["inner_area"], about["outer_area"]]
    row += [
        area(wj.Policy(walker, data, objective), grid, "direct")
        for objective in ("fewest-strides", "least-effort")
    ]
    print(f"{label:32}{''.join(f'{x:10.4g}' for x in row)}{capture.max():10}", flush=True)


def area(walker, grid, method: str = "cell-map") -> float:
    return sum(wj.basin(walker, grid, method).attrs["area"])


def with_springs(walker):
    """The system with each stiffness of its spring, without a motor."""
    (name,) = {*STIFFNESSES} & {*vars(walker)}
    low, high = STIFFNESSES[name]
    return [change(walker, **{name: value}) for value in np.linspace(low, high, 41)]


def with_action(walker, data, number: int):
    names = names_in(data, "actions")
    return change(walker, **{name: float(data[name][number]) for name in names})


def change(walker, **values):
    return type(walker)(**vars(walker) | values)


def linear_feedback(walker, data, grid, coarse):
    """The system with the linear feedback of the largest basin that is found."""
    names = names_in(data, "actions")
    limits = {name: (float(data[name].min()), float(data[name].max())) for name in names}
    actions = [with_action(walker, data, k) for k in range(data.sizes["action_number"])]
    best = max(actions, key=lambda one: area(one, coarse))
    if isinstance(walker, wj.systems.SpringMassRunner):
        steered, gains = FeedbackRunner(float(best.angle), 0.0), {"angle_per_apex": (-2.0, 2.0)}
    else:
        gait, zeros = wj.find_gait(walker), np.zeros(len(walker.section))
        steered = wj.Feedback(best, gait, dict.fromkeys(names, zeros), limits)
        width = {name: 20 * (high - low) for name, (low, high) in limits.items()}
        gains = {
            f"{name}_per_{one}": (-width[name], width[name])
            for name in names
            for one in walker.section
        }
    free = limits | gains
    loss = lambda place: -area(change(steered, **dict(zip(free, place, strict=True))), coarse)
    begin = [float(vars(steered)[name]) for name in free]
    found = differential_evolution(
        loss, [*free.values()], x0=begin, rng=0, maxiter=12, popsize=6, tol=0, polish=False
    )
    order = np.argsort(found.population_energies)[:6]
    places = [begin, *found.population[order]]  # on coarse cells the best may be an artefact
    every = [change(steered, **dict(zip(free, map(float, one), strict=True))) for one in places]
    return max(every, key=lambda one: area(one, grid))


def converge() -> None:
    """The kernel's area and both bounds over grids each twice as fine as the one before."""
    walker, actions = wj.PoweredWalker(0.004), {"push_off": (0.0, 0.08, 33)}
    found = []
    print(f"\n{'cells':>10}{'kernel':>12}{'at-least':>12}{'at-most':>12}")
    for finer in (1, 2, 4, 8, 16):
        axes = {"theta": (0.05, 0.45, 40 * finer), "sum": (-0.05, 0.01, 48 * finer)}
        about = wj.viable(walker, wj.Grid.sheared(**axes), actions).attrs
        found.append([about[name] for name in ("area", "inner_area", "outer_area")])
        words = "".join(f"{x:12.6g}" for x in found[-1])
        print(f"{40 * finer:>5} x{48 * finer:>4}{words}", flush=True)
    kernel, inner, outer = np.array(found).T
    for name, gaps in {
        "between bounds": outer - inner,
        "lower bound to the finest kernel": kernel[-1] - inner,
        "upper bound to the finest kernel": outer - kernel[-1],
        "kernel to the finest one": np.abs(kernel - kernel[-1])[:-1],
    }.items():
        rate = -np.polyfit(np.arange(len(gaps)), np.log2(gaps), 1)[0]
        print(f"{name}: the power {rate:.2f} of the size of cells")


def measure() -> None:
    """Seconds for a million cells and 64 actions, and for as many strides."""
    grid = wj.Grid.sheared(theta=(0.0, 0.8, 1000), sum=(-0.4, 0.05, 1000))
    walker, actions = wj.PoweredWalker(0.004), {"push_off": (0.0, 0.1, 64)}
    x = grid.centres(np.arange(grid.size))
    wj.strides(walker, x[:1000])
    wj.viable(walker, wj.Grid.sheared(theta=(0, 1, 9), sum=(0, 1, 9)), actions)
    seconds = {}
    for name, work in {
        "a million strides": lambda: wj.strides(walker, x),
        "kernel, without bounds": lambda: wj.viable(walker, grid, actions, bounds=False),
        "kernel, with bounds": lambda: wj.viable(walker, grid, actions),
    }.items():
        start = time.perf_counter()
        work()
        seconds[name] = time.perf_counter() - start
    print(f"{os.cpu_count()} cores; jax {jax.__version__}; 1,000,000 cells, 64 actions")
    for name, value in seconds.items():
        print(f"{name:24}{value:8.1f} s")


def measure_levels() -> None:
    """Cells, areas and seconds of bounds that are narrowed level by level."""
    walker, actions = wj.PoweredWalker(0.004), {"push_off": (0.0, 0.1, 17)}
    names = "cells levels mapped at-least at-most area seconds".split()
    print("".join(f"{name:>10}" for name in names))
    for levels in range(4):
        side = 800 // 2**levels
        grid = wj.Grid.sheared(theta=(0.0, 0.8, side), sum=(-0.4, 0.05, side))
        start = time.perf_counter()
        data = wj.viable(walker, grid, actions, levels=levels)
        seconds, about = time.perf_counter() - start, data.attrs
        areas = "".join(f"{about[name]:10.4g}" for name in ("inner_area", "outer_area", "area"))
        print(f"{grid.size:10}{levels:10}{int(data['mapped'].sum()):10}{areas}{seconds:10.1f}")


if __name__ == "__main__":
    main()

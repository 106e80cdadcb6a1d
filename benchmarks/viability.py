"""How large could the basin be? Passive, with the best constant action, and with any control.

For the simplest walker with push-off, with a torque in its hip, and with both; for one on round
feet with push-off; and for the spring-mass runner with its angle of attack. All areas are of one
window each:

- `passive`: of the basin without actions, by cell mapping;
- `constant`: of the largest basin that one of the actions has if it is taken at every stride;
- `1`, `2`: of states that lead into the passive basin within so many strides (1- and 2-step
  capturable);
- `kernel`: of the viability kernel, from which some choice of actions goes on for ever, and what it
  is at least and at most by what cells do as a whole;
- `policy`: of the basin of the walker whose actions are `Policy`'s, followed directly.

Then a kernel of a million cells and 64 actions, and strides alone for comparison; and bounds on
grids of the same finest cells, which are coarser at first.
"""

import argparse
import os
import time

import jax
import numpy as np

import walker_jax as wj

PUSH, HIP = {"push_off": (0.0, 0.1, 33)}, {"hip_angle": (-0.8, 0.0, 33)}
BOTH = {"hip_angle": (-0.8, 0.0, 9), "push_off": (0.0, 0.1, 9)}
SPRING = {"hip_stiffness": 2.0}
WINDOW = {"theta": (0.0, 0.8, 400), "sum": (-0.4, 0.05, 450)}
CASES = {
    "simplest 0.004, push-off": (wj.PoweredWalker(0.004), PUSH, WINDOW),
    "simplest 0.009, push-off": (wj.PoweredWalker(0.009), PUSH, WINDOW),
    "simplest 0.004, spring 2, angle": (wj.PoweredWalker(0.004, **SPRING), HIP, WINDOW),
    "simplest 0.004, both": (wj.PoweredWalker(0.004, **SPRING), BOTH, WINDOW),
    "simplest 0.009, both": (wj.PoweredWalker(0.009, **SPRING), BOTH, WINDOW),
    "round feet 0.004, push-off": (
        wj.PoweredRoundFootWalker(0.004),
        {"push_off": (0.0, 0.1, 9)},
        {"theta": (0.0, 0.5, 50), "sum": (-0.3, 0.05, 70), "phidot": (-0.6, 0.3, 30)},
    ),
    "runner, angle": (
        wj.SpringMassRunner(),
        {"angle": (0.8, 1.5, 141)},
        {"apex": (0.7, 2.2, 3000)},
    ),
}


def main():
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--without-speed", action="store_true")
    args = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    names = "passive constant 1 2 kernel at-least at-most policy strides".split()
    print(f"{'':32}{''.join(f'{name:>10}' for name in names)}")
    for label, (walker, actions, axes) in CASES.items():
        make = wj.Grid.sheared if "sum" in axes else wj.Grid.plain
        grid = make(**axes)
        data = wj.viable(walker, grid, actions)
        capture, cell = data["capture"].values, grid.cell_area
        constant = max(area_of(walker, grid, data, number) for number in actions_of(data))
        followed = wj.basin(wj.Policy(walker, data), grid, "direct")
        within = [float(((capture >= 0) & (capture <= n)).sum() * cell) for n in (1, 2)]
        about = data.attrs
        row = [about["target_area"], constant, *within, about["area"], about["inner_area"]]
        row += [about["outer_area"], sum(followed.attrs["area"])]
        print(f"{label:32}{''.join(f'{x:10.4g}' for x in row)}{capture.max():10}", flush=True)
    if not args.without_speed:
        measure()
        measure_levels()


def actions_of(data) -> range:
    return range(data.sizes["action_number"])


def area_of(walker, grid, data, number: int) -> float:
    """The area of the basins with one action at every stride."""
    values = {name: float(data[name][number]) for name in data.attrs["actions"]}
    acting = type(walker)(**{name: value for name, value in vars(walker).items()} | values)
    return sum(wj.basin(acting, grid).attrs["area"])


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

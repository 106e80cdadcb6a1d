"""Do MuJoCo's steps approach a robot's strides, and how long does a robot from a file compile?

compass.xml starts at its gait, once with the contacts of this package, which neither give nor slip,
and once in MuJoCo's time steps, with its soft contacts. Errors are of angles (rad): in the swing,
and after the heel strike of the second foot. Then five_link.xml, with the controller of
five_link.py, against systems.FiveLinkBiped, written by hand: the time until a first stride is
done, each compiled anew, in turns. Three minutes on one core.

The answer: to first order in the time constant of contacts, also after the impact if the time step
shrinks as the square: with a step of a fixed share of the time constant, the error of an impact
depends on when in a step it begins. A robot from a file takes 1.2 times as long as one by hand.

| time constant (s) | step (s) | swing | order | after impact | order |
| 0.02 | 0.0005 | 6.4e-04 | | 8.5e-03 | |
| 0.01 | 0.000125 | 3.2e-04 | 1.0 | 4.1e-03 | 1.1 |
| 0.005 | 3.125e-05 | 1.6e-04 | 1.0 | 1.7e-03 | 1.3 |
| 0.0025 | 7.8125e-06 | 8.0e-05 | 1.0 | 8.0e-04 | 1.1 |
| robot | first stride (s) |
| file | 4.0 |
| hand | 3.3 |
| file | 4.2 |
| hand | 3.5 |
"""

import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import jax
import numpy as np

jax.config.update("jax_enable_x64", True)
ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests" / "helpers"))

import mujoco_strides  # noqa: E402 (after the path to it)
import robot_examples  # noqa: E402 (after the path to it)
from robot_examples import FILES, as_robot  # noqa: E402 (after the path to it)

import walker_jax as wj  # noqa: E402 (after the precision is set)
from walker_jax import systems  # noqa: E402 (after the precision is set)

TIMES = 0.7, 1.2


def approach() -> None:
    """Print errors of MuJoCo's steps."""
    robot = wj.robot(FILES / "compass.xml")
    gait = wj.find_gait(robot, as_robot((0.2880980750, -0.3570541806, -0.2028504303)))
    period = float(gait.step_times[0])
    motion = wj.export_motion(robot, gait.states[0], mujoco_strides.PATH, strides=2, rate=1000)
    print("| time constant (s) | step (s) | swing | order | after impact | order |")
    before: Any = None
    for halving in range(4):
        tau, step = 0.02 / 2**halving, 5e-4 / 4**halving
        how: dict[str, float] = {"time_constant": tau, "step": step}
        errors = np.array(mujoco_strides.largest_errors(motion, TIMES, period, **how))
        orders = ["", ""] if before is None else [f"{one:.1f}" for one in np.log2(before / errors)]
        cells = (f"{e:.1e} | {order}" for e, order in zip(errors, orders, strict=True))
        print(f"| {tau:g} | {step:g} | {' | '.join(cells)} |")
        before = errors


def first_stride(name: str) -> None:
    """Print the time until a first stride is done, in a process that has no programs."""
    made = {"file": robot_examples.five_link, "hand": systems.FiveLinkBiped}[name]
    machine, x = made(), np.array(robot_examples.BIPED_GAIT)
    begun = time.perf_counter()
    jax.block_until_ready(wj.stride(machine, x))
    print(f"| {name} | {time.perf_counter() - begun:.1f} |")


def compilation() -> None:
    """Print the times of first strides of both, in turns, without programs on disk."""
    print("| robot | first stride (s) |", flush=True)
    for name in ("file", "hand") * 2:
        alone = os.environ | {"WALKER_JAX_CACHE_DIR": ""}
        subprocess.run([sys.executable, __file__, name], check=True, env=alone)


if __name__ == "__main__":
    if len(sys.argv) > 1:
        first_stride(sys.argv[1])
    else:
        approach()
        compilation()

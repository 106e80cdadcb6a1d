"""How long do curves of bifurcations, charts and Lyapunov exponents take, and how exact are they?

The doubling of the simplest walker's gait is followed over the stiffness of a spring at its hip,
from 0 to 0.25 and to 1, where its slope is known from other programs (`tests/data/systems.json`).
The chart has the defaults of `walker-jax chart`. Exponents are those of the walker at a slope of
0.0185, and of the map of Hénon, compared with a plain loop over `numpy.linalg.qr`. `first` is the
first call of a process, which compiles, and `next` the second.

The answer: curves agree with the other programs to their last digit, and take half a second. A
chart takes six seconds. The loop takes a thousand times as long for a stride of Hénon's map. With
no machine code on disk, `walker-jax chart` takes 19 s of processor time for the spring, and 47 s
for round feet.

    2 cores, shared with others; jax 0.10.2
                                first (s)   next (s)   error
    doubling, no spring                   2.8       1.76
    doublings to stiffness 0.25           0.4       0.35   3.7e-14
    doublings to stiffness 1              0.4       0.32   1.4e-15
    chart of 120 x 90 cells               7.7       6.45
    exponents of the walker               0.5       0.49   0.1 sigma
    exponents of Hénon's map              0.1       0.02   0.2 sigma
    a loop over numpy.linalg.qr takes 1,345 times as long a stride
"""

import argparse
import json
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np

import walker_jax as wj

REFERENCE = Path(__file__).parents[1] / "tests" / "data" / "systems.json"
BOUNDS = {"slope": (0.001, 0.1), "hip_stiffness": (0.0, 1.0)}


def timed(call: Callable[[], Any]) -> tuple[Any, float, float]:
    """The result of a call, and the seconds that it takes at first and again."""
    seconds = []
    for _ in range(2):
        start = time.perf_counter()
        result = call()
        seconds.append(time.perf_counter() - start)
    return result, *seconds


def loop_over_qr(strides: int) -> np.ndarray:
    """The exponents of Hénon's map from a loop in Python."""
    x, frame, sums = np.array([0.1, 0.1]), np.eye(2), np.zeros(2)
    for _ in range(strides):
        jacobian = np.array([[-2.8 * x[0], 1.0], [0.3, 0.0]])
        x = np.array([1 - 1.4 * x[0] ** 2 + x[1], 0.3 * x[0]])
        frame, factor = np.linalg.qr(jacobian @ frame)
        sums += np.log(np.abs(np.diag(factor)))
    return sums / strides


def main():
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--strides", type=int, default=20_000, help="of each walk, of Hénon's map")
    args = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    known = json.loads(REFERENCE.read_text())
    walker = wj.SpringWalker(0.012, hip_stiffness=0.0)
    branch, *seconds = timed(lambda: wj.continue_gait(walker, "slope", (0.012, 0.02)))
    (doubling,) = branch.doublings
    print(f"{len(os.sched_getaffinity(0))} cores; jax {jax.__version__}")
    print("                                first (s)   next (s)   error")
    print(f"doubling, no spring            {seconds[0]:10.1f}{seconds[1]:11.2f}")
    for one in known["period_doubling"]["values"].values():
        k = float(one["k"])
        bounds = BOUNDS | {"hip_stiffness": (0.0, k)}
        curve, *seconds = timed(lambda b=bounds: wj.continue_event(walker, doubling, bounds=b))
        error = abs(curve.values[-1, 0] - one["slope_doubling"])
        print(f"doublings to stiffness {k:<8g}{seconds[0]:10.1f}{seconds[1]:11.2f}   {error:.1e}")
    _, *seconds = timed(lambda: wj.chart(wj.SpringWalker(0.012, hip_stiffness=0.2), BOUNDS))
    print(f"chart of 120 x 90 cells        {seconds[0]:10.1f}{seconds[1]:11.2f}")
    steep = wj.SimplestWalker(0.0185)
    start = np.asarray(wj.find_gait(steep).states[0])
    found, *seconds = timed(lambda: wj.lyapunov(steep, start))
    exact = np.array(known["lyapunov"]["values"]["0.0185"]["exponents"])
    sigmas = np.abs(found.exponents - exact).max() / found.errors[0]
    print(
        f"exponents of the walker        {seconds[0]:10.1f}{seconds[1]:11.2f}   {sigmas:.1f} sigma"
    )
    henon = wj.HenonMap()
    run = lambda: wj.lyapunov(henon, np.array([0.1, 0.1]), args.strides)
    found, *seconds = timed(run)
    sigmas = abs(found.exponents[0] - known["henon_lyapunov"]["l1"]) / found.errors[0]
    print(
        f"exponents of Hénon's map       {seconds[0]:10.1f}{seconds[1]:11.2f}   {sigmas:.1f} sigma"
    )
    _, _, by_loop = timed(lambda: loop_over_qr(20_000))
    ours = seconds[1] / (32 * (args.strides + 500))
    print(
        f"a loop over numpy.linalg.qr takes {by_loop / 20_000 / ours:,.0f} times as long a stride"
    )


if __name__ == "__main__":
    main()

"""How long do curves of bifurcations, charts and Lyapunov exponents take, and how exact are they?

The doubling of the simplest walker's gait is followed over the stiffness of a spring at its hip,
from 0 to 0.25 and to 1, where its slope is known from other programs (`tests/data/systems.json`).
The chart has the defaults of `walker-jax chart`. Exponents are those of the walker at a slope of
0.0185, and of the map of Hénon, compared with a plain loop over `numpy.linalg.qr`. `first` is the
first call of a process, which compiles, and `next` the second.

Two peers do the same for the map of Hénon where they are installed (`pip install bifpy
pynamicalsys`, and gfortran for the former): AUTO-07p, in Fortran, follows the doubling of its fixed
point from b = 0.3 to -1, and pynamicalsys, compiled by Numba, computes the exponents of one walk.
Of these the fastest of eight calls counts. PyDSTool 0.91 does not load beside NumPy 2, jaxcont 0.4
has no maps, and no package index at hand has BifurcationKit, COCO or MATCONT.

The answer: curves agree with the other programs to their last digit, and take half a second. A
chart takes six seconds. The loop takes a thousand times as long for a stride of Hénon's map. AUTO
takes about as long as this package; its file of results has ten digits. With no machine code on
disk, `walker-jax chart` takes 19 s of processor time for the spring, and 47 s for round feet.

    2 cores, shared with others; jax 0.10.2
                                first (s)   next (s)   error
    doubling, no spring                   2.8       1.76
    doublings to stiffness 0.25           0.4       0.35   3.7e-14
    doublings to stiffness 1              0.4       0.32   1.4e-15
    chart of 120 x 90 cells               7.7       6.45
    exponents of the walker               0.5       0.49   0.1 sigma
    exponents of Hénon's map              0.1       0.02   0.2 sigma
    a loop over numpy.linalg.qr takes 1,345 times as long a stride
    doublings of Hénon's map, 37 points             0.245 s, error 4e-16
      by AUTO-07p 0.240 s (1.0 times as long), error 1e-09
    exponents by pynamicalsys: 18 to 45 times as long a stride, error 5e-04
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
AGAIN = 8
"""Calls of the peers, and of this package beside them, of which the fastest counts."""
BOUNDS = {"slope": (0.001, 0.1), "hip_stiffness": (0.0, 1.0)}


def timed(call: Callable[[], Any], again: int = 1) -> tuple[Any, float, float]:
    """The result of a call, and the seconds that it takes at first, and at least of those again."""
    seconds = []
    for _ in range(1 + again):
        start = time.perf_counter()
        result = call()
        seconds.append(time.perf_counter() - start)
    return result, seconds[0], min(seconds[1:])


def loop_over_qr(strides: int) -> np.ndarray:
    """The exponents of Hénon's map from a loop in Python."""
    x, frame, sums = np.array([0.1, 0.1]), np.eye(2), np.zeros(2)
    for _ in range(strides):
        jacobian = np.array([[-2.8 * x[0], 1.0], [0.3, 0.0]])
        x = np.array([1 - 1.4 * x[0] ** 2 + x[1], 0.3 * x[0]])
        frame, factor = np.linalg.qr(jacobian @ frame)
        sums += np.log(np.abs(np.diag(factor)))
    return sums / strides


def doublings_by_auto() -> float:
    """Follow the doublings of the fixed point by AUTO-07p; the largest error of a on the curve."""
    from bifpy import auto  # pyright: ignore[reportMissingImports] (no dependency)

    def advance(state, parameters):
        (x, y), (a, b) = state, parameters[:2]
        return [1 - a * x**2 + y, b * x]

    def begin(state, parameters, _):
        x = (-0.7 + np.sqrt(0.7**2 + 0.4)) / 0.2
        state[0], state[1], parameters[0], parameters[1] = x, 0.3 * x, 0.1, 0.3

    how = {"ips": auto.IPS_MAP, "ndim": 2, "npar": 2, "nmx": 400, "isp": 2, "iads": 1, "jac": 0}
    how |= {"itmx": 9, "itnw": 7, "epsl": 1e-10, "epsu": 1e-10, "epss": 1e-8}
    steps = {"ds": 0.01, "dsmin": 1e-5, "dsmax": 0.05, "rl0": 0.0, "rl1": 1.3}
    found = auto.run(advance, begin, how | steps, icu=[1])
    points = [one for branch in found.branches for one in branch.points]
    (doubling,) = [one for one in points if "DOUBLING" in str(one.point_type)]
    steps = {"ds": -0.02, "dsmin": 1e-5, "dsmax": 0.2, "rl0": -1.0, "rl1": 0.31}
    curve = auto.restart(advance, how | steps, doubling, icu=[2, 1], isw=2, stpnt=begin)
    points = [one for branch in curve.branches for one in branch.points]
    b, a = np.array([list(one.parameters)[:2] for one in points]).T
    return float(np.abs(a - 0.75 * (1 - b) ** 2).max())


def exponents_by_pynamicalsys(strides: int) -> np.ndarray:
    """The exponents of Hénon's map from one walk of pynamicalsys."""
    import pynamicalsys  # pyright: ignore[reportMissingImports] (no dependency)

    system = pynamicalsys.DiscreteDynamicalSystem(model="henon map")
    return system.lyapunov([0.1, 0.1], strides, parameters=[1.4, 0.3], transient_time=500)


def timed_if_installed(call: Callable[[], Any]) -> tuple[Any, float] | None:
    """The result of a call of a peer, and the seconds that it takes again; None without it."""
    try:
        result, _, seconds = timed(call, AGAIN)
    except ImportError:
        return None
    return result, seconds


def beside_peers(auto: tuple[float, float] | None, strides: int, known: dict) -> None:
    """This package on the map of Hénon, and the peers that are installed in the same run."""
    system = wj.systems.HenonMap(0.1, 0.3)
    branch = wj.continue_gait(system, "a", (0.0, 1.3), wj.find_gait(system, [[0.9, 0.27]]))
    (doubling,) = branch.doublings
    system, bounds = wj.systems.HenonMap(doubling.value, 0.3), {"a": (0.3, 4.0), "b": (-1.0, 0.3)}
    curve, _, own = timed(lambda: wj.continue_event(system, doubling, ("a", "b"), bounds), AGAIN)
    a, b = curve.values.T
    error = np.abs(a - 0.75 * (1 - b) ** 2).max()
    print(f"doublings of Hénon's map, {len(a)} points             {own:.3f} s, error {error:.0e}")
    if auto is None:
        print("  AUTO-07p (bifpy) is not installed")
    else:
        error, peer = auto
        print(f"  by AUTO-07p {peer:.3f} s ({peer / own:.1f} times as long), error {error:.0e}")
    _, _, own = timed(
        lambda: wj.lyapunov(wj.systems.HenonMap(), np.array([0.1, 0.1]), strides), AGAIN
    )
    found = timed_if_installed(lambda: exponents_by_pynamicalsys(strides))
    if found is None:
        print("pynamicalsys is not installed")
    else:
        error, ratio = found[0][0] - known["henon_lyapunov"]["l1"], 32 * found[1] / own
        print(f"exponents by pynamicalsys: {ratio:.1f} times as long a stride, error {error:.0e}")


def main():
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--strides", type=int, default=20_000, help="of each walk, of Hénon's map")
    args = parser.parse_args()
    auto = timed_if_installed(doublings_by_auto)  # it forks, which JAX forbids once it computes
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
    henon = wj.systems.HenonMap()
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
    beside_peers(auto, args.strides, known)


if __name__ == "__main__":
    main()

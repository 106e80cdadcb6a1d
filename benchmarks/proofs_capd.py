"""Proofs beside CAPD: what does a verified stride cost, and how wide is its image?

    python benchmarks/proofs_capd.py CAPD_STRIDE

CAPD (Kapela, Mrozek, Wilczak and Zgliczynski 2021) is a C++ library of rigorous integrators for
ordinary differential equations in general. CAPD_STRIDE is the program of `capd_stride.cpp`, which
says how to build it. Boxes of some half width lie about the gait of the simplest walker at slope
0.004. Times are processor time on one core, of all boxes in one call for the package and of one box
after the other for CAPD, which takes turns with it and has its fastest order and tolerance of 35.

Measured on an AMD EPYC with AVX-512, with CAPD 6.1: microseconds of a stride, and the width of the
image over that of the true one (of points: itself). Of the boxes of half width 1e-3 the package
leaves 78 % open, CAPD's C0 all and its C1 none; widths are those of the others.

    half width   package         CAPD, C0         CAPD, C1, with derivatives
    0            15   3.9e-10    3059   8.9e-11   4400   1.1e-10
    1e-8         15   1.002      2304   1.000     4410   1.001
    1e-6         15   1.000      1407   1.002     3113   1.006
    1e-4         10   1.04       1104   1.15      3088   1.56
    3e-4          9   1.13       1042   1.57      4406   2.70
    1e-3          9   1.90        589   -         7487   7.52

Points with the accuracy of gaits' proofs, which run in NumPy: 2424 microseconds each, 1024 at once,
and 7e-15 wide; CAPD takes 6405, and is 5e-14 wide. Other work ran on the machine's two cores.
"""

import argparse
import os
import subprocess
import time
from typing import NamedTuple

import jax
import numpy as np

import walker_jax as wj
from walker_jax.proofs.boxes import PLANE, Trap, boxes_of, carry, upright_boxes
from walker_jax.proofs.enclosures import BALLS
from walker_jax.proofs.provable import check_provable, enclose_parameters
from walker_jax.proofs.returns import POINT_ACCURACY, verify_points
from walker_jax.proofs.strides import STRIDE, verify_stride

jax.config.update("jax_enable_x64", True)

WALKER = wj.SimplestWalker(0.004)
HALVES = (0.0, 1e-8, 1e-6, 1e-4, 3e-4, 1e-3)
ORDERS = (6, 8, 10, 12, 16, 20, 30)
TOLERANCES = (1e-8, 1e-10, 1e-12, 1e-15, 1e-18)
TRIED = 10
"""Boxes with which each order and tolerance is tried."""
MANY = 16384
"""Boxes in one call of the package."""


class Setting(NamedTuple):
    """How CAPD is used: C0 for the image, C1 for derivatives too."""

    kind: str
    order: int
    tolerance: float


class Found(NamedTuple):
    """Verified strides of some boxes."""

    widths: np.ndarray
    """Of the image in theta and thetadot; NaN where a box is open."""
    seconds: float
    """Processor time of a stride."""

    @property
    def open(self) -> float:
        return float(np.isnan(self.widths[:, 0]).mean())


def run_capd(program: str, setting: Setting, half: float, centres, rounds: int = 1) -> Found:
    given = [program, *map(str, setting), str(half), str(rounds)]
    starts = "\n".join(f"{theta!r} {thetadot!r}" for theta, thetadot in centres.tolist())
    done = subprocess.run(given, input=starts, capture_output=True, text=True, check=True)
    *lines, seconds = done.stdout.splitlines()
    bounds = [line.split() if line != "open" else ["nan"] * 4 for line in lines]
    low_high = np.asarray(bounds, float)
    return Found(low_high[:, 1::2] - low_high[:, ::2], float(seconds))


def run_own(half: float, centres, count: int) -> Found:
    """Strides of kernels as a basin's proof makes them; the images of the first boxes, before they
    are put into rectangles."""
    walker = check_provable(WALKER)
    theta, thetadot = upright_boxes(centres[:count].T, [np.full(count, half)] * 2)
    found = verify_stride(enclose_parameters(walker, PLANE), (theta, thetadot))
    widths = np.stack([one.upper - one.lower for one in found.state], -1)
    carry(walker, boxes_of(theta, thetadot), Trap.nowhere())  # compiles
    return Found(
        np.where((found.verdict == STRIDE)[:, None], widths, np.nan), time_own(half, centres)
    )


def time_own(half: float, centres) -> float:
    walker, halves = check_provable(WALKER), [np.full(len(centres), half)] * 2
    boxes = boxes_of(*upright_boxes(centres.T, halves))
    start = time.process_time()
    carry(walker, boxes, Trap.nowhere())
    return (time.process_time() - start) / len(centres)


def true_widths(half: float, centres) -> np.ndarray:
    """By plain strides from a grid of each box, its corners among them; zero for points."""
    if half == 0:
        return np.zeros_like(centres)
    place = np.linspace(-1, 1, 21)
    places = half * np.stack(np.meshgrid(place, place), -1).reshape(-1, 1, 2)
    starts = (centres + places).reshape(-1, 2)
    states = np.asarray(wj.strides(WALKER, starts, tolerance=1e-14).state)
    return np.ptp(states.reshape(len(places), -1, 2), axis=0)


def width_of(found: Found, true: np.ndarray) -> float:
    """The median width, over that of the true image; of points, the width itself."""
    ratios = found.widths / np.where(true > 0, true, 1.0)
    known = ratios[~np.isnan(ratios[:, 0])].mean(1)
    return float(np.median(known)) if len(known) else np.inf


def fastest(program: str, kind: str, half: float, centres, own: Found, true) -> Setting:
    """The fastest order and tolerance with no more open boxes than the package, and images no wider
    (by 1 %). If there is none: with the fewest open boxes, and nearly the narrowest (by 10 %)."""
    tried = []
    for order in ORDERS:
        for tolerance in TOLERANCES:
            setting = Setting(kind, order, tolerance)
            found = run_capd(program, setting, half, centres)
            tried.append((found.open, width_of(found, true), found.seconds, setting))
    most = 1.01 * width_of(own, true)
    as_good = [one for one in tried if one[0] <= own.open and one[1] <= most]
    if not as_good:
        proving = [one for one in tried if one[0] == min(tried)[0]]
        as_good = [one for one in proving if one[1] <= 1.1 * min(each[1] for each in proving)]
    return min(as_good, key=lambda one: one[2])[-1]


def told(found: Found, true: np.ndarray) -> str:
    width = width_of(found, true)
    size = f"{width:.3f} times" if true.any() else f"{width:.1e}"
    return f"{1e6 * found.seconds:7.1f} us, width {size}, open {found.open:.0%}"


def print_boxes(program: str, half: float, centres, count: int, repeats: int) -> None:
    """Both take turns, so that a busy machine slows both."""
    some, true = centres[:count], true_widths(half, centres[:count])
    own = run_own(half, centres, count)
    few = Found(own.widths[:TRIED], own.seconds)
    settings = [
        fastest(program, kind, half, some[:TRIED], few, true[:TRIED]) for kind in ("C0", "C1")
    ]
    found, times = [own, *(run_capd(program, one, half, some) for one in settings)], []
    for _ in range(repeats):
        capd = [run_capd(program, one, half, some).seconds for one in settings]
        times.append([time_own(half, centres), *capd])
    medians = [
        one._replace(seconds=float(s))
        for one, s in zip(found, np.median(times, axis=0), strict=True)
    ]
    print(f"half width {half:g}")
    print(f"  own                      {told(medians[0], true)}")
    for i, setting in enumerate(settings, 1):
        slower = np.median([each[i] / each[0] for each in times])
        name = f"CAPD {setting.kind} order {setting.order:2} {setting.tolerance:g}"
        print(f"  {name:24} {told(medians[i], true)}, {slower:.0f} times as long", flush=True)


def print_points(program: str, centres, count: int, repeats: int) -> None:
    """Points as accurately as for gaits, in NumPy: many at once, as single ones cost as much."""
    known, none = enclose_parameters(check_provable(WALKER), BALLS), np.zeros((1, 2))
    own = []
    for _ in range(repeats + 1):
        start = time.process_time()
        found = verify_points(known, centres)
        seconds = (time.process_time() - start) / len(centres)
        widths = np.stack([one.upper - one.lower for one in found.state], -1)
        own.append(Found(np.where((found.verdict == STRIDE)[:, None], widths, np.nan), seconds))
    setting = fastest(program, "C0", 0.0, centres[:TRIED], own[0], none)
    capd = [run_capd(program, setting, 0.0, centres[:count]) for _ in range(repeats)]
    print(f"points, order {POINT_ACCURACY.order}, {POINT_ACCURACY.tolerance:g}")
    for name, some in (("own", own[1:]), (f"CAPD {setting}", capd)):
        found = some[0]._replace(seconds=float(np.median([one.seconds for one in some])))
        print(f"  {name}: {told(found, none)}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("program", metavar="CAPD_STRIDE")
    parser.add_argument("--boxes", type=int, default=100)
    parser.add_argument("--repeats", type=int, default=5)
    options = parser.parse_args()
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})  # one core for both
    gait = np.asarray(wj.find_gait(WALKER).states[0])
    centres = gait + np.random.default_rng(1).normal(size=(MANY, 2)) * 5e-4
    for half in HALVES:
        print_boxes(options.program, half, centres, options.boxes, options.repeats)
    print_points(options.program, centres[:1024], options.boxes, options.repeats)

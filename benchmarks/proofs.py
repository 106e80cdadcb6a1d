"""Proofs: what do verified strides cost, how close are they, and does an independent checker agree?

    python benchmarks/proofs.py --boxes 1000

Verified strides are those of `prove_basin`: boxes of half a side `r` about the gait at slope 0.004,
as polynomials of second degree, without derivatives. `overestimation` is the radius of an enclosure
over the largest error of its polynomial at random points. The checker (tests/helpers) replays one
random start in each box of the proof of 99 % of the least disturbance, in interval arithmetic of 40
digits.

Measured on two cores busy with other work: 37,000 verified strides a second and 1,020,000 plain
ones, 27 times; overestimation 13 at r = 1e-5 and 11 at 1e-4, where at 1e-6 the tolerance of the
series is all of the radius; 36,217 strides and 5 s for 99 % of the least disturbance at slope
0.004.
"""

import argparse
import importlib
import sys
import time
from pathlib import Path
from typing import Any

import jax
import numpy as np

import walker_jax as wj
from walker_jax.proofs.boxes import PLANE, Boxes, Trap, carry
from walker_jax.proofs.enclosures import Enclosure, monomials
from walker_jax.proofs.provable import check_provable, enclose_parameters
from walker_jax.proofs.strides import verify_stride

sys.path.append(str(Path(__file__).parent.parent / "tests" / "helpers"))
checker: Any = importlib.import_module("interval_checker")  # a module of the tests
jax.config.update("jax_enable_x64", True)

WALKER = wj.SimplestWalker(0.004)
RADII = {0.004: 0.0022562, 0.009: 0.0022556}


def seconds(call, repeats: int) -> float:
    """The median time of a call, compiled before."""
    call()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        call()
        times.append(time.perf_counter() - start)
    return float(np.median(times))


def print_cost(repeats: int) -> None:
    walker, gait = check_provable(WALKER), np.asarray(wj.find_gait(WALKER).states[0])
    centres = gait + np.random.default_rng(1).normal(size=(16384, 2)) * 5e-4
    terms = np.concatenate([centres[..., None], np.tile(1e-5 * np.eye(2), (16384, 1, 1))], -1)
    boxes = Boxes(terms, np.zeros((16384, 2)))
    verified = seconds(lambda: carry(walker, boxes, Trap.nowhere()), repeats)
    plain = seconds(lambda: jax.block_until_ready(wj.strides(WALKER, centres)), repeats)
    rates = f"verified {16384 / verified:,.0f}/s, plain {16384 / plain:,.0f}/s"
    print(f"{rates}, {verified / plain:.0f} times")


def print_overestimation() -> None:
    known, gait = (
        enclose_parameters(check_provable(WALKER), PLANE),
        np.asarray(wj.find_gait(WALKER).states[0]),
    )
    rng = np.random.default_rng(2)
    for radius in (1e-6, 1e-5, 1e-4):
        centres = gait + rng.normal(size=(100, 2)) * 5e-4
        theta = Enclosure([centres[:, 0], radius, *[None] * 4], 0.0, PLANE)
        thetadot = Enclosure([centres[:, 1], None, radius, *[None] * 3], 0.0, PLANE)
        found = verify_stride(known, (theta, thetadot))
        off = 0.0
        for _ in range(200):
            u = rng.uniform(-1, 1, (100, 2))
            plain = np.asarray(wj.strides(WALKER, centres + radius * u, tolerance=1e-14).state)
            powers = [np.prod(u ** np.array(p), axis=1) for p in monomials(PLANE)]
            value = np.sum([t * p for t, p in zip(found.state[0].terms, powers, strict=True)], 0)
            off = np.maximum(off, np.abs(value - plain[:, 0]))
        one = found.state[0]
        sizes = f"radius {np.median(one.radius):.1e} of a spread of {np.median(one.spread):.1e}"
        print(f"r {radius:g}: {sizes}, overestimation {np.median(one.radius / off):.1f}")


def print_theorems(boxes: int, parts: list[float]) -> None:
    for slope, least in RADII.items():
        for part in parts:
            start = time.perf_counter()
            data = wj.prove_basin(wj.SimplestWalker(slope), part * least, levels=20)
            took = time.perf_counter() - start
            proved, strides = bool(data.attrs["all_walk"]), data.attrs["verified_strides"]
            print(f"slope {slope}: {part:.2%} of {least}: proved {proved}, {took:.0f} s, ", end="")
            print(f"{data.sizes['cell']} cells, {strides} strides", flush=True)
            if slope == 0.004 and part == 0.99:
                print_checks(data, boxes)


def print_checks(data, count: int) -> None:
    answers = checker.replay(data, "0.004", count, seed=3)
    told = f"{answers['walks']} walk as proved, {answers['falls']} fall, {answers[None]} open"
    print(f"checker: {told}", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--boxes", type=int, default=100)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--parts", nargs="*", type=float, default=[0.99, 0.999])
    options = parser.parse_args()
    print_cost(options.repeats)
    print_overestimation()
    print_theorems(options.boxes, options.parts)

"""How long do walkers walk beyond the loss of walking, and by which law?

The mean life of the simplest walker over the slope, beyond the crisis near 0.019045, from starts
on what was the attractor, and what opens there and further on. Walkers leave near the unstable gait
of period three with multipliers 12.5 and 0.0019, beyond its stable manifold. Their states there lie
on three leaves, which a state three strides before tells apart. Each leaf is folded, and its fold
moves towards the manifold as the slope grows: where the first one touches it walking is lost, and
where another one does a further way out opens. The distance from the manifold is that along the
left eigenvector of the larger multiplier.

Laws (slope - crisis)^-exponent, fitted in windows of slopes, stand beside exponents from the
multipliers of orbits that meet at the crisis. `--pictures FOLDER` draws what it finds.
"""

import argparse
import time
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np
from matplotlib.figure import Figure

import walker_jax as wj
from walker_jax import figures
from walker_jax.figures.layout import figure_of
from walker_jax.figures.style import BASINS, INK
from walker_jax.gaits.cycles import Gait, linearise
from walker_jax.integrators.integrator import Integrator
from walker_jax.stability.escapes import CrisisLaw, crisis_exponents
from walker_jax.walking.iteration import iterate, orbits

ATTRACTOR = 0.0188
STRIDES, TOLERANCE = 60_000, 1e-10
DISTANCES = np.append(np.geomspace(4e-7, 5.6e-5, 12), [6.5e-5, 7.5e-5, 9.5e-5, 1.35e-4, 1.55e-4])
"""Slopes less that of the crisis."""
KEPT = 0.01
"""Share of walks that never fall, from which on there is an attractor beside the saddle."""
TOLD = 0.0191, 0.0192
"""Slopes whose saddles are told."""
LEAVES = (0.2500, 0.2601), (0.2601, 0.2632), (0.2632, 0.2700)
"""theta three strides before, of walkers on each leaf near the gait of period three."""
HEIGHTS = -0.62, -0.25
"""Along the manifold, of what is drawn (1e-4)."""
NEAR, TURNED = 0.003, 0.264
"""Distance from that gait, and theta a stride before."""
LOOKED_AT = np.arange(20, 139)
"""Strides of walks, of 150."""


class Visits(NamedTuple):
    """Walkers on their way past the gait of period three."""

    beyond: np.ndarray
    """How far beyond its stable manifold; negative on the side of the attractor."""
    along: np.ndarray
    """Along that manifold."""
    leaf: np.ndarray
    """Number of the leaf."""
    before: np.ndarray
    """The distance and the leaf five strides earlier, if the walker was there; else NaN."""
    falls: np.ndarray
    """Whether they fall within twelve strides."""
    strides: int
    """Of all walks that are looked at."""


def starts_on_attractor(count: int) -> np.ndarray:
    """Starts on the chaotic attractor, before it is lost."""
    walker = wj.SimplestWalker(ATTRACTOR)
    gait = np.asarray(wj.find_gait(walker).states[0])
    near = gait + np.linspace(-1e-4, 1e-4, count)[:, None] * np.array([1.0, 0.0])
    end = iterate(walker, near, 300, Integrator(TOLERANCE))
    return np.asarray(end.state)[end.outcome == wj.Outcome.STRIDE]


def gate_gait(walker: wj.SimplestWalker) -> Gait:
    """The gait of period three that walkers pass when they escape."""
    found = wj.find_gaits(walker, 3)
    return min(found, key=lambda one: abs(np.abs(one.multipliers).max() - 12.6))


def visits(slope: float, starts: np.ndarray) -> Visits:
    """Walkers near the state of that gait which the folds of the leaves reach."""
    walker = wj.SimplestWalker(slope)
    cycle = np.asarray(gate_gait(walker).states)
    cycle = np.roll(cycle, -cycle[:, 0].argmin(), axis=0)
    matrices = linearise(walker, cycle[None], Integrator(TOLERANCE)).jacobian[0]
    values, vectors = np.linalg.eig(np.linalg.multi_dot(matrices[::-1]))
    vectors = vectors[:, np.argsort(-np.abs(values))]
    vectors = vectors / vectors[0]
    states, _ = orbits(walker, starts, 150, Integrator(TOLERANCE))
    inside, along = np.moveaxis((states - cycle[0]) @ np.linalg.inv(vectors).T, -1, 0)
    near = np.abs(states[..., 0] - cycle[0, 0]) < NEAR
    near[:, 1:] &= states[:, :-1, 0] > TURNED
    leaf = np.full(near.shape, -1)
    for number, (low, high) in enumerate(LEAVES):
        three = states[:, :-3, 0]
        leaf[:, 3:][near[:, 3:] & (low < three) & (three < high)] = number
    walk, at = np.nonzero((leaf >= 0) & np.isin(np.arange(states.shape[1]), LOOKED_AT))
    five = np.where(leaf >= 0, -inside, np.nan)[walk, at - 5], leaf[walk, at - 5]
    falls = np.isnan(states[walk, at + 12, 0])
    strides = int(np.isfinite(states[:, LOOKED_AT, 0]).sum())
    return Visits(
        -inside[walk, at], along[walk, at], leaf[walk, at], np.stack(five), falls, strides
    )


def opening(leaf: int, slopes: tuple[float, float], starts: np.ndarray) -> float:
    """The slope at which the fold of a leaf touches the manifold, from where it is before that."""
    folds = []
    for slope in slopes:
        found = visits(slope, starts)
        folds.append(found.beyond[found.leaf == leaf].max())
    rate = (folds[1] - folds[0]) / (slopes[1] - slopes[0])
    return float(slopes[0] - folds[0] / rate)


def tell_ways_out(slope: float, found: Visits) -> float:
    """Walkers that pass beyond the manifold, by leaf; and of the first, by that of before.

    Returns how far the fold of the third leaf is from where walkers are, five strides before they
    pass beyond the manifold on the first.
    """
    out = found.beyond > 0
    shares = [f"{(out & (found.leaf == n)).sum() / found.strides:.5f}" for n in range(len(LEAVES))]
    first = out & (found.leaf == 0)
    earlier = [f"{np.mean(found.before[1][first] == n):.0%}" for n in range(len(LEAVES))]
    third = found.beyond[found.leaf == 2].max()
    inside = found.before[0][first]
    inside = inside[(inside < -5e-4) & (inside > -1.5e-3)]
    print(
        f"{slope:.5f}  beyond it in a stride, by leaf: {', '.join(shares)}, and of these "
        f"{found.falls[out].mean():.1%} fall; those of the first were, five strides before, "
        f"{-inside.max():.6f} to {-inside.min():.6f} inside, on the leaves by "
        f"{', '.join(earlier)}; the fold of the third is {-third:.6f} inside"
    )
    return float(inside.min() - third)


def tell_lives(starts: np.ndarray, crisis: float) -> np.ndarray:
    """Slopes, mean lives and their errors, with the saddles at some of these."""
    rows = []
    print("distance   slope         escape rate (95 %)              mean life")
    for slope in crisis + DISTANCES:
        found = wj.transients(
            wj.SimplestWalker(slope), starts, strides=STRIDES, tolerance=TOLERANCE
        )
        kept = 1 - float(found.ended.mean())
        if kept < KEPT:
            rows.append((slope, found.mean_life, found.mean_life / np.sqrt(found.ended.sum())))
        print(
            f"{slope - crisis:.2e}   {slope:.8f}  {found.rate:.6f} ({found.low:.6f}, "
            f"{found.high:.6f})  {found.mean_life:10.1f}"
            + f"  left out: {kept:.0%} come to a stable gait"
            * (kept >= KEPT),
            flush=True,
        )
    for slope in TOLD:
        found = wj.transients(wj.SimplestWalker(slope), starts, tolerance=TOLERANCE)
        print(
            f"saddle at {slope}: mean life {found.mean_life:.1f}, exponents "
            f"{found.exponents.round(4)}, dimension {found.dimension:.4f}"
        )
    return np.array(rows).T


def tell_laws(lives: np.ndarray, crisis: float) -> tuple[CrisisLaw, dict[str, float]]:
    """Laws in windows of distances, and exponents that multipliers predict."""
    distance = lives[0] - crisis
    laws = []
    for low, high in ((0, 2e-4), (0, 6e-5), (1e-6, 6e-5)):
        inside = (distance > low) & (distance < high)
        laws.append(wj.crisis_law(*lives[:, inside], crisis=crisis))
        print(f"distances of {low:g} to {high:g}: {laws[-1]}")
    walker, predicted = wj.SimplestWalker(crisis), {}
    orbits_met = {"long gait": wj.find_gait(walker)}
    orbits_met["period two"] = wj.find_gaits(walker, 2)[0]
    orbits_met["period three"] = gate_gait(walker)
    for name, gait in orbits_met.items():
        sizes = np.abs(gait.multipliers)
        kind = "homoclinic" if name == "period three" else "heteroclinic"
        predicted[f"{name}, {kind}"] = exponent = crisis_exponents(sizes)[kind]
        print(f"{name}, multipliers {sizes}: {kind} {exponent:.4f}")
    return laws[0], predicted


def draw_leaves(panels: dict[float, Visits]) -> Figure:
    """The leaves near the gait of period three, and the manifold beyond which walkers fall."""
    figure = Figure(figsize=(9, 3.6), layout="constrained")
    colours = BASINS[0], BASINS[1], BASINS[2]
    rows = figure.subplots(1, len(panels), sharex=True, sharey=True)
    for ax, (slope, found) in zip(rows, panels.items(), strict=True):
        ax.axvspan(0, 1, color="#fae0b5", zorder=0)
        ax.axvline(0, color=INK, lw=1)
        for number, colour in enumerate(colours):
            own = found.leaf == number
            label = f"{('first', 'second', 'third')[number]} leaf"
            points = 1e3 * found.beyond[own], 1e4 * found.along[own]
            ax.plot(*points, ls="", marker=".", ms=1.2, mew=0, color=colour)
            ax.plot([], [], "o", color=colour, ms=4, label=label)
        ax.set(xlim=(-2.6, 0.9), ylim=HEIGHTS, title=f"slope {slope:g}")
    rows[0].set_ylabel("along the manifold (1e-4)")
    rows[len(rows) // 2].set_xlabel("beyond the stable manifold of the gait of period three (1e-3)")
    rows[0].text(0.1, HEIGHTS[0], "falls", va="bottom")
    rows[-1].legend(loc="lower right", fontsize="small")
    return figure


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--starts", type=int, default=2000, help="on what was the attractor")
    parser.add_argument("--pictures", type=Path, help="folder for pictures")
    args = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    begin = time.process_time()
    starts = starts_on_attractor(args.starts)
    many = starts_on_attractor(4 * args.starts)
    crisis = opening(0, (0.01904, 0.019044), many)
    second = opening(1, (0.01912, 0.019125), many)
    print(f"the first fold touches the manifold at {crisis:.8f}, the second at {second:.7f}")
    panels = {slope: visits(slope, many) for slope in (0.0191, 0.01914, 0.01916, 0.0192)}
    gaps = [tell_ways_out(slope, found) for slope, found in panels.items()]
    third = float(np.interp(0, gaps[2:0:-1], [*panels][2:0:-1]))
    print(f"the third fold is where walkers are five strides before from {third:.6f} on")
    lives = tell_lives(starts, crisis)
    law, predicted = tell_laws(lives, crisis)
    if args.pictures is not None:
        openings = {"second fold": second, "third leaf": third}
        ax = figures.crisis_law(lives[0], lives[1], lives[2], law, predicted, openings)
        figure_of(ax).savefig(args.pictures / "crisis.png", dpi=80)
        before = visits(0.01904, many)
        shown = {0.01904: before, **{slope: panels[slope] for slope in (0.0191, 0.0192)}}
        draw_leaves(shown).savefig(args.pictures / "leaves.png", dpi=80)
        walker = wj.SimplestWalker(0.0191)
        found = wj.transients(walker, starts, tolerance=TOLERANCE)
        ax = figures.chaotic_saddle(found, starts, gate_gait(walker))
        figure_of(ax).savefig(args.pictures / "saddle.png", dpi=80)
    print(f"{time.process_time() - begin:.0f} s of the processor")


if __name__ == "__main__":
    main()

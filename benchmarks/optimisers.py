"""What does the gradient of a basin's area cost, is it right, and is it worth it?

The gradient takes 2.3 times as long as the area alone, and is within 4 % of differences of areas on
finer grids. At a fractal boundary it is itself an average over a band, from areas on coarser grids.
One parameter and a limit are too easy a problem to tell a gradient search from searches with models
or simplices: with the strides of a gradient search of five places these come as far, and random
search does not. Best areas are given relative to that of the gradient search, for five seeds; on
two busy cores:

area           1.24 s, 434,462 strides, 349,183 a second
and gradient   2.98 s, 1,206,947 strides, 405,194 a second
the gradient takes 2.27 times as long as the area alone
 slope          by the integral      by a difference   apart  averaged
 0.003       -0.09792 +- 0.00094   -0.09739 +- 0.00072    0.5%  False
 0.006       -0.04064 +- 0.00042   -0.04205 +- 0.00036   -3.4%  False
  0.01       -0.06630 +- 0.00270   -0.06677 +- 0.00037   -0.7%  True
 0.013       -0.13538 +- 0.00323   -0.13289 +- 0.00054    1.9%  True

slope, speed at least 0.06: from 0.001492; 5.6 million strides
by the gradient    0.001931  at (0.00168807), 5 places
random search      93.5% of that (88.4%, 93.1%, 93.5%, 96.9%, 99.1%)
nelder mead        100.0% of that (100.0%, 100.0%, 100.0%, 100.0%, 100.0%)
cobyqa             99.9% of that (99.9%, 99.9%, 99.9%, 99.9%, 99.9%)
"""

import time
from collections.abc import Callable

import jax
import numpy as np
from scipy.optimize import NonlinearConstraint, minimize

import walker_jax as wj
from walker_jax.basins.refinement import refine_cells
from walker_jax.walkers.parameters import with_parameter

jax.config.update("jax_enable_x64", True)  # before the walkers are made

SECTION = wj.Grid.sheared(theta=(0, np.pi / 4, 200), sum=(-0.12, 0.06, 200))
LEVELS = 4
"""Of the areas that are compared in the end."""
PROBLEMS = {
    "slope, speed at least 0.06": (
        wj.SimplestWalker(0.008),
        {"slope": (0.001, 0.02)},
        {"speed": 0.06},
        SECTION,
    ),
}
SEEDS = range(5)


class Spent(Exception):
    """All strides have been made that a search may make."""


class Search:
    """The area over parameters, for searches without derivatives, that counts strides."""

    def __init__(self, walker, bounds, limits, grid, strides):
        self.walker, self.names, self.limits, self.grid = walker, list(bounds), limits, grid
        self.low, self.high = np.array(list(bounds.values())).T
        self.left, self.best = strides, (0.0, None)

    def build_walker(self, place):
        walker = self.walker
        for name, value in zip(self.names, self.low + (self.high - self.low) * place, strict=True):
            walker = with_parameter(walker, name, np.asarray(value))
        return walker

    def slack(self, place):
        walker = self.build_walker(np.clip(place, 0, 1))
        gait = wj.find_gait(walker)
        measured = lambda name: np.nan_to_num(wj.measure(walker, name, (), gait).value, nan=-1)
        return [measured(name) / least - 1 for name, least in self.limits.items()]

    def loss(self, place):
        """Minus the area, in units of 0.001; zero, and no strides, where a limit is broken."""
        place = np.clip(place, 0, 1)
        if self.left <= 0:
            raise Spent
        if min(self.slack(place)) < -1e-6:
            return 0.0
        options = {"strides": 200, "check": 50_000, "seed": 0, "tolerance": None}
        found = refine_cells(
            self.build_walker(place), self.grid, LEVELS - 2, by_centres=True, **options
        )
        self.left -= found.total_strides
        if found.area > self.best[0]:
            self.best = found.area, place
        return -1000 * found.area


def random_search(search: Search, start, seed: int) -> None:
    rng = np.random.default_rng(seed)
    while True:
        search.loss(rng.uniform(size=len(search.names)))


def nelder_mead(search: Search, start, seed: int) -> None:
    """From the start, and again from random places until the strides are spent."""
    rng = np.random.default_rng(seed)
    while True:
        minimize(search.loss, start, method="Nelder-Mead", bounds=[(0, 1)] * len(start))
        start = rng.uniform(size=len(start))


def cobyqa(search: Search, start, seed: int) -> None:
    """Quadratic models, and limits as constraints; then again, as above."""
    rng = np.random.default_rng(seed)
    limits = NonlinearConstraint(search.slack, 0, np.inf)
    while True:
        options = {"initial_tr_radius": 0.1, "final_tr_radius": 0.001}
        bounds = [(0, 1)] * len(start)
        minimize(
            search.loss, start, method="COBYQA", bounds=bounds, constraints=limits, options=options
        )
        start = rng.uniform(size=len(start))


def exact(walker: wj.Walker, grid: wj.Grid) -> float:
    return float(wj.refine(walker, grid, LEVELS).total_area)


def compare(title: str) -> None:
    walker, bounds, limits, grid = PROBLEMS[title]
    found = wj.optimise(walker, bounds, at_least=limits, grid=grid, starts=1, levels=LEVELS)
    climbing = found.isel(evaluation=found.stage.values >= 0)
    _, first = np.unique(climbing.parameters.values, axis=0, return_index=True)
    strides, best = int(climbing.strides.sum()), float(found.exact_optimum)
    values = ", ".join(f"{x:.6g}" for x in found.optimum.values)
    print(f"\n{title}: from {float(found.exact_start):.6f}; {strides / 1e6:.1f} million strides")
    print(f"{'by the gradient':18} {best:.6f}  at ({values}), {len(first)} places", flush=True)
    start = np.array([float(getattr(walker, name)) for name in bounds])
    low, high = np.array(list(bounds.values())).T
    searches: list[Callable] = [random_search, nelder_mead, cobyqa]
    for one in searches:
        reached = []
        for seed in SEEDS:
            search = Search(walker, bounds, limits, grid, strides)
            try:
                one(search, (start - low) / (high - low), seed)
            except Spent:
                pass
            place = search.best[1]
            reached.append(0.0 if place is None else exact(search.build_walker(place), grid) / best)
        name = one.__name__.replace("_", " ")
        parts = ", ".join(f"{part:.1%}" for part in sorted(reached))
        print(f"{name:18} {np.median(reached):.1%} of that ({parts})", flush=True)


def accuracy() -> None:
    print(f"{'slope':>6} {'by the integral':>24} {'by a difference':>20} {'apart':>7}  averaged")
    for slope, half in ((0.003, 2e-4), (0.006, 4e-4), (0.010, 5e-4), (0.013, 5e-4)):
        found = wj.measure(
            wj.SimplestWalker(slope), "area", ["slope"], grid=SECTION, levels=4, bands=(half,)
        )
        ends = [
            wj.refine(wj.SimplestWalker(slope + h), SECTION, 6, seed=7, check=1_000_000)
            for h in (-half, half)
        ]
        low, high = ends
        difference = float(high.total_area - low.total_area) / (2 * half)
        error = np.hypot(float(low.total_area_error), float(high.total_area_error)) / (2 * half)
        value, own = found.gradient[0], found.gradient_error[0]
        print(
            f"{slope:6} {value:14.5f} +- {own:.5f} {difference:10.5f} +- {error:.5f} "
            f"{value / difference - 1:7.1%}  {bool(found.averaged[0])}",
            flush=True,
        )


def cost(repeats: int = 5) -> None:
    options = {"strides": 200, "check": 50_000, "seed": 0, "tolerance": None}
    walker = wj.SimplestWalker(0.004)
    plain, both = [], []
    made = 0, 0
    for _ in range(repeats + 1):  # the first compiles
        begun = time.perf_counter()
        area = refine_cells(walker, SECTION, 3, by_centres=True, **options)
        middle = time.perf_counter()
        found = wj.measure(walker, "area", ["slope"], grid=SECTION, levels=3, check=50_000)
        plain.append(middle - begun)
        both.append(time.perf_counter() - middle)
        made = area.total_strides, found.strides
    ratio = np.median(np.array(both[1:]) / np.array(plain[1:]))
    for name, seconds, strides in (("area", plain, made[0]), ("and gradient", both, made[1])):
        middle = float(np.median(seconds[1:]))
        print(f"{name:14} {middle:.2f} s, {strides:,} strides, {strides / middle:,.0f} a second")
    print(f"the gradient takes {ratio:.2f} times as long as the area alone")


def main() -> None:
    cost()
    accuracy()
    for title in PROBLEMS:
        compare(title)


if __name__ == "__main__":
    main()

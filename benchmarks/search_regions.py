"""Do the regions of a search without a guess contain the gaits that attract?

`find_gait` without a guess searches from the cells of a walker's `gait_region` and, if no gait
there is stable, from those of its `further_gait_region`; it returns the most stable gait. For
walkers with parameters drawn over their ranges (a Latin square, seed 0), the gait with the largest
basin in a region several times as wide is found by following starts from that region. Per family
the table counts the walkers drawn; those whose starts mostly converge to a gait of period one
(longer periods are counted apart); among these, the walkers whose gait lies in one of the two
regions, those for which the search finds a stable gait, and those for which it finds this very
gait, the one with the largest basin. Walkers whose gait lies in neither region, or for which the
search finds no stable gait, are listed below, one a line.

In space hardly any start returns from so wide a region. There the stable gait of the default
walker, the toy of Coleman and others, is followed along one parameter after the other, each step
from the state of the one before, and a search without a guess is tried at every value.

The answer: all are inside, and the search finds a stable gait of every one. Walkers with stiff
springs have two stable gaits, and the less stable one has the larger basin; the same holds for some
walkers on round feet.

    spring                 80 drawn    0 longer   80 walk   80 inside   80 stable   44 same   221 s
    point-foot             60 drawn    2 longer   17 walk   17 inside   17 stable   17 same    66 s
    powered               200 drawn   15 longer   57 walk   57 inside   57 stable   54 same   104 s
    round-foot             60 drawn    2 longer   46 walk   46 inside   46 stable   39 same   102 s
    upper-body             50 drawn    6 longer   24 walk   24 inside   24 stable   24 same    69 s
    kneed                  40 drawn    0 longer   30 walk   30 inside   30 stable   30 same   162 s
    powered-point-foot     80 drawn    4 longer   23 walk   23 inside   23 stable   22 same   149 s
    powered-round-foot     60 drawn    4 longer   28 walk   28 inside   28 stable   28 same   149 s
    powered-upper-body     40 drawn    2 longer   15 walk   15 inside   15 stable   15 same   123 s
    spatial                30 drawn    0 longer   30 walk   30 inside   30 stable   30 same    45 s

(Before kneed walkers had a `further_gait_region`, 4 of their 30 were outside.)

    python benchmarks/search_regions.py [FAMILY ...]

With `--all-cells`, the search from few starts, `FEW_STARTS`, is compared with one from all cells of
the regions. Of each walker drawn it finds the same gait, or none as well. Where no gait is stable,
all cells follow. The last two families were not compared.

    spring                  80 drawn    80 stable    80 same      9 s,    291 s of all cells
    point-foot              60 drawn    17 stable    60 same    117 s,    187 s of all cells
    powered                200 drawn    57 stable   200 same    125 s,    223 s of all cells
    round-foot              60 drawn    46 stable    60 same     48 s,    135 s of all cells
    upper-body              50 drawn    24 stable    50 same     64 s,    102 s of all cells
    kneed                   40 drawn    30 stable    40 same    144 s,    266 s of all cells
    powered-point-foot      80 drawn    23 stable    80 same    125 s,    210 s of all cells

    python benchmarks/search_regions.py --all-cells [FAMILY ...]
"""

import sys
import time
from unittest import mock

import jax
import numpy as np

import walker_jax as wj
from walker_jax.basins.attracting_gaits import gait_of_grid, is_same_cycle
from walker_jax.gaits import search
from walker_jax.gaits.cycles import Gait
from walker_jax.gaits.search import search_gait
from walker_jax.grids import MAX_SIZE

jax.config.update("jax_enable_x64", True)
STRIDES = 200
MOTORS = {
    "hip_spring": (0, 0.5),
    "hip_damper": (0, 0.05),
    "hip_angle": (-0.5, 0.1),
    "push_off": (0, 0.3),
}
PLANES = {"theta": (0.0, np.pi / 4, 60), "sum": (-1.3, 0.4, 130)}
VOLUMES = {"theta": (0.0, 1.5, 22), "sum": (-1.6, 0.6, 28), "phidot": (-3.0, 1.5, 24)}
FAMILIES = {  # the class, how many, and the ranges of its parameters
    "spring": (wj.SpringWalker, 80, {"slope": (0.001, 0.05), "hip_stiffness": (0.1, 100)}),
    "point-foot": (wj.PointFootWalker, 60, {"slope": (0.001, 0.2), "foot_mass": (1e-4, 3.0)}),
    "powered": (
        wj.PoweredWalker,
        200,
        {
            "slope": (-0.05, 0.1),
            "hip_stiffness": (0, 20),
            "hip_damping": (0, 4),
            "hip_angle": (-1.0, 0.2),
            "push_off": (0, 0.4),
        },
    ),
    "round-foot": (
        wj.RoundFootWalker,
        60,
        {
            "slope": (0.002, 0.2),
            "foot_radius": (0, 0.8),
            "hip_mass": (0, 3),
            "com_from_hip": (0.1, 0.7),
            "leg_inertia": (0.002, 0.1),
        },
    ),
    "upper-body": (
        wj.UpperBodyWalker,
        50,
        {
            "slope": (0.002, 0.2),
            "foot_radius": (0, 0.7),
            "body_mass": (0.1, 5),
            "body_com": (-0.1, 0.5),
            "body_inertia": (0, 0.2),
        },
    ),
    "kneed": (wj.KneedWalker, 40, {"slope": (0.03, 0.12), "foot_radius": (0, 0.6)}),
    "powered-point-foot": (
        wj.PoweredPointFootWalker,
        80,
        {"slope": (-0.03, 0.08), "foot_mass": (0.001, 0.3), **MOTORS},
    ),
    "powered-round-foot": (
        wj.PoweredRoundFootWalker,
        60,
        {"slope": (-0.03, 0.08), "foot_radius": (0, 0.6), **MOTORS},
    ),
    "powered-upper-body": (
        wj.PoweredUpperBodyWalker,
        40,
        {"slope": (-0.03, 0.08), "foot_radius": (0, 0.6), **MOTORS},
    ),
}

SIZES = {  # of walkers in space, on both sides of the toy's
    "slope": (0.06, 0.09),
    "hip_width": (0.325, 0.45),
    "disc_radius": (0.08, 0.165),
    "com_height": (0.28, 0.36),
    "com_outward": (0.6, 0.8),
}


def draw_parameters(count: int, ranges: dict[str, tuple[float, float]]) -> list[dict[str, float]]:
    """A Latin square: each of `count` equal parts of each range once; of wide ones by logarithm."""
    rng, columns = np.random.default_rng(0), []
    for low, high in ranges.values():
        places = (rng.permutation(count) + rng.uniform(size=count)) / count
        wide = low > 0 and high > 10 * low
        columns.append(low * (high / low) ** places if wide else low + (high - low) * places)
    return [dict(zip(ranges, row, strict=True)) for row in np.stack(columns, axis=1).tolist()]


def wide_region(walker: wj.Walker) -> wj.Grid:
    """Starts several times as wide about as those of the walker's `gait_region`."""
    return wj.Grid.sheared(**PLANES if len(walker.section) == 2 else VOLUMES)


class Survey:
    """Counts of the walkers of a family."""

    def __init__(self, name: str):
        self.name, self.began, self.lost = name, time.process_time(), []
        self.drawn = self.longer = self.walking = self.inside = self.stable = self.same = 0

    def add(self, walker: wj.Walker, owner: Gait) -> None:
        """Count a walker with a gait of period one that attracts."""
        searched, state = search_gait(walker), np.asarray(owner.states)
        regions = walker.gait_region(), walker.further_gait_region()
        inside = any(one is not None and bool(one.contains(state).all()) for one in regions)
        stable = bool(searched.found and searched.stable)
        self.walking += 1
        self.inside += inside
        self.stable += stable
        self.same += stable and is_same_cycle(owner, searched)
        if not (inside and stable):
            self.lost.append(f"  {walker}: {state[0].round(4).tolist()}")

    def report(self) -> None:
        counts = f"{self.drawn:5} drawn {self.longer:5} longer {self.walking:5} walk"
        found = f"{self.inside:5} inside {self.stable:5} stable {self.same:5} same"
        seconds = time.process_time() - self.began
        print(f"{self.name:20} {counts} {found} {seconds:6.0f} s", *self.lost, sep="\n", flush=True)


def survey(name: str) -> None:
    kind, count, ranges = FAMILIES[name]
    found = Survey(name)
    for parameters in draw_parameters(count, ranges):
        try:
            walker = kind(**parameters)
        except ValueError:  # a walker that cannot be
            continue
        found.drawn += 1
        owner = gait_of_grid(walker, wide_region(walker), STRIDES, None)
        if owner is not None and len(owner.states) == 1:
            found.add(walker, owner)
        found.longer += owner is not None and len(owner.states) > 1
    found.report()


def survey_in_space() -> None:
    found, toy = Survey("spatial"), wj.SpatialWalker()
    middle = wj.find_gait(toy)
    for parameter, ends in SIZES.items():
        for end in ends:
            gait = middle
            for value in np.linspace(float(getattr(toy, parameter)), end, 4)[1:].tolist():
                walker = wj.SpatialWalker(**{parameter: value})
                gait = search_gait(walker, np.asarray(gait.states[0]))
                found.drawn += 1
                if not gait.found or not gait.stable:
                    break
                found.add(walker, gait)
    found.report()


def compare_with_all_cells(name: str) -> None:
    """Count the walkers of a family for which few starts lead to the gait that all lead to."""
    kind, count, ranges = FAMILIES[name]
    drawn = stable = same = 0
    seconds = [0.0, 0.0]
    for parameters in draw_parameters(count, ranges):
        try:
            walker = kind(**parameters)
        except ValueError:  # a walker that cannot be
            continue
        found = []
        if not drawn:
            search_gait(walker)  # compiles
        for i, starts in enumerate((search.FEW_STARTS, MAX_SIZE)):
            with mock.patch.object(search, "FEW_STARTS", starts):
                began = time.process_time()
                found.append(search_gait(walker))
                seconds[i] += time.process_time() - began
        few, all_cells = found
        drawn += 1
        stable += bool(all_cells.found and all_cells.stable)
        neither = not few.found and not all_cells.found
        same += neither or (few.stable == all_cells.stable and is_same_cycle(few, all_cells))
    counts = f"{drawn:5} drawn {stable:5} stable {same:5} same"
    print(f"{name:20} {counts} {seconds[0]:6.0f} s, {seconds[1]:6.0f} s of all cells", flush=True)


if __name__ == "__main__":
    names = [name for name in sys.argv[1:] if name != "--all-cells"]
    if "--all-cells" in sys.argv:
        for name in names or FAMILIES:
            compare_with_all_cells(name)
    else:
        for name in names or (*FAMILIES, "spatial"):
            survey_in_space() if name == "spatial" else survey(name)

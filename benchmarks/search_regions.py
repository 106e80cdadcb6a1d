"""Does a search without a guess find the gait that has the basin, over the ranges of parameters?

`find_gait` without a guess searches from the cells of a walker's `gait_region`, and where no gait
there is stable, from those of its `further_gait_region`. For walkers with parameters drawn over
their ranges (a Latin square, seed 0), the gait with the largest basin in a region several times as
wide, found by following starts from it, stands beside the gait of the search. Per family: walkers
drawn, those to whose gait of period one most of these starts converge, and those of them for which
the search finds it; and each for which it does not, with what it finds. A search without a guess is
for gaits of period one alone: walkers that converge to longer ones are counted apart.

In space hardly a start returns from so wide a region. There the stable gait of the default walker,
the toy of Coleman and others, is followed along one parameter after the other, each step from the
state of the one before, and a search without a guess is tried at every value.

ANSWER

    python benchmarks/search_regions.py [FAMILY ...]
"""

import sys
import time

import jax
import numpy as np

import walker_jax as wj
from walker_jax.basins.attracting_gaits import compare_with_search, gait_of_grid
from walker_jax.gaits.search import search_gait

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
    "spring": (wj.SpringWalker, 80, {"slope": (0.001, 0.05), "hip_stiffness": (0, 100)}),
    "point-foot": (wj.PointFootWalker, 60, {"slope": (0.001, 0.2), "foot_mass": (1e-4, 1.0)}),
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
    """A Latin square: each of `count` equal parts of each range once."""
    rng = np.random.default_rng(0)
    columns = {
        name: low + (high - low) * (rng.permutation(count) + rng.uniform(size=count)) / count
        for name, (low, high) in ranges.items()
    }
    return [
        dict(zip(columns, map(float, row), strict=True))
        for row in zip(*columns.values(), strict=True)
    ]


def wide_region(walker: wj.Walker) -> wj.Grid:
    """Starts several times as wide about as those of the walker's `gait_region`."""
    return wj.Grid.sheared(**PLANES if len(walker.section) == 2 else VOLUMES)


def survey(name: str) -> None:
    kind, count, ranges = FAMILIES[name]
    began = time.process_time()
    walking, longer, found, others = 0, 0, 0, []
    drawn = draw_parameters(count, ranges)
    for parameters in drawn:
        try:
            walker = kind(**parameters)
        except ValueError:  # a walker that cannot be
            continue
        owner = gait_of_grid(walker, wide_region(walker), STRIDES, None)
        if owner is None or len(owner.states) > 1:
            longer += owner is not None
            continue
        walking += 1
        difference = compare_with_search(owner, search_gait(walker))
        found += not difference
        if difference:
            values = ", ".join(f"{key}={value:.4g}" for key, value in parameters.items())
            states = np.asarray(owner.states[0]).round(4).tolist()
            others.append(f"  {values}\n    {states}: {difference}")
    report(name, (len(drawn), longer, walking, found), others, began)


def survey_in_space() -> None:
    began = time.process_time()
    toy = wj.SpatialWalker()
    middle = wj.find_gait(toy)
    tried, walking, found, others = 0, 0, 0, []
    for parameter, ends in SIZES.items():
        for end in ends:
            gait = middle
            for value in np.linspace(float(getattr(toy, parameter)), end, 4)[1:].tolist():
                walker = wj.SpatialWalker(**{parameter: value})
                gait = search_gait(walker, np.asarray(gait.states[0]))
                tried += 1
                if not gait.found or not gait.stable:
                    break
                walking += 1
                difference = compare_with_search(gait, search_gait(walker))
                found += not difference
                if difference:
                    states = np.asarray(gait.states[0]).round(4).tolist()
                    others.append(f"  {parameter}={value:.4g}\n    {states}: {difference}")
    report("spatial", (tried, 0, walking, found), others, began)


def report(name: str, counts: tuple[int, ...], others: list[str], began: float) -> None:
    drawn, longer, walking, found = counts
    counted = f"{drawn:5} drawn {longer:5} longer {walking:5} walk {found:5} found"
    print(f"{name:20} {counted} {time.process_time() - began:6.0f} s", flush=True)
    print(*others, sep="\n", end="\n" if others else "", flush=True)


if __name__ == "__main__":
    for name in sys.argv[1:] or (*FAMILIES, "spatial"):
        survey_in_space() if name == "spatial" else survey(name)

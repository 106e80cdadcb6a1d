"""Do knees enlarge the basin, and do round feet undo it?

The script compares the volumes of whole basins and the least disturbances of walkers with straight
legs and with knees, on point and on round feet. They have equal mass distributions: a straight leg
has the mass, the centre of mass and the moment of inertia of a thigh and a shank in line. It varies
first the slope, then the radius of the feet, and gives the energy that the gait loses at impacts.

Lengths are in legs, times in sqrt(l / g). Volumes, in rad^3 g/l, are those of all starts of the
section that converge to any attractor, refined once, and checked by 50,000 random starts; their
errors are standard errors. Where they do not tell which of two volumes is larger, the step `finely`
refines three times. The least disturbance is the plain length of a change of (theta, thetadot,
phidot). It is that of the nearest failure along 1000 directions, at distances in steps of 0.000125,
and so an upper bound.

    python benchmarks/knees.py PLACE [STEP ...]

writes the results to the JSON file PLACE, reuses those that are there, and prints the tables; a
picture of the same name lies beside it. Steps are gaits, branches, volumes, finely, disturbances,
slices and starts; without any, all. On two busy cores a volume takes 3 to 10 processor seconds, and
one that is refined three times 40 to 75.
"""

import json
import sys
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import walker_jax as wj
from walker_jax import multibody
from walker_jax.basins.volumes import runs_of
from walker_jax.figures.style import BASINS, INK, TITLE
from walker_jax.gaits.search import search_gait
from walker_jax.multibody.single_support import coordinates_and_rates
from walker_jax.stability.gait_mapper import mapper_of_gait

MASSES = {
    "default": {},
    "human-like": {
        "hip_mass": 34.637,
        "thigh_mass": 6.096,
        "shank_mass": 2.852,
        "thigh_length": 0.4056 / 0.8292,
        "shank_length": 0.4236 / 0.8292,
        "thigh_com": (0.4056 - 0.23) / 0.8292,
        "shank_com": (0.4236 - 0.2402) / 0.8292,
    },
}
"""The default walker with knees is Hsu Chen's (2007); the lengths of the other are in legs."""
LEGS = "straight", "knees"
ROUND = 0.25
SLOPES = {"default": (0.05, 0.06, 0.07, 0.08, 0.09), "human-like": (0.04, 0.06, 0.08)}
SPAN = 0.002, 0.12
RADII = 0.0, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.75
GENTLE, STEEP = 0.02, 0.09
"""Slopes on which the radius of the feet varies; only straight legs walk on the first."""
SERIES = (STEEP, *LEGS), (GENTLE, "straight")
MIDDLING = 0.3
SMALL = {"theta": (0, np.pi / 2, 48), "sum": (-1, 0.4, 42), "phidot": (-2.5, 1.5, 48)}
LARGE = {"theta": (0, np.pi / 2, 24), "sum": (-1.6, 1.2, 42), "phidot": (-5, 2.5, 45)}
"""Windows for feet of radii up to `MIDDLING`, and for larger ones, whose basins are larger."""
LEVELS, CHECK = 1, 50_000
FINELY = 3, 300_000
"""Levels of refinement and starts of the check, for pairs of nearly equal volumes."""
DIRECTIONS, REACH, PARTS = 1000, 0.064, 8
STARTS = 400_000


def straight_legs(walker: wj.KneedWalker) -> wj.RoundFootWalker:
    """The walker without knees whose legs have the same mass distribution."""
    get = lambda name: float(getattr(walker, name))
    thigh, shank = get("thigh_mass"), get("shank_mass")
    down = get("thigh_com"), get("thigh_length") + get("shank_com")
    com = (thigh * down[0] + shank * down[1]) / (thigh + shank)
    apart = thigh * shank / (thigh + shank) * (down[1] - down[0]) ** 2
    return wj.RoundFootWalker(
        get("slope"),
        hip_mass=get("hip_mass"),
        leg_mass=thigh + shank,
        leg_inertia=get("thigh_inertia") + get("shank_inertia") + apart,
        leg_length=get("thigh_length") + get("shank_length"),
        com_from_hip=com,
        foot_radius=get("foot_radius"),
    )


def make(masses: str, legs: str, radius: float, slope: float) -> wj.HeavyLegWalker:
    kneed = wj.KneedWalker(slope, **MASSES[masses], foot_radius=radius)
    return kneed if legs == "knees" else straight_legs(kneed)


def paths() -> list[list[tuple]]:
    """Cases, each list along a path on which a gait is the guess for the next."""
    found = []
    for masses, slopes in SLOPES.items():
        for legs in LEGS:
            middle = 0.06 if masses == "human-like" else 0.07
            radii = np.linspace(0, ROUND, 6).round(3).tolist()
            found.append([(masses, legs, radius, middle) for radius in radii])
            for radius in (0.0, ROUND):
                for end in (min(slopes), max(slopes)):
                    path = np.linspace(middle, end, round(abs(end - middle) / 0.005) + 1)
                    found.append(
                        [(masses, legs, radius, slope) for slope in path.round(3).tolist()]
                    )
    for slope, *legs in SERIES:
        radii = np.arange(0, max(RADII) + 0.01, 0.05).round(3).tolist()
        found += [[("default", one, radius, slope) for radius in radii] for one in legs]
    return found


def cases() -> list[tuple]:
    """Those of the tables."""
    over_slopes = [
        (masses, legs, radius, slope)
        for masses, slopes in SLOPES.items()
        for slope in slopes
        for radius in (0.0, ROUND)
        for legs in LEGS
    ]
    over_radii = [
        ("default", one, radius, slope)
        for slope, *legs in SERIES
        for radius in RADII
        for one in legs
    ]
    return over_slopes + [case for case in over_radii if case not in over_slopes]


def measure_gaits(kept: dict) -> None:
    """Follow gaits along the paths, and keep what they are like."""
    for path in paths():
        guess = None
        for case in path:
            known = kept.get(key(case), {}).get("state")
            if known is not None:
                guess = known
                continue
            walker = make(*case)
            # Of a walker with knees there is no gait to start from but its own; the straight one
            # begins with that of the walker with knees.
            if guess is None:
                start = (case[0], "straight", *case[2:])
                guess = kept.get(key(start), {}).get("state")
            gait = search_gait(walker, guess)
            if not gait.found:
                print(f"no gait: {key(case)}", flush=True)
                break
            guess = np.asarray(gait.states[0]).tolist()
            kept[key(case)] = {"state": guess} | describe(walker, gait)
            print(key(case), kept[key(case)], flush=True)


def follow_branches(kept: dict) -> None:
    """Print where gaits begin in a fold and where they double their period, over the slope."""
    for masses in MASSES:
        for radius in (0.0, ROUND):
            for legs in LEGS:
                case = (masses, legs, radius, 0.06)
                walker = make(*case)
                gait = wj.find_gait(walker, kept[key(case)]["state"])
                branch = wj.continue_gait(walker, "slope", SPAN, gait)
                folds, doublings = (
                    [round(one.value, 5) for one in found]
                    for found in (branch.folds, branch.doublings)
                )
                print(
                    f"{masses} {legs} {radius:g}: folds {folds}, doublings {doublings}", flush=True
                )


def describe(walker: wj.HeavyLegWalker, gait: wj.Gait) -> dict[str, float]:
    """Its largest multiplier, speed, step length, and what impacts take of its kinetic energy."""
    measured = lambda name: wj.measure(walker, name, (), gait).value
    start, total = gait.states[0], float(gait.step_times[0])
    before = wj.trajectory(walker, start, np.array([total]))
    before = wj.State(*(getattr(before, name)[0] for name in wj.State._fields))
    kinetic = lambda state: float(
        multibody.kinetic_energy(walker.system(), *coordinates_and_rates(state))
    )
    arrives, leaves = kinetic(before), kinetic(walker.lift(jnp.asarray(start)))
    step = measured("step-length")
    weight = sum(float(getattr(walker, name, 0)) * n for name, n in PARTS_OF_WEIGHT.items())
    lost = weight * float(np.sin(float(walker.slope))) * step
    return {
        "multiplier": measured("spectral-radius"),
        "speed": measured("speed"),
        "step": step,
        "heel": (arrives - leaves) / arrives,
        "knee": float(lost - (arrives - leaves)) / lost,
    }


PARTS_OF_WEIGHT = {"hip_mass": 1, "leg_mass": 2, "thigh_mass": 2, "shank_mass": 2}


def window(walker: wj.Walker) -> wj.Grid:
    """The section, theta to its end at pi/2; rates as far as basins reach on feet of this size."""
    large = float(vars(walker)["foot_radius"]) > MIDDLING
    return wj.Grid.sheared(**(LARGE if large else SMALL))


def measure_volume(walker: wj.Walker) -> dict:
    data = wj.refine(walker, window(walker), LEVELS, check=CHECK)
    walks = runs_of(data).spread(data["run_attractor"].values) >= 0
    ends = [walks[:, [0, -1]].sum(), walks[:, :, [0, -1]].sum()]
    return {
        "volume": float(data.total_area),
        "error": float(data.total_area_error),
        "cells": int(walks.sum()),
        "cut": int(sum(ends)),
        "periods": data.period.values.tolist(),
        "mistaken": int(data.mistaken),
    }


def measure_finely(walker: wj.Walker) -> dict:
    levels, check = FINELY
    data = wj.refine(walker, window(walker), levels, check=check)
    return {"fine": float(data.total_area), "fine_error": float(data.total_area_error)}


def measure_disturbance(walker: wj.Walker, state: list[float]) -> dict:
    """The first failure on rays from the gait, at distances that are divided twice."""
    mapper = mapper_of_gait(walker, wj.find_gait(walker, state), 200, None)
    rng = np.random.default_rng(0)
    rays = rng.normal(size=(DIRECTIONS, 3))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    low, part = 0.0, REACH / PARTS
    for _ in range(3):
        high = low + part
        while mapper(np.asarray(state) + high * rays).converged.all():
            high += part
        low, part = high - part, part / PARTS
    return {"size": high, "within": high - low}


def measure_slice(walker: wj.Walker, state: list[float]) -> dict:
    """The area of the basin's slice through the gait, at its phidot."""
    axes = {name: (low, high, 2 * count) for name, (low, high, count) in SMALL.items()}
    grid = wj.Grid.sheared(**(axes | {"phidot": state[2]}))
    data = wj.refine(walker, grid, 2, check=CHECK)
    return {"slice": float(data.total_area), "slice_error": float(data.total_area_error)}


def compare_with_starts(walker: wj.Walker, state: list[float]) -> dict:
    """Basin stability over the same region."""
    grid = window(walker)
    gait = wj.find_gait(walker, state)
    found = wj.basin_stability(walker, grid, gait, samples=STARTS, strides=200, seed=1)
    whole = grid.size * grid.cell_area
    return {
        name: whole * float(getattr(found, field))
        for name, field in (("by_starts", "value"), ("low", "low"), ("high", "high"))
    }


def key(case: tuple) -> str:
    masses, legs, radius, slope = case
    return f"{masses} {legs} {radius:g} {slope:g}"


def main(place: str, *steps: str) -> None:
    jax.config.update("jax_enable_x64", True)
    path = Path(place)
    kept = json.loads(path.read_text()) if path.exists() else {}
    chosen = steps or ("gaits", "branches", *WORK)
    if "gaits" in chosen:
        measure_gaits(kept)
        path.write_text(json.dumps(kept))
    if "branches" in chosen:
        follow_branches(kept)
    for step in chosen:
        name, measure, todo = WORK.get(step, ("", None, []))
        for case in todo:
            one = kept.get(key(case), {})
            if name in one or not one.get("multiplier", 1) < 1:
                continue
            begun = time.process_time()
            kept[key(case)] |= (found := measure(make(*case), one["state"]))
            path.write_text(json.dumps(kept))
            print(f"{key(case)} {found} {time.process_time() - begun:.1f} s", flush=True)
    print_tables(kept)
    draw(kept, path.with_suffix(".png"))


CHECKED = [("default", legs, 0.0, 0.07) for legs in LEGS]
SLICED = [case for case in cases() if case[0] == "default" and case[2] in (0, ROUND)]
SLICED = [case for case in SLICED if case[3] in (0.05, 0.07, 0.09)]
CLOSE = [("default", legs, 0.0, slope) for slope in (0.08, 0.09) for legs in LEGS]
WORK = {
    "volumes": ("volume", lambda walker, _: measure_volume(walker), cases()),
    "finely": ("fine", lambda walker, _: measure_finely(walker), CLOSE),
    "disturbances": ("size", measure_disturbance, cases()),
    "slices": ("slice", measure_slice, SLICED),
    "starts": ("by_starts", compare_with_starts, CHECKED),
}
"""What each step measures: the name of its result, the function and its cases."""


def print_tables(kept: dict) -> None:
    """Print each table as Markdown."""
    show = lambda names, *case: " | ".join(column(kept.get(key(case)), name) for name in names)
    names = "volume", "size", "multiplier"
    heads = [f"{what}, {legs}" for what in ("volume", "disturbance", "multiplier") for legs in LEGS]
    print("\n| masses | slope | feet | " + " | ".join(heads) + " |")
    print("|---|---:|---|" + "---:|" * len(heads))
    for masses, slopes in SLOPES.items():
        for slope in slopes:
            for radius in (0.0, ROUND):
                both = [show([n], masses, legs, radius, slope) for n in names for legs in LEGS]
                feet = "round" if radius else "points"
                print(f"| {masses} | {slope:g} | {feet} | {' | '.join(both)} |")
    names = "volume", "size", "multiplier", "heel", "knee", "speed", "step"
    print(
        "\n| slope | legs | radius | volume | disturbance | multiplier | lost at heel strike | ",
        end="",
    )
    print("of all, at knee strike | speed | step |")
    print("|---:|---|---:|" + "---:|" * len(names))
    for slope, *chosen in SERIES:
        for legs in chosen:
            for radius in RADII:
                if key(("default", legs, radius, slope)) in kept:
                    row = show(names, "default", legs, radius, slope)
                    print(f"| {slope:g} | {legs} | {radius:g} | {row} |")
    for case in SLICED:
        one = kept.get(key(case), {})
        if "slice" in one:
            print(f"slice of {key(case)}: {one['slice']:.5f} +- {one['slice_error']:.5f}")
    for case in CLOSE:
        one = kept.get(key(case), {})
        if "fine" in one:
            print(f"refined three times, {key(case)}: {one['fine']:.5f} +- {one['fine_error']:.5f}")
    for case in CHECKED:
        one = kept[key(case)]
        if "low" in one:
            print(
                f"\n{key(case)}: {one['volume']:.5f} +- {one['error']:.5f}, by {STARTS} starts "
                f"{one['by_starts']:.5f} ({one['low']:.5f} to {one['high']:.5f})"
            )


def column(one: dict | None, name: str) -> str:
    """One number of a table, with its error where it has one."""
    if one is None:
        return "no gait"
    if name == "volume" and name in one:
        return f"{one[name]:.4f} ± {one['error']:.4f}"
    if name == "size" and name in one:
        return f"{one[name]:.4f}"
    unknown = "unstable" if one["multiplier"] >= 1 else ""
    return f"{abs(one[name]):.3f}" if name in one else unknown


def draw(kept: dict, place: Path) -> None:
    """Volumes over slope and radius, least disturbances and multipliers over the radius."""
    figure, axes = plt.subplots(2, 2, figsize=(10, 7.6), layout="constrained")
    lines = {"straight": "-o", "knees": "--s"}
    names = {"straight": "straight legs", "knees": "knees"}
    for radius, colour in ((0.0, BASINS[0]), (ROUND, BASINS[1])):
        for legs in LEGS:
            found = [kept.get(key(("default", legs, radius, s)), {}) for s in SLOPES["default"]]
            feet = "round feet" if radius else "point feet"
            look = {"color": colour, "label": f"{names[legs]}, {feet}", "ms": 5}
            values, errors = (np.array([x.get(n, np.nan) for x in found]) for n in VOLUME)
            axes[0, 0].errorbar(SLOPES["default"], values, errors, None, lines[legs], **look)
    titles = {
        "volume": ("Volume over the foot radius", VOLUME_LABEL),
        "size": (
            "Least disturbance over the foot radius",
            "least disturbance (rad, time in √(l/g))",
        ),
        "multiplier": ("Largest multiplier over the foot radius", "modulus"),
    }
    for ax, (name, (title, label)) in zip(axes.flat[1:], titles.items(), strict=True):
        for (slope, *chosen), colour in zip(SERIES, (INK, BASINS[2]), strict=True):
            for legs in chosen:
                found = [(r, kept.get(key(("default", legs, r, slope)), {})) for r in RADII]
                known = [(r, one) for r, one in found if name in one]
                radii, values = [r for r, _ in known], [one[name] for _, one in known]
                look = {"color": colour, "label": f"{names[legs]}, slope {slope:g}", "ms": 5}
                ax.plot(radii, values, lines[legs], **look)
        if name == "volume":
            ax.set_yscale("log")
        ax.set_title(title, **TITLE)
        ax.set(xlabel="foot radius (leg lengths)", ylabel=label)
    axes[0, 0].set_title("Volume of the basin over the slope", **TITLE)
    axes[0, 0].set(xlabel="slope (rad)", ylabel=VOLUME_LABEL, ylim=(0, 0.1))
    axes[0, 0].set_xticks(SLOPES["default"])
    for ax in axes.flat:
        ax.spines[["top", "right"]].set_visible(False)
    axes[0, 0].legend(frameon=False, loc="upper left")
    axes[0, 1].legend(frameon=False)
    figure.savefig(place, dpi=150)


VOLUME = "volume", "error"
VOLUME_LABEL = "volume (rad³ g/l)"

if __name__ == "__main__":
    main(*sys.argv[1:])

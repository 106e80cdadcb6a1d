"""What does a walk in space cost, and how far does the basin of the toy reach?

First the time: starts are spread by 0.02 about the gait of each walker, and followed to an
attractor or a failure. A walker in space has ten variables and seven dimensions of starts; a planar
one on round feet has four and three. The processor time of both is measured in turn, in one run.
Then, with `--study`, the basin: how far along each coordinate of the section walkers return, up to
the first that does not; the share that returns from a cube about the gait; and this share over hip
width, radius of the discs and inertia. `--design` follows the exact gradient of the least
disturbance in all seven coordinates to a design with a larger basin. `--picture` draws a slice of
the basin.

A stride in space takes 11 times as long as a planar one on round feet, both in walks, which end at
different strides, and when all of 20,000 starts make one stride (`wj.strides`, 25.9 against 2.48 us
of processor time). `--study` gives the numbers of docs/results.md.

    in space: 5.8 strides a start, 34.51 us of processor time a stride, 57958 strides a second on
    two cores, 101 s for a million starts there
    round feet: 2.3 strides a start, 3.18 us of processor time a stride, 628832 strides a second on
    two cores, 4 s for a million starts there
    a stride in space takes 10.8 times as long

(On a machine that had other processes to run: the ratio counts, not the times.)

    python benchmarks/space.py
    python benchmarks/space.py --study
    python benchmarks/space.py --design
    python benchmarks/space.py --picture docs/space.png
"""

import sys
import time

import jax
import numpy as np

import walker_jax as wj
from walker_jax import figures
from walker_jax.basins.attractor import Attractor
from walker_jax.basins.mapper import Mapper
from walker_jax.gaits.search import search_gait
from walker_jax.integrators.integrator import Integrator
from walker_jax.stability.gait_mapper import mapper_of_gait

jax.config.update("jax_enable_x64", True)
COUNT, REPEATS, SPREAD = 10_000, 3, 0.02
SAMPLES = 4000
STRIDES = 500
FARTHEST, DISTANCES = 3.0, 400
FREE = ("hip_width", "disc_radius", "com_height", "com_outward")
STEPS, LONGEST, DIRECTIONS = 4, 0.02, 2000
CELLS = 240
SIZES = {
    "hip_width": (0.325, 0.33, 0.34, 0.35, 0.375, 0.4, 0.45),
    "disc_radius": (0.08, 0.1, 0.11, 0.14, 0.155, 0.165),
    "com_height": (0.28, 0.3, 0.33, 0.36),
    "com_outward": (0.6, 0.65, 0.75, 0.8),
    "inertia_xx": (0.19, 0.2184, 0.26, 0.3),
    "inertia_zz": (0.185, 0.22, 0.3),
    "slope": (0.06, 0.065, 0.075, 0.08, 0.09),
}


def compare_times() -> None:
    walkers = {"in space": wj.SpatialWalker(), "round feet": wj.RoundFootWalker(0.02)}
    rng, starts, mappers = np.random.default_rng(0), {}, {}
    for name, walker in walkers.items():
        gait = wj.find_gait(walker)
        x = np.asarray(gait.states[0])
        starts[name] = x + SPREAD * rng.uniform(-1, 1, (COUNT, len(x)))
        mappers[name] = mapper_of_gait(walker, gait, STRIDES, None)
        mappers[name](starts[name][:100])
    least, made = {name: np.inf for name in walkers}, {}
    for _ in range(REPEATS):
        for name, mapper in mappers.items():
            begun = time.process_time()
            labels = mapper(starts[name])
            least[name] = min(least[name], time.process_time() - begun)
            made[name] = labels.total_strides
    each = {name: least[name] / made[name] for name in walkers}
    for name, seconds in each.items():
        print(
            f"{name}: {made[name] / COUNT:.1f} strides a start, {1e6 * seconds:.2f} us of "
            f"processor time a stride, {2 / seconds:.0f} strides a second on two cores, "
            f"{1e6 * least[name] / COUNT / 2:.0f} s for a million starts there"
        )
    print(f"a stride in space takes {each['in space'] / each['round feet']:.1f} times as long")


def measure_extents(mapper, x: np.ndarray) -> None:
    """The first failure along each coordinate, on both sides."""
    for i, name in enumerate(mapper.walker.section):
        for sign in (-1, 1):
            low, high = 0.0, FARTHEST
            distances = np.geomspace(1e-5, FARTHEST, DISTANCES)
            while True:
                points = x + sign * distances[:, None] * np.eye(7)[i]
                labels = mapper(points)
                first = int((~labels.converged).argmax())
                low, high = distances[first - 1] if first else low, distances[first]
                if high - low < 1e-7:
                    break
                distances = np.linspace(low, high, 41)[1:]
            fate = wj.Outcome(int(labels.fate[first])).name
            made = int(labels.strides[first])
            print(f"{name}: {sign * high:+.7f}, {fate} after {made} strides")


def without_boxes(walker: wj.SpatialWalker, gait: wj.Gait) -> Mapper:
    """The mapper to a gait that follows walkers until they are there: boxes would cost more."""
    attractor = Attractor(np.asarray(gait.states))
    return Mapper(walker, [attractor], Integrator(1e-12), STRIDES)


def returning(walker: wj.SpatialWalker, guess: np.ndarray, offsets: np.ndarray) -> str:
    """The share of starts that returns, its standard error, and what becomes of the others."""
    gait = search_gait(walker, guess)
    if not (gait.found and gait.stable):
        return "no stable gait"
    labels = without_boxes(walker, gait)(np.asarray(gait.states[0]) + offsets)
    share = labels.converged.mean()
    error = np.sqrt(share * (1 - share) / len(offsets))
    names, counts = np.unique(labels.fate[~labels.converged], return_counts=True)
    fates = ", ".join(
        f"{wj.Outcome(int(name)).name} {count}" for name, count in zip(names, counts, strict=True)
    )
    modulus = abs(gait.multipliers[0])
    return f"{share:.4f} +- {error:.4f}; largest multiplier {modulus:.4f}; {fates}"


def study() -> None:
    walker = wj.SpatialWalker()
    gait = wj.find_gait(walker)
    x = np.asarray(gait.states[0])
    measure_extents(mapper_of_gait(walker, gait, STRIDES, None), x)
    offsets = SPREAD * np.random.default_rng(1).uniform(-1, 1, (SAMPLES, 7))
    print(f"toy: {returning(walker, x, offsets)}")
    for name, values in SIZES.items():
        for value in values:
            other = wj.SpatialWalker(**{name: value})
            print(f"{name} {value}: {returning(other, x, offsets)}")


def design() -> None:
    """Steps along the gradient of the least disturbance by the logarithms of four sizes."""
    walker = wj.SpatialWalker()
    guess = np.asarray(wj.find_gait(walker).states)
    offsets = SPREAD * np.random.default_rng(1).uniform(-1, 1, (SAMPLES, 7))
    for step in range(STEPS + 1):
        gait = wj.find_gait(walker, guess)
        guess = np.asarray(gait.states)
        found = wj.measure(walker, "least-disturbance", FREE, gait, directions=DIRECTIONS)
        values = np.array([float(getattr(walker, name)) for name in FREE])
        print(step, values.round(5).tolist(), f"least disturbance {found.value:.8f}", flush=True)
        slope = found.gradient * values
        print(f"  {returning(walker, guess, offsets)}; by logarithms {slope.round(5).tolist()}")
        values = values * np.exp(LONGEST * slope / np.abs(slope).max())
        walker = wj.SpatialWalker(**dict(zip(FREE, values.tolist(), strict=True)))


def draw(place: str) -> None:
    """The slice of yaw and rate of lean through the gait, and that of theta and its rate."""
    import matplotlib.pyplot as plt

    walker = wj.SpatialWalker()
    x = np.asarray(wj.find_gait(walker).states[0])
    point = dict(zip(walker.section, x.tolist(), strict=True))
    around = lambda name, half: (point[name] - half, point[name] + half, CELLS)
    slices = ({"yaw": 0.25, "leandot": 0.05}, {"theta": 0.05, "thetadot": 0.12})
    fig, axes = plt.subplots(1, 2, figsize=(13, 5.8), layout="constrained")
    for ax, sizes in zip(axes, slices, strict=True):
        grid = wj.Grid.through(point, **{name: around(name, half) for name, half in sizes.items()})
        figures.basin(wj.basin(walker, grid, "direct", strides=200), ax=ax)
    fig.savefig(place, dpi=110)


if __name__ == "__main__":
    if "--picture" in sys.argv:
        draw(sys.argv[-1])
    elif "--design" in sys.argv:
        design()
    elif "--study" in sys.argv:
        study()
    else:
        compare_times()

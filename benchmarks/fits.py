"""Do intervals of 95 % hold the truth 95 times in a hundred, and how long does a fit take?

Made-up recordings of twelve steps by encoders: angles with normal noise of 1e-3 rad, rounded to
4096 counts a turn, and heel strikes with noise of 1e-3. Every fit begins at parameters that are off
by a tenth. Then one long recording is fitted by SciPy as well: `least_squares` on the same
residuals, compiled by the package, with derivatives by differences.

The answer: of 400 intervals for the slope of the simplest walker, 94.2 % hold the truth; for the
slope and the foot mass of the walker with point feet 95.8 % and 96.0 %; for the slope and the shank
mass of the walker with knees 95.0 % and 95.0 %. A fit takes 0.04 s, 0.11 s and 0.4 s of a
processor, and the longest 0.3 s, 0.4 s and 2.4 s by the clock, on two that eight programs shared.
SciPy takes 64 to 75 times as long for 120 steps, 17 to 21 s beside 0.25 to 0.29 s in three runs on
a quiet machine, both with OPENBLAS_NUM_THREADS=1; 49 to 59 times with two threads of BLAS, which
wait for each other. With two, an earlier version had 36 times for 60 steps, 126 times for 240.

Usage: python benchmarks/fits.py [simplest compass kneed scipy ...] [fits]
"""

import sys
import time

import jax
import numpy as np
from jax.flatten_util import ravel_pytree
from scipy.optimize import least_squares

import walker_jax as wj
from walker_jax.fitting.residuals import all_residuals
from walker_jax.walkers.parameters import value_of, with_values

jax.config.update("jax_enable_x64", True)

NOISE, COUNT = 1e-3, 2 * np.pi / 4096
DEVIATIONS: dict[str, float] = {"time": 1e-3}
TOLERANCE = 1e-9  # of each step: a millionth of the noise
CASES = {  # the walker, parameters, columns, time between samples
    "simplest": (wj.SimplestWalker(0.009), ("slope",), ("theta", "phi"), 0.1),
    "compass": (wj.PointFootWalker(0.009, 0.05), ("slope", "foot_mass"), ("theta", "phi"), 0.3),
    "kneed": (wj.KneedWalker(0.05), ("slope", "shank_mass"), ("theta", "phi", "knee"), 0.3),
}


def noise_of(columns) -> dict[str, float]:
    """Return the noise of all columns, rounding included, and that of heel strikes."""
    return dict.fromkeys(columns, float(np.hypot(NOISE, COUNT / np.sqrt(12)))) | DEVIATIONS


def make_motion(walker, columns, spacing, steps):
    """Make times, exact angles, and times of heel strikes, from a disturbed gait."""
    gait = wj.find_gait(walker)
    made = wj.walk(walker, gait.states[0] * 1.002, steps)
    strikes = np.append(0, np.cumsum(made.times))
    times = np.arange(spacing / 2, strikes[-1], spacing)
    state = wj.trajectory(walker, made.states[0], times, strides=steps)
    return times, {name: np.asarray(getattr(state, name)) for name in columns}, strikes


def record(motion, random):
    """Record a motion by encoders."""
    times, angles, strikes = motion
    noisy = {
        name: COUNT * np.round((one + NOISE * random.normal(size=len(times))) / COUNT)
        for name, one in angles.items()
    }
    at = strikes + DEVIATIONS["time"] * random.normal(size=len(strikes))
    return wj.read_recordings({"time": times} | noisy, strikes=at)


def cover(name, count):
    """Return a row: how often intervals hold the truth, and the times of the fits."""
    walker, names, columns, spacing = CASES[name]
    truth = np.array([float(value_of(walker, one)) for one in names])
    guess = with_values(walker, {one: 1.1 * value for one, value in zip(names, truth, strict=True)})
    noise = noise_of(columns)
    motion, random = make_motion(walker, columns, spacing, 12), np.random.default_rng(1)
    held, errors, spent = [], [], []
    for _ in range(count):
        recordings, begun = record(motion, random), time.perf_counter()
        found = wj.fit(guess, recordings, names, noise=noise, tolerance=TOLERANCE)
        spent.append(time.perf_counter() - begun)
        ends = np.array([*found.intervals().values()])
        held.append((ends[:, 0] < truth) & (truth < ends[:, 1]) & found.converged)
        values, deviations = [*found.parameters.values()], [*found.errors.values()]
        errors.append((np.array(values) - truth) / deviations)
    shares = ", ".join(f"{share:.1%}" for share in np.mean(held, axis=0))
    spread = ", ".join(f"{one:.3f}" for one in np.std(errors, axis=0))
    times = f"{np.median(spent):.2f} s, {max(spent[1:]):.2f} s"
    return f"| {name} | {', '.join(names)} | {count} | {shares} | {spread} | {times} |"


def clocks() -> np.ndarray:
    """Return the time, and that of the processor, in which threads that wait spin."""
    return np.array([time.perf_counter(), time.process_time()])


def compare(steps):
    """Print times of one fit, and of SciPy's with differences on the same residuals.

    Neither includes compilation; SciPy begins where the starts of steps are fitted already. Of a
    fit they are medians of several.
    """
    walker, names, columns, spacing = CASES["simplest"]
    motion = make_motion(walker, columns, spacing, steps)
    recordings = record(motion, np.random.default_rng(0))
    noise = noise_of(columns)
    asked = with_values(walker, {"slope": 1.1 * walker.slope}), recordings, names
    found, spent = wj.fit(*asked, noise=noise), []  # compiles
    for _ in range(9):
        begun = clocks()
        found = wj.fit(*asked, noise=noise)
        spent.append(clocks() - begun)
    ours = np.median(spent, axis=0)
    posed = found.problem
    assert posed is not None
    flat, unflatten = ravel_pytree(posed.begun)
    residuals = jax.jit(lambda at, data: all_residuals(posed.layout, unflatten(at), data))
    by_hand = lambda at: np.asarray(residuals(at, posed.data))
    by_hand(np.asarray(flat))
    begun = clocks()
    other = least_squares(by_hand, np.asarray(flat), x_scale="jac")
    theirs = clocks() - begun
    cost = found.data.attrs["sum_of_squares"]
    print(f"{steps} steps, {len(flat)} unknowns, {len(other.fun)} residuals")
    for name, a, b in zip(("clock", "processor"), ours, theirs, strict=True):
        print(f"{name}: {a:.2f} s; SciPy {b:.2f} s, {b / a:.0f} times as long")
    print(f"sums of squares {cost:.6f} and {2 * other.cost:.6f}")


if __name__ == "__main__":
    words = [one for one in sys.argv[1:] if not one.isdigit()] or [*CASES, "scipy"]
    (fits_made,) = [int(one) for one in sys.argv[1:] if one.isdigit()] or [400]
    print("| walker | parameters | fits | intervals hold the truth | spread | time, longest |")
    for case in words:
        if case != "scipy":
            print(cover(case, fits_made), flush=True)
    if "scipy" in words:
        for steps_made in (60, 120, 240):
            compare(steps_made)

"""Which number predicts how rough a ground a walker bears, and what does swing-leg control add?

Hobbelen and Wisse (2007) report a correlation of 93 % between their gait sensitivity norm and the
largest disturbance that a walker survives, over slope, foot radius and hip stiffness. Here the
roughness that a walker bears is the standard deviation of normally distributed steps at which it
falls after 100 strides on average. Its logarithm is compared with those of five numbers, each
oriented so that more is better, over walkers with random parameters that have a stable gait: point
feet over slope, hip stiffness and damping; round feet over slope and radius; and point feet with a
spring whose slack angle is fed back at each heel strike with random gains. Rank correlation
(Spearman) and linear correlation (Pearson), with bootstrap intervals of 95 %.

Then `wj.optimise` makes the area larger by a hip spring with a constant slack angle, and by its
feedback, neither of which costs energy, and the sensitivity norm smaller by feedback.

Some five minutes of processor time; and in the last part five for four walkers, and more than two
for the fifth, whose spring is optimised for the area by itself. docs/powered.md shows the results.
"""

import json
import sys
from pathlib import Path
from typing import Any

import jax
import numpy as np
import xarray as xr
from scipy.stats import pearsonr, qmc, spearmanr

import walker_jax as wj
from walker_jax.basins.windows import default_region
from walker_jax.gaits.search import search_gait
from walker_jax.walkers.parameters import parameters, with_parameter

SLOPE = 0.009
REGION = wj.Grid.sheared(theta=(0, np.pi / 4, 100), sum=(-0.3, 0.3, 240))
"""Where the areas of walkers on point feet are."""
MEAN, WALKS, LIMIT = 100, 300, 400
"""Strides until a fall, number of walks, and strides after which these are left off."""
COARSE, FINE = 1.5, 1.1
"""Factors from one roughness to the next."""
WALKERS = {"point": 14, "round": 8, "feedback": 10}
PREDICTORS = ("area", "disturbance", "multiplier", "sensitivity", "stability")
WORDS = {
    "area": "area of the basin",
    "disturbance": "least disturbance",
    "multiplier": "1 - largest multiplier",
    "sensitivity": "1 / sensitivity norm",
    "step sensitivity": "1 / norm of steps on time",
    "stability": "basin stability",
}
UNITS = {"area": "\n(rad² / √(l/g))", "disturbance": "\n(rad, time in √(l/g))"}
RESAMPLES = 4000
PRINTED = 0.93


def main(part: str = "all", folder: str = ".") -> None:
    jax.config.update("jax_enable_x64", True)
    place = Path(folder)
    if part in ("all", "measure"):
        for family in WALKERS:
            rows = [row for walker in draw_walkers(family) if (row := measure(walker, family))]
            (place / f"predictors-{family}.json").write_text(json.dumps(rows))
    if part in ("all", "compare"):
        files = sorted(place.glob("predictors-*.json"))
        rows = [row for file in files for row in json.loads(file.read_text())]
        compare(rows)
        draw(rows, place / "predictors.png")
    if part in ("all", "train"):
        train()


def draw_walkers(family: str) -> list[wj.Walker]:
    """Walkers with random parameters."""
    count = WALKERS[family]
    draws = lambda low, high: qmc.scale(
        qmc.LatinHypercube(len(low), rng=np.random.default_rng(7)).random(count), low, high
    ).tolist()
    if family == "point":
        rows = draws([0.004, 0, 0], [0.014, 1.5, 0.03])  # more damping leaves no gait
        return [wj.PoweredWalker(*row) for row in rows]
    if family == "round":
        return [wj.RoundFootWalker(a, foot_radius=b) for a, b in draws([0.004, 0], [0.012, 0.4])]
    passive = wj.PoweredWalker(SLOPE, 1.0)
    gait = wj.find_gait(passive)
    return [wj.Feedback(passive, gait, {"hip_angle": row}) for row in draws([-2, -2], [2, 2])]


def measure(walker: wj.Walker, family: str) -> dict | None:
    """All numbers of a walker; None without a stable gait."""
    gait = search_gait(walker)
    if not (gait.found and gait.stable):
        return None
    region: Any = default_region(walker) if family == "round" else REGION
    scale = np.abs(gait.states[0])
    norm = wj.gait_sensitivity(walker, gait).norm
    of_steps = wj.gait_sensitivity(walker, gait, ("step",), ("time",)).norm
    stability = wj.basin_stability(walker, 0.1, gait, scale=scale, samples=2000, strides=200)
    area = wj.measure(walker, "area", (), grid=region, levels=1, check=20_000).value
    row = {
        "family": family,
        "parameters": {name: float(value) for name, value in vars(walker).items()},
        "area": float(area),
        "disturbance": wj.least_disturbance(walker, gait, directions=256, strides=200).size,
        "multiplier": 1 - float(np.abs(gait.multipliers[0])),
        "sensitivity": 1 / float(norm),
        "step sensitivity": 1 / float(of_steps),
        "stability": float(stability.value),
        "roughness": roughness_borne(walker, gait),
    }
    print(json.dumps(row), flush=True)
    return row


def roughness_borne(walker: wj.Walker, gait: wj.Gait) -> float:
    """Standard deviation of steps at which a walker falls after MEAN strides on average."""

    def log_mean(roughness: float) -> float:
        walks = wj.steps_to_fall(walker, roughness, WALKS, gait=gait, limit=LIMIT)
        return np.log(min(max(walks.mean, 0.1), 1e6))

    roughness = 2e-4
    while log_mean(roughness) > np.log(MEAN):
        roughness *= COARSE
    while log_mean(roughness) < np.log(MEAN):
        roughness /= FINE
    low, high = log_mean(roughness), log_mean(roughness * FINE)
    return roughness * FINE ** ((low - np.log(MEAN)) / (low - high))


def compare(rows: list[dict]) -> None:
    """Print correlations of each number with the roughness that is borne."""
    groups = {family: [row for row in rows if row["family"] == family] for family in WALKERS}
    for name, group in (*groups.items(), ("all", rows)):
        if len(group) < 3:
            continue
        print(f"{name}, {len(group)} walkers:")
        for predictor in WORDS:
            x, y = (
                np.log([max(row[key], 1e-3 if key == "stability" else 1e-12) for row in group])
                for key in (predictor, "roughness")
            )
            parts = [
                f"{with_interval(statistic, x, y)}"
                for statistic in (lambda a, b: spearmanr(a, b)[0], lambda a, b: pearsonr(a, b)[0])
            ]
            print(f"  {WORDS[predictor]:26} rank {parts[0]}  linear {parts[1]}")
    print(f"printed for the sensitivity norm, linear: {PRINTED:.2f}")


def with_interval(statistic, x: np.ndarray, y: np.ndarray) -> str:
    """A correlation and its bootstrap interval."""
    rng = np.random.default_rng(0)
    draws = []
    for _ in range(RESAMPLES):
        chosen = rng.integers(len(x), size=len(x))
        if np.ptp(x[chosen]) > 0 and np.ptp(y[chosen]) > 0:
            draws.append(statistic(x[chosen], y[chosen]))
    low, high = np.percentile(draws, (2.5, 97.5)) if draws else (np.nan, np.nan)
    value = statistic(x, y) if np.ptp(x) > 0 else np.nan
    return f"{value:+.2f} ({low:+.2f} to {high:+.2f})"


def draw(rows: list[dict], path: Path) -> None:
    """The roughness that is borne against each number."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import LogLocator, NullFormatter

    from walker_jax.figures.style import BASINS

    figure = Figure(figsize=(10.5, 6.2), layout="constrained")
    figure.suptitle(
        "Roughness at which a walker falls after 100 strides", x=0.01, ha="left", fontweight="bold"
    )
    panels = figure.subplots(2, 3, sharey=True).flat
    looks = {"point": (BASINS[0], "o"), "round": ("#c7691c", "s"), "feedback": (BASINS[2], "^")}
    words = {"point": "point feet", "round": "round feet", "feedback": "feedback"}
    for ax, (name, about) in zip(panels, WORDS.items(), strict=True):
        for family, (colour, mark) in looks.items():
            own = [row for row in rows if row["family"] == family and row[name] > 0]
            x, y = ([row[key] for row in own] for key in (name, "roughness"))
            ax.plot(x, y, mark, color=colour, mec="white", ms=7, label=words[family])
        ax.set(xscale="log", yscale="log", xlabel=about + UNITS.get(name, ""))
        for axis in (ax.xaxis, ax.yaxis):
            axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
            axis.set_major_formatter("{x:g}")
            axis.set_minor_formatter(NullFormatter())
        ax.tick_params(axis="x", labelsize="small")
        ax.grid(alpha=0.3)
    for ax in list(figure.axes)[::3]:
        ax.set_ylabel("roughness borne (leg lengths)")
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper right", ncols=3, frameon=False)
    figure.savefig(path, dpi=150)


def train() -> None:
    """What a hip spring with a slack angle, and its feedback, add at no cost of energy."""
    passive = wj.PoweredWalker(SLOPE)
    report("passive", passive)
    gait = wj.find_gait(wj.PoweredWalker(SLOPE, 1.0))
    gains = {"hip_angle_per_theta": (-4.0, 4.0), "hip_angle_per_thetadot": (-4.0, 4.0)}
    fed = wj.Feedback(wj.PoweredWalker(SLOPE, 1.0), gait, {"hip_angle": [0.0, 0.0]})
    report("hip spring of stiffness 1", fed)
    report("its feedback, for the norm", optimised(fed, gains, "sensitivity-norm"))
    report("its feedback, for the area", optimised(fed, gains, "area"))
    spring = wj.PoweredWalker(SLOPE, 1.0, hip_angle=-0.1)
    bounds = {"hip_stiffness": (0.0, 20.0), "hip_angle": (-0.6, 0.2), "hip_damping": (0.0, 4.0)}
    report("hip spring, for the area", optimised(spring, bounds, "area"))


def optimised(walker: wj.Walker, bounds: dict, objective: str) -> wj.Walker:
    """The walker with the best values of its free parameters."""
    data: xr.Dataset = wj.optimise(
        walker, bounds, objective, grid=REGION if objective == "area" else None, starts=1, levels=1
    )
    for name, value in zip(data["parameter"].values, data["optimum"].values, strict=True):
        walker = with_parameter(walker, str(name), float(value))
    return walker


def report(name: str, walker: wj.Walker) -> None:
    gait = wj.find_gait(walker)
    names = [one.name for one in parameters(walker)]
    area = wj.measure(walker, "area", (), grid=REGION, levels=2)
    cost = wj.measure(walker, "cost-of-transport", (), gait).value
    print(
        json.dumps(
            {
                "walker": name,
                "parameters": {one: round(float(getattr(walker, one)), 6) for one in names},
                "area": area.value,
                "area_error": area.value_error,
                "norm": float(wj.gait_sensitivity(walker, gait).norm),
                "multiplier": float(np.abs(gait.multipliers[0])),
                "cost": cost,
                "least_disturbance": wj.least_disturbance(walker, gait).size,
                "roughness": roughness_borne(walker, gait),
            }
        ),
        flush=True,
    )


if __name__ == "__main__":
    main(*sys.argv[1:])

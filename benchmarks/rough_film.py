"""How do a trained walker and an untrained one walk on the same rough ground? A film.

Both have a hip spring of stiffness 1 at slope 0.009. The trained one sets the spring's slack angle
at each heel strike, with gains near those that benchmarks/predictors.py finds for the norm.
Neither spends energy on it. The steps of the ground are normally distributed. On such ground 300
walks last 3.9 (3.7 to 4.1) and 16.4 (14.7 to 18.2) strides on average. Of the first twelve seeds,
the film has the one on which both walkers come nearest to these means.

    python benchmarks/rough_film.py docs/rough.gif

writes the film that docs/powered.md shows, in some ten seconds.
"""

import sys
from itertools import zip_longest
from pathlib import Path

import jax
import numpy as np
from matplotlib.figure import Figure

import walker_jax as wj
from walker_jax.figures.films import film_writer
from walker_jax.figures.poses import draw_ground, draw_pose, leg_size, to_level

GAINS = 3.37, 2.2
ROUGHNESS, STRIDES, SEED = 0.003, 100, 4
FRAME_INTERVAL = 0.3
"""Time between frames, of which 20 are shown in a second."""


def main(path: str = "rough.gif") -> None:
    jax.config.update("jax_enable_x64", True)
    spring = wj.PoweredWalker(0.009, 1.0)
    gait = wj.find_gait(spring)
    trained = wj.Feedback(spring, gait, {"hip_angle": GAINS})
    heights = ROUGHNESS * np.random.default_rng(SEED).normal(size=STRIDES)
    walks = {
        name: wj.motion(walker, gait.states[0], STRIDES, step=FRAME_INTERVAL, ground=heights)
        for name, walker in (("hip spring alone", spring), ("with feedback", trained))
    }
    figure = Figure(figsize=(6, 3), layout="constrained")
    axes = figure.subplots(1, 2)
    headings = []
    for ax, (name, walk) in zip(axes, walks.items(), strict=True):
        draw_ground(ax, walk)
        ax.set_axis_off()
        ax.set_aspect("equal")
        ax.set_title(name, loc="left", fontsize=10)
        headings.append(ax.set_title("stride 1", loc="right", fontsize=10, fontweight="bold"))
    figure.draw_without_rendering()
    figure.set_layout_engine("none")
    counts = [int((walk["outcome"].values == wj.Outcome.STRIDE).sum()) for walk in walks.values()]
    print(dict(zip(walks, counts, strict=True)))
    frames = zip_longest(*(range(walk.sizes["frame"]) for walk in walks.values()))
    with film_writer(figure, Path(path), "", [*axes]) as grab:
        for numbers in frames:
            drawn = []
            for ax, heading, walk, k, made in zip(
                axes, headings, walks.values(), numbers, counts, strict=True
            ):
                fallen = k is None
                pose = walk.isel(frame=-1 if fallen else k)
                drawn += draw_pose(ax, pose)
                follow(ax, walk, pose)
                down = fallen or k == walk.sizes["frame"] - 1
                number = int(pose["stride"])
                heading.set_text(f"fell after {made} strides" if down else f"stride {number + 1}")
            grab()
            for one in drawn:
                one.remove()


def follow(ax, walk, pose) -> None:
    """Show the surroundings of the walker."""
    tall = 1.2 * leg_size(walk)
    x, y = to_level(pose["hip"].values[None] * [[1, 0]], float(walk.attrs["walker_slope"]))[0]
    y += float(walk["footholds"][min(int(pose["stride"]), walk.sizes["foothold"] - 1), 1])
    ax.set(xlim=(x - 0.75 * tall, x + 0.75 * tall), ylim=(y - 0.25 * tall, y + tall))


if __name__ == "__main__":
    main(*sys.argv[1:])

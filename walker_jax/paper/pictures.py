"""The paper's figures, each with its caption."""

from collections.abc import Callable
from typing import NamedTuple

import xarray as xr
from matplotlib.figure import Figure

from walker_jax import figures
from walker_jax.figures.layout import figure_of


class PaperFigure(NamedTuple):
    """A figure of the paper."""

    number: int
    title: str
    draw: Callable[[dict[str, xr.Dataset]], Figure]
    text: str


FIGURES = (
    PaperFigure(
        1,
        "A step",
        lambda data: figures.step(data["stride"]),
        "Drawn from a computed stride: the gait at a slope of 0.009, whose steps are longer than "
        "those at 0.004. The swing foot is a little above the ground until the legs are about to "
        "pass each other, below it for a moment between the third pose and the fourth, which the "
        "model allows, and then above it until the heel strike of the last pose.",
    ),
    PaperFigure(
        2,
        "The Poincaré section",
        lambda data: figure_of(figures.basin(data["section"])),
        "The whole feasible section at a slope of 0.004, every cell followed until it fails or "
        "converges to the gait: F falls forward, B backward, and R runs (its foot pulls at the "
        "ground). The basin of attraction, which is too narrow for a letter, is dark; the dot is "
        "the gait. At the right border, a few walkers stop on both feet.",
    ),
    PaperFigure(
        3,
        "Fixed points over the slope",
        lambda data: figure_of(figures.gait_branches(data["gaits"])),
        "The long gait, the middle line, is stable up to a slope of 0.01509, where it doubles its "
        "period; the short one below it never is, nor is a slower one above, whose leg swings to "
        "and fro once more. A fourth gait differs from that by less than 0.00002.",
    ),
    PaperFigure(
        4,
        "The basin, enlarged and sheared",
        lambda data: figure_of(figures.basin(data["cell_mapping"])),
        "Cell mapping on the paper's own grid: 200 × 250 cells, Δθ = 0.002, Δ(θ + θ̇) = 0.0002. A "
        "walker that leaves this window is lost to cell mapping; the figure below is by direct "
        "iteration.",
    ),
    PaperFigure(
        5,
        "Nine steps towards the fixed point",
        lambda data: figures.steps_over_basin(data["direct_iteration"], data["walk"]),
        "From just inside the first tail of the basin. The basin is that of the same cells, by "
        "direct iteration.",
    ),
    PaperFigure(
        6,
        "Leg angles on that walk",
        lambda data: figure_of(figures.leg_angles(data["walk"])),
        "The legs exchange roles at every heel strike, the thin lines.",
    ),
    PaperFigure(
        7,
        "The basin at increasing slopes",
        lambda data: figures.basins_in_a_row(data["basins"]),
        "The paper does not print its slopes. Where the basin is largest it has smooth edges; at "
        "steeper slopes fingers of failure reach into it; beyond 0.01905 it is lost.",
    ),
    PaperFigure(
        8,
        "Stability, and area of the basin",
        lambda data: figure_of(figures.stability_and_area(data["gaits"], data["areas"])),
        "The gait is most stable at a slope of 0.0138, and the basin is largest on the smallest "
        "slope: one says nothing about the other. Areas are those of the whole section up to "
        "θ = π/4, by cells of the paper's size, and by refinement.",
    ),
)

"""Passive dynamic walkers: their gaits, and the basins of attraction of these.

    import walker_jax as wj

    walker = wj.SimplestWalker(slope=0.004)
    grid = wj.Grid.sheared(theta=(0, 0.4, 200), sum=(-0.04, 0.01, 250))
    wj.basin(walker, grid)

Importing sets no JAX flag. Turn on float64 for numbers to quote:
`jax.config.update("jax_enable_x64", True)`.
"""

from importlib.metadata import version

from walker_jax.basin import basin, compare_methods
from walker_jax.bifurcations import attractors, bifurcation_diagram, loss_of_walking
from walker_jax.boundaries import Dimension, Uncertainty, box_counting, uncertainty_exponent
from walker_jax.branches import Bifurcation, Branch, continue_gait
from walker_jax.cells import Grid
from walker_jax.checks import ComputationFailed
from walker_jax.design import optimise
from walker_jax.gaits import Gait, descend, find_gait, find_gaits, gait_derivatives
from walker_jax.margins import Margins, margins, margins_of_many
from walker_jax.motion import motion
from walker_jax.objectives import (
    AreaGradient,
    DisturbanceGradient,
    Measure,
    area_gradient,
    disturbance_gradient,
    gait_measures,
)
from walker_jax.refinement import refine
from walker_jax.robustness import (
    BasinStability,
    LeastDisturbance,
    LeastStepDown,
    basin_stability,
    boundary_dimension,
    least_disturbance,
    least_step_down,
    robustness,
    robustness_table,
)
from walker_jax.stride import Outcome, Stride, Walk, step_down, stride, strides, trajectory, walk
from walker_jax.sweep import sweep
from walker_jax.walkers import (
    HeavyLegWalker,
    PointFootWalker,
    RoundFootWalker,
    SimplestWalker,
    SpringWalker,
    State,
    UpperBodyWalker,
    Walker,
)

__version__ = version("walker-jax")

__all__ = [
    "AreaGradient",
    "BasinStability",
    "Bifurcation",
    "Branch",
    "ComputationFailed",
    "Dimension",
    "DisturbanceGradient",
    "Gait",
    "Grid",
    "HeavyLegWalker",
    "LeastDisturbance",
    "LeastStepDown",
    "Margins",
    "Measure",
    "Outcome",
    "PointFootWalker",
    "RoundFootWalker",
    "SimplestWalker",
    "SpringWalker",
    "State",
    "Stride",
    "Uncertainty",
    "UpperBodyWalker",
    "Walk",
    "Walker",
    "area_gradient",
    "attractors",
    "basin",
    "basin_stability",
    "bifurcation_diagram",
    "boundary_dimension",
    "box_counting",
    "compare_methods",
    "continue_gait",
    "descend",
    "disturbance_gradient",
    "find_gait",
    "find_gaits",
    "gait_derivatives",
    "gait_measures",
    "least_disturbance",
    "least_step_down",
    "loss_of_walking",
    "margins",
    "margins_of_many",
    "motion",
    "optimise",
    "refine",
    "robustness",
    "robustness_table",
    "step_down",
    "stride",
    "strides",
    "sweep",
    "trajectory",
    "uncertainty_exponent",
    "walk",
]

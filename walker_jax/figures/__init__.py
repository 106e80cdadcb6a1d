"""Pictures of results: one function a picture, which computes nothing and returns its Axes.

Each takes a result and draws it on `ax`, or on a figure of its own that no window, and no state of
pyplot, knows of: `figures.basin(data).figure.savefig("basin.png", dpi=150)`. Angles are in rad and
times in sqrt(l / g), with leg length l and gravity g. Colours differ in lightness as well as hue,
so that they are told apart in grey print and by the colour-blind.
"""

from walker_jax.figures.basin_maps import basin as basin
from walker_jax.figures.basin_maps import basin_slices as basin_slices
from walker_jax.figures.basin_maps import basins_in_a_row as basins_in_a_row
from walker_jax.figures.basin_maps import stability_and_area as stability_and_area
from walker_jax.figures.basin_maps import sweep as sweep
from walker_jax.figures.branch_plots import bifurcation_diagram as bifurcation_diagram
from walker_jax.figures.branch_plots import bifurcations as bifurcations
from walker_jax.figures.branch_plots import gait_branches as gait_branches
from walker_jax.figures.branch_plots import largest_multiplier as largest_multiplier
from walker_jax.figures.films import check_film as check_film
from walker_jax.figures.films import film as film
from walker_jax.figures.multiplier_plots import multipliers as multipliers
from walker_jax.figures.optimum_plots import basins_compared as basins_compared
from walker_jax.figures.optimum_plots import optimisation as optimisation
from walker_jax.figures.optimum_plots import optimised as optimised
from walker_jax.figures.poses import leg_angles as leg_angles
from walker_jax.figures.poses import step as step
from walker_jax.figures.poses import steps_over_basin as steps_over_basin
from walker_jax.figures.robustness_plots import boundary_dimension as boundary_dimension
from walker_jax.figures.robustness_plots import disturbance as disturbance
from walker_jax.figures.robustness_plots import robustness as robustness
from walker_jax.figures.robustness_plots import robustness_measures as robustness_measures
from walker_jax.figures.robustness_plots import robustness_table as robustness_table
from walker_jax.figures.style import thinned as thinned

"""Pictures of results: one function per picture, which draws a data set and returns its Axes.

Each function draws a data set of a kind that `walker_jax.storage.schema` lists, and computes
nothing but the layout. It draws on `ax`, or on a new figure outside any window and outside pyplot:
`figures.basin(data).figure.savefig("basin.png", dpi=150)`. Sizes of text are those of matplotlib's
`rcParams`. Given axes need a figure with a layout, as from
`plt.subplots(1, 2, layout="constrained")`, with 5 by 4.4 inches or more for each. Words around a
picture can be left out, as `Style` says: `figures.basin(data, ax, legend=False)`. Angles are in rad
and times in sqrt(l / g), with leg length l and gravity g. Colours differ in lightness as well as
hue, so that they can be told apart in grey print and by the colour-blind.
"""

from walker_jax.figures.basin_maps import basin as basin
from walker_jax.figures.basin_maps import basin_slices as basin_slices
from walker_jax.figures.basin_maps import basins_in_a_row as basins_in_a_row
from walker_jax.figures.basin_maps import thin as thin
from walker_jax.figures.basin_maps import zoomed_basin as zoomed_basin
from walker_jax.figures.boundary_plots import boundary as boundary
from walker_jax.figures.branch_plots import bifurcation_diagram as bifurcation_diagram
from walker_jax.figures.branch_plots import bifurcations as bifurcations
from walker_jax.figures.branch_plots import gait_branches as gait_branches
from walker_jax.figures.branch_plots import largest_multiplier as largest_multiplier
from walker_jax.figures.capture_plots import capturability as capturability
from walker_jax.figures.chart_plots import chart as chart
from walker_jax.figures.exponent_plots import lyapunov_exponents as lyapunov_exponents
from walker_jax.figures.fall_plots import probable_fall as probable_fall
from walker_jax.figures.films import check_film as check_film
from walker_jax.figures.films import film as film
from walker_jax.figures.films import zoom_film as zoom_film
from walker_jax.figures.fraction_plots import basin_fractions as basin_fractions
from walker_jax.figures.layout import Style as Style
from walker_jax.figures.layout import for_print as for_print
from walker_jax.figures.metastable_plots import metastability as metastability
from walker_jax.figures.mode_graphs import modes as modes
from walker_jax.figures.multiplier_plots import multipliers as multipliers
from walker_jax.figures.optimum_plots import basins_before_and_after as basins_before_and_after
from walker_jax.figures.optimum_plots import optimisation as optimisation
from walker_jax.figures.optimum_plots import optimum as optimum
from walker_jax.figures.poses import step as step
from walker_jax.figures.proof_plots import proof as proof
from walker_jax.figures.robustness_plots import boundary_dimension as boundary_dimension
from walker_jax.figures.robustness_plots import disturbance as disturbance
from walker_jax.figures.robustness_plots import robustness as robustness
from walker_jax.figures.robustness_plots import robustness_measures as robustness_measures
from walker_jax.figures.robustness_plots import robustness_table as robustness_table
from walker_jax.figures.saddle_plots import chaotic_saddle as chaotic_saddle
from walker_jax.figures.saddle_plots import crisis_law as crisis_law
from walker_jax.figures.stability_plots import stability_and_area as stability_and_area
from walker_jax.figures.style import BASINS as BASINS
from walker_jax.figures.style import FAILURES as FAILURES
from walker_jax.figures.style import INK as INK
from walker_jax.figures.style import OTHERS as OTHERS
from walker_jax.figures.sweep_plots import sweep as sweep
from walker_jax.figures.viability_plots import viability as viability
from walker_jax.figures.volume_plots import volume as volume
from walker_jax.figures.walk_plots import leg_angles as leg_angles
from walker_jax.figures.walk_plots import steps_over_basin as steps_over_basin

"""Equations of motion and of impact of a multibody system, from the positions of its masses.

The method is that of Schwab and Wisse (2001, sections 3.1 and 3.2), whose equation numbers are
cited. A system is given by its transfer function x = F(q), from generalised coordinates q to the
coordinates x of its masses: those of point masses in the plane or in space; the angles of rigid
bodies in the plane, whose masses are moments of inertia; and the axes of rigid bodies in space
(`space`). JAX differentiates F. Constraints may be on rates too, as those of discs that roll
(`constraints`).

q, its rates and their dual forces are arrays with one number for each generalised coordinate. Units
are the user's own. Every function is pure and takes one configuration, to be mapped by `jax.vmap`;
over thousands of configurations, `scalars.unroll` makes it fastest.
"""

from walker_jax.multibody.constraints import ConstrainedSolution as ConstrainedSolution
from walker_jax.multibody.constraints import RateConstraints as RateConstraints
from walker_jax.multibody.constraints import rate_matrix as rate_matrix
from walker_jax.multibody.constraints import solve_constrained as solve_constrained
from walker_jax.multibody.equations import Motion as Motion
from walker_jax.multibody.equations import solve_motion as solve_motion
from walker_jax.multibody.impacts import Impact as Impact
from walker_jax.multibody.impacts import impact as impact
from walker_jax.multibody.impacts import push as push
from walker_jax.multibody.independent_rates import ConstrainedMotion as ConstrainedMotion
from walker_jax.multibody.linear import WORST_PIVOT as WORST_PIVOT
from walker_jax.multibody.linear import block as block
from walker_jax.multibody.linear import factorise as factorise
from walker_jax.multibody.linear import solve_factored as solve_factored
from walker_jax.multibody.system import Coordinates as Coordinates
from walker_jax.multibody.system import System as System
from walker_jax.multibody.system import check_state as check_state
from walker_jax.multibody.system import convective_acceleration as convective_acceleration
from walker_jax.multibody.system import jacobian as jacobian
from walker_jax.multibody.system import kinetic_energy as kinetic_energy
from walker_jax.multibody.system import mass_matrix as mass_matrix
from walker_jax.multibody.system import potential_energy as potential_energy
from walker_jax.multibody.system import reduced_force as reduced_force
from walker_jax.multibody.system import velocity as velocity
from walker_jax.multibody.system import virtual_power as virtual_power

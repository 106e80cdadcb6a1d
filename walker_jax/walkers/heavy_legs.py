"""Walkers with mass on their legs, whose section has three coordinates."""

from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from walker_jax.checks import WrongUse
from walker_jax.grids import Grid
from walker_jax.kernels.scalars import unroll
from walker_jax.multibody.single_support import stance_coordinates
from walker_jax.walkers.masses import MultibodyWalker
from walker_jax.walkers.model import Scalar, State


class HeavyLegWalker(MultibodyWalker):
    """Walkers with mass anywhere on the legs, whose section has three dimensions.

    What a walker of your own derives from. Its fields are its parameters, scalars, `slope` among
    them. It defines `system` and `swing_foot`. Legs must be alike: with both feet on the slope,
    phi = 2 theta and v = 0 of either.
    """

    slope: Scalar

    section: ClassVar = ("theta", "thetadot", "phidot")

    def __check_init__(self):
        if any(np.shape(leaf) or isinstance(leaf, Tracer) for leaf in jax.tree.leaves(self)):
            return
        foot = swing_foot_at(self, 0.3)
        if isinstance(foot, Tracer):  # of a walker made in a function that JAX transforms
            return
        along, above = np.asarray(foot)
        if not abs(above) <= 1e-5 * abs(along):
            raise WrongUse(
                f"swing_foot of {type(self).__name__} must be on the slope where phi = 2 theta, "
                f"v = 0, but v = {above:.3g} at theta = 0.3"
            )

    def lift(self, x):
        """phi = 2 theta."""
        return State(x[0], 2 * x[0], x[1], x[2])

    def project(self, state):
        return jnp.stack([state.theta, state.thetadot, state.phidot])

    def clearance(self, state):
        above = lambda walker, *legs: walker.swing_foot(stance_coordinates([*legs]))[1]
        return unroll(above)(self, state.theta, state.phi)

    def reach(self, state):
        """Of feet that roll, how far the walker gets by a step, rolling included."""
        ahead = lambda walker, *legs: walker.swing_foot(stance_coordinates([*legs]))[0]
        return unroll(ahead)(self, state.theta, state.phi)

    def feasible(self, x):
        """0 < theta < pi/2, thetadot < 0, and the trailing foot lifts: phidot > 2 thetadot."""
        theta, thetadot, phidot = x[0], x[1], x[2]
        finite = jnp.isfinite(theta) & jnp.isfinite(thetadot) & jnp.isfinite(phidot)
        forward = (theta > 0) & (theta < np.pi / 2) & (thetadot < 0)
        return finite & forward & (phidot > 2 * thetadot)


PENDULUM_AXES = {"theta": (0, 0.7, 35), "sum": (-0.6, 0.3, 50), "turn": (-1.1, 0.3, 24)}


def pendulum_region(leg_length: Scalar, axes: dict[str, Any] = PENDULUM_AXES) -> Grid:
    """A region to search for gaits, with rates counted in that of a pendulum of the leg's length.

    That of toppling, by which walkers are searched for otherwise, vanishes as feet grow.
    """
    rate = 1 / float(np.sqrt(leg_length))
    return Grid(axes, np.array([[1, 0, 0], [-rate, rate, 0], [0, 0, rate]]))


@jax.jit
def swing_foot_at(walker: HeavyLegWalker, theta: Scalar | float) -> Float[Array, " 2"]:
    """(u, v) of the swing foot with legs as at heel strike, phi = 2 theta."""
    theta = jnp.asarray(theta, walker.slope.dtype)
    return walker.swing_foot(stance_coordinates([theta, 2 * theta]))

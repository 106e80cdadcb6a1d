"""Walkers with feet that are points."""

from typing import ClassVar

import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Bool

from walker_jax.grids import Grid
from walker_jax.walkers.model import SWING, Scalar, State, Walker
from walker_jax.walkers.phase import is_of_package


class AbstractPointFootWalker(Walker):
    """Walkers on point feet, with mass on the legs only at their ends.

    At lift-off a foot that stood does not move across its leg. So phidot after heel strike follows
    from theta and thetadot, and the section has two dimensions.
    """

    section: ClassVar = ("theta", "thetadot")

    def lift(self, x):
        """phi = 2 theta, phidot = (1 - cos 2theta) thetadot, from (22).

        The trailing foot was at rest, and its leg pulls it along itself only, so its velocity
        across the leg stays zero. The hip's velocity across that leg is cos(2 theta) thetadot. The
        leg turns at that rate, thetadot - phidot = cos(2 theta) thetadot, whatever the masses.
        """
        theta, thetadot = x[0], x[1]
        return State(theta, 2 * theta, thetadot, (1 - jnp.cos(2 * theta)) * thetadot)

    def project(self, state):
        return jnp.stack([state.theta, state.thetadot])

    def push(self, state, change):
        """phidot follows thetadot as in `lift`, also where the feet are at different heights."""
        turn = (1 - jnp.cos(state.phi)) * change
        return state._replace(thetadot=state.thetadot + change, phidot=state.phidot + turn)

    def clearance(self, state):
        return jnp.cos(state.theta) - jnp.cos(state.theta - state.phi)

    def reach(self, state):
        return jnp.sin(state.theta - state.phi) - jnp.sin(state.theta)

    def basin_region(self, gait):
        """All feasible angles, and rates that hold the basins of such walkers."""
        return Grid.sheared(theta=(0, np.pi / 4, 200), sum=(-1.1, 0.1, 800))

    def feasible(self, x):
        """0 < theta < pi/4 and thetadot < 0: beyond pi/4 no impact leaves the walker going on."""
        theta, thetadot = x[0], x[1]
        finite = jnp.isfinite(theta) & jnp.isfinite(thetadot)
        return finite & (theta > 0) & (theta < np.pi / 4) & (thetadot < 0)


class AbstractMasslessFootWalker(AbstractPointFootWalker):
    """The limit of vanishing foot mass: the hip does not feel the swing leg."""

    slope: Scalar

    def modes(self):
        """With what is known of the walkers of the package, which swing by the same methods.

        The stance leg is an inverted pendulum, thetaddot = sin(theta - slope). It moves one way
        until it stops, and then goes back: falls last. `contact_force` is least at an end of the
        swing. Where `rises_past_contact` is known, a foot ahead that has come down stays down too,
        unless the stance leg is in tension, when no stride follows.
        """
        modes = super().modes()
        if not all(is_of_package(type(self), method) for method in (*SWING, "past_contact")):
            return modes
        swing = modes["swing"]
        *falls, strike = swing.guards
        pulls, *others = swing.conditions
        lasting = [one._replace(persists=True) for one in falls]
        strike = strike._replace(persists=swing.early_exit is not None)
        conditions = pulls._replace(least_at_ends=True), *others
        return modes | {"swing": swing._replace(guards=(*lasting, strike), conditions=conditions)}

    def struck(self, state, impulse, arm):
        """The foot keeps its speed across the swing leg: phidot changes by (1 - cos phi) times as
        much as thetadot, which changes by P . (d hip / d theta); phases may have other masses."""
        if self.phases():
            return None
        change = arm[0] * impulse[0] + arm[1] * impulse[1]
        turn = (1 - jnp.cos(state.phi)) * change
        return state._replace(thetadot=state.thetadot + change, phidot=state.phidot + turn)

    def contact_force(self, state):
        """(8). For an inverted pendulum, Q_v > 0 over a stride if it holds at both its ends.

        thetadot^2 / 2 + cos(theta - slope) is a constant E, and Q_v has the sign of
        3 cos(theta - slope) - 2 E. On any interval of theta that is least at one end.
        """
        tension = state.thetadot**2 - jnp.cos(state.theta - self.slope)
        return jnp.sin(state.theta) * tension, -jnp.cos(state.theta) * tension

    def impact(self, state):
        """(18), with phi for 2 theta: the feet may also be at different heights."""
        theta, phi, thetadot, _ = state
        c, s = jnp.cos(phi), jnp.sin(phi)
        foot = -jnp.sin(theta) * c * s * thetadot, jnp.cos(theta) * c * s * thetadot
        return foot, State(theta, phi, c**2 * thetadot, c * (c - 1) * thetadot)

    def impulse(self, state: State) -> tuple[Scalar, Scalar]:
        """Impulse (rho_x, rho_y) of the ground on the swing foot at heel strike, (19).

        It acts along the swing leg, as the paper says below (19), and changes the momentum of the
        hip to that after the impact. So rho_x has the sign of sin(theta) thetadot sin(2 theta),
        opposite to the printed sign.
        """
        s = jnp.sin(state.phi) * state.thetadot
        swing = state.theta - state.phi
        return -jnp.sin(swing) * s, jnp.cos(swing) * s


def rises_past_contact(walker: AbstractMasslessFootWalker, state: State) -> Bool[Array, ""]:
    """Return whether h > 0 rises, with the swing leg ahead and the stance leg in compression.

    Then h'' = sin(phi) (thetadot^2 - cos(theta - slope)) - sin(theta - slope) > 0, and a spring
    between the legs adds to it, so h goes on rising. This ends by tension, or with phi > 0. In
    strides from the section it is then too late to come down again. That is tested, not proved, and
    does not hold for launches.
    """
    theta, phi, thetadot, phidot = state
    rising = (phi > 2 * theta) & (phidot > 2 * thetadot)
    return rising & (phi < 0) & (thetadot**2 < jnp.cos(theta - walker.slope))


def gait_strip(slope: ArrayLike, hip_stiffness: ArrayLike = 0.0) -> Grid:
    """Return a strip of the section that shrinks like slope^{1/3} (Garcia and others 1998).

    At its widest, the upper edge is where walkers begin to fall backward,
    thetadot = -2 sin((theta - slope) / 2). The lower edge follows the leg, which a spring swings in
    a shorter time, to first order 2 h = pi / sqrt(1 + hip_stiffness). A walker of constant speed
    v = -thetadot makes a step 2 theta = 2 h v, and its gain on the slope equals the loss at heel
    strike, slope = theta v^2:

        theta = slope^{1/3} h^{2/3},    v = slope^{1/3} h^{-1/3}.
    """
    angle, stiffness = float(np.asarray(slope)), float(np.asarray(hip_stiffness))
    widest = min(2 * angle ** (1 / 3), np.pi / 4)
    edge = widest - 2 * np.sin((widest - angle) / 2)
    half = np.pi / 2 / np.sqrt(1 + stiffness)
    fast = angle ** (1 / 3) * min(0.0, half ** (2 / 3) - half ** (-1 / 3))
    axes = {"theta": (0, widest, 100), "sum": (fast - 0.15 * widest, edge, 1000)}
    return Grid.sheared(**axes)

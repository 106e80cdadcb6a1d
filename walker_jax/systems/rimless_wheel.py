"""The rimless wheel with a torso, which walks on a slope or on level ground."""

from typing import ClassVar, NamedTuple

import jax.numpy as jnp
import numpy as np

from walker_jax import multibody
from walker_jax.grids import Grid
from walker_jax.hybrid.modes import SECTION, Condition, Guard, Mode
from walker_jax.integrators.roots import Real, Scalar
from walker_jax.kernels.scalars import unroll
from walker_jax.multibody.single_support import SingleSupport, leg, normal_force
from walker_jax.systems.hybrid_system import HybridSystem
from walker_jax.systems.parameter import Parameter


class WheelState(NamedTuple):
    """Angles (rad) and rates, or their time derivatives."""

    theta: Scalar
    """Angle of the stance spoke from the normal of the slope, positive before it is upright."""
    psi: Scalar
    """Angle of the torso from the vertical, positive forward."""
    thetadot: Scalar
    psidot: Scalar


class TorsoWheel(HybridSystem):
    """A rimless wheel with a torso, which leans forward and so drives the wheel.

    Massless spokes of length 1 stand `2 alpha` apart about a hub of mass 1, and gravity is 1. The
    torso turns about the hub. A motor between torso and stance spoke holds the torso at an angle
    from the vertical, by the torque `tau = stiffness (lean - psi) - damping psidot` on the torso
    and its opposite on the spoke. With `s = theta - slope`, and `M`, `l` and `I` the torso's mass,
    distance of its centre of mass from the hub, and inertia,

        (1 + M) s'' - M l cos(s + psi) psi'' + M l sin(s + psi) psi'^2 = (1 + M) sin(s) + tau,
        (I + M l^2) psi'' - M l cos(s + psi) s'' + M l sin(s + psi) s'^2 = M l sin(psi) + tau,

    until the next spoke strikes at `theta = -alpha` and stays on the ground. At the strike the hub
    loses its velocity along that spoke. Hub and torso together keep their angular momentum about
    the new foot, and the torso keeps its own about the hub.

    The section is just after the strike, at `theta = alpha`. A stride is `BACKWARD` if the wheel
    stops or a strike turns it back, `FORWARD` or `BACKWARD` if the torso falls to that side, to
    `|psi| = pi / 2`, and `RUNNING` if the ground would have to pull. Sanchez and Bhounsule (2021,
    Automation 2:98-115) describe a wheel driven by the pitch of a hanging body.

    **Arguments:** angles in rad, the others in units of the hub's mass, the spokes and gravity.

    - `slope`: slope of the ground; 0 if level.
    - `alpha`: half the angle between spokes.
    - `torso_mass`, `torso_com`, `torso_inertia`: mass, distance of the centre of mass from the hub,
      and moment of inertia about the centre of mass; `I + M l^2` must be above 0.
    - `stiffness`, `damping`, `lean`: gains of the motor, and the angle at which it holds the torso.

    Raises `ValueError` for slopes and angles beyond a right angle, and negative masses, lengths,
    inertias, stiffness and damping.
    """

    slope: Real = Parameter("slope", "of the ground", "rad", 0.0, -np.pi / 2, np.pi / 2).field()
    alpha: Real = Parameter("alpha", "half the spoke angle", "rad", np.pi / 8, 0, np.pi / 2).field()
    torso_mass: Real = Parameter("torso_mass", "of the torso", "hub mass", 1.0, closed=True).field()
    torso_com: Real = Parameter("torso_com", "from the hub", "spokes", 0.5, closed=True).field()
    torso_inertia: Real = Parameter("torso_inertia", "of the torso", "", 0.1, closed=True).field()
    stiffness: Real = Parameter("stiffness", "of the motor", "", 1.5, closed=True).field()
    damping: Real = Parameter("damping", "of the motor", "", 0.3, closed=True).field()
    lean: Real = Parameter("lean", "of the torso", "rad", 0.5, -np.inf).field()

    section: ClassVar = ("thetadot", "psi", "psidot")

    def system(self) -> multibody.System:
        """Return masses and F(q), with q = (u, v, theta, psi).

        The foot is at u along the slope, and at v normal to it.
        """

        def torque(q, qdot):
            tau = self.stiffness * (self.lean - q[3]) - self.damping * qdot[3]
            return jnp.stack([jnp.zeros_like(tau), jnp.zeros_like(tau), tau, tau])

        return self.bodies(lambda q: q[:2] + leg(q[2]), torque)

    def bodies(self, hub, torque=None) -> multibody.System:
        """Return hub and torso: positions, and the torso's angle psi, the last entry of q."""

        def transfer(q):
            place = hub(q)
            torso = place + self.torso_com * leg(self.slope - q[-1])
            return jnp.concatenate([place, torso, q[-1:]])

        M, one = self.torso_mass, jnp.ones_like(self.torso_mass)
        down, none = -leg(self.slope), jnp.zeros_like(one)[None]
        masses = jnp.stack([one, one, M, M, self.torso_inertia])
        return multibody.System(transfer, masses, jnp.concatenate([down, M * down, none]), torque)

    def strike(self, state: WheelState) -> WheelState:
        """Return the state on the next spoke, which is massless: its impulse is along it."""

        def rates(wheel, state):
            before, spoke = leg(state.theta), leg(state.theta + 2 * wheel.alpha)
            # the hub is at leg(theta), and its velocity is the derivative of that
            turned = jnp.stack([-before[1], before[0]])
            q = jnp.stack([*before, state.psi])
            qdot = jnp.stack([*(state.thetadot * turned), state.psidot])
            along = lambda q: jnp.stack([spoke @ q[:2]])
            after = multibody.impact(wheel.bodies(lambda q: q[:2]), along, q, qdot).velocities
            return -spoke[1] * after[0] + spoke[0] * after[1], after[2]

        return WheelState(state.theta + 2 * self.alpha, state.psi, *unroll(rates)(self, state))

    def modes(self):
        guards = (
            Guard(lambda state: state.thetadot, "BACKWARD", at_once=True),
            Guard(lambda state: -np.pi / 2 - state.psi, "BACKWARD"),
            Guard(lambda state: state.psi - np.pi / 2, "FORWARD"),
            Guard(lambda state: -self.alpha - state.theta, SECTION, reset=self.strike),
        )
        pushes = Condition(lambda state: normal_force(self, state), "RUNNING", at_start=True)
        return {"stance": Mode(SingleSupport(self), guards, (pushes,))}

    def lift(self, x):
        return WheelState(jnp.asarray(self.alpha, x.dtype), x[1], x[0], x[2])

    def project(self, state):
        return jnp.stack([state.thetadot, state.psi, state.psidot])

    def feasible(self, x):
        """The wheel rolls on, thetadot < 0, and the torso has not fallen, |psi| < pi / 2."""
        return super().feasible(x) & (x[0] < 0) & (jnp.abs(x[1]) < np.pi / 2)

    def gait_region(self):
        return Grid.plain(thetadot=(-1.5, 0, 12), psi=(-0.5, 1, 6), psidot=(-1, 1, 4))

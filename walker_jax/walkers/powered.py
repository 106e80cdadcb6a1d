"""The simplest walker with a motor in its hip and push-off from its trailing foot."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from walker_jax.walkers.abstract_point_foot import AbstractMasslessFootWalker
from walker_jax.walkers.model import DRIVE, WORK, Scalar, State, shown_by
from walker_jax.walkers.parameter_table import (
    ANY_SLOPE,
    HIP_ANGLE,
    HIP_DAMPING,
    HIP_STIFFNESS,
    PUSH_OFF,
)


class PoweredWalker(AbstractMasslessFootWalker):
    """The simplest walker with a torque in its hip and push-off.

    The hip's torque on the swing leg is that of a spring and a damper, in the limit of vanishing
    foot mass m (`SpringWalker`):

        phiddot = sin(phi) (thetadot^2 - cos(theta - slope)) + sin(theta - slope)
                  - hip_stiffness (phi - hip_angle) - hip_damping phidot.

    With a negative slack angle the spring is a motor that swings the leg forward and holds it there
    (Wisse, Schwab, van der Linde and van der Helm 2005, IEEE Trans. Robot. 21:393-401).

    Just before heel strike the trailing leg gives the hip the impulse P = `push_off` along itself
    (Kuo 2002, J. Biomech. Eng. 124:113-120). The new stance leg then keeps the part of the hip's
    velocity across itself,

        thetadot+ = cos(phi) thetadot + P sin(phi),    phi < 0.

    On level ground the push-off makes up for the loss at heel strike. A gait of period one starts
    from (theta, thetadot) and arrives at -theta with the same thetadot, as an inverted pendulum
    does. With phi = -2 theta, the condition thetadot+ = thetadot is P = -thetadot tan(theta).

    **Arguments:** masses of the hip M and length of the leg l are 1.

    - `slope`: of the ground (rad), between -pi/2 and pi/2: level ground and uphill too.
    - `hip_stiffness`: K / (m g l), not negative.
    - `hip_damping`: C / (m l sqrt(g l)), not negative.
    - `hip_angle`: phi at which the spring is slack (rad).
    - `push_off`: P, not negative.

    Raises `ValueError` otherwise.
    """

    slope: Scalar = eqx.field(converter=ANY_SLOPE.convert)
    hip_stiffness: Scalar = eqx.field(
        converter=HIP_STIFFNESS.convert, default=HIP_STIFFNESS.default
    )
    hip_damping: Scalar = eqx.field(converter=HIP_DAMPING.convert, default=HIP_DAMPING.default)
    hip_angle: Scalar = eqx.field(converter=HIP_ANGLE.convert, default=HIP_ANGLE.default)
    push_off: Scalar = eqx.field(converter=PUSH_OFF.convert, default=PUSH_OFF.default)

    @shown_by(*DRIVE)
    def driven_by_gravity(self):
        """True without push-off: the hip's torque does work of the order of the foot's mass."""
        return bool(np.all(np.asarray(self.push_off) == 0))

    @shown_by(*WORK)
    def motor_work(self, start, end):
        """P^2 / 2: the impulse is along the leg, at right angles to the hip's velocity."""
        return self.push_off**2 / 2

    def vector_field(self, state):
        """(7), and the hip's torque."""
        theta, phi, thetadot, phidot = state
        angle = theta - self.slope
        thetaddot = jnp.sin(angle)
        phiddot = jnp.sin(phi) * (thetadot**2 - jnp.cos(angle)) + thetaddot
        # Added last, a torque of zero leaves every bit as it is.
        phiddot = phiddot - self.hip_stiffness * (phi - self.hip_angle) - self.hip_damping * phidot
        return State(thetadot, phidot, thetaddot, phiddot)

    def impact(self, state):
        """(18) as if thetadot were thetadot + P tan(phi).

        The hip's velocity along the new stance leg is lost. Across that leg it is
        cos(phi) thetadot + P sin(phi) before heel strike, and all else follows from that.
        """
        gain = self.push_off * jnp.sin(state.phi) / jnp.cos(state.phi)
        return super().impact(state._replace(thetadot=state.thetadot + gain))

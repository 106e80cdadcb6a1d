"""A biped with knees and a torso, whose motors follow virtual constraints."""

import jax
import jax.numpy as jnp
import numpy as np

from walker_jax.grids import Grid
from walker_jax.hybrid.modes import SECTION, Condition, Guard, Mode
from walker_jax.integrators.roots import Real
from walker_jax.multibody.single_support import (
    SingleSupport,
    coordinates_and_rates,
    normal_force,
)
from walker_jax.systems.five_links import LINKS, AbstractFiveLinkRobot
from walker_jax.systems.parameter import Parameter

LEAST_SCUFF = 1e-6
"""Depth (m) from which the foot counts as below the ground: a smaller depth is rounding."""


class FiveLinkBiped(AbstractFiveLinkRobot):
    """Torso, thighs and shanks on point feet, on level ground, held by virtual constraints.

    The robot is that of `five_links`, with absolute angles q = (q_1, ..., q_5) of stance shank,
    stance thigh, torso, swing thigh and swing shank. It has motors in both knees and between the
    torso and each thigh, but none at the foot. They enforce four virtual constraints by springs and
    dampers, u = -(k y + c y'), that depend on the angle of the stance leg, from foot to hip,
    theta = (q_1 + q_2) / 2:

        y_1 = q_1 - q_2 - bend                                          stance knee
        y_2 = q_3 - lean                                                torso
        y_3 = (q_4 + q_5) / 2 + theta                                   swing leg, the mirror image
        y_4 = q_5 - q_4 - bend - swing_bend (1 - theta^2 / reach^2)     swing knee

    u_1 and u_4 turn the knees, and u_3 the swing thigh against the torso. The motor at the stance
    hip takes up the reaction of u_3, so u_2 is the whole torque on the torso. A stride ends when
    the swing foot comes down in front of the other. It neither bounces nor slips; the other foot
    comes off, and the legs change roles. The motors restore the energy lost in the impact.

    The section is just after the impact, with both feet on the ground. Its coordinates are the
    angles of the links except the swing shank, whose angle follows from the others, and all rates.
    Failures are `FORWARD`: the hip reaches the ground; `BACKWARD`: the stance leg stops, so that
    theta no longer measures progress; `RUNNING`: the ground would have to pull; `SCUFFED`: the
    swing foot is below the ground on its way, from the start on if it does not lift; and `OUTSIDE`:
    the start is not feasible, or the foot comes down while the stance shank leans back, a state
    outside the section. Knees have no stops, and nothing slips: the gait needs a coefficient of
    friction of 0.3, and its impact 0.6.

    Westervelt, Grizzle and Koditschek (2003, IEEE Transactions on Automatic Control 48, 42-56)
    describe such constraints as Bezier polynomials of theta; in theory their control keeps them
    exactly.
    """

    lean: Real = Parameter("lean", "of the torso, from the vertical", "rad", 0.15, -np.inf).field()
    bend: Real = Parameter("bend", "of the stance knee", "rad", 0.2, -np.inf).field()
    swing_bend: Real = Parameter(
        "swing_bend", "more of the swing knee", "rad", 0.6, -np.inf
    ).field()
    reach: Real = Parameter("reach", "of the stance leg", "rad", 0.3).field()
    stiffness: Real = Parameter("stiffness", "of motors", "N m/rad", 400.0, closed=True).field()
    damping: Real = Parameter("damping", "of motors", "N m s/rad", 40.0, closed=True).field()

    def motors(self, q, qdot):
        """Return the torques on the links; none on the foot."""

        def outputs(q):
            shank, thigh, torso, swing_thigh, swing_shank = q[2:]
            theta = (shank + thigh) / 2
            swung = self.swing_bend * (1 - (theta / self.reach) ** 2)
            legs, bend = theta + (swing_thigh + swing_shank) / 2, swing_shank - swing_thigh
            return jnp.stack(
                [shank - thigh - self.bend, torso - self.lean, legs, bend - self.bend - swung]
            )

        y, rates = jax.jvp(outputs, (q,), (qdot,))
        knee, torso, leg, swing_knee = -self.stiffness * y - self.damping * rates
        torques = [knee, -knee - torso - leg, torso, leg - swing_knee, swing_knee]
        return jnp.stack([0 * knee, 0 * knee, *torques])

    def modes(self):
        hip_and_foot = lambda state: self.places(coordinates_and_rates(state)[0])[1]
        ahead = lambda state: hip_and_foot(state)[0, 1]
        sunk = lambda state: -hip_and_foot(state)[1, 1]
        guards = (
            Guard(lambda state: -hip_and_foot(state)[1, 0], "FORWARD"),
            Guard(lambda state: -state.rates[0] - state.rates[1], "BACKWARD", at_once=True),
            Guard(sunk, "OUTSIDE", (ahead, lambda state: -state.angles[0])),
            Guard(
                sunk,
                SECTION,
                (ahead, lambda state: state.angles[0]),
                reset=self.strike,
                makes_zero=("SCUFFED",),
            ),
        )
        above = lambda state: LEAST_SCUFF - sunk(state)
        conditions = (
            Condition(lambda state: normal_force(self, state), "RUNNING", at_start=True),
            Condition(above, "SCUFFED", zero_at_start=True),
        )
        return {"stance": Mode(SingleSupport(self), guards, conditions, as_smooth=True)}

    def gait_region(self):
        """Legs near their constraints, at several speeds; all rates follow from the speed."""
        theta, half = -0.85 * float(self.reach), float(self.bend) / 2
        posture = theta + half, theta - half, float(self.lean), -theta - half
        axes = {link: (at - 0.4, at + 0.4, 1) for link, at in zip(LINKS[:4], posture, strict=True)}
        axes |= {f"{link}_excess": (-1.5, 1.5, 1) for link in LINKS}
        axes["stance_thigh_excess"] = 0.5, 2.9, 8
        shear = np.eye(9)
        shear[4:, 5] = 0.35, 1.0, 0.35, 0.6, 0.9
        return Grid(axes, shear)

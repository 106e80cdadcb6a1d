"""The compass gait with a torque at the hip that is switched off within the stride."""

from dataclasses import replace
from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from walker_jax import multibody
from walker_jax.grids import Grid
from walker_jax.hybrid.modes import SECTION, Condition, Guard, Mode
from walker_jax.integrators.roots import Real, Scalar
from walker_jax.kernels.scalars import unroll
from walker_jax.multibody.single_support import (
    SingleSupport,
    coordinates_and_rates,
    leg,
    normal_force,
)
from walker_jax.systems.hybrid_system import HybridSystem
from walker_jax.systems.parameter import Parameter


class CompassState(NamedTuple):
    """Angles (rad) and rates, or their time derivatives."""

    theta: Scalar
    """Angle of the stance leg from the normal of the slope, positive before it is upright."""
    phi: Scalar
    """Angle from the stance leg to the swing leg, positive if the swing leg is behind."""
    thetadot: Scalar
    phidot: Scalar


class SwitchedCompass(HybridSystem):
    """The compass gait, with a constant hip torque until the stance leg passes an angle.

    Two straight legs of length 1 have a point mass each; the hip has a mass of 1, and gravity is 1.
    It is the biped of Goswami, Thuilot and Espiau (1998, Int. J. Robotics Research 17:1282-1301),
    with their a = 1 - com_from_hip. `multibody` gives the equations of motion of its three point
    masses. While theta > switch_angle, a torque at the hip turns both legs forward. Then it jumps
    to zero: a stride has two modes.

    The swing foot may pass below the ground. At heel strike, at `phi = 2 theta` ahead, the foot
    that stood is free, the other one stops, and the legs are exchanged (`multibody.impact`). The
    section is just after that. A stride is `BACKWARD` if the stance leg stops or the strike turns
    it back, `FORWARD` if it falls to theta = -pi/2, `RUNNING` if the ground would have to pull, and
    `STOPPED` if the trailing foot does not lift. A start is feasible if that foot lifts,
    phidot > 2 thetadot.

    **Arguments:** angles in rad, the others in units of the hip's mass, the legs and gravity.

    - `slope`: slope of the ground.
    - `leg_mass`: mass of each leg.
    - `com_from_hip`: distance of a leg's mass from the hip; 1 is at the foot.
    - `torque`: torque of the hip on the swing leg, and its opposite on the stance leg; negative to
      hold both back.
    - `switch_angle`: theta at which the torque stops; not negative, as a foot may strike from 0 on.

    Raises `ValueError` for slopes beyond a right angle, for masses and distances that are not
    above zero, and for a negative switch angle.
    """

    slope: Real = Parameter("slope", "of the ground", "rad", np.nan, -np.pi / 2, np.pi / 2).field()
    leg_mass: Real = Parameter("leg_mass", "of each leg", "hip mass", 0.5).field()
    com_from_hip: Real = Parameter("com_from_hip", "of a leg's mass", "leg length", 0.5).field()
    torque: Real = Parameter("torque", "of the hip", "", 0.02, -np.inf).field()
    switch_angle: Real = Parameter(
        "switch_angle", "where it stops", "rad", 0.1, closed=True
    ).field()

    section: ClassVar = ("theta", "thetadot", "phidot")

    def system(self) -> multibody.System:
        """Return masses and F(q), with q = (u, v, theta, phi); u and v are the stance foot's."""

        def transfer(q):
            hip, to_mass = q[:2] + leg(q[2]), self.com_from_hip
            stance, swing = hip - to_mass * leg(q[2]), hip - to_mass * leg(q[2] - q[3])
            return jnp.concatenate([hip, stance, swing])

        m, one = self.leg_mass, jnp.ones_like(self.leg_mass)
        masses, down = jnp.stack([one, one, m, m, m, m]), -leg(self.slope)
        torque = lambda q, qdot: jnp.zeros_like(q).at[3].set(-self.torque)
        return multibody.System(transfer, masses, masses * jnp.concatenate([down] * 3), torque)

    def modes(self):
        stops = Guard(lambda state: state.thetadot, "BACKWARD", at_once=True)
        falls = Guard(lambda state: -np.pi / 2 - state.theta, "FORWARD")
        passes = Guard(lambda state: self.switch_angle - state.theta, "free")
        free = replace(self, torque=jnp.zeros_like(self.torque))
        after = lambda state: after_strike(free, state)
        lifts = Condition(lambda state: foot_speed(after(state)), "STOPPED")
        contact, ahead = lambda state: state.phi - 2 * state.theta, lambda state: -state.phi
        strikes = Guard(contact, SECTION, (ahead,), reset=after, must_hold=(lifts,))
        return {"driven": self.swing(stops, passes), "free": free.swing(stops, falls, strikes)}

    def swing(self, *guards: Guard) -> Mode:
        """Return a mode of the swing."""
        force = Condition(lambda state: normal_force(self, state), "RUNNING", at_start=True)
        return Mode(SingleSupport(self), guards, (force,))

    def lift(self, x):
        return CompassState(x[0], 2 * x[0], x[1], x[2])

    def project(self, state):
        return jnp.stack([state.theta, state.thetadot, state.phidot])

    def feasible(self, x):
        """0 < theta < pi/2, thetadot < 0, and the trailing foot lifts: phidot > 2 thetadot."""
        forward = (x[0] > 0) & (x[0] < np.pi / 2) & (x[1] < 0)
        return super().feasible(x) & forward & (foot_speed(self.lift(x)) > 0)

    def gait_region(self):
        axes = {"theta": (0, 0.6, 15), "sum": (-0.6, 0.3, 20), "turn": (-0.8, 0.2, 8)}
        return Grid(axes, np.array([[1, 0, 0], [-1, 1, 0], [0, 0, 1]]))


def foot_speed(state: CompassState) -> Scalar:
    """Return a number proportional to the trailing foot's upward speed just after heel strike."""
    return state.phidot - 2 * state.thetadot


@jax.jit
def after_strike(walker: SwitchedCompass, state: CompassState) -> CompassState:
    """Return the state after heel strike, of the other leg."""

    def solve(walker, state):
        foot = lambda q: q[:2] + leg(q[2]) - leg(q[2] - q[3])
        after = multibody.impact(walker.system(), foot, *coordinates_and_rates(state))
        return [*after.velocities[2:]]

    thetadot, phidot = unroll(solve)(walker, state)
    return CompassState(state.theta - state.phi, -state.phi, thetadot - phidot, -phidot)

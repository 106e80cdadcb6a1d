"""Walkers with mass on their legs, and with bodies on joints between them."""

import collections
import functools
import keyword
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from walker_jax.checks import WrongUse, is_traced
from walker_jax.grids import Grid
from walker_jax.kernels.scalars import unroll
from walker_jax.multibody.single_support import stance_coordinates
from walker_jax.systems.trees import is_many, settle
from walker_jax.walkers.masses import MultibodyWalker
from walker_jax.walkers.model import Scalar, State, region_of_starts


class HeavyLegWalker(MultibodyWalker):
    """Walkers with mass anywhere on the legs, and with any number of bodies on joints.

    Derive your own walker from this class. Its fields are its parameters, scalars, among them
    `slope`. It defines `system` and `swing_foot`. Legs must be alike: with both feet on the slope,
    phi = 2 theta and v = 0 for either foot.

    `joints` names further coordinates: the angle of a torso, a mass that slides along it, arms,
    feet on ankles. The generalised coordinates are q = (u, v, theta, phi, *joints). A full state
    holds (theta, phi, *joints) and their rates. In the section, the joints and their rates follow
    those of the legs. Joints move bodies, but not the points of the feet that touch the ground.
    Springs, dampers and motors on them are the `generalised_forces` of `system`. At heel strike a
    joint keeps its coordinate, as an angle from the slope's normal does. A joint measured from a
    leg needs its own `exchange_legs`.
    """

    slope: Scalar

    joints: ClassVar[tuple[str, ...]] = ()
    """Names of the coordinates of joints."""
    section: ClassVar = ("theta", "thetadot", "phidot")

    def __init_subclass__(cls, **kwargs):
        cls.joints = tuple(cls.joints)
        if cls.joints:
            given = [name for name in ("section", "state") if name in vars(cls)]
            if given:
                raise WrongUse(f"{given[0]} of {cls.__name__} must be left out: joints make it")
            rates = [rate_of(joint) for joint in cls.joints]
            cls.section = (*HeavyLegWalker.section, *cls.joints, *rates)
            cls.state = state_with(cls.joints)
        super().__init_subclass__(**kwargs)

    def __check_init__(self):
        settle(self)
        if taken := {*self.section} & {*vars(self)}:
            raise WrongUse(f"joints must not have names of parameters, unlike {min(taken)}")
        if is_many(self) or is_traced(self):
            return
        foot, moved = swing_foot_at(self, 0.3, 0.0), swing_foot_at(self, 0.3, 0.1)
        if isinstance(foot, Tracer):  # of a walker made in a function that JAX transforms
            return
        along, above = np.asarray(foot)
        if not abs(above) <= 1e-5 * abs(along):
            raise WrongUse(
                f"swing_foot of {type(self).__name__} must be on the slope where phi = 2 theta, "
                f"v = 0, but v = {above:.3g} at theta = 0.3"
            )
        away = np.abs(np.asarray(moved - foot)).max()
        if not away <= 1e-5 * abs(along):
            raise WrongUse(
                f"swing_foot of {type(self).__name__} must stay where joints "
                f"({', '.join(self.joints)}) move, but they move it by {away:.3g} at 0.1 each"
            )

    def lift(self, x):
        """phi = 2 theta."""
        joints = [x[i] for i in range(3, len(self.section))]
        places, rates = joints[: len(self.joints)], joints[len(self.joints) :]
        return self.state(x[0], 2 * x[0], *places, x[1], x[2], *rates)

    def project(self, state):
        legs = [state.theta, state.thetadot, state.phidot]
        names = *self.joints, *map(rate_of, self.joints)
        return jnp.stack([*legs, *(getattr(state, name) for name in names)])

    def clearance(self, state):
        above = lambda walker, *legs: walker.swing_foot(with_joints(walker, *legs))[1]
        return unroll(above)(self, state.theta, state.phi)

    def reach(self, state):
        """On rolling feet, rolling is included: it is the progress of the walker in a step."""
        ahead = lambda walker, *legs: walker.swing_foot(with_joints(walker, *legs))[0]
        return unroll(ahead)(self, state.theta, state.phi)

    def feasible(self, x):
        """0 < theta < pi/2, thetadot < 0, and the trailing foot lifts: phidot > 2 thetadot."""
        theta, thetadot, phidot = x[0], x[1], x[2]
        finite = jnp.all(jnp.isfinite(x))
        forward = (theta > 0) & (theta < np.pi / 2) & (thetadot < 0)
        return finite & forward & (phidot > 2 * thetadot)


def rate_of(joint: str) -> str:
    """Return the name of the rate of a coordinate."""
    return f"{joint}dot"


@functools.cache
def state_with(joints: tuple[str, ...]) -> type:
    """Make the full state of a walker with joints: coordinates first, then their rates."""
    if not joints:
        return State
    coordinates = "theta", "phi", *joints
    proper = all(isinstance(one, str) and one.isidentifier() for one in joints)
    names = *coordinates, *map(rate_of, coordinates)
    taken = proper and any(
        keyword.iskeyword(one) or one[0] == "_" or hasattr(tuple, one) for one in names
    )
    if not proper or taken or "sum" in names or len(set(names)) < len(names):
        raise WrongUse(f"joints must be different names of coordinates, not {joints!r}")
    kind = collections.namedtuple("JointedState", names)
    # No module has the class, so pickle must be told how to make one.
    reduce = lambda state: (make_state, (joints, tuple(state)))
    kind.__reduce__ = reduce  # pyright: ignore[reportAttributeAccessIssue] (as pickle asks)
    return kind


def make_state(joints: tuple[str, ...], values: tuple) -> Any:
    """Make a full state of a walker with joints, from its numbers."""
    return state_with(joints)(*values)


def with_joints(
    walker: HeavyLegWalker, theta: Scalar, phi: Scalar, at: Scalar | float = 0.0
) -> Float[Array, " q"]:
    """Return q with the stance foot at the origin and all joints at one place."""
    return stance_coordinates([theta, phi, *[jnp.full_like(theta, at)] * len(walker.joints)])


PENDULUM_AXES = {"theta": (0, 0.7, 35), "sum": (-0.6, 0.3, 50), "turn": (-1.1, 0.3, 24)}


def pendulum_region(
    walker: HeavyLegWalker, leg_length: Scalar, axes: dict[str, Any] = PENDULUM_AXES
) -> Grid:
    """Return a region to search for gaits, with rates in units of a pendulum of the leg's length.

    The toppling rate, the usual unit, vanishes for large feet.
    """
    return region_of_starts(walker, axes, 1 / float(np.sqrt(leg_length)))


@jax.jit
def swing_foot_at(
    walker: HeavyLegWalker, theta: Scalar | float, joints: Scalar | float
) -> Float[Array, " 2"]:
    """Return (u, v) of the swing foot at heel strike, phi = 2 theta, with all joints equal."""
    theta = jnp.asarray(theta, walker.slope.dtype)
    return walker.swing_foot(with_joints(walker, theta, 2 * theta, joints))

"""Walkers with bodies on joints."""

import functools
import itertools
import pickle
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import walker_jax as wj
from walker_jax.multibody import System
from walker_jax.walkers.masses import gravity, leg


class LooseBody(wj.UpperBodyWalker):
    """An upper body on a joint, with a spring and a damper to the angle midway between the legs."""

    joints: ClassVar = ("torso",)
    body_inertia: Any = 0.05
    stiffness: Any = 80.0
    damping: Any = 8.0

    def system(self):
        def transfer(q):
            hip, legs = self.hip_and_legs(q)
            return jnp.concatenate([hip + self.body_com * leg(q[4]), legs, q[4:]])

        def torque(q, qdot):
            away, rate = (x[4] - x[2] + x[3] / 2 for x in (q, qdot))
            turn = -self.stiffness * away - self.damping * rate
            return jnp.stack([0 * turn, 0 * turn, -turn, turn / 2, turn])

        one = wj.UpperBodyWalker.system(self)
        return System(transfer, one.masses, gravity(self.slope, one.masses, turns=3), torque)


@functools.cache
def loose_gait(damping: float) -> wj.Gait:
    return wj.find_gait(
        LooseBody(0.004, stiffness=10 * damping, damping=damping),
        [0.165, -0.183, -0.023, 0.0006, -0.213],
    )


@functools.cache
def walker_and_gait() -> tuple[LooseBody, wj.Gait]:
    return LooseBody(0.004), loose_gait(8.0)


def extrapolated(values: list) -> np.ndarray:
    """The limit of a series in powers of 1/c, from its values for c doubled each time."""
    for power in range(1, len(values)):
        pairs = itertools.pairwise(values)
        values = [(2**power * finer - coarse) / (2**power - 1) for coarse, finer in pairs]
    return values[0]


@pytest.mark.slow
def test_a_body_on_a_stiffening_joint_becomes_one_that_is_held():
    """Behind a heel strike the joint closes at once, as if by a second impact. That leads to the
    same rates as one impact in which both feet and the mechanism take part."""
    held = wj.find_gait(wj.UpperBodyWalker(0.004, body_inertia=0.05))
    gaits = [loose_gait(damping) for damping in (8.0, 16.0, 32.0, 64.0)]
    theta = extrapolated([gait.states[0, 0] for gait in gaits])
    sizes = [np.sort(np.abs(gait.multipliers))[::-1][:3] for gait in gaits]
    assert abs(theta - held.states[0, 0]) < 1e-10
    np.testing.assert_allclose(
        extrapolated(sizes), np.sort(np.abs(held.multipliers))[::-1], rtol=0, atol=1e-8
    )
    assert abs(gaits[0].states[0, 0] - held.states[0, 0]) > 1e-4


@pytest.mark.slow
def test_coordinates_of_joints_come_behind_those_of_the_legs():
    walker, gait = walker_and_gait()
    assert walker.section == ("theta", "thetadot", "phidot", "torso", "torsodot")
    assert walker.state._fields == ("theta", "phi", "torso", "thetadot", "phidot", "torsodot")
    x = jnp.asarray(gait.states[0])
    full = walker.lift(x)
    assert float(full.phi) == 2 * float(full.theta) and full.torso == x[3]
    assert jnp.array_equal(walker.project(full), x)
    again = wj.stride(walker, jnp.stack(full))
    np.testing.assert_allclose(again.state, wj.stride(walker, x).state, rtol=0, atol=1e-13)


@pytest.mark.slow
def test_derivatives_of_ten_strides_are_differences():
    walker, gait = walker_and_gait()
    x = jnp.asarray(gait.states[0]) + jnp.array([1e-3, 0, 0, 2e-3, 0])
    last = jax.jit(lambda x: wj.walk(walker, x, 10).states[-1])
    by_jax = jax.jit(jax.jacfwd(last))(x)
    by_hand = np.empty((5, 5))
    for i, one in enumerate(np.eye(5)):
        away = lambda h, one=one: np.asarray(last(x + h * one) - last(x - h * one)) / (2 * h)
        by_hand[:, i] = (4 * away(5e-5) - away(1e-4)) / 3
    np.testing.assert_allclose(by_jax, by_hand, rtol=0, atol=1e-7)


@pytest.mark.slow
def test_energy_is_constant_without_a_damper_but_for_the_spring():
    walker = LooseBody(0.004, stiffness=5.0, damping=0.0)
    x = jnp.array([0.17, -0.2, -0.02, 0.03, -0.1])
    path = wj.trajectory(walker, x, jnp.linspace(0, 2.5, 6), tolerance=1e-14)
    energy = jax.vmap(walker.energy)(path)
    spring = 2.5 * (path.torso - path.theta + path.phi / 2) ** 2
    np.testing.assert_allclose(energy + spring, energy[0] + spring[0], rtol=0, atol=1e-13)
    assert np.ptp(spring) > 1e-3


@pytest.mark.slow
def test_rough_ground_films_and_basins_take_many_joints():
    walker, gait = walker_and_gait()
    even = wj.walk(walker, gait.states[0], 2, ground=np.zeros(2))
    assert even.states.shape == (3, 6)
    np.testing.assert_allclose(even.states[2], np.stack(walker.lift(gait.states[0])), atol=1e-11)
    film = wj.motion(walker, gait.states[0], 1)
    np.testing.assert_allclose(film.torso[[0, -1]], gait.states[0, 3], atol=1e-11)
    theta, thetadot, phidot, torso, torsodot = gait.states[0]
    middle = theta + thetadot
    axes = {"theta": (theta - 0.01, theta + 0.01, 3), "sum": (middle - 0.003, middle + 0.003, 3)}
    grid = wj.Grid.sheared(**axes, phidot=phidot, torso=torso, torsodot=torsodot)
    data = wj.basin(walker, grid, "direct")
    assert (data.attractor == 0).all()


@pytest.mark.slow
def test_gaits_are_found_without_a_guess():
    _, gait = walker_and_gait()
    found = wj.find_gait(walker_and_gait()[0])
    np.testing.assert_allclose(found.states, gait.states, rtol=0, atol=1e-11)


def test_joints_that_move_a_foot_are_refused():
    class Long(LooseBody):
        def swing_foot(self, q):
            return super().swing_foot(q) - jnp.stack([q[4], 0 * q[4]])

    with pytest.raises(ValueError, match=r"Long must stay where joints \(torso\) move, but they"):
        Long(0.004)


def test_full_states_can_be_pickled():
    walker = LooseBody(0.004)
    full = jax.tree.map(np.asarray, walker.lift(jnp.array([0.2, -0.2, -0.01, 0.1, 0.02])))
    again = pickle.loads(pickle.dumps(full))
    assert type(again) is walker.state and again == full


def test_a_joint_is_no_parameter_and_makes_the_section():
    with pytest.raises(ValueError, match="must not have names of parameters, unlike slope"):
        type("Same", (LooseBody,), {"joints": ["slope"]})(0.004)
    with pytest.raises(ValueError, match="section of Own must be left out: joints make it"):
        type("Own", (LooseBody,), {"joints": ("arm",), "section": ("theta", "arm")})


NAMES = [("phi",), ("torso", "torso"), ("a b",), ("a", "adot"), (1,), ("sum",), ("if",), ("count",)]


@pytest.mark.parametrize("names", NAMES)
def test_names_of_joints_are_checked(names):
    with pytest.raises(ValueError, match="joints must be different names of coordinates, not"):
        type("Other", (LooseBody,), {"joints": names})

"""Robots from files against the package's own walkers of the same masses and lengths."""

import dataclasses
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import robot_examples
from jax.extend.core import jaxprs_in_params
from robot_examples import BIPED_GAIT, FILES, TELESCOPE, UNIT, as_robot

import walker_jax as wj
from walker_jax import multibody, systems
from walker_jax.multibody.single_support import accelerations_and_forces
from walker_jax.robots.stances import RobotState

GAIT = 0.2880980750416, -0.3570541806, -0.2028504303
"""Of the twin of compass.xml, to the digits printed."""
TWINS = {
    "compass": (robot_examples.round_foot, GAIT),
    "kneed": (robot_examples.kneed, (0.2545755, -0.36957756, -0.32204866)),
}


@pytest.mark.parametrize("name", ["compass", pytest.param("kneed", marks=pytest.mark.slow)])
def test_a_file_is_the_walker_of_its_masses(name):
    made, guess = TWINS[name]
    gait = wj.find_gait(made(), guess)
    found = wj.find_gait(wj.robot(FILES / f"{name}.xml"), as_robot(guess))
    assert np.abs(found.states - as_robot(gait.states)).max() < 1e-11
    assert np.abs(found.multipliers - gait.multipliers).max() < 1e-9
    assert np.abs(found.step_times * UNIT - gait.step_times).max() < 1e-11


def test_a_file_with_knees_walks_by_the_gait_of_its_twin():
    """The gait is known to the digits printed."""
    x = as_robot(TWINS["kneed"][1])
    made = wj.stride(wj.robot(FILES / "kneed.xml"), x)
    assert made.outcome == wj.Outcome.STRIDE
    np.testing.assert_allclose(made.state, x, rtol=0, atol=1e-6)


@pytest.mark.parametrize("sides", [("a", "b"), ("front", "rear"), ("1", "2")])
def test_legs_share_numbers_whatever_their_sides_are_called(sides, tmp_path):
    text = (FILES / "compass.xml").read_text()
    for side, own in zip(("left", "right"), sides, strict=True):
        text = re.sub(rf"{side}_(\w+)", rf"\1_{own}", text)
    (tmp_path / "compass.xml").write_text(text)
    other, robot = wj.robot(tmp_path / "compass.xml"), wj.robot(FILES / "compass.xml")
    assert other.parameters == robot.parameters and other.section == robot.section


@pytest.mark.slow
@pytest.mark.parametrize("name", TWINS)
def test_a_file_fails_as_the_walker_of_its_masses(name):
    """On points: by its reach a walker tells whether a bent leg comes down in front, and on round
    feet that includes what they have rolled; the robot's is from contact to contact."""
    made, gait = TWINS[name]
    walker = dataclasses.replace(made(), foot_radius=jnp.asarray(0.0))
    points = {"foot_radius": 0.0, "foot_z": {"compass": -1.0, "kneed": -0.5}[name]}
    robot = wj.robot(FILES / f"{name}.xml", parameters=points)
    starts = gait * np.random.default_rng(5).uniform(0.3, 2, (400, 3))
    expected, strides = wj.strides(walker, starts), wj.strides(robot, as_robot(starts))
    assert strides.outcome.tolist() == expected.outcome.tolist()
    assert len({*expected.outcome.tolist()}) >= 4
    walked = expected.outcome == wj.Outcome.STRIDE
    assert np.abs(strides.state[walked] - as_robot(expected.state[walked])).max() < 1e-9


def test_five_links_with_motors_keep_the_gait_of_the_biped():
    """To the eight digits in which it is given."""
    made = wj.stride(robot_examples.five_link(), BIPED_GAIT)
    np.testing.assert_allclose(made.state, BIPED_GAIT, rtol=0, atol=5e-8)


@pytest.mark.slow
def test_five_links_are_the_biped_that_is_written_by_hand():
    robot, biped = robot_examples.five_link(), systems.FiveLinkBiped()
    found, gait = (wj.find_gait(one, BIPED_GAIT) for one in (robot, biped))
    assert found.stable
    assert np.abs(found.states - gait.states).max() < 1e-12
    assert np.abs(found.multipliers - gait.multipliers).max() < 1e-9
    assert np.abs(found.step_times - gait.step_times).max() < 1e-12


@pytest.mark.slow
def test_five_links_fail_as_the_biped_that_is_written_by_hand():
    robot, biped = robot_examples.five_link(), systems.FiveLinkBiped()
    starts = BIPED_GAIT * np.random.default_rng(6).uniform(0.4, 2, (200, 9))
    strides = [wj.strides(one, starts) for one in (robot, biped)]
    assert strides[0].outcome.tolist() == strides[1].outcome.tolist()
    assert len({*strides[0].outcome.tolist()}) >= 4
    walked = strides[0].outcome == wj.Outcome.STRIDE
    assert np.abs(strides[0].state - strides[1].state)[walked].max() < 1e-9


def size_of_program(system, x):
    """Equations of a stride's program, those within loops and branches included."""

    def count(jaxpr):
        inner = (part for one in jaxpr.eqns for part in jaxprs_in_params(one.params))
        return len(jaxpr.eqns) + sum(map(count, inner))

    *_, kernel = jax.make_jaxpr(lambda x: wj.stride(system, x))(x).eqns
    return count(kernel.params["program"].closed.jaxpr)


@pytest.mark.slow
def test_the_program_of_a_file_is_not_much_larger():
    robot, biped = robot_examples.five_link(), systems.FiveLinkBiped()
    assert robot.section == biped.section
    sizes = [size_of_program(one, np.full(9, 0.1)) for one in (robot, biped)]
    assert sizes[1] > 1000 and sizes[0] < 1.3 * sizes[1]


def test_all_numbers_of_a_file_have_derivatives():
    """Accelerations of a machine with springs, dampers, armatures, slides and servos."""
    robot = wj.robot(
        TELESCOPE, parameters={"stance_hip_servo_ctrl": 0.3, "stance_shoulder_ctrl": 0.2}
    )
    q, rates = np.random.default_rng(7).uniform(-0.3, 0.3, (2, 7))

    def accelerations(numbers):
        changed = dataclasses.replace(robot.landing(), numbers=numbers)
        state = RobotState(tuple(jnp.asarray(q)), tuple(jnp.asarray(rates)))
        return jnp.stack(accelerations_and_forces(changed, state)[0])

    @jax.jit
    def along(numbers, name):
        return jax.jvp(accelerations, (numbers,), (one_of(name),))

    numbers = robot.parameters
    one_of = lambda name: {other: jnp.where(name == i, 1.0, 0.0) for i, other in enumerate(numbers)}
    assert len(numbers) > 40
    h, unmoved = 1e-5, []
    for i, name in enumerate(numbers):
        found = along(numbers, i)[1]
        up, down = (along(numbers | {name: numbers[name] + d}, i)[0] for d in (h, -h))
        change = np.asarray(up - down) / 2 / h
        assert np.allclose(found, change, rtol=1e-6, atol=1e-6 * np.abs(change).max() + 1e-7)
        unmoved += [] if change.any() else [name]
    assert all(one.startswith(("knee", "foot_radius")) or "ctrl" in one for one in unmoved), unmoved


def test_a_urdf_robot_is_that_of_the_mjcf_file(tmp_path):
    """With a hip that turns freely, without torque."""
    text = (FILES / "compass.xml").read_text()
    inertial = '<inertial pos="0 0 0" mass="10"'
    turning = text.replace(inertial, f'<joint name="turn" axis="0 1 0"/>{inertial}')
    (tmp_path / "turning.xml").write_text(turning)
    flat = {"slope": 0.05}
    one, other = (
        wj.robot(tmp_path / "turning.xml"),
        wj.robot(FILES / "compass.urdf", parameters=flat),
    )
    assert (
        one.section
        == other.section
        == ("stance_leg", "hip", "stance_leg_rate", "hip_rate", "swing_leg_rate")
    )
    x = np.array([-0.29, 0.3, 1.12, -0.7, 0.48])
    walked = [wj.stride(robot, x) for robot in (one, other)]
    assert walked[0].outcome == wj.Outcome.STRIDE
    assert np.abs(walked[0].state - walked[1].state).max() < 1e-12
    # The hip has its mass at the joints, so nothing turns it.
    assert np.abs(walked[0].state[1] - (0.3 - 0.7 * walked[0].time)) < 1e-12


def test_a_keyframe_is_where_gaits_are_sought(tmp_path):
    """Whichever leg stands in it."""
    text = (FILES / "compass.xml").read_text()
    for qpos, qvel in (("0 .95 -.28 .28", "0 0 1.1 .5"), ("0 .95 .28 -.28", "0 0 .5 1.1")):
        key = f'<keyframe><key qpos="{qpos}" qvel="{qvel}"/></keyframe></mujoco>'
        (tmp_path / "keyed.xml").write_text(text.replace("</mujoco>", key))
        robot = wj.robot(tmp_path / "keyed.xml")
        assert robot.gait_region().size == 1 and robot.near == (-0.28, 1.1, 0.5)


def test_straight_legs_scuff_if_that_is_checked():
    x = as_robot(GAIT)
    robot = wj.robot(FILES / "compass.xml", check_scuffing=True)
    assert wj.stride(robot, x).outcome == wj.Outcome.SCUFFED


def test_a_spring_at_the_hips_is_that_of_the_joints(tmp_path):
    """Energy is constant, that of the springs included: each has its slack angle."""
    text = (FILES / "compass.xml").read_text()
    spring = '<joint axis="0 1 0" stiffness="3" springref="5"/>'
    changed = text.replace(
        '<geom contype="0" conaffinity="0"/>', f'{spring}<geom contype="0" conaffinity="0"/>'
    )
    changed = changed.replace('type="slide"', 'type="slide" stiffness="0"').replace(
        'axis="0 1 0"/>\n', "/>\n"
    )
    (tmp_path / "sprung.xml").write_text(changed)
    robot = wj.robot(tmp_path / "sprung.xml")
    assert robot.parameters["hip_stiffness"] == 3

    def energy(state):
        angles, rates = (jnp.stack(part) for part in state)
        q, qdot = (jnp.concatenate([jnp.zeros(2), one]) for one in (angles, rates))
        system = robot.landing().system()
        stretch = 3 * jnp.sum((angles - np.radians(5)) ** 2) / 2
        kinetic = multibody.kinetic_energy(system, q, qdot)
        return kinetic + multibody.potential_energy(system, q) + stretch

    state = robot.lift(jnp.asarray(as_robot([0.3, -0.36, -0.2])))
    rates = robot.modes()["stance"].field(state)
    assert abs(jax.jvp(energy, (state,), (rates,))[1]) < 1e-12 * abs(energy(state))


def test_knees_may_be_drawn_bent_and_turn_the_other_way(tmp_path):
    """Their stop is then a number; guards, forces and impacts stay."""
    text = (FILES / "kneed.xml").read_text()
    for side in ("left", "right"):
        text = text.replace(
            f'<body name="{side}_shank" pos="0 0 -0.5">',
            f'<body name="{side}_shank" pos="0 0 -0.5" euler="0 20 0">',
        )
    text = text.replace('axis="0 1 0" range="0 150"', 'axis="0 -1 0" range="-130 20"')
    (tmp_path / "bent.xml").write_text(text)
    robots = wj.robot(FILES / "kneed.xml"), wj.robot(tmp_path / "bent.xml")
    assert robots[1].parameters["knee_stop"] == pytest.approx(np.radians(20))
    rng = np.random.default_rng(8)
    locked = RobotState((0.2, -0.3), tuple(rng.normal(size=2)))
    free = RobotState((0.1, 0.2, 0.5), tuple(rng.normal(size=3)))
    drawn = free._replace(coordinates=(0.1, 0.2, 0.5 - np.radians(20)))
    for mode, states in (("knee_locked", (locked, locked)), ("knee_free", (free, drawn))):
        found = []
        for robot, state in zip(robots, states, strict=True):
            made = robot.modes()[mode]
            state = jax.tree.map(jnp.asarray, state)
            functions = [one.value for one in (*made.guards, *made.conditions)]
            values = [one(state) for one in functions]
            field = made.field(state)
            after = jax.tree.leaves(made.guards[-1].reset(state)) if mode == "knee_locked" else []
            found.append(np.array([*values, *field.rates, *after]))
        assert np.abs(found[0] - found[1]).max() < 1e-11


def test_steps_have_a_length_and_swings_an_energy():
    """The length of a step on rolling feet: the legs' chord, and what both feet roll."""
    robot, x = wj.robot(FILES / "compass.xml"), as_robot(GAIT)
    end = RobotState((jnp.asarray(GAIT[0]), jnp.asarray(-GAIT[0])), tuple(jnp.zeros(2)))
    length = robot.step_length(jnp.asarray(x), lambda: end)
    assert length == pytest.approx(2 * 0.95 * np.sin(GAIT[0]) + 2 * 0.05 * GAIT[0], abs=1e-12)
    energy, state = robot.modes()["stance"].energy, robot.lift(jnp.asarray(x))
    rates = robot.modes()["stance"].field(state)
    assert energy is not None
    assert abs(jax.jvp(energy, (state,), (rates,))[1]) < 1e-12 * abs(energy(state))

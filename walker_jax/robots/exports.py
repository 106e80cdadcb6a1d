"""Walks of a robot for MuJoCo: a keyframe in its file, qpos and qvel over time, a film."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from walker_jax.checks import ComputationFailed, WrongUse, check_kind, check_number, check_whole
from walker_jax.robots.files import is_urdf, load_mujoco
from walker_jax.robots.postures import mujoco_states
from walker_jax.robots.reading import Reader
from walker_jax.robots.robot_files import read_machine
from walker_jax.robots.robots import Robot
from walker_jax.systems.outcomes import Outcome
from walker_jax.walking.iteration import walk
from walker_jax.walking.trajectories import trajectory

FILM_SIZE = 480, 640
"""Height and width of a film, which MuJoCo renders without settings of its own."""


class MuJoCoMotion(NamedTuple):
    """A walk in MuJoCo's coordinates, from the first foot at the origin of the file."""

    times: Float[np.ndarray, " times"]
    qpos: Float[np.ndarray, "times nq"]
    qvel: Float[np.ndarray, "times nv"]


def export_motion(
    robot: Robot,
    x: Any,
    path: str | os.PathLike,
    *,
    strides: int = 4,
    rate: float | int = 100.0,
    feet: Sequence[str] | None = None,
    keyframe: str | os.PathLike | None = None,
    film: str | os.PathLike | None = None,
) -> MuJoCoMotion:
    """Return a walk from a point of the section in MuJoCo's coordinates.

    ```python
    robot = wj.robot("compass.xml")
    gait = wj.find_gait(robot)
    way = wj.export_motion(robot, gait.states[0], "compass.xml", keyframe="started.xml")
    ```

    **Arguments:**

    - `robot`: from the file at `path`, with the same `feet`.
    - `x`: a point of the section, such as a state of a gait.
    - `strides`, `rate`: number of strides, and of states in a unit of time.
    - `keyframe`: where an MJCF file of the robot goes, whose first keyframe is the start of the
      walk.
    - `film`: where a film goes, .gif, which MuJoCo renders; it needs OpenGL.

    Raises `ValueError` for another file, and `ComputationFailed` where the walk ends in a failure,
    or where there is no OpenGL.
    """
    check_kind("robot", robot, Robot)
    check_whole("strides", strides)
    check_number("rate", rate)
    if not 0 < rate < np.inf:
        raise WrongUse(f"rate must be positive and finite, not {rate}")
    if film is not None and not str(film).endswith(".gif"):
        raise WrongUse(f"film must end in .gif, not be {film}")
    reader, machine = read_machine(path, feet)
    if machine != robot.machine:
        raise WrongUse(f"path must be that of the robot, and feet be the same, not {path}")
    made = walk(robot, x, strides)
    outcomes = np.asarray(made.outcomes)
    if (outcomes != Outcome.STRIDE).any():
        at = int(np.argmax(outcomes != Outcome.STRIDE))
        raise ComputationFailed(f"the walk ends in stride {at + 1}: no motion to export")
    motion = sample_walk(reader, robot, np.asarray(made.states), np.asarray(made.times), rate)
    if keyframe is not None:
        write_keyframe(reader, motion, Path(path), Path(keyframe))
    if film is not None:
        write_film(reader, motion, machine.size, Path(film), rate)
    return motion


def sample_walk(
    reader: Reader, robot: Robot, starts: np.ndarray, durations: np.ndarray, rate: float | int
) -> MuJoCoMotion:
    """Return the states of a walk at equal times, and at its end."""
    parts, begun, at, stance = [], 0.0, 0.0, robot.first()
    for k, duration in enumerate(durations.tolist()):
        first = np.ceil(begun * rate - 1e-9) / rate
        times = np.append(
            np.arange(first, begun + duration - 1e-9 / rate, 1 / rate), begun + duration
        )
        way = trajectory(robot, starts[k], jnp.asarray(times - begun))
        values, rates = (np.stack([*map(np.asarray, part)], axis=1) for part in way)
        qs = np.concatenate([np.tile([at, 0.0], (len(values), 1)), values], axis=1)
        moving = np.pad(rates, ((0, 0), (2, 0)))
        parts.append((times, *mujoco_states(reader, stance, qs, moving, swapped=k % 2 == 1)))
        at, begun = float(stance.sole(jnp.asarray(qs[-1]))[0]), begun + duration
    kept = [tuple(one[:-1] for one in part) for part in parts[:-1]] + parts[-1:]
    return MuJoCoMotion(*(np.concatenate(one) for one in zip(*kept, strict=True)))


def write_keyframe(reader: Reader, motion: MuJoCoMotion, source: Path, path: Path) -> None:
    """Write an MJCF file with a keyframe at the start of a motion, before any other.

    It is the robot's own with all its digits, or of a URDF file what MuJoCo makes of it, which has
    six digits.
    """
    text = reader.spec.to_xml() if is_urdf(source) else source.read_text()
    builder = ElementTree.TreeBuilder(insert_comments=True)
    root = ElementTree.fromstring(text, ElementTree.XMLParser(target=builder))
    keys = root.find("keyframe")
    keys = ElementTree.SubElement(root, "keyframe") if keys is None else keys
    numbers = lambda values: " ".join(map(repr, values.tolist()))
    qpos, qvel = numbers(motion.qpos[0]), numbers(motion.qvel[0])
    keys.insert(0, ElementTree.Element("key", name="walk", qpos=qpos, qvel=qvel))
    ElementTree.indent(root)
    path.write_text(ElementTree.tostring(root, encoding="unicode") + "\n")


def write_film(
    reader: Reader, motion: MuJoCoMotion, size: float, path: Path, rate: float | int
) -> None:
    """Write a film by MuJoCo's renderer, seen from the side; its time is the walk's."""
    from PIL import Image

    mujoco, model, plane = load_mujoco(), reader.model, reader.plane
    data, camera = mujoco.MjData(model), mujoco.MjvCamera()
    camera.distance, camera.elevation = 2.4 * size, -10
    for light, least in ((model.vis.headlight.ambient, 0.4), (model.vis.headlight.diffuse, 0.6)):
        light[:] = np.maximum(light, least)  # most files have a dim one
    camera.azimuth = float(np.degrees(np.arctan2(plane.across[1], plane.across[0])))
    frames = []
    try:
        with mujoco.Renderer(model, *FILM_SIZE) as renderer:
            for qpos in motion.qpos:
                data.qpos[:] = qpos
                mujoco.mj_forward(model, data)
                camera.lookat[:] = data.subtree_com[0]
                renderer.update_scene(data, camera)
                frames.append(Image.fromarray(renderer.render()))
    except Exception as error:  # whatever a platform without OpenGL raises
        reason = " ".join(str(error).split())
        raise ComputationFailed(
            f"film needs OpenGL, which MuJoCo cannot use here ({reason}): set MUJOCO_GL to egl or "
            "osmesa, or leave out film"
        ) from error
    frames[0].save(
        path, save_all=True, append_images=frames[1:], duration=1000 / float(rate), loop=0
    )

"""States of a robot in MuJoCo's coordinates, qpos and qvel."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from walker_jax.robots.machine import BASE, joint_values
from walker_jax.robots.reading import Reader
from walker_jax.robots.stances import Stance


def joints_and_base(
    stance: Stance, q: Float[Array, " q"]
) -> tuple[Float[Array, " links"], Float[Array, " 2"]]:
    """Return the joints' values from the pose of the file, and the place of the base."""
    coordinates = stance.all_coordinates(q)
    base = stance.pose(q).joint(BASE)
    return jnp.stack(joint_values(stance.machine, coordinates)), jnp.stack(base)


@jax.jit
def with_rates(
    stance: Stance, qs: Float[Array, "n q"], rates: Float[Array, "n q"]
) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Return these for many states, and their rates."""
    one = lambda q, rate: jax.jvp(lambda q: joints_and_base(stance, q), (q,), (rate,))
    return jax.vmap(one)(qs, rates)


def mujoco_states(
    reader: Reader,
    stance: Stance,
    qs: Float[np.ndarray, "n q"],
    rates: Float[np.ndarray, "n q"],
    *,
    swapped: bool = False,
) -> tuple[Float[np.ndarray, "n nq"], Float[np.ndarray, "n nv"]]:
    """Return qpos and qvel of states; `swapped` where the second leg of the file stands.

    A state has the coordinates (u, v) of the stance foot, u along the ground from the origin of the
    file, then those of the free links.
    """
    (joints, base), (turns, moves) = with_rates(stance, jnp.asarray(qs), jnp.asarray(rates))
    model, plane = reader.model, reader.plane
    slides = np.stack([plane.flat(reader.data.xaxis[i]) for i in (0, 1)], axis=1)
    links = [stance.machine.mirror[i] if swapped else i for i in range(len(stance.machine.links))]
    dofs = [reader.tree.dofs[i] for i in links]

    def placed(joints, moved):
        found = np.zeros((len(joints), model.nv))
        found[:, dofs] = joints
        found[:, :2] = np.linalg.solve(slides, np.asarray(moved).T).T
        return found

    rest = reader.base - np.array([0.0, plane.height])
    return model.qpos0[None] + placed(joints, base - rest[None]), placed(turns, moves)

"""Boxes of starts, carried from stride to stride by kernels, many at once.

A box is a parallelogram c + A u, |u_i| <= 1, with a radius for rounding. From stride to stride only
this linear part is kept. The image of a box is enclosed in a rectangle along the image's longer
side; upright rectangles would grow wherever the motion turns the box (Lohner 1987).
"""

from collections.abc import Callable, Hashable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from walker_jax.kernels import kernel
from walker_jax.kernels.primitive import nan_allowed
from walker_jax.kernels.program_cache import user_code_states
from walker_jax.proofs.enclosures import (
    ROUNDING,
    Enclosure,
    Space,
    choose,
    exactly,
    interval_between,
    outward,
)
from walker_jax.proofs.flows import ORDER
from walker_jax.proofs.landings import enclose_landings
from walker_jax.proofs.provable import enclose_parameters
from walker_jax.proofs.strides import STRIDE, TOLERANCE, verify_stride

PLANE = Space(2, 2)
"""Space of polynomials of second degree in two variables: a box of size r is enclosed up to r^3."""
CHUNK = 8192
"""Number of boxes in one call. Fewer are padded to it, or to an eighth of it, so that calls share
two programs."""
TRAPPED = 4
"""Verdict beside those of strides: all of the next states are in the trap."""


class Boxes(NamedTuple):
    """Parallelograms of the section."""

    terms: Float[np.ndarray, "boxes 2 3"]
    """For each coordinate: the midpoint, and the change along each side."""
    radii: Float[np.ndarray, "boxes 2"]

    @property
    def count(self) -> int:
        return len(self.terms)

    def at(self, which) -> "Boxes":
        return Boxes(self.terms[which], self.radii[which])


class Trap(NamedTuple):
    """Ellipse about a point of the section: |L^T (x - centre)| <= size."""

    centre: Float[np.ndarray, " 2"]
    factor: Float[np.ndarray, "2 2"]
    """L, lower triangular."""
    size: float

    @classmethod
    def nowhere(cls) -> "Trap":
        """Return a trap that holds nothing."""
        return cls(np.zeros(2), np.eye(2), -1.0)


class Carried(NamedTuple):
    """Boxes after a stride."""

    boxes: Boxes
    verdicts: Int[np.ndarray, " boxes"]


def boxes_of(theta: Enclosure, thetadot: Enclosure) -> Boxes:
    """Return the boxes given by two NumPy enclosures that are linear in two variables."""
    shape = np.broadcast_shapes(*(np.shape(t) for one in (theta, thetadot) for t in one.terms[:3]))
    fill = lambda value: np.broadcast_to(np.asarray(0.0 if value is None else value), shape)
    linear = [one.terms[:3] for one in (theta, thetadot)]
    terms = np.stack([np.stack([fill(t) for t in one], -1) for one in linear], -2)
    return Boxes(terms, np.stack([fill(theta.radius), fill(thetadot.radius)], -1))


def upright_boxes(centres, halves) -> tuple[Enclosure, ...]:
    """Enclose both coordinates of upright boxes: centre + half u, with a variable u for each."""
    return tuple(
        Enclosure([c, *[h if i == j else None for j in range(2)], None, None, None], 0.0, PLANE)
        for i, (c, h) in enumerate(zip(centres, halves, strict=True))
    )


def carry(walker, boxes: Boxes, trap: Trap) -> Carried:
    """Carry each box through one stride."""
    code = user_code_of(carry_box, walker)
    return call_in_chunks(lambda some: carry_chunk(walker, some, trap, code), boxes)


def carry_partly(walker, boxes: Boxes) -> Carried:
    """Carry through one stride those starts of each box that make one."""
    code = user_code_of(land_box, walker)
    return call_in_chunks(lambda some: land_chunk(walker, some, code), boxes)


def user_code_of(function: Callable, walker) -> Hashable:
    """Describe the present state of the user's own code that a function of a walker runs."""
    return user_code_states(function, jax.tree.structure((walker,)))


def call_in_chunks(call: Callable[[Boxes], tuple], boxes: Boxes) -> Carried:
    """Join the results of calls with one chunk of the boxes each."""
    found = []
    for first in range(0, boxes.count, CHUNK):
        places = np.arange(first, min(first + CHUNK, boxes.count))
        size = CHUNK if boxes.count > CHUNK // 8 else CHUNK // 8
        padded = np.concatenate([places, np.repeat(places[-1:], size - len(places))])
        with nan_allowed():  # in enclosures of boxes that make no stride
            results = call(boxes.at(padded))
        found.append([np.asarray(one)[: len(places)] for one in results])
    terms, radii, verdicts = (np.concatenate(part) for part in zip(*found, strict=True))
    return Carried(Boxes(terms, radii), verdicts)


@partial(jax.jit, static_argnames="code")
def carry_chunk(walker, boxes: Boxes, trap: Trap, code: Hashable) -> tuple:
    return jax.vmap(carry_box, (None, 0, 0, None))(walker, boxes.terms, boxes.radii, trap)


@kernel
def carry_box(walker, terms: Float[Array, "2 3"], radii: Float[Array, " 2"], trap: Trap) -> tuple:
    """Return the terms and radii of a box after a stride, and the verdict."""
    model = enclose_parameters(walker, PLANE)
    box = lambda i: Enclosure([*terms[i], None, None, None], radii[i], PLANE)
    found = verify_stride(model, (box(0), box(1)), order=ORDER, tolerance=TOLERANCE)
    inside = is_trapped(found.state, trap)
    new, new_radii = rectangle_of(found.state)
    verdict = choose((found.verdict == STRIDE) & inside, TRAPPED, found.verdict)
    return new, new_radii, verdict.astype(jnp.int8)


@partial(jax.jit, static_argnames="code")
def land_chunk(walker, boxes: Boxes, code: Hashable) -> tuple:
    return jax.vmap(land_box, (None, 0, 0))(walker, boxes.terms, boxes.radii)


@kernel
def land_box(walker, terms: Float[Array, "2 3"], radii: Float[Array, " 2"]) -> tuple:
    """Return the same as `carry_box` for those starts that make a stride."""
    model = enclose_parameters(walker, PLANE)
    box = lambda i: Enclosure([*terms[i], None, None, None], radii[i], PLANE)
    verdict, (axis, low, high) = enclose_landings(model, (box(0), box(1)))
    known = [interval_between(*both) for both in zip(low, high, strict=True)]
    s, t = upright_boxes([one.midpoint for one in known], [one.radius for one in known])
    a, b = (exactly(one, PLANE) for one in axis)
    scale = 1.0 / (a * a + b * b)
    theta, thetadot = (a * s - b * t) * scale, (a * t + b * s) * scale
    new = jnp.stack([jnp.stack(one.terms[:3]) for one in (theta, thetadot)])
    return new, jnp.stack([theta.radius, thetadot.radius]), verdict.astype(jnp.int8)


def is_trapped(x: tuple, trap: Trap) -> Any:
    """Return whether all of an enclosure certainly lies in a trap."""
    (a, b), L = (
        (one - exactly(c, one.space) for one, c in zip(x, trap.centre, strict=True)),
        trap.factor,
    )
    first = exactly(L[0, 0], a.space) * a + exactly(L[1, 0], a.space) * b
    second = exactly(L[1, 1], a.space) * b
    size = trap.size * (1 - 4 * ROUNDING)
    return ((first * first + second * second).upper <= size * size) & (size > 0)


def rectangle_of(x: tuple) -> tuple:
    """Enclose an enclosure in a rectangle along its longer side; return its terms and radii.

    Along the axes (a, b) and (-b, a), a vector (u, v) from the midpoint is s (a, b) + t (-b, a):

        s = (a u + b v) / (a^2 + b^2),    t = (a v - b u) / (a^2 + b^2).
    """
    theta, thetadot = x
    columns = [(theta.terms[i], thetadot.terms[i]) for i in (1, 2)]
    lengths = [jnp.sqrt(a * a + b * b) for a, b in columns]
    first = lengths[0] >= lengths[1]
    longest = jnp.where(first, lengths[0], lengths[1])
    usable = longest > 0
    part = lambda i: jnp.where(first, columns[0][i], columns[1][i])
    a = jnp.where(usable, part(0) / longest, 1.0)
    b = jnp.where(usable, part(1) / longest, 0.0)
    exact = lambda value: exactly(value, theta.space)
    u, v = (one - exact(one.midpoint) for one in x)
    scale = 1.0 / (exact(a) * exact(a) + exact(b) * exact(b))
    s = ((exact(a) * u + exact(b) * v) * scale).magnitude
    t = ((exact(a) * v - exact(b) * u) * scale).magnitude
    terms = jnp.stack(
        [
            jnp.stack([theta.midpoint, a * s, -b * t]),
            jnp.stack([thetadot.midpoint, b * s, a * t]),
        ]
    )
    rounding = lambda p, q: outward(ROUNDING * (jnp.abs(p) + jnp.abs(q)))
    radii = jnp.stack([rounding(a * s, b * t), rounding(b * s, a * t)])
    return terms, radii

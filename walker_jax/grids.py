"""Grids of cells: affine images of boxes divided into equal cells.

A point has box coordinates u, along which the cells lie, and state coordinates
x = origin + shear @ u. If the box has fewer coordinates than the state, the grid is a slice, on
which some coordinates of the state are fixed. Along each box axis cells are half open, [low, high),
but the last one is closed: both borders of the box belong to the grid. Cells are numbered from 0
with the last axis fastest (C order), by int32; -1 stands for none.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float, Int, Int32, Shaped

from walker_jax.checks import (
    WrongUse,
    check_kind,
    check_number,
    is_number,
    numbers,
    short,
)

MAX_SINKS = 255
MAX_SIZE = 2**31 - 1 - MAX_SINKS
CELLS_PER_PART = 2**16
"""Cells of a map per part, so that a part stays in the cache."""
Axis = Any
"""(low, high, count): the ends of an axis and the number of its cells; `Grid` checks it."""


class Grid(eqx.Module):
    """Equal cells of a box, and of its image x = origin + shear @ u.

    `Grid.plain` and `Grid.sheared` make the usual grids; `Grid(axes, shear, origin)` makes any
    other. All fields but the names are array leaves, so a jitted function of a grid is not compiled
    again for another window or count.

    ```python
    grid = wj.Grid.sheared(theta=(0.1, 0.3, 200), sum=(-0.02, 0.02, 100))
    grid.shape  # (200, 100); each cell is 0.001 by 0.0004
    window = grid.zoom((0.2, -0.2), 10)  # a tenth as wide, around a state
    ```

    Raises ValueError for no axes, an axis that is not (low, high, count) with finite low < high and
    count >= 1, a shear that is not an (s, d) matrix of rank d, an origin that is not s finite
    numbers, or more than `MAX_SIZE` cells.
    """

    names: tuple[str, ...] = eqx.field(static=True)
    """Names of the box coordinates u."""
    fixed: tuple[str, ...] = eqx.field(static=True)
    """Names of the last coordinates of the state, which a slice holds fixed; empty otherwise."""
    lower: Float[np.ndarray | Array, " d"]
    """Lower ends of the axes."""
    upper: Float[np.ndarray | Array, " d"]
    """Upper ends of the axes; they belong to the last cells."""
    counts: Int32[np.ndarray | Array, " d"]
    """Cells along each axis."""
    shear: Float[np.ndarray | Array, "s d"]
    """Matrix from box coordinates to state coordinates, x = origin + shear @ u."""
    unshear: Float[np.ndarray | Array, "d s"]
    """Its inverse, u = unshear @ (x - origin). For a slice it holds for points in the slice."""
    origin: Float[np.ndarray | Array, " s"]
    """The state at which u is zero."""

    def __init__(
        self,
        axes: Mapping[str, Axis] | None = None,
        shear: ArrayLike | None = None,
        origin: ArrayLike | None = None,
        fixed: tuple[str, ...] = (),
        **named: Axis,
    ):
        if named or axes is None or shear is None:
            wrong = f", not {', '.join(named)}" if named else ""
            plain = ", ".join(f"{name}=(low, high, count)" for name in named or ("theta",))
            raise WrongUse(
                f"axes and shear of a Grid must be given{wrong}: try Grid.plain({plain})"
            )
        check_kind("axes", axes, Mapping)
        if not axes:
            raise WrongUse("axes={}: a grid needs at least one axis, (low, high, count)")
        lower, upper, counts = zip(*(check_axis(*item) for item in axes.items()), strict=True)
        if math.prod(counts) > MAX_SIZE:
            raise WrongUse(
                f"axes must have at most {MAX_SIZE} cells, not {math.prod(counts)}: lower a count"
            )
        self.names = tuple(axes)
        self.lower = np.array(lower)
        self.upper = np.array(upper)
        self.counts = np.array(counts, np.int32)
        self.fixed = tuple(fixed)
        self.shear = numbers("shear", shear).copy()
        count = len(axes)
        if self.shear.ndim != 2 or self.shear.shape[1] != count or len(self.shear) < count:
            shape = f"(rows, {count}), with {count} rows or more"
            raise WrongUse(f"shear must have shape {shape}, not {self.shear.shape}")
        size = len(self.shear)
        if not np.isfinite(self.shear).all():
            raise WrongUse(f"shear must be finite, not {self.shear.tolist()}")
        self.origin = np.zeros(size) if origin is None else numbers("origin", origin).copy()
        if self.origin.shape != (size,) or not np.isfinite(self.origin).all():
            given = self.origin.tolist()
            raise WrongUse(f"origin must be finite, of shape ({size},), not {given}")
        try:
            # The inverse is exact for the shears below. Adding zero turns -0 into 0.
            square = self.shear.T @ self.shear if size > count else self.shear
            inverse = np.linalg.inv(square) + 0.0
            self.unshear = inverse @ self.shear.T if size > count else inverse
        except np.linalg.LinAlgError:
            raise WrongUse(f"shear must be invertible, not {self.shear.tolist()}") from None

    @classmethod
    def plain(cls, **axes: Axis) -> "Grid":
        """Make a grid along the state's own axes, x = u.

        Each axis is (low, high, count), for example `theta=(0, 0.4, 200)`. The last axes may be
        numbers: the grid is then a slice, on which those coordinates have these values.
        """
        along, values = split_axes(axes)
        return cls(along, np.eye(len(axes), len(along)), values, tuple(axes)[len(along) :])

    @classmethod
    def sheared(cls, *, theta: Axis, sum: Axis, **others: Axis) -> "Grid":
        """Make a grid along theta and theta + thetadot, for states (theta, thetadot, others...).

        Each axis is (low, high, count); the last ones may be numbers, as in `plain`. These are the
        coordinates of Schwab and Wisse (2001), Figure 4.
        """
        axes = {"theta": theta, "sum": sum, **others}
        along, values = split_axes(axes)
        shear = np.eye(len(axes), len(along))
        shear[1, 0] = -1
        return cls(along, shear, values, tuple(axes)[len(along) :])

    @classmethod
    def through(cls, point: Mapping[str, float], **axes: Axis) -> "Grid":
        """Make a slice through a point, along any coordinates of the state.

        `point` names all coordinates in their order, as `dict(zip(walker.section, state))` does.
        Each axis is (low, high, count) of one coordinate; the others keep their values at the
        point.
        """
        check_kind("point", point, Mapping)
        unknown = [name for name in axes if name not in point]
        if unknown or not axes:
            raise WrongUse(
                f"axes must be of {', '.join(point)}, not {', '.join(unknown) or 'none'}"
            )
        names = list(point)
        shear = np.zeros((len(names), len(axes)))
        shear[[names.index(name) for name in axes], range(len(axes))] = 1
        values = numbers("point", list(point.values())).astype(float)
        return cls(axes, shear, np.where(shear.any(axis=1), 0.0, values))

    def zoom(self, centre: Float[ArrayLike, " s"], factor: float | int) -> "Grid":
        """Return a grid of as many cells in a window around a point, `factor` times as narrow.

        Its box coordinates are offsets from that point, which is its origin. They stay exact where
        coordinates of the point have no digits left.

        Raises ValueError for a centre that is not s finite numbers, or a factor that is not
        positive.
        """
        check_number("factor", factor)
        if not 0 < factor < math.inf:
            raise WrongUse(f"factor={factor}: must be positive and finite")
        half = (np.asarray(self.upper) - np.asarray(self.lower)) / 2 / factor
        counts = zip(self.names, half.tolist(), self.shape, strict=True)
        axes = {name: (-width, width, count) for name, width, count in counts}
        return Grid(axes, self.shear, numbers("centre", centre), self.fixed)

    @property
    def coordinates(self) -> int:
        """Number of coordinates of the state; on the host only."""
        return len(self.shear)

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of cells along each axis; on the host only."""
        return tuple(int(count) for count in self.counts)

    @property
    def size(self) -> int:
        """Number of cells; on the host only."""
        return math.prod(self.shape)

    @property
    def spacing(self) -> Float[np.ndarray | Array, " d"]:
        """Width of a cell along each box axis."""
        return (self.upper - self.lower) / self.counts.astype(self.lower.dtype)

    @property
    def cell_area(self) -> float:
        """Length, area or volume of a cell in the state's coordinates; on the host only."""
        if self.coordinates == len(self.names):
            return float(np.prod(self.spacing) * abs(np.linalg.det(self.shear)))
        return float(np.prod(self.spacing) * np.sqrt(np.linalg.det(self.shear.T @ self.shear)))

    @property
    def axes(self) -> dict[str, np.ndarray]:
        """Box coordinates of the centres along each axis; on the host only."""
        ends = zip(self.names, self.lower, self.spacing, self.shape, strict=True)
        return {
            name: np.asarray(low + (np.arange(count, dtype=low.dtype) + 0.5) * width)
            for name, low, width, count in ends
        }

    @property
    def fixed_values(self) -> dict[str, float]:
        """The fixed coordinates of a slice; on the host only."""
        values = self.origin[self.coordinates - len(self.fixed) :]
        return {name: float(value) for name, value in zip(self.fixed, values, strict=True)}

    @property
    def box(self) -> dict[str, list[float | int] | float]:
        """[low, high, count] of each axis, and the fixed coordinates; on the host only."""
        ends = zip(self.names, self.lower, self.upper, self.shape, strict=True)
        return {
            name: [float(low), float(high), n] for name, low, high, n in ends
        } | self.fixed_values

    def centre(self, index: Int[ArrayLike, ""]) -> Float[Array, " s"]:
        """Return the centre of a cell, x = origin + shear @ (lower + (i + 1/2) spacing).

        The index is 0 ... size - 1, and i is the place of the cell on each axis.
        """
        lower, spacing = jnp.asarray(self.lower), jnp.asarray(self.spacing)
        u = lower + (self.cell_place(index).astype(lower.dtype) + 0.5) * spacing
        return jnp.asarray(self.origin) + multiply(self.shear, u)

    def centres(self, indices: Int[np.ndarray, " n"]) -> Float[np.ndarray, "n s"]:
        """Return the centres of many cells; on the host only."""
        dtype = jnp.result_type(float)  # on the host, to compile nothing for so little work
        fields = (self.lower, self.spacing, self.shear, self.origin)
        lower, spacing, shear, origin = (np.asarray(part, dtype) for part in fields)
        places = np.unravel_index(indices, self.counts)
        u = [
            low + (i.astype(dtype) + dtype.type(0.5)) * step
            for low, step, i in zip(lower, spacing, places, strict=True)
        ]
        found = np.empty((len(indices), len(origin)), dtype)
        # Coordinate by coordinate: NumPy is slow over short rows.
        for k, row in enumerate(shear):
            found[:, k] = origin[k] + sum(each * along for each, along in zip(row, u, strict=True))
        return found

    def contains(self, points: Float[np.ndarray, "*n s"]) -> Bool[np.ndarray, "*n"]:
        """Return whether each point lies in a cell; on the host only."""
        fields = (self.lower, self.upper, self.unshear, self.origin)
        lower, upper, unshear, origin = (np.asarray(part, points.dtype) for part in fields)
        with np.errstate(invalid="ignore"):  # raised by points that are not finite
            u = np.sum(unshear * (points - origin)[..., None, :], axis=-1)
        return ((lower <= u) & (u <= upper)).all(axis=-1)

    def points_at(self, shares: Float[np.ndarray, "n d"]) -> Float[np.ndarray, "n s"]:
        """Return points at shares, from 0 to 1, of the length of each axis; on the host only."""
        lower, upper = np.asarray(self.lower), np.asarray(self.upper)
        u = lower + (upper - lower) * shares
        return np.asarray(self.origin) + u @ np.asarray(self.shear).T

    def place(self, point: Float[np.ndarray, " s"]) -> Float[np.ndarray, " d"]:
        """Return a point's place on each axis, in cells from the first centre; host only."""
        u = np.asarray(self.unshear) @ (point - np.asarray(self.origin))
        return (u - np.asarray(self.lower)) / np.asarray(self.spacing) - 0.5

    def position(self, point: Float[Array, " s"]) -> Float[Array, " d"]:
        """Return a point's place on each axis, in cells from the lower end; JAX can trace it."""
        lower, spacing = jnp.asarray(self.lower), jnp.asarray(self.spacing)
        u = multiply(self.unshear, point.astype(lower.dtype) - jnp.asarray(self.origin))
        return (u - lower) / spacing

    def cell_place(self, index: Int[ArrayLike, ""]) -> Int32[Array, " d"]:
        """Return the place of a cell on each axis, from 0; the index is 0 ... size - 1."""
        places = []
        for count in self.counts[::-1]:
            index, place = jnp.divmod(jnp.asarray(index).astype(jnp.int32), count)
            places.insert(0, place)
        return jnp.stack(places)

    def cell(self, point: Float[Array, " s"]) -> Int32[Array, ""]:
        """Return the index of the cell that holds x; -1 where none does or x is not finite.

        Raises ValueError for a slice, in which hardly any point lies.
        """
        if self.coordinates != len(self.names):
            raise WrongUse(f"the grid must not be a slice, with {' and '.join(self.fixed)} fixed")
        lower, upper, spacing = map(jnp.asarray, (self.lower, self.upper, self.spacing))
        u = multiply(self.unshear, point.astype(lower.dtype) - jnp.asarray(self.origin))
        inside = jnp.all((lower <= u) & (u <= upper))  # False for NaN
        places = jnp.floor(jnp.where(inside, u - lower, 0) / spacing).astype(jnp.int32)
        places = jnp.minimum(places, self.counts - 1)  # the upper border is in the last cell
        index = jnp.int32(0)
        for place, count in zip(places, self.counts, strict=True):
            index = index * count + place
        return jnp.where(inside, index, -1)


def split_axes(axes: Mapping[str, Axis]) -> tuple[dict[str, Axis], Float[np.ndarray, " s"]]:
    """Split axes into those with cells, and an origin with the fixed values of the last ones."""
    single: list[bool] = [is_number(axis) for axis in axes.values()]
    count = len(axes) - sum(single)
    if count == 0:
        raise WrongUse(f"axes={dict(axes)!r}: a grid needs at least one axis, (low, high, count)")
    if any(single[:count]):
        name = list(axes)[single.index(True)]
        raise WrongUse(
            f"{name}={short(axes[name])}: only the last axes may be numbers: "
            "give (low, high, count)"
        )
    values = [0.0] * count + [float(axis) for axis in list(axes.values())[count:]]
    return dict(list(axes.items())[:count]), np.array(values)


def check_axis(name: str, axis: Axis) -> tuple[float, float, int]:
    """Return the three parts of an axis, checked."""
    try:
        low, high, count = axis
        low, high, count = float(low), float(high), operator.index(count)
    except (TypeError, ValueError, OverflowError):
        raise WrongUse(
            f"{name}={short(axis)}: an axis is (low, high, count), two numbers and an integer"
        ) from None
    if not math.isfinite(high - low):
        raise WrongUse(f"{name}={short(axis)}: the ends of an axis must be finite")
    if low >= high:
        raise WrongUse(f"{name}={short(axis)}: low must be below high")
    if count < 1:
        raise WrongUse(f"{name}={short(axis)}: the count of cells must be positive")
    few = min(count, MAX_SIZE)  # more are refused later, and may be more than a float can tell
    if (high - low) / few < np.finfo(float).tiny:
        raise WrongUse(
            f"{name}={short(axis)}: the cells are narrower than numbers can be apart: "
            "lower the count"
        )
    return low, high, count


def multiply(
    matrix: Float[np.ndarray | Array, "m n"], vector: Float[Array, " n"]
) -> Float[Array, " m"]:
    """Return matrix @ vector as a sum, which no accelerator computes in a shorter type."""
    return jnp.sum(jnp.asarray(matrix) * vector[None], axis=1)


def cell_slices(size: int) -> list[slice]:
    """Return slices that cover an array, each of a part that stays in the cache."""
    return [
        slice(start, min(start + CELLS_PER_PART, size)) for start in range(0, size, CELLS_PER_PART)
    ]


def edge(label: Shaped[np.ndarray, "*shape"]) -> Bool[np.ndarray, "*shape"]:
    """Return whether each cell has a neighbour, corners included, with another label."""
    most, least = label, label
    for axis in range(label.ndim):
        most = among_neighbours(np.maximum, most, axis)
        least = among_neighbours(np.minimum, least, axis)
    return most != least


def steps_around(axes: int) -> Int[np.ndarray, "n axes"]:
    """Return the steps from a cell to its neighbours, corners included, and to itself."""
    return np.stack(np.meshgrid(*[(-1, 0, 1)] * axes, indexing="ij"), -1).reshape(-1, axes)


def among_neighbours(pick: np.ufunc, values: np.ndarray, axis: int) -> np.ndarray:
    """Pick the largest, or least, of each value and its two neighbours along an axis."""
    picked = values.copy()
    here, there = (np.moveaxis(array, axis, 0) for array in (picked, values))
    pick(here[1:], there[:-1], out=here[1:])
    pick(here[:-1], there[1:], out=here[:-1])
    return picked


def axes_around(state: Float[ArrayLike, " section"], names: tuple[str, ...]) -> dict:
    """Return the axes of a window around a gait's state.

    If `names` has phidot and joints too, these are fixed at their values in the state.
    """
    theta, thetadot, *others = map(float, np.asarray(state))
    middle = theta + thetadot if names[1] == "sum" else thetadot
    below, above = (0.5, 0.3) if "phidot" in names else (0.25, 0.1)
    return {
        "theta": (0.0, 2.5 * theta, 200),
        names[1]: (middle - below * theta, middle + above * theta, 250),
        **dict(zip(names[2:], others, strict=False)),
    }

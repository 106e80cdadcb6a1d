"""Options for coordinates of the section: the axes of a picture or a region, and a start."""

from collections.abc import Container
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from walker_jax.basins.windows import fill_from_paper, grid_along, outline, window_of_region
from walker_jax.checks import WrongUse, is_number
from walker_jax.cli.groups import option
from walker_jax.cli.options import (
    PHIDOT_HELP,
    check_finite,
    read_numbers,
    refuse,
    refuse_again,
)
from walker_jax.gaits.selection import require_gait
from walker_jax.grids import Grid
from walker_jax.systems.system import System

Axis = tuple[float, float, int]
"""Ends of an axis, and its number of cells."""
AXIS = {"metavar": "LO HI N"}
AXES: Any = option(
    None,
    "An axis by name, or NAME=VALUE for a slice: one for each coordinate of the section.",
    metavar="NAME=LO:HI:N",
)
START: Any = option(None, "A coordinate of the start, by name: one for each.", metavar="NAME=VALUE")
AXIS_FORM = "NAME=LO:HI:N or NAME=VALUE"
WINDOW_CELLS = 200
"""Cells along each axis of a default window."""


class Section:
    """Axes from options of their own, or all axes from --axis."""

    axis: list[str] | None

    @property
    def own(self) -> dict[str, Any]:
        """The options for single axes, with their values."""
        return {name: given for name, given in vars(self).items() if name != "axis"}

    def check(self, walker: System) -> None:
        """Refuse axes that the walker's section lacks."""
        if not has_plane(walker):
            each = "give --axis for each coordinate of the section"
            refuse(f"is for walkers in the plane: {each}", **self.own)
        turned = {name: self.own.get(name) for name in ("phidot", "at_phidot")}
        if "phidot" not in walker.section:
            section = ", ".join(walker.section)
            refuse(f"must be left out: it is not on the section, {section}", **turned)
        check_finite(at_phidot=turned["at_phidot"])


@dataclass(frozen=True)
class Window(Section):
    """The window of a picture, by default that of the paper."""

    theme = "Window"
    theta: Axis | None = option(None, "Stance angle, rad (default: 0 0.4 200).", **AXIS)
    sum: Axis | None = option(None, "theta + thetadot (default: -0.04 0.01 250).", **AXIS)
    at_phidot: float | None = option(None, f"{PHIDOT_HELP}: a slice there (default: at the gait).")
    axis: list[str] | None = AXES

    def axes(self, walker: System, most: int = 2) -> dict[str, Any]:
        """Return the axes; at most `most` of them may be ranges.

        For a walker an axis may be None. The default for any other system is its `gait_region`.
        """
        self.check(walker)
        if self.axis:
            axes = axes_from(walker, self.axis)
            check_ranges(axes, most)
        elif has_plane(walker):
            axes = fill_from_paper(walker, self.own_axes(walker))
        else:
            axes = axes_of_region(walker)
        check_drawable(outline(axes))
        return axes

    def own_axes(self, walker: System) -> dict[str, Any]:
        """Return the axes that options of their own give, for a walker; None if missing."""
        axes: dict[str, Any] = {"theta": self.theta, "sum": self.sum}
        axes |= {"phidot": self.at_phidot} if "phidot" in walker.section else {}
        joints = walker.section[3:] if walker.section[0] == "theta" else ()
        return axes | dict.fromkeys(joints)


@dataclass(frozen=True)
class Region(Section):
    """The region in which areas are measured, by default all of the section."""

    theme = "Region"
    theta: Axis | None = option(None, "Stance angle, rad (default: all).", **AXIS)
    sum: Axis | None = option(None, "theta + thetadot.", **AXIS)
    at_phidot: float | None = option(None, f"{PHIDOT_HELP}: a slice there (else at the gait).")
    axis: list[str] | None = AXES

    def grid(self, walker: System) -> Grid | None:
        """Return the grid of these axes; None if no axes are given."""
        self.check(walker)
        grid = grid_along(axes_from(walker, self.axis)) if self.axis else self.own_grid(walker)
        if grid is not None:
            check_drawable(grid)
        return grid

    def own_grid(self, walker: System) -> Grid | None:
        """Return the grid of the axes that options of their own give."""
        axes = {"theta": self.theta, "sum": self.sum}
        if "phidot" in walker.section:
            ranged = self.own.get("phidot")
            axes |= {"at-phidot": self.at_phidot} if ranged is None else {"phidot": ranged}
        if all(axis is None for axis in axes.values()):
            return None
        if None in axes.values():
            raise WrongUse(f"give {' and '.join(f'--{name}' for name in axes)}, or none of them")
        return Grid.sheared(**{name.removeprefix("at-"): axis for name, axis in axes.items()})


@dataclass(frozen=True)
class Volume(Region):
    """A region of two dimensions or three."""

    phidot: Axis | None = option(None, "The rate between the legs, for volumes.", **AXIS)


@dataclass(frozen=True)
class Start:
    """A point of the section."""

    theme = "Start"
    theta: float | None = option(None, "Stance angle at the start, rad (default: see below).")
    thetadot: float | None = option(None, "Its rate at the start, rad per unit of time.")
    phidot: float | None = option(None, f"{PHIDOT_HELP}.")
    start: list[str] | None = START

    def coordinates(self, walker: System) -> dict[str, float]:
        """Return the given coordinates, from --start or from options of their own."""
        own = {"theta": self.theta, "thetadot": self.thetadot, "phidot": self.phidot}
        check_finite(**own)
        refuse_own(walker, **own)
        given = {name: value for name, value in own.items() if value is not None}
        return start_from(walker, self.start) if self.start else given


def has_plane(walker: System) -> bool:
    """Return whether a section has the plane of theta and thetadot, which has own options."""
    return walker.section[:2] == ("theta", "thetadot")


def has_own_options(walker: System) -> bool:
    """Return whether all coordinates of a section have options of their own."""
    return {*walker.section} <= {"theta", "thetadot", "phidot"}


def refuse_own(walker: System, **own: Any) -> None:
    """Refuse options for single coordinates on a section with other coordinates."""
    if not has_own_options(walker):
        section = ", ".join(walker.section)
        refuse(
            f"is for walkers in the plane: give --start NAME=VALUE, for each of {section}", **own
        )


def start_from(walker: System, texts: list[str]) -> dict[str, float]:
    """Read the coordinates that --start names."""
    given: dict[str, float] = {}
    for text in texts:
        name, (value,) = read_numbers("--start", "NAME=VALUE", (float,), text)
        check_coordinate("--start", walker, name, given)
        check_finite(start=value)
        given[name] = value
    for name in walker.section:
        if name not in given:
            raise WrongUse(f"--start {name}=VALUE is required too")
    return given


def begin_at(walker: System, given: dict[str, float]) -> Float[np.ndarray, " section"]:
    """Return the state with these coordinates, or the gait's if none are given."""
    instead = walker.section if has_own_options(walker) else ["--start NAME=VALUE"]
    state = state_from(walker, given) if given else require_gait(walker, instead).states[0]
    return np.asarray(state)


def state_from(walker: System, given: dict[str, float]) -> Float[np.ndarray, " section"]:
    """Return the state on the section with these coordinates, by name."""
    section = ", ".join(walker.section)
    for name in walker.section:
        if name not in given:
            raise WrongUse(f"--{name} is required too: the section is {section}")
    for name in given:
        if name not in walker.section:
            raise WrongUse(f"--{name} must be left out: it is not on the section, {section}")
    return np.array([given[name] for name in walker.section])


def axes_from(walker: System, texts: list[str]) -> dict[str, Any]:
    """Read the axes that --axis names, in the order of the section."""
    axes: dict[str, Any] = {}
    for text in texts:
        kinds = (float, float, int) if ":" in text else (float,)
        name, numbers = read_numbers("--axis", AXIS_FORM, kinds, text)
        check_coordinate("--axis", walker, name, axes)
        axes[name] = tuple(numbers) if ":" in text else numbers[0]
        check_finite(axis=numbers[0] if ":" not in text else None)
    for name in walker.section:
        if name not in axes:
            raise WrongUse(f"--axis {name}=LO:HI:N is required too, or {name}=VALUE for a slice")
    return {name: axes[name] for name in walker.section}


def axes_of_region(system: System) -> dict[str, Any]:
    """Return the axes of the region in which a system's gaits are sought."""
    axes = window_of_region(system, WINDOW_CELLS)
    if axes is None:
        names = ", ".join(system.section)
        raise WrongUse(f"--axis NAME=LO:HI:N is required, for each of {names}")
    return axes


def check_coordinate(option: str, walker: System, name: str, earlier: Container[str]) -> None:
    """Refuse a name that is not on the section, or that the option has named before."""
    refuse_again(option, name, earlier)
    if name not in walker.section:
        section = ", ".join(walker.section)
        raise WrongUse(f"{option} must be of the section, {section}, not of {name}")


def check_section(walker: System, axis: list[str] | None) -> None:
    """Refuse a section of one coordinate, which has no picture, and of many without --axis."""
    count = len(walker.section)
    if count == 1:
        raise WrongUse(
            f"{walker.label()} has a section of one coordinate, and pictures have two: use "
            "walker_jax.basin in Python"
        )
    if count > 3 and not axis:
        raise WrongUse(
            f"--axis is required: {walker.label()} has a section of {count} coordinates; give two "
            "or three of them as NAME=LO:HI:N, the others as NAME=VALUE"
        )


def check_ranges(axes: dict[str, Any], most: int) -> None:
    """Refuse axes if too few or too many of them are ranges, for a picture."""
    count = sum(not is_number(axis) for axis in axes.values())
    if not 2 <= count <= most:
        numbers = "two" if most == 2 else "two or three"
        raise WrongUse(f"--axis must be NAME=LO:HI:N for {numbers} coordinates, not {count}")


def check_drawable(grid: Grid) -> None:
    """Refuse a grid that is too coarse for a picture."""
    if min(grid.shape) < 2:
        axes = " and ".join(f"--{name}" for name in grid.names)
        raise WrongUse(f"{axes} must have 2 cells or more each for a picture, not {grid.shape}")


def asked_of(grid: Grid | None) -> dict[str, Any]:
    """Return the part of a request about a grid: its axes, and the point a slice goes through."""
    if grid is None:
        return {}
    origin = np.asarray(grid.origin)
    return grid.box | ({} if grid.fixed or not origin.any() else {"origin": origin.tolist()})

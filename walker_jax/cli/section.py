"""Options for coordinates of the section: the axes of a picture or a region, and a start."""

from typing import TYPE_CHECKING, Any

import walker_jax as wj
from walker_jax.cli.options import RANGE, Axis, Group, axis_option, named, number, refuse
from walker_jax.refusals import WrongUse

if TYPE_CHECKING:
    import numpy as np
    from jaxtyping import Float


PHIDOT = "Rate between the legs, on sections that have it"
WINDOW_CELLS = 200
"""Cells along each axis of a default window."""


def start_option(*excludes: str) -> Any:
    """Make the option for the coordinates of a start."""
    text = "A coordinate of the start, by name: one for each."
    return named(text, "VALUE", excludes=excludes)


def axes_option(*excludes: str) -> Any:
    """Make the option for axes by name."""
    text = "An axis by name, or NAME=VALUE for a slice: one for each coordinate of the section."
    return named(text, RANGE, "VALUE", metavar=f"NAME={RANGE}", excludes=excludes)


class Section(Group):
    """Axes by options of their own, for walkers in the plane, or all axes by --axis."""

    theme = "Window"
    theta: Axis | None = axis_option("Stance angle, rad (default: 0 0.4 200).")
    sum: Axis | None = axis_option("theta + thetadot (default: -0.04 0.01 250).")
    axis: dict[str, Any] = axes_option("theta", "sum", "thetadot", "phidot", "at_phidot")

    @property
    def own(self) -> dict[str, Any]:
        """The options for single axes, with their values."""
        return {name: given for name, given in vars(self).items() if name != "axis"}

    def check(self, walker: "wj.System") -> None:
        """Refuse axes that the walker's section lacks."""
        if not has_plane(walker):
            each = "give --axis for each coordinate of the section"
            refuse(f"is for walkers in the plane: {each}", **self.own)
        if "phidot" not in walker.section:
            section = ", ".join(walker.section)
            turned = {name: self.own.get(name) for name in ("phidot", "at_phidot")}
            refuse(f"must be left out: it is not on the section, {section}", **turned)


class Window(Section):
    """The window of a picture, by default that of the paper."""

    def axes(self, walker: "wj.System", most: int = 2) -> dict[str, Any]:
        """Return the axes; at most `most` of them may be ranges.

        For a walker an axis may be None. The default for any other system is its `gait_region`.
        """
        from walker_jax.basins.windows import fill_from_paper, outline

        self.check(walker)
        if self.axis:
            axes = named_axes(walker, self.axis)
            check_ranges(axes, most)
        elif has_plane(walker):
            axes = fill_from_paper(walker, self.own_axes(walker))
        else:
            axes = axes_of_region(walker)
        check_drawable(outline(axes))
        return axes

    def own_axes(self, walker: "wj.System") -> dict[str, Any]:
        """Return the axes that options of their own give, for a walker; None if missing."""
        axes: dict[str, Any] = {"theta": self.theta, "sum": self.sum}
        axes |= {"phidot": self.own.get("at_phidot")} if "phidot" in walker.section else {}
        return axes | dict.fromkeys(walker.section[3:])


class SlicedWindow(Window):
    """A window that may be a slice of a section of three dimensions."""

    at_phidot: float | None = number(None, f"{PHIDOT}: a slice there (default: at the gait).")


class Region(Section, theme="Region"):
    """The region in which areas are measured, by default all of the section."""

    theta: Axis | None = axis_option("Stance angle, rad (default: all).")
    sum: Axis | None = axis_option("theta + thetadot.")
    at_phidot: float | None = number(None, f"{PHIDOT}: a slice there (else at the gait).")

    def grid(self, walker: "wj.System") -> "wj.Grid | None":
        """Return the grid of these axes; None if no axes are given."""
        from walker_jax.basins.windows import grid_along

        self.check(walker)
        grid = grid_along(named_axes(walker, self.axis)) if self.axis else self.own_grid(walker)
        if grid is not None:
            check_drawable(grid)
        return grid

    def own_grid(self, walker: "wj.System") -> "wj.Grid | None":
        """Return the grid of the axes that options of their own give."""

        axes: dict[str, Any] = {"theta": self.theta, "sum": self.sum}
        if "phidot" in walker.section:
            ranged = self.own.get("phidot")
            axes |= {"at-phidot": self.at_phidot} if ranged is None else {"phidot": ranged}
        if all(axis is None for axis in axes.values()):
            return None
        if None in axes.values():
            raise WrongUse(f"give {' and '.join(f'--{name}' for name in axes)}, or none of them")
        return wj.Grid.sheared(**{name.removeprefix("at-"): axis for name, axis in axes.items()})


class Volume(Region):
    """A region of two dimensions or three."""

    phidot: Axis | None = axis_option(
        "The rate between the legs, for volumes.", excludes=["at_phidot"]
    )


class Start(Group, theme="Start"):
    """A point of the section."""

    theta: float | None = number(None, "Stance angle at the start, rad (default: see below).")
    thetadot: float | None = number(None, "Its rate at the start, rad per unit of time.")
    phidot: float | None = number(None, f"{PHIDOT}.")
    start: dict[str, float] = start_option("theta", "thetadot", "phidot")

    def coordinates(self, walker: "wj.System") -> dict[str, float]:
        """Return the given coordinates, from --start or from options of their own."""
        own = {"theta": self.theta, "thetadot": self.thetadot, "phidot": self.phidot}
        refuse_own(walker, **own)
        check_start(walker, self.start)
        return self.start or {name: value for name, value in own.items() if value is not None}


def named_axes(walker: "wj.System", given: dict[str, Any]) -> dict[str, Any]:
    """Return the axes that --axis names, in the order of the section."""
    check_names("--axis", walker, given)
    for name in walker.section:
        if name not in given:
            raise WrongUse(f"--axis {name}={RANGE} is required too, or {name}=VALUE for a slice")
    return {name: given[name] for name in walker.section}


def has_plane(walker: "wj.System") -> bool:
    """Return whether a section has the plane of theta and thetadot, which has own options."""
    return walker.section[:2] == ("theta", "thetadot")


def has_own_options(walker: "wj.System") -> bool:
    """Return whether all coordinates of a section have options of their own."""
    return {*walker.section} <= {"theta", "thetadot", "phidot"}


def refuse_own(walker: "wj.System", **own: Any) -> None:
    """Refuse options for single coordinates on a section with other coordinates."""
    if not has_own_options(walker):
        each = f"give --start NAME=VALUE, for each of {', '.join(walker.section)}"
        refuse(f"is for walkers in the plane: {each}", **own)


def check_start(walker: "wj.System", start: dict[str, float]) -> None:
    """Refuse a start by --start that lacks coordinates, or that has others than the section."""
    check_names("--start", walker, start)
    for name in walker.section:
        if start and name not in start:
            raise WrongUse(f"--start {name}=VALUE is required too")


def begin_at(walker: "wj.System", given: dict[str, float]) -> "Float[np.ndarray, ' section']":
    """Return the state with these coordinates, or the gait's if none are given."""
    import numpy as np

    from walker_jax.gaits.selection import require_gait

    instead = walker.section if has_own_options(walker) else ["--start NAME=VALUE"]
    state = state_from(walker, given) if given else require_gait(walker, instead).states[0]
    return np.asarray(state)


def state_from(walker: "wj.System", given: dict[str, float]) -> "Float[np.ndarray, ' section']":
    """Return the state on the section with these coordinates, by name."""
    import numpy as np

    section = ", ".join(walker.section)
    for name in walker.section:
        if name not in given:
            raise WrongUse(f"--{name} is required too: the section is {section}")
    for name in given:
        if name not in walker.section:
            raise WrongUse(f"--{name} must be left out: it is not on the section, {section}")
    return np.array([given[name] for name in walker.section])


def axes_of_region(system: "wj.System") -> dict[str, Any]:
    """Return the axes of the region of a system's gaits, or of the basin of a robot's."""
    from walker_jax.basins.windows import window_of_basin, window_of_region

    known = is_robot(system)
    axes = window_of_basin(system) if known else window_of_region(system, WINDOW_CELLS)
    if axes is None:
        names = ", ".join(system.section)
        raise WrongUse(f"--axis NAME={RANGE} is required, for each of {names}")
    return axes


def is_robot(system: "wj.System") -> bool:
    """Return whether a system is a robot from a file, which has a window around its gait."""
    from walker_jax.robots.robots import Robot

    return isinstance(system, Robot)


def check_names(option: str, walker: "wj.System", given: dict[str, Any]) -> None:
    """Refuse names that are not on the section."""
    for name in given:
        if name not in walker.section:
            section = ", ".join(walker.section)
            raise WrongUse(f"{option} must be of the section, {section}, not of {name}")


def check_section(walker: "wj.System", axis: dict[str, Any]) -> None:
    """Refuse a section of one coordinate, which has no picture, and of many without --axis."""
    count = len(walker.section)
    if count == 1:
        raise WrongUse(
            f"{walker.label()} has a section of one coordinate, and pictures have two: use "
            "walker_jax.basin in Python"
        )
    if count > 3 and not axis and not is_robot(walker):
        raise WrongUse(
            f"--axis is required: {walker.label()} has a section of {count} coordinates; give two "
            f"or three of them as NAME={RANGE}, the others as NAME=VALUE"
        )


def check_ranges(axes: dict[str, Any], most: int) -> None:
    """Refuse axes if too few or too many of them are ranges, for a picture."""
    count = sum(isinstance(axis, tuple) for axis in axes.values())
    if not 2 <= count <= most:
        numbers = "two" if most == 2 else "two or three"
        raise WrongUse(f"--axis must be NAME={RANGE} for {numbers} coordinates, not {count}")


def check_drawable(grid: "wj.Grid") -> None:
    """Refuse a grid that is too coarse for a picture."""
    if min(grid.shape) < 2:
        axes = " and ".join(f"--{name}" for name in grid.names)
        raise WrongUse(f"{axes} must have 2 cells or more each for a picture, not {grid.shape}")


def asked_of(grid: "wj.Grid | None") -> dict[str, Any]:
    """Return the part of a request about a grid: its axes, and the point a slice goes through."""
    import numpy as np

    if grid is None:
        return {}
    origin = np.asarray(grid.origin)
    return grid.box | ({} if grid.fixed or not origin.any() else {"origin": origin.tolist()})

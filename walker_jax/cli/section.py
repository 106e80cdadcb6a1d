"""Options for coordinates of the section: the axes of a picture or a region, and a start."""

from typing import Any

import walker_jax as wj
from walker_jax.cli import library as lib
from walker_jax.cli.options import RANGE, Axis, Group, named, only_given, option, option_of, refuse
from walker_jax.refusals import WrongUse

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


class Section(Group, theme="Window"):
    """Axes by options of their own, for walkers in the plane, or all axes by --axis."""

    theta: Axis | None = option(None, "Stance angle, rad (default: 0 0.4 200).")
    sum: Axis | None = option(None, "theta + thetadot (default: -0.04 0.01 250).")
    axis: dict[str, Any] = axes_option("theta", "sum", "thetadot", "phidot", "at_phidot")

    def given(self, walker: "wj.System", most: int | None = None) -> dict[str, Any]:
        """Return the axes that are given, by name; None where a walker's own is missing.

        Options of their own are for sections with the plane of theta and thetadot; they are
        refused for any other, as are those for coordinates that the section lacks. At most `most`
        of the axes of --axis may be ranges.
        """
        if self.axis:
            return named_axes(walker, self.axis, most)
        own = only_given(**vars(self))
        del own["axis"]  # none is given
        if not has_plane(walker):
            each = "give --axis for each coordinate of the section"
            refuse(f"is for walkers in the plane: {each}", **own)
            return {}
        second = "thetadot" if "thetadot" in own else "sum"
        axes = {"theta": self.theta, second: own.get(second)}
        if "phidot" in walker.section:
            return axes | {"phidot": own.get("phidot", own.get("at_phidot"))}
        others = {name: own.get(name) for name in ("phidot", "at_phidot")}
        section = ", ".join(walker.section)
        refuse(f"must be left out: it is not on the section, {section}", **others)
        return axes


class Window(Section):
    """The window of a picture, by default that of the paper."""

    def axes(self, walker: "wj.System", most: int = 2) -> dict[str, Any]:
        """Return the axes; at most `most` of them may be ranges.

        For a walker an axis may be None. The default for any other system is its `gait_region`.
        """
        axes = self.given(walker, most) or axes_of_region(walker)
        if not self.axis and has_plane(walker):
            axes = lib.fill_from_paper(walker, axes | dict.fromkeys(walker.section[3:]))
        check_drawable(lib.outline(axes))
        return axes


class SlicedWindow(Window):
    """A window that may be a slice of a section of three dimensions."""

    at_phidot: float | None = option(None, f"{PHIDOT}: a slice there (default: at the gait).")


class Region(Section, theme="Region"):
    """The region in which areas are measured, by default all of the section."""

    theta: Axis | None = option(None, "Stance angle, rad (default: all).")
    sum: Axis | None = option(None, "theta + thetadot.")
    at_phidot: float | None = option(None, f"{PHIDOT}: a slice there, of --theta and --sum.")

    def grid(self, walker: "wj.System") -> "wj.Grid | None":
        """Return the grid of these axes; None if no axes are given."""
        axes = self.given(walker)
        if all(axis is None for axis in axes.values()):
            return None
        if None in axes.values():
            ranged = isinstance(axes.get("phidot"), tuple)
            names = ("at-phidot" if name == "phidot" and not ranged else name for name in axes)
            raise WrongUse(f"give {' and '.join(f'--{name}' for name in names)}, or none of them")
        grid = lib.grid_along(axes)
        check_drawable(grid)
        return grid


class Volume(Region):
    """A region of two dimensions or three."""

    phidot: Axis | None = option(
        None, "The rate between the legs, for volumes.", excludes=["at_phidot"]
    )


class Start(Group):
    """A point of the section."""

    theta: float | None = option(None, "Stance angle at the start, rad (default: see below).")
    thetadot: float | None = option(None, "Its rate at the start, rad per unit of time.")
    phidot: float | None = option(None, f"{PHIDOT}.")
    start: dict[str, float] = start_option("theta", "thetadot", "phidot")

    def coordinates(self, walker: "wj.System", **usual: float) -> dict[str, float]:
        """Return the coordinates of the start, in the order of the section: none, or all.

        Options of their own may have `usual` values.
        """
        own = {"theta": self.theta, "thetadot": self.thetadot, "phidot": self.phidot}
        refuse_own(walker, **own)
        if self.start:
            check_names("--start", walker, self.start, "NAME=VALUE is required too")
        given, section = self.start or usual | only_given(**own), ", ".join(walker.section)
        for name in walker.section if given else ():
            if name not in given:
                raise WrongUse(f"--{name} is required too: the section is {section}")
        for name in given:
            if name not in walker.section:
                raise WrongUse(f"--{name} must be left out: it is not on the section, {section}")
        return {name: given[name] for name in walker.section if given}

    def begin(self, walker: "wj.System", **usual: float) -> list[float]:
        """Return the start, by default the first state of the gait."""
        if given := self.coordinates(walker, **usual):
            return [*given.values()]
        own = ", ".join(map(option_of, walker.section))
        instead = f"give {own if has_own_options(walker) else '--start NAME=VALUE'}"
        (gait,) = lib.selection.select_gaits(walker, instead=instead)
        return gait.states[0].tolist()


def has_plane(walker: "wj.System") -> bool:
    """Return whether a section has the plane of theta and thetadot, which has own options."""
    return walker.section[:2] == ("theta", "thetadot")


def has_own_options(walker: "wj.System") -> bool:
    """Return whether all coordinates of a section have options of their own."""
    return {*walker.section} <= {"theta", "thetadot", "phidot"}


def refuse_own(walker: "wj.System", **own: Any) -> None:
    """Refuse options of their own for coordinates where some coordinates have none."""
    if not has_own_options(walker):
        each = f"give --start NAME=VALUE, for each of {', '.join(walker.section)}"
        refuse(f"is for walkers in the plane: {each}", **own)


def check_names(option: str, walker: "wj.System", given: dict[str, Any], missing: str) -> None:
    """Refuse names that are not on the section, and coordinates without a name."""
    for name in given:
        if name not in walker.section:
            section = ", ".join(walker.section)
            raise WrongUse(f"{option} must be of the section, {section}, not of {name}")
    for name in walker.section:
        if name not in given:
            raise WrongUse(f"{option} {missing.replace('NAME', name)}")


def named_axes(walker: "wj.System", given: dict[str, Any], most: int | None = None) -> dict:
    """Return the axes that --axis names, in the order of the section.

    For a picture at least two and at most `most` of them must be ranges.
    """
    check_names("--axis", walker, given, f"NAME={RANGE} is required too, or NAME=VALUE for a slice")
    count = sum(isinstance(axis, tuple) for axis in given.values())
    if most is not None and not 2 <= count <= most:
        numbers = "two" if most == 2 else "two or three"
        raise WrongUse(f"--axis must be NAME={RANGE} for {numbers} coordinates, not {count}")
    return {name: given[name] for name in walker.section}


def axes_of_region(system: "wj.System") -> dict[str, Any]:
    """Return the axes of the region of a system's gaits, or of the basin of a robot's."""
    robot = isinstance(system, lib.Robot)
    axes = lib.window_of_basin(system) if robot else lib.window_of_region(system, WINDOW_CELLS)
    if axes is None:
        names = ", ".join(system.section)
        raise WrongUse(f"--axis NAME={RANGE} is required, for each of {names}")
    return axes


def check_section(walker: "wj.System", axis: dict[str, Any]) -> None:
    """Refuse a section of one coordinate, which has no picture, and of many without --axis."""
    count = len(walker.section)
    if count == 1:
        raise WrongUse(
            f"{walker.label()} has a section of one coordinate, and pictures have two: use "
            "walker_jax.basin in Python"
        )
    if count > 3 and not axis and not isinstance(walker, lib.Robot):
        raise WrongUse(
            f"--axis is required: {walker.label()} has a section of {count} coordinates; give two "
            f"or three of them as NAME={RANGE}, the others as NAME=VALUE"
        )


def check_drawable(grid: "wj.Grid") -> None:
    """Refuse a grid that is too coarse for a picture."""
    if min(grid.shape) < 2:
        axes = " and ".join(f"--{name}" for name in grid.names)
        raise WrongUse(f"{axes} must have 2 cells or more each for a picture, not {grid.shape}")


def grid_of(walker: "wj.System", axes: dict[str, Any]) -> "wj.Grid":
    """Return the grid of a window; axes that are None are filled around the walker's gait."""
    return lib.grid_along(lib.fill_around_gait(walker, axes))


def asked_of(grid: "wj.Grid | None") -> dict[str, Any]:
    """Return the part of a request about a grid: its axes, and the point a slice goes through."""
    if grid is None:
        return {}
    origin = lib.numpy.asarray(grid.origin)
    return grid.box | ({} if grid.fixed or not origin.any() else {"origin": origin.tolist()})

"""Options for coordinates of the section: the axes of a window or a region, and a start.

Each is a dictionary by names, to which coordinates of walkers in the plane come by own options.
"""

from collections.abc import Iterable
from typing import Any

import walker_jax as wj
from walker_jax.cli import library as lib
from walker_jax.cli.options import RANGE, Axis, named, option
from walker_jax.refusals import WrongUse

WINDOW_CELLS = 200
"""Cells along each axis of a default window."""
PHIDOT = "Rate between the legs, on sections that have it"


def start_option(theme: str = "Start", **more: Any) -> Any:
    """Declare the options for the coordinates of a start, and more of them."""
    own = {
        "theta": (float, option(None, "Stance angle, rad; short for --start theta=X.")),
        "thetadot": (float, option(None, "Its rate, rad per unit of time.")),
        "phidot": (float, option(None, f"{PHIDOT}.")),
        **more,
    }
    text = "A coordinate of the start, by name; give each."
    return named(text, "VALUE", theme=theme, own=own)


def axes_option(theme: str) -> Any:
    """Declare the options for the axes of a window, or a region."""
    own = {
        "theta": (Axis, option(None, "Stance angle, rad; short for --axis theta=LO:HI:N.")),
        "sum": (Axis, option(None, "theta + thetadot.")),
        "thetadot": (Axis, option(None, "The plain section: thetadot in the place of --sum.")),
        "phidot": (Axis, option(None, f"{PHIDOT}.")),
        "at_phidot": (
            float,
            option(None, "A slice of such a section, at this rate.", keys=["phidot"]),
        ),
    }
    return axis_option(theme=theme, own=own, sets=dict.fromkeys(("grid", "axis"), "--axis"))


def axis_option(**settings: Any) -> Any:
    """Declare the option for axes by name."""
    text = "An axis by name, or NAME=VALUE for a slice; give each coordinate of the section."
    return named(text, RANGE, "VALUE", flags=["--axis"], metavar=f"NAME={RANGE}", **settings)


def check_names(names: Iterable[str], given: dict[str, Any]) -> None:
    """Refuse coordinates of other names than these."""
    for name in given:
        if name not in names:
            known = f"the coordinates are {', '.join(names)}"
            raise WrongUse(f"{name} must be left out: {known}", of=name)


def start_on(walker: "wj.System", given: dict[str, float], **usual: float) -> dict[str, float]:
    """Return the coordinates of a start, in the order of the section: none, or all."""
    given = usual | given
    check_names(walker.section, given)
    if given and (missing := [name for name in walker.section if name not in given]):
        raise WrongUse(f"--start NAME=VALUE is required too for {', '.join(missing)}")
    return {name: given[name] for name in walker.section if given}


def begin_at(walker: "wj.System", start: dict[str, float]) -> list[float]:
    """Return a start, or the first state of the gait if none is given."""
    if start:
        return [*start.values()]
    (gait,) = lib.selection.select_gaits(walker, instead="give --start NAME=VALUE")
    return gait.states[0].tolist()


def has_plane(walker: "wj.System") -> bool:
    """Return whether a section has the plane of theta and thetadot, where windows are sheared."""
    return walker.section[:2] == ("theta", "thetadot")


def axes_on(walker: "wj.System", given: dict[str, Any]) -> dict[str, Any]:
    """Return the axes in the order of the section; None where none is given.

    Instead of thetadot, a walker in the plane has the axis `sum` unless thetadot is given.
    """
    names = [*walker.section]
    if has_plane(walker) and "thetadot" not in given:
        names[1] = "sum"
    check_names(names, given)
    return {name: given.get(name) for name in names}


def check_whole(axes: dict[str, Any]) -> None:
    """Refuse axes of which some are missing."""
    for name, axis in axes.items():
        if axis is None:
            either = f"--axis {name}={RANGE} is required too, or {name}=VALUE for a slice"
            raise WrongUse(either)


def window_on(walker: "wj.System", given: dict[str, Any], most: int = 2) -> dict[str, Any]:
    """Return the axes of a window, of which two, or up to `most`, are ranges.

    An axis of a walker in the plane may be None. The default for any other system is its
    `gait_region`.
    """
    axes = axes_on(walker, given)
    if has_plane(walker):
        axes = lib.fill_from_paper(walker, axes)
    elif given:
        check_whole(axes)
    else:
        axes = axes_of_region(walker)
    slices = [axis for name, axis in axes.items() if axis is None and name == "phidot"]
    count = len(axes) - len(slices) - sum(isinstance(axis, float) for axis in axes.values())
    if not 2 <= count <= most:
        numbers = "two" if most == 2 else "two or three"
        raise WrongUse(f"--axis must be NAME={RANGE} for {numbers} coordinates, not {count}")
    check_drawable(lib.outline(axes))
    return axes


def region_on(walker: "wj.System", given: dict[str, Any]) -> "wj.Grid | None":
    """Return the grid of a region; None if no axes are given."""
    if not given:
        return None
    axes = axes_on(walker, given)
    check_whole(axes)
    grid = lib.grid_along(axes)
    check_drawable(grid)
    return grid


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
    for name, count in zip(grid.names, grid.shape, strict=True):
        if count < 2:
            raise WrongUse(f"{name} must have 2 cells or more for a picture, not {count}", of=name)


def grid_of(walker: "wj.System", axes: dict[str, Any]) -> "wj.Grid":
    """Return the grid of a window; axes that are None are filled around the walker's gait."""
    return lib.grid_along(lib.fill_around_gait(walker, axes))


def asked_of(grid: "wj.Grid | None") -> dict[str, Any]:
    """Return the part of a request about a grid: its axes, and the point a slice goes through."""
    if grid is None:
        return {}
    origin = lib.numpy.asarray(grid.origin)
    return grid.box | ({} if grid.fixed or not origin.any() else {"origin": origin.tolist()})

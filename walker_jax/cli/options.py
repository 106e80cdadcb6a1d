"""Options that several commands have, and what is read from them."""

import math
from collections.abc import Callable, Container
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from jaxtyping import Float

from walker_jax.basins.windows import fill_from_paper, grid_along, window_of_region
from walker_jax.checks import WrongUse, is_number
from walker_jax.grids import Grid
from walker_jax.systems.system import System
from walker_jax.walkers.model import Walker
from walker_jax.walkers.parameters import check_parameter

Json = Annotated[bool, typer.Option("--json", help="Print the answer as JSON.")]
Out = Annotated[Path, typer.Option(help="Where the data set goes (Zarr).")]
PictureOfData = Annotated[
    Path | None,
    typer.Option(
        "--figure", help="Where the picture goes (default: the name of the data set with .png)."
    ),
]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace what is there.")]
Workers = Annotated[
    int | None,
    typer.Option(min=1, help="Compute pieces in so many processes (Dask), which share the cores."),
]
Scheduler = Annotated[
    str | None,
    typer.Option(metavar="ADDRESS", help="Compute pieces on the workers of a Dask scheduler."),
]
Seed = Annotated[int, typer.Option(min=0, help="Seed of random numbers.")]
AxisOption = tuple[float, float, int]
"""The ends of an axis, and its number of cells."""
WindowTheta = Annotated[
    AxisOption | None,
    typer.Option(metavar="LO HI N", help="Stance angle, rad (default: 0 0.4 200)."),
]
WindowSum = Annotated[
    AxisOption | None,
    typer.Option("--sum", metavar="LO HI N", help="theta + thetadot (default: -0.04 0.01 250)."),
]
"""The window of a picture, by default that of the paper."""
RegionTheta = Annotated[
    AxisOption | None, typer.Option(metavar="LO HI N", help="Stance angle, rad (default: all).")
]
RegionSum = Annotated[
    AxisOption | None, typer.Option("--sum", metavar="LO HI N", help="theta + thetadot.")
]
"""The region in which areas are measured, by default all of the section."""
Axes = Annotated[
    list[str] | None,
    typer.Option(
        "--axis",
        metavar="NAME=LO:HI:N",
        help="An axis along a coordinate of the section, or NAME=VALUE for a slice there: one for "
        "each, in the place of the other axes.",
    ),
]
AXIS_FORM = "NAME=LO:HI:N or NAME=VALUE"
StartAt = Annotated[
    list[str] | None,
    typer.Option(
        "--start", metavar="NAME=VALUE", help="A coordinate of the start, by name: one for each."
    ),
]
PHIDOT_HELP = "Rate between the legs, for walkers whose section has it"
SlicePlace = Annotated[float | None, typer.Option(help=f"{PHIDOT_HELP}: where the slice is.")]


def check_finite(**values: float) -> None:
    """Refuse NaN and infinity for options of these names."""
    for name, value in values.items():
        if not math.isfinite(value):
            raise WrongUse(f"--{name} must be finite, not {value}")


def check_drawable(grid: Grid) -> None:
    """Refuse a grid that is too coarse for a picture."""
    if min(grid.shape) < 2:
        axes = " and ".join(f"--{name}" for name in grid.names)
        raise WrongUse(f"{axes} must have 2 cells or more each for a picture, not {grid.shape}")


def state_from(walker: System, given: dict[str, float]) -> Float[np.ndarray, " section"]:
    """A state on the section from the options that name its coordinates."""
    section = ", ".join(walker.section)
    for name in given:
        if name not in walker.section and not isinstance(walker, Walker):
            raise WrongUse(
                f"--{name} is for walkers: give --start NAME=VALUE, for each of {section}"
            )
    for name in walker.section:
        if name not in given:
            raise WrongUse(f"--{name} is required too: the section is {section}")
    for name in given:
        if name not in walker.section:
            raise WrongUse(f"--{name} must be left out: it is not on the section, {section}")
    return np.array([given[name] for name in walker.section])


def check_coordinate(option: str, walker: System, name: str, earlier: Container[str]) -> None:
    """Refuse a name that the section lacks, or that an option was given for before."""
    if name in earlier:
        raise WrongUse(f"{option} is given twice for {name}")
    if name not in walker.section:
        section = ", ".join(walker.section)
        raise WrongUse(f"{option} must be of the section, {section}, not of {name}")


def start_from(walker: System, texts: list[str] | None, given: dict[str, float]) -> dict:
    """The coordinates that --start names, or those that have options of their own."""
    named: dict[str, float] = {}
    for text in texts or []:
        name, (value,) = read_numbers("--start", "NAME=VALUE", (float,), text)
        check_coordinate("--start", walker, name, named)
        check_finite(start=value)
        named[name] = value
    if named and given:
        raise WrongUse(f"--start and --{next(iter(given))} exclude each other: give one of them")
    for name in walker.section if named else ():
        if name not in named:
            raise WrongUse(f"--start {name}=VALUE is required too")
    return named or given


def axes_from(walker: System, texts: list[str], **others: Any) -> dict[str, Any]:
    """The axes that --axis names, in the order of the section. `others` exclude them."""
    axes: dict[str, Any] = {}
    for name, value in others.items():
        if value is not None:
            name = f"at-{name}" if is_number(value) and name == "phidot" else name
            raise WrongUse(f"--axis and --{name} exclude each other: give one of them")
    for text in texts:
        if ":" in text:
            kinds = (float, float, int)
            name, (low, high, count) = read_numbers("--axis", AXIS_FORM, kinds, text)
            axis: Any = (low, high, count)
        else:
            name, (axis,) = read_numbers("--axis", AXIS_FORM, (float,), text)
            check_finite(axis=axis)
        check_coordinate("--axis", walker, name, axes)
        axes[name] = axis
    for name in walker.section:
        if name not in axes:
            raise WrongUse(f"--axis {name}=LO:HI:N is required too, or {name}=VALUE for a slice")
    return {name: axes[name] for name in walker.section}


WINDOW_CELLS = 200
"""Along each axis of a window that no option gives."""


def window_from(walker: System, axis: list[str] | None, axes: dict[str, Any]) -> dict[str, Any]:
    """The axes of a window: those of --axis, or `axes`, of which those of a walker may be None.

    The default of any other system is the region in which its gaits are searched for.
    """
    if axis:
        return axes_from(walker, axis, **axes)
    if isinstance(walker, Walker):
        return fill_from_paper(walker, axes)
    refuse_axes_of_walkers(walker, **axes)
    window = window_of_region(walker, WINDOW_CELLS)
    if window is None:
        names = ", ".join(walker.section)
        raise WrongUse(f"--axis NAME=LO:HI:N is required, for each of {names}")
    return window


def refuse_axes_of_walkers(walker: System, **axes: Any) -> None:
    """Refuse axes of a walker's section for any other system."""
    for name, given in axes.items():
        if given is not None and not isinstance(walker, Walker):
            raise WrongUse(f"--{name} is for walkers: give --axis for each of a system's axes")


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


def refuse_for_systems(walker: System, **options: Any) -> None:
    """Refuse options, those that are not None, that only walkers have."""
    for name, given in options.items():
        if given is not None and not isinstance(walker, Walker):
            raise WrongUse(f"--{name} is for walkers, not for {walker.label()}: leave it out")


def check_ranges(axes: dict[str, Any], most: int) -> None:
    """Refuse axes of which too few, or too many, are ranges for a picture."""
    count = sum(not is_number(axis) for axis in axes.values())
    if not 2 <= count <= most:
        numbers = "two" if most == 2 else "two or three"
        raise WrongUse(f"--axis must be NAME=LO:HI:N for {numbers} coordinates, not {count}")


def check_phidot(walker: System, at_phidot: float | None, phidot: AxisOption | None = None) -> None:
    """Refuse phidot for a walker whose section lacks it, and two ways to give it."""
    given = "--at-phidot" if phidot is None else "--phidot"
    refuse_axes_of_walkers(walker, **{"at-phidot": at_phidot, "phidot": phidot})
    if "phidot" not in walker.section and (phidot is not None or at_phidot is not None):
        section = ", ".join(walker.section)
        raise WrongUse(f"{given} must be left out: it is not on the section, {section}")
    if phidot is not None and at_phidot is not None:
        raise WrongUse("--phidot and --at-phidot exclude each other: give one of them")


def grid_from(
    walker: System,
    theta: AxisOption | None,
    sum_: AxisOption | None,
    at_phidot: float | None,
    phidot: AxisOption | None = None,
    axis: list[str] | None = None,
) -> Grid | None:
    """The grid of these axes, with phidot at one value or over a range; None for no axes."""
    if axis:
        others = {"theta": theta, "sum": sum_, "at-phidot": at_phidot, "phidot": phidot}
        grid = grid_along(axes_from(walker, axis, **others))
        check_drawable(grid)
        return grid
    refuse_axes_of_walkers(walker, theta=theta, sum=sum_)
    check_phidot(walker, at_phidot, phidot)
    last = {"--at-phidot": at_phidot} if phidot is None else {"--phidot": phidot}
    options = {"--theta": theta, "--sum": sum_} | (last if "phidot" in walker.section else {})
    if all(axis is None for axis in options.values()):
        return None
    if len(walker.section) > 3:
        given = next(name for name, axis in options.items() if axis is not None)
        raise WrongUse(
            f"{given} is for walkers in the plane: give --axis for each coordinate of the section"
        )
    if None in options.values():
        raise WrongUse(f"give {' and '.join(options)}, or none of them")
    names = ("theta", "sum", "phidot")
    grid = Grid.sheared(**dict(zip(names, options.values(), strict=False)))
    check_drawable(grid)
    return grid


def asked_of(grid: Grid | None) -> dict[str, Any]:
    """The part of a request about a grid: its axes, and the point through which a slice goes."""
    if grid is None:
        return {}
    origin = np.asarray(grid.origin)
    return grid.box | ({} if grid.fixed or not origin.any() else {"origin": origin.tolist()})


def cluster_from(workers: int | None, scheduler: str | None) -> int | str | None:
    """What computes pieces: worker processes, those of a scheduler, or, by None, this process."""
    if workers is not None and scheduler is not None:
        raise WrongUse("--workers and --scheduler exclude each other: give one of them")
    return scheduler if workers is None else workers


def check_range(walker: System, name: str, low: float, high: float) -> None:
    """Refuse values that the parameter cannot have, and those that --from and --to do not order."""
    check_parameter(walker, name, low, high)
    if not low < high:
        raise WrongUse(f"--from {low:g} must be below --to {high:g}")


def read_numbers(
    option: str, form: str, kinds: tuple[Callable, ...], text: str
) -> tuple[str, list[Any]]:
    """The name of a parameter and the numbers in a text like NAME=LO:HI, numbers of these kinds.

    The name may have hyphens or underscores.
    """
    name, _, numbers = text.partition("=")
    try:
        pairs = zip(kinds, numbers.split(":"), strict=True)
        return name.replace("-", "_"), [kind(number) for kind, number in pairs]
    except ValueError:
        raise WrongUse(f"{option} must be {form}, not {text}") from None


def hyphenated(name: str) -> str:
    """A name of the library as users type it."""
    return name.replace("_", "-")

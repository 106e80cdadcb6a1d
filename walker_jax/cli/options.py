"""Options that several commands have."""

import functools
import inspect
import math
import re
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from jax.typing import ArrayLike

import walker_jax as wj
from walker_jax.checks import ComputationFailed, WrongUse
from walker_jax.cli.answers import said
from walker_jax.grids import Grid
from walker_jax.walkers.family import WALKERS
from walker_jax.walkers.model import Walker
from walker_jax.walkers.parameters import Parameter, parameters

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
Axis = tuple[float, float, int]
PLACES = ("out", "figure", "animate", "overwrite")
"""Arguments of the library about places, which are options of the same names here."""
WINDOW = {"theta": (0.0, 0.4, 200), "sum": (-0.04, 0.01, 250)}
"""That of Schwab and Wisse (2001), Figure 4."""
PHIDOT_HELP = "Rate between the legs, for walkers whose section has it"


def list_walkers(wanted: bool) -> bool:
    """Print the walkers there are, and end, if that is wanted."""
    if not wanted:
        return wanted
    for name, kind in WALKERS.items():
        print(f"{name}: {(kind.__doc__ or '').splitlines()[0]}")
        print(f"  section ({', '.join(kind.section)})")
        for one in parameters(kind):
            flag = option_of(one.name)
            what = f"{one.meaning}, {one.bounds()}"
            print(f"  {flag:18} {one.unit:17} {one.default:<8g} {what}")
    raise typer.Exit


ListWalkers = Annotated[
    bool,
    typer.Option(
        "--list-walkers",
        is_eager=True,
        callback=list_walkers,
        help="The walkers, their parameters, units and defaults.",
    ),
]


def option_of(parameter: str) -> str:
    return f"--{parameter.replace('_', '-')}"


def with_options_named(message: str, names: Iterable[str]) -> str:
    """A message of the library, parameters in it as the options that set them."""
    pattern = rf"\b({'|'.join(sorted(names, key=len, reverse=True))})\b"
    return re.sub(pattern, lambda found: option_of(found[0]), message)


def takes_walker(command: Callable[..., None], *, without: tuple[str, ...] = ()) -> Callable:
    """A command whose first argument is a walker, as one with options for the walker.

    `without` are parameters that the command sets itself, from options of its own.
    """
    offered: dict[str, Parameter] = {}
    owners: dict[str, list[str]] = {}
    for name, kind in WALKERS.items():
        for one in parameters(kind):
            offered.setdefault(one.name, one)
            owners.setdefault(one.name, []).append(name)
    for name in without:
        del offered[name]

    def help_of(one: Parameter) -> str:
        whose = "" if len(owners[one.name]) == len(WALKERS) else f" {', '.join(owners[one.name])}:"
        return f"{whose} {one.meaning}; {one.unit} (default: {one.default:g})".strip()

    def option(name: str, annotation: object, default: object) -> inspect.Parameter:
        keyword = inspect.Parameter.KEYWORD_ONLY
        return inspect.Parameter(name, keyword, default=default, annotation=annotation)

    panel = "Walker"
    names = " | ".join(WALKERS)
    walker = typer.Option(help=f"Its model: {names}.", rich_help_panel=panel, metavar="NAME")
    options = [option("walker", Annotated[str, walker], "simplest")]
    for one in offered.values():
        number = typer.Option(help=help_of(one), rich_help_panel=panel, show_default=False)
        options.append(option(one.name, Annotated[float | None, number], None))
    options.append(option("list_walkers", ListWalkers, False))

    @functools.wraps(command)
    def with_options(**given):
        name = given.pop("walker")
        given.pop("list_walkers")
        values = {one: given.pop(one) for one in offered}
        values = {one: value for one, value in values.items() if value is not None}
        if name not in WALKERS:
            raise WrongUse(f"--walker must be one of {', '.join(WALKERS)}, not {name}")
        known = {one.name: one.default for one in parameters(WALKERS[name])}
        for one in values:
            if one not in known:
                takes = ", ".join(option_of(other) for other in known)
                raise WrongUse(f"{option_of(one)} is no parameter of {name}, which has {takes}")
        try:
            walker = WALKERS[name](**(known | values))
        except WrongUse as error:
            raise WrongUse(with_options_named(str(error), known)) from error
        return command(walker, **given)

    own = list(inspect.signature(command).parameters.values())[1:]
    own = [one.replace(kind=inspect.Parameter.KEYWORD_ONLY) for one in own]
    signature = inspect.Signature([*options, *own])
    vars(with_options)["__signature__"] = signature  # which typer reads
    with_options.__annotations__ = {one.name: one.annotation for one in (*options, *own)}
    return with_options


def window(walker: Walker, x: ArrayLike) -> Grid:
    """The part of the section, or of a slice through it, around the gait; around x if none is."""
    from walker_jax.grids import axes_around

    if isinstance(walker, wj.SimplestWalker):
        return Grid.sheared(**WINDOW)
    gait = wj.find_gait(walker)
    state = gait.states[0] if gait.found else x
    return Grid.sheared(**axes_around(state, ("theta", "sum", *walker.section[2:])))


def start_of(walker: Walker, given: dict[str, float]) -> np.ndarray:
    """A point of the section from the options that name its coordinates."""
    for name in walker.section:
        if name not in given:
            raise WrongUse(f"--{name} is required too: the section is {', '.join(walker.section)}")
    for name in given:
        if name not in walker.section:
            raise WrongUse(f"--{name} is not on the section, {', '.join(walker.section)}")
    return np.array([given[name] for name in walker.section])


def gait_of(walker: Walker, instead: Iterable[str]):
    """The most stable gait of period one that is found; options `instead` make it needless."""
    gait = wj.find_gait(walker)
    if not gait.found:
        options = ", ".join(option_of(name) for name in instead)
        raise ComputationFailed(
            f"no gait of period 1 found for {said(walker)}: give {options}, or another --slope"
        )
    return gait


def cluster_of(workers: int | None, scheduler: str | None) -> int | str | None:
    """Who computes pieces: worker processes, those of a scheduler, or this process, none."""
    if workers is not None and scheduler is not None:
        raise WrongUse("--workers and --scheduler exclude each other: give one of them")
    return scheduler if workers is None else workers


def region_of(
    walker: Walker, theta: Axis | None, sum_: Axis | None, at_phidot: float | None
) -> Grid | None:
    """The grid of these axes, if they are given, all or none."""
    sliced = "phidot" in walker.section
    if at_phidot is not None and not sliced:
        raise WrongUse(f"--at-phidot is for walkers whose section has it, not {walker.section}")
    axes: dict[str, Axis | float | None] = {"theta": theta, "sum": sum_}
    axes |= {"phidot": at_phidot} if sliced else {}
    given = {name: axis for name, axis in axes.items() if axis is not None}
    if given and len(given) < len(axes):
        raise WrongUse(
            f"give {' and '.join(f'--{name}' for name in axes)}, or none of them".replace(
                "--phidot", "--at-phidot"
            )
        )
    grid = Grid.sheared(**given) if given else None
    if grid is not None and min(grid.shape) < 2:
        raise WrongUse(f"a picture needs 2 cells or more along each axis, not {grid.shape}")
    return grid


def filled(axes: dict, values: dict, default: Axis | None = None) -> dict:
    """The axes, those that are not given with values of their own or the default one."""
    return {
        name: values.get(name, default) if axis is None else axis for name, axis in axes.items()
    }


def finite(**values: float) -> None:
    for name, value in values.items():
        if not math.isfinite(value):
            raise WrongUse(f"{name} must be finite, not {value}")

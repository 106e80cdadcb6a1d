"""The command `walker-jax`. Each command asks the library, prints a summary, and keeps the result.

Answers go to standard output; progress, warnings and the one line that says what is wrong go to
standard error. Exit code 0: done; 2: wrong usage; 1: the computation failed; 130: interrupted by
Ctrl-C; 143: terminated by SIGTERM.
"""

import functools
import gc
import inspect
import json
import math
import os
import re
import signal
import sys
import time
from collections.abc import Callable, Iterable
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NoReturn

import jax
import numpy as np
import typer
from jax.typing import ArrayLike
from typer.core import TyperGroup

import walker_jax as wj
from walker_jax import store
from walker_jax.cells import Grid
from walker_jax.checks import ComputationFailed, WrongUse
from walker_jax.kernels.object_cache import cache_folder
from walker_jax.walkers import WALKERS, Parameter, SimplestWalker, Walker, parameters

if TYPE_CHECKING:
    import xarray


class Commands(TyperGroup):
    """The commands; what interrupts them carries notes on what they leave."""

    def invoke(self, ctx):
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt as interruption:  # of which typer would keep no more than a code
            raise Interrupted(*notes_of(interruption)) from interruption


app = typer.Typer(
    cls=Commands,
    add_completion=False,
    no_args_is_help=True,
    help="Passive dynamic walkers: their gaits, and the basins of attraction of these.",
)

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
PICTURES = (".png", ".svg", ".pdf")  # those that carry a title, by which a picture is known again


WINDOW = {"theta": (0.0, 0.4, 200), "sum": (-0.04, 0.01, 250)}
"""That of Schwab and Wisse (2001), Figure 4."""
FRAME = 0.15
"""Time between two frames of a film: 1/20 s for legs of one metre."""
PHIDOT_HELP = "Rate between the legs, for walkers whose section has it"


class Interrupted(BaseException):
    """The command was interrupted, and what there is to say of what it leaves."""


class Terminated(BaseException):
    """The command is to end at once, what it has begun to write removed."""


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


def description(walker: Walker) -> dict:
    """A walker by name and parameters, for a request or an answer."""
    values = {one.name: float(getattr(walker, one.name)) for one in parameters(walker)}
    return {"name": type(walker).__name__, **values}


def said(walker: Walker) -> str:
    """A walker in words."""
    name, *values = description(walker).items()
    return ", ".join([name[1], *(f"{key} {value:g}" for key, value in values)])


@app.callback()
def common(list_walkers: ListWalkers = False) -> None:
    """Passive dynamic walkers: their gaits, and the basins of attraction of these."""


@app.command()
@takes_walker
def walk(
    walker: Walker,
    theta: Annotated[
        float | None, typer.Option(help="Stance angle at the start, rad (default: see above).")
    ] = None,
    thetadot: Annotated[float | None, typer.Option(help="Its rate, rad per unit of time.")] = None,
    phidot: Annotated[float | None, typer.Option(help=f"{PHIDOT_HELP}.")] = None,
    strides: Annotated[int, typer.Option(min=1, max=1_000_000, help="Strides at most.")] = 9,
    animate: Annotated[
        Path | None,
        typer.Option(help="Where a film goes, .gif, or .mp4 where the program ffmpeg is there."),
    ] = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Walk from one start, stride by stride, until a failure.

    The simplest walker starts at theta 0.2, thetadot -0.21645 by default, any other in its gait. A
    film shows it walk, about as fast as one with legs of one metre, and its way over the basin.
    """
    given = {"theta": theta, "thetadot": thetadot, "phidot": phidot}
    given = {name: value for name, value in given.items() if value is not None}
    finite(**given)
    if isinstance(walker, wj.SimplestWalker):
        given = {"theta": 0.2, "thetadot": -0.21645} | given
    request = {
        "command": "walk",
        "walker": description(walker),
        "start": given,
        "strides": strides,
        "version": version("walker-jax"),
    }
    if animate is not None:
        from walker_jax import poses

        poses.check_film(animate)
        store.check_picture(animate, request, overwrite=overwrite, argument="animate")
    start = start_of(walker, given) if given else gait_of(walker, walker.section).states[0]
    made = wj.walk(walker, start, strides)
    outcomes = np.asarray(made.outcomes)
    completed = int((outcomes == wj.Outcome.STRIDE).sum())
    count = min(completed + 1, strides)
    names = [wj.Outcome(code).name for code in outcomes[:count].tolist()]
    states, times = np.asarray(made.states)[: completed + 1], np.asarray(made.times)[:count]
    if animate is not None and names[0] == "OUTSIDE":
        options = " and ".join(f"--{name}" for name in walker.section)
        raise WrongUse(f"{options} must be a feasible start for a film, not {states[0].tolist()}")
    if animate is not None:
        shown = wj.motion(walker, start, strides, step=FRAME)
        data = wj.basin(walker, window(walker, start), "direct", progress=True)
        signature = store.signature(request)
        poses.film(shown, animate, data, signature=signature, progress=True)
    if as_json:
        print_json({"states": states, "outcomes": names, "times": times})
        return
    row = lambda values: "  ".join(f"{value:10.6f}" for value in values)
    heads = "  ".join(f"{name:>10}" for name in walker.section)
    print(f"{'stride':>6}  {heads}  {'time':>8}  outcome")
    for i, (state, name, duration) in enumerate(zip(states, names, times, strict=False), start=1):
        print(f"{i:6}  {row(state)}  {duration:8.4f}  {name}")
    if len(states) > len(names):
        print(f"{'next':>6}  {row(states[-1])}")
    if animate is not None:
        print(f"film {animate}")


def window(walker: Walker, x: ArrayLike) -> Grid:
    """The part of the section, or of a slice through it, around the gait; around x if none is."""
    from walker_jax.basin import around

    if isinstance(walker, wj.SimplestWalker):
        return Grid.sheared(**WINDOW)
    gait = wj.find_gait(walker)
    state = gait.states[0] if gait.found else x
    return Grid.sheared(**around(state, ("theta", "sum", *walker.section[2:])))


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


@app.command()
@takes_walker
def gait(
    walker: Walker,
    period: Annotated[int, typer.Option(min=1, help="Strides in a cycle.")] = 1,
    all_: Annotated[
        bool, typer.Option("--all", help="All gaits of the period, stable or not.")
    ] = False,
    guess: Annotated[
        tuple[float, float] | None,
        typer.Option(metavar="THETA THETADOT", help="Where the search begins."),
    ] = None,
    phidot: Annotated[float | None, typer.Option(help=f"{PHIDOT_HELP}: with --guess.")] = None,
    figure: Annotated[
        Path | None, typer.Option(help="Where a picture of the multipliers goes.")
    ] = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Find the gaits of a walker: cycles of strides, and their stability."""
    if phidot is not None and guess is None:
        raise WrongUse("--phidot is for --guess alone")
    start = None
    if guess is not None:
        given = {"theta": guess[0], "thetadot": guess[1]}
        given |= {} if phidot is None else {"phidot": phidot}
        finite(**given)
        start = start_of(walker, given)
    if guess is not None and all_:
        raise WrongUse("--guess and --all exclude each other: give one of them")
    request = {
        "command": "gait",
        "walker": description(walker),
        "period": period,
        "guess": None if start is None else start.tolist(),
        "all": all_,
        "version": version("walker-jax"),
    }
    if figure is not None:
        check_suffix(figure)
        store.check_picture(figure, request, overwrite=overwrite)

    slope = request["walker"]["slope"]
    found, first = [], None
    if all_ or (period > 1 and guess is None):
        found = wj.find_gaits(walker, period)
        found.sort(key=lambda gait: np.abs(gait.multipliers[0]))
        found = found if all_ else found[:1]
    # the long gait of period one is not the most stable one on every slope
    if period == 1 or guess is not None:
        first = wj.find_gait(walker, start, period)
        same = lambda gait: np.allclose(gait.states, first.states, rtol=0, atol=1e-8)
        found = [first] * bool(first.found) + [gait for gait in found if not same(gait)]
    if not found:
        raise ComputationFailed(no_gait(walker, period, None if all_ else first, guess is not None))
    if figure is not None:
        from walker_jax import figures

        draw(figures.multipliers(found), figure, request)
    if as_json:
        gaits = [
            {
                "period": period,
                "states": one.states,
                "multipliers": [[value.real, value.imag] for value in one.multipliers.tolist()],
                "step_times": one.step_times,
                "stable": bool(one.stable),
                "residual": float(one.residual),
            }
            for one in found
        ]
        print_json({"slope": slope, "gaits": gaits, "walker": request["walker"]})
        return
    for one in found:
        kind = "stable" if one.stable else "unstable"
        values = ", ".join(f"{value:.8g}" for value in one.multipliers)
        print(f"{kind} gait of period {period} at slope {slope:g} rad, multipliers {values}")
        for state, duration in zip(one.states, one.step_times, strict=True):
            named = zip(walker.section, state, strict=True)
            shown = "  ".join(f"{name} {value:.13f}" for name, value in named)
            print(f"  {shown}  step time {duration:.10f}")
    if figure is not None:
        print(f"picture {figure}")


@app.command()
@functools.partial(takes_walker, without=("slope",))
def bifurcation(
    walker: Walker,
    low: Annotated[float, typer.Option("--from", help="Lowest slope, rad.")] = 0.001,
    high: Annotated[float, typer.Option("--to", help="Highest slope, rad.")] = 0.022,
    period_max: Annotated[
        int, typer.Option(min=1, max=64, help="Longest period of the gaits that are followed.")
    ] = 8,
    strides: Annotated[
        int, typer.Option(min=1, help="Strides after which a walker walks for ever.")
    ] = 3000,
    out: Out = Path("bifurcation.zarr"),
    figure: PictureOfData = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Follow the gaits over the slope: how each is born, doubles and ends."""
    from walker_jax import figures
    from walker_jax.gaits import check_parameter, with_parameter

    check_parameter(walker, "slope", low, high)
    walker = with_parameter(walker, "slope", low)
    if not low < high:
        raise WrongUse(f"--from {low:g} must be below --to {high:g}")
    request = {
        "command": "bifurcation",
        "walker": {key: value for key, value in description(walker).items() if key != "slope"},
        "slope": [low, high],
        "period_max": period_max,
        "strides": strides,
        "version": version("walker-jax"),
    }
    figure, data = made_before(out, figure, request, overwrite=overwrite)
    if data is None:
        data = wj.bifurcation_diagram(
            walker, "slope", (low, high), period_max=period_max, strides=strides, progress=True
        )
        data = store.save(data, out, request)
    draw(figures.bifurcations(data), figure, request)

    def events(fold: bool, cascade: bool | None = None) -> list[dict]:
        chosen = data["event_fold"].values == fold
        if cascade is not None:
            chosen &= data["cascade"].values == cascade
        order = np.flatnonzero(chosen)
        order = order[
            np.lexsort([data[f"event_{key}"].values[order] for key in ("value", "period")])
        ]
        listed = []
        for i in order:
            period = int(data["event_period"][i])
            kind = {"period": period} if fold else {"from": period, "to": 2 * period}
            slope, state = float(data["event_value"][i]), data["event_states"].values[i, 0]
            listed.append({**kind, "slope": slope, "state": state})
        return listed

    below, above = map(float, data["lost"].values)
    windows = []
    for number in np.unique(data["event_branch"].values[data["event_fold"].values]):
        own = data["event_branch"].values == number
        slopes = np.sort(data["event_value"].values[own])
        if len(slopes) > 1 and slopes[0] > above:
            period = int(data["event_period"].values[own][0])
            windows.append({"period": period, "from": float(slopes[0]), "to": float(slopes[1])})
    answer = {
        "doublings": events(fold=False, cascade=True),
        "other_doublings": events(fold=False, cascade=False),
        "folds": events(fold=True),
        "lost": {"below": below, "above": above},
        "stable_beyond": windows,
    }
    if as_json:
        print_json(answer)
        return
    others = [f"{name} {value}" for name, value in request["walker"].items() if name != "name"]
    name = ", ".join([request["walker"]["name"], *others])
    print(f"Gaits of {name}, from slope {low:g} to {high:g} rad")
    for title, key in (
        ("doublings of the long gait", "doublings"),
        ("doublings of other gaits", "other_doublings"),
        ("folds", "folds"),
    ):
        print(f"  {title}:{'' if answer[key] else ' none'}")
        for event in answer[key]:
            periods = f"{event['from']} to {event['to']}" if "to" in event else event["period"]
            state = ", ".join(f"{value:.6f}" for value in event["state"])
            print(f"    period {periods} at {event['slope']:.12f}, ({state})")
    if math.isnan(below):
        print("  no walker that starts close to a gait walks on, on any slope")
    elif math.isnan(above):
        print("  walkers that start close to a gait walk on up to the highest slope")
    else:
        print(f"  walking is lost between {below:.8f}, where a walker makes {strides} strides,")
        print(f"  and {above:.8f}, where none does")
    for window in windows:
        where = f"from {window['from']:.9f} to {window['to']:.9f}"
        print(f"  a gait of period {window['period']} is stable beyond that, {where}")
    print(f"  data set {out}, picture {figure}")


def no_gait(walker: Walker, period: int, gait: Any, guessed: bool) -> str:
    """That no gait was found, why, given how a search ended, if there was one, and what to try."""
    one = guessed or (isinstance(walker, SimplestWalker) and period == 1)
    if gait is None or not (np.isfinite(gait.residual) or one):
        why = "none of the searches all over the section led to one"
    elif not np.isfinite(gait.residual):
        where = "--guess" if guessed else "the state where the search begins"
        why = f"the walker makes no stride from {where}"
    elif gait.residual > 1e-6:
        why = f"the search ended where a stride misses the next state by {gait.residual:.2g}"
    elif period > 1:
        why = "the search ended in a gait of a shorter period, or too close to a bifurcation"
    else:
        why = "the search ended too close to a bifurcation"
    other = "another --guess" if guessed else "--guess THETA THETADOT"
    return (
        f"no gait of period {period} found for {said(walker)}: {why}; "
        f"try {other}, or another --slope"
    )


def picture_of(out: Path, figure: Path | None) -> Path:
    """Where the picture of a data set goes, both places checked."""
    if not out.name:
        raise WrongUse(f"--out {out} is not the name of a data set")
    figure = figure or out.with_suffix(".png")
    check_suffix(figure)
    if out.absolute() in (figure.absolute(), *figure.absolute().parents):
        raise WrongUse(f"--figure {figure} must be another place than --out {out}")
    return figure


def made_before(
    out: Path, figure: Path | None, request: dict, *, overwrite: bool
) -> "tuple[Path, xarray.Dataset | None]":
    """Where the picture goes, and what the same command has left at `out`, if it has ended.

    Something else at either place is refused.
    """
    figure = picture_of(out, figure)
    found = store.find(out, request, overwrite=overwrite)  # first: it says what is other
    store.check_picture(figure, request, overwrite=overwrite)
    return figure, found


def check_suffix(figure: Path) -> None:
    if figure.suffix not in PICTURES:
        raise WrongUse(f"--figure {figure} must end in one of {', '.join(PICTURES)}")


def draw(axes, path: Path, request: dict) -> None:
    """Save the picture to which axes belong, signed with the request."""
    picture = axes.get_figure(root=True)
    with store.draft_of(path) as draft:
        picture.savefig(draft, dpi=150, metadata={"Title": store.signature(request)})


@app.command()
@takes_walker
def basin(
    walker: Walker,
    theta: Annotated[
        Axis | None,
        typer.Option(metavar="LO HI N", help="Stance angle, rad (default: 0 0.4 200)."),
    ] = None,
    sum_: Annotated[
        Axis | None,
        typer.Option(
            "--sum", metavar="LO HI N", help="theta + thetadot (default: -0.04 0.01 250)."
        ),
    ] = None,
    thetadot: Annotated[
        Axis | None,
        typer.Option(metavar="LO HI N", help="The plain section: thetadot in the place of --sum."),
    ] = None,
    phidot: Annotated[
        Axis | None,
        typer.Option(metavar="LO HI N", help=f"{PHIDOT_HELP}: a grid of three dimensions."),
    ] = None,
    at_phidot: Annotated[
        float | None,
        typer.Option(help="A slice of such a section, followed directly (default: at the gait)."),
    ] = None,
    method: Annotated[
        Literal["cell-map", "direct"] | None,
        typer.Option(
            help="Cell mapping (default), or direct iteration (of a slice always).",
        ),
    ] = None,
    strides: Annotated[
        int | None, typer.Option(min=1, help="Strides at most, direct only (default: 200).")
    ] = None,
    workers: Workers = None,
    scheduler: Scheduler = None,
    out: Out = Path("basin.zarr"),
    figure: PictureOfData = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Compute and draw the basin of attraction of a walker's gait.

    By default that of the simplest walker in the window of Schwab and Wisse (2001), Figure 4. For
    another walker the window is around its gait. The data set is written piece by piece: after an
    interruption the same command goes on.
    """
    from walker_jax import figures
    from walker_jax.basin import around, artefacts

    has_phidot = "phidot" in walker.section
    if not has_phidot and (phidot is not None or at_phidot is not None):
        flag = "--phidot" if phidot is not None else "--at-phidot"
        raise WrongUse(
            f"{flag} is for walkers whose section has it, not {', '.join(walker.section)}"
        )
    if phidot is not None and at_phidot is not None:
        raise WrongUse("--phidot and --at-phidot exclude each other: give one of them")
    if thetadot is not None and sum_ is not None:
        raise WrongUse("--sum and --thetadot exclude each other: give one of them")
    cluster = cluster_of(workers, scheduler)
    sliced = has_phidot and phidot is None
    method = method or ("direct" if sliced else "cell-map")
    if sliced and method == "cell-map":
        raise WrongUse("--method cell-map is not for a slice, which walkers leave: give --phidot")
    if strides is not None and method != "direct":
        raise WrongUse("--strides is for --method direct alone")
    strides = strides or 200
    if at_phidot is not None:
        finite(**{"at-phidot": at_phidot})
    axes: dict[str, Axis | float | None] = {"theta": theta}
    axes |= {"sum": sum_} if thetadot is None else {"thetadot": thetadot}
    if has_phidot:
        axes["phidot"] = at_phidot if phidot is None else phidot
    if isinstance(walker, wj.SimplestWalker):
        axes = filled(axes, WINDOW)
    grid_of = wj.Grid.plain if thetadot is not None else wj.Grid.sheared
    # Where an axis is still to be found by a gait, another holds its place.
    shape = grid_of(**filled(axes, {"phidot": 0.0}, default=(0.0, 1.0, 2))).shape
    if min(shape) < 2:
        raise WrongUse(f"a picture needs 2 cells or more along each axis, not {shape}")
    request = {
        "command": "basin",
        "walker": description(walker),
        "axes": {
            name: list(axis) if isinstance(axis, tuple) else axis for name, axis in axes.items()
        },
        "method": method,
        **({"strides": strides} if method == "direct" else {}),
        "version": version("walker-jax"),
    }
    figure, data = made_before(out, figure, request, overwrite=overwrite)
    reused, begun = data is not None, out.exists() and not overwrite
    clock = Stopwatch()
    if data is None:
        if None in axes.values():
            needed = [name for name, axis in axes.items() if axis is None]
            axes = filled(axes, around(gait_of(walker, needed).states[0], tuple(axes)))
        options: Any = {"out": out, "request": request, "overwrite": overwrite}
        options |= {"strides": strides, "cluster": cluster, "progress": True}
        data = wj.basin(walker, grid_of(**axes), method, **options)
    seconds = clock.seconds()
    flat = data["fate"].ndim == 2
    draw_basin = figures.basin if flat else figures.basin_slices
    draw(draw_basin(figures.thinned(data)), figure, request)

    counts, lost, made = tally(data)
    fates = dict(zip(wj.Outcome.__members__, counts.tolist(), strict=True))
    mapped = [name for name in ("cycles", "falling") if name in data]
    attractors = [
        {
            "period": int(data["period"][i]) or None,
            "states": data["states"].values[i][: max(1, int(data["period"][i]))],
            "cells": int(data["cells"][i]),
            "area": float(data["area"][i]),
            "artefact": bool(artefact),
            **{name: int(data[name][i]) for name in mapped},
        }
        for i, artefact in enumerate(artefacts(data))
    ]
    if as_json:
        print_json(
            {
                "slope": request["walker"]["slope"],
                "method": method,
                "cells": int(data["fate"].size),
                "area": float(data["area"].sum()),
                "attractors": attractors,
                "fates": fates,
                "seconds": seconds,
                "walker": request["walker"],
            }
        )
        return
    print(f"Basin of attraction, {said(walker)}, {method}")
    if sliced:
        print(f"  slice at phidot {float(data['phidot']):.10g}")
    measure = "area" if flat else "volume"
    for i, one in enumerate(attractors):
        numbers = [", ".join(f"{value:.6f}" for value in state) for state in one["states"][:4]]
        states = ", ".join(f"({state})" for state in numbers)
        more = ", ..." if len(one["states"]) > 4 else ""
        period = f"period {one['period']}" if one["period"] else "no period"
        size = f"{one['cells']} cell{'s' * (one['cells'] != 1)}, {measure} {one['area']:.6g}"
        kind = "artefact" if one["artefact"] else "attractor"
        print(f"  {kind} {i}: {period}, {size}, at {states}{more}{of_cells(one)}")
    print(f"  {measure} {float(data['area'].sum()):.6g} in all")
    print(
        "  cells: "
        + ", ".join(f"{n} {name}" for name, n in fates.items() if n or name == "UNDECIDED")
    )
    if lost:
        print(f"  {lost} cells walk on without coming near a known attractor")
    if reused:
        print(f"  taken from {out}, computed before")
    elif begun:
        print(f"  went on with {out}, begun before; {seconds['run']:.2f} s to run")
    else:
        made = data["fate"].size if method == "cell-map" else made
        print(
            f"  {made / max(seconds['run'], 1e-9):,.0f} strides per second; "
            f"{seconds['compile']:.1f} s to compile, {seconds['run']:.2f} s to run"
        )
    print(f"  data set {out}, picture {figure}")


def of_cells(attractor: dict) -> str:
    """What stands for an attractor in a cell map, where that is not one cycle that leads there."""
    cycles, falling = attractor.get("cycles", 1), attractor.get("falling", 0)
    if attractor["artefact"]:
        centres = len(attractor["states"])
        if falling == 0:
            return ": walkers from there do not come to one attractor"
        return f": a walker falls from {f'{falling} of {centres}' if centres > 1 else 'there'}"
    joined = [f"{cycles} cycles of cells"] * (cycles > 1)
    joined += [f"a walker falls from {falling} of their centres"] * (falling > 0)
    return f": {', '.join(joined)}" if joined else ""


def cluster_of(workers: int | None, scheduler: str | None) -> int | str | None:
    """Who computes pieces: worker processes, those of a scheduler, or this process, none."""
    if workers is not None and scheduler is not None:
        raise WrongUse("--workers and --scheduler exclude each other: give one of them")
    return scheduler if workers is None else workers


def tally(data: "xarray.Dataset") -> tuple[np.ndarray, int, int]:
    """Cells of each outcome, those that walk on near no attractor, and the strides of all.

    Few rows at a time: a large data set is not in memory.
    """
    counts, lost, made = np.zeros(len(wj.Outcome), int), 0, 0
    row = data["fate"].dims[0]
    rows = max(1, 2**22 * data.sizes[row] // data["fate"].size)
    for first in range(0, data.sizes[row], rows):
        part = data[["fate", "attractor", "strides"]].isel({row: slice(first, first + rows)})
        fate, attractor, strides = (part[name].values.ravel() for name in part)
        counts += np.bincount(fate, minlength=len(counts))
        lost += int(((fate == wj.Outcome.STRIDE) & (attractor < 0)).sum())
        made += int(strides.sum(dtype=np.int64) + (fate != wj.Outcome.STRIDE).sum())
    return counts, lost, made


@app.command()
@takes_walker
def robustness(
    walker: Walker,
    theta: Annotated[
        Axis | None,
        typer.Option(metavar="LO HI N", help="Stance angle, rad (default: 0 0.7854 200)."),
    ] = None,
    sum_: Annotated[
        Axis | None,
        typer.Option(
            "--sum",
            metavar="LO HI N",
            help="theta + thetadot (default: -0.12 0.06 200; -1.1 0.1 800 but for the simplest).",
        ),
    ] = None,
    at_phidot: Annotated[
        float | None,
        typer.Option(help=f"{PHIDOT_HELP}: a slice there (default: at the gait)."),
    ] = None,
    levels: Annotated[
        int, typer.Option(min=0, max=8, help="Times that cells on a boundary are cut in two.")
    ] = 4,
    disturbances: Annotated[
        float, typer.Option(help="Of basin stability: at most, as a part of the gait's own state.")
    ] = 0.1,
    strides: Annotated[
        int, typer.Option(min=1, help="Strides in which a walker may come back.")
    ] = 500,
    low: Annotated[
        float | None, typer.Option("--from", help="Lowest slope of a table over slopes, rad.")
    ] = None,
    high: Annotated[float | None, typer.Option("--to", help="Highest slope, rad.")] = None,
    count: Annotated[
        int | None, typer.Option(min=2, help="Slopes in the table (default: 20).")
    ] = None,
    out: Out = Path("robustness.zarr"),
    figure: PictureOfData = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Measure how large a disturbance a gait survives, on one slope or over many.

    The area of the basin with its error, the least disturbance from which the walker does not come
    back and, where that leads to another motion, the least one from which it falls, the least step
    down, the part of random disturbances that is survived, and the dimension
    of the boundary. By default over all angles of a walker on point feet, and in a slice around the
    gait of any other.
    """
    from walker_jax import figures
    from walker_jax.gaits import check_parameter

    if (low is None) != (high is None):
        raise WrongUse("--from and --to are for a table over slopes: give both or none")
    if low is None and count is not None:
        raise WrongUse("--count is for a table over slopes: give --from and --to too")
    finite(disturbances=disturbances)
    if disturbances <= 0:
        raise WrongUse(f"--disturbances must be above 0, not {disturbances}")
    grid = region_of(walker, theta, sum_, at_phidot)
    slopes = None
    if low is not None and high is not None:
        check_parameter(walker, "slope", low, high)
        if not low < high:
            raise WrongUse(f"--from {low:g} must be below --to {high:g}")
        slopes = np.linspace(low, high, count or 20).round(12)
    about = description(walker)
    slope = about["slope"] if slopes is None else about.pop("slope")
    request = {
        "command": "robustness",
        "walker": about,
        "slopes": None if slopes is None else slopes.tolist(),
        "axes": {} if grid is None else grid.box,
        "levels": levels,
        "disturbances": disturbances,
        "strides": strides,
        "version": version("walker-jax"),
    }
    figure, data = made_before(out, figure, request, overwrite=overwrite)
    if data is None:
        options = {"levels": levels, "disturbances": disturbances, "strides": strides}
        if slopes is None:
            data = wj.robustness(walker, grid, **options)
        else:
            data = wj.robustness_table(walker, slopes, "slope", grid, progress=True, **options)
        data = store.save(data, out, request)
    if slopes is None:
        picture, rows = figures.robustness(data), [measures(data, slope)]
    else:
        picture = figures.robustness_table(data)
        rows = [measures(data.isel(slope=i), float(slope)) for i, slope in enumerate(slopes)]
    draw(picture, figure, request)
    if as_json:
        print_json({"walker": about} | (rows[0] if slopes is None else {"slopes": rows}))
        return
    values = [f"{name} {value:g}" for name, value in about.items() if name not in ("name", "slope")]
    print(", ".join([f"Robustness, {about['name']}", *values]))
    for row in rows:
        print_measures(row)
    print(f"  data set {out}, picture {figure}")


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


@app.command()
@takes_walker
def optimise(
    walker: Walker,
    over: Annotated[
        list[str] | None, typer.Option(help="A parameter that is free; may be repeated.")
    ] = None,
    bound: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=LO:HI", help="Its bounds; one for each of them."),
    ] = None,
    objective: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="area (default), least-disturbance, speed, step-length, spectral-radius or "
            "cost-of-transport; NAME=WEIGHT, repeated, for a weighted sum, to be large.",
        ),
    ] = None,
    at_least: Annotated[
        tuple[str, float] | None,
        typer.Option(metavar="NAME VALUE", help="Least speed, step-length, ...; one limit."),
    ] = None,
    at_most: Annotated[
        tuple[str, float] | None,
        typer.Option(metavar="NAME VALUE", help="Greatest value of one of them; one limit."),
    ] = None,
    theta: Annotated[
        Axis | None,
        typer.Option(metavar="LO HI N", help="Where the area is measured, as for robustness."),
    ] = None,
    sum_: Annotated[
        Axis | None, typer.Option("--sum", metavar="LO HI N", help="theta + thetadot.")
    ] = None,
    at_phidot: Annotated[
        float | None, typer.Option(help=f"{PHIDOT_HELP}: a slice there (default: at the gait).")
    ] = None,
    starts: Annotated[
        int, typer.Option(min=1, help="Starts: the walker given, and others within the bounds.")
    ] = 3,
    levels: Annotated[
        int, typer.Option(min=0, max=8, help="Refinement of the areas at both ends.")
    ] = 4,
    strides: Annotated[int, typer.Option(min=1, help="Strides a walker is followed for.")] = 200,
    scan: Annotated[
        int, typer.Option(min=0, help="Values of each parameter at which the objective is drawn.")
    ] = 25,
    seed: Annotated[int, typer.Option(min=0, help="Of the starts.")] = 0,
    out: Out = Path("optimum.zarr"),
    figure: PictureOfData = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Design a walker: the parameters with the largest basin, or another objective, by gradient.

    For example: walker-jax optimise --over slope --bound slope=0.001:0.02 --at-least speed 0.06

    What has been measured is kept as it goes: after an interruption the same command goes on. The
    picture shows the climb over a scan of the objective, and the basins before and after.
    """
    from walker_jax import figures

    bounds = bounds_of(walker, over or [], bound or [])
    wanted = objective_of(objective or ["area"])
    least, most = (dict([one]) if one else {} for one in (at_least, at_most))
    grid = region_of(walker, theta, sum_, at_phidot)
    request = {
        "command": "optimise",
        "walker": description(walker),
        "bounds": bounds,
        "objective": wanted,
        "at_least": least,
        "at_most": most,
        "axes": {} if grid is None else grid.box,
        "starts": starts,
        "levels": levels,
        "strides": strides,
        "scan": scan,
        "seed": seed,
        "version": version("walker-jax"),
    }
    figure, data = made_before(out, figure, request, overwrite=overwrite)
    kept = data is not None

    def keep(trace: "xarray.Dataset") -> None:
        nonlocal kept
        store.save(trace, out, request)
        kept = True

    if data is None or "found" not in data:  # not begun, or interrupted
        try:
            with store.resumable(out, lambda: kept, overwrite=overwrite):
                data = wj.optimise(
                    walker,
                    bounds,
                    wanted,
                    at_least=least,
                    at_most=most,
                    grid=grid,
                    starts=starts,
                    levels=levels,
                    strides=strides,
                    scan=scan,
                    seed=seed,
                    known=data,
                    keep=keep,
                    progress=True,
                )
        except store.Occupied:
            raise
        except WrongUse as error:
            message = str(error)
            for word, options in NAMED.items():
                message = message.replace(f"{word} ", f"{options} ", 1)
            raise WrongUse(message) from error
        data = store.save(data, out, request)
    if not data["found"]:
        reasons = "; ".join(dict.fromkeys(data["note"].values.tolist()))
        raise ComputationFailed(f"no start leads anywhere: {reasons}")
    draw(figures.optimised(data), figure, request)
    answer = optimum(data)
    if as_json:
        print_json(answer | {"walker": request["walker"]})
        return
    print_optimum(walker, answer, " + ".join(objective or ["area"]))
    for note in data["note"].values.tolist():
        if note:
            print(f"  a start led nowhere: {note}")
    print(f"  data set {out}, picture {figure}")


NAMED = {
    "limits of": "--at-least and --at-most of",
    "limits must be": "--at-least and --at-most must be",
    "bounds of": "--bound of",
    "objective must": "--objective must",
    "grid is": "--theta, --sum and --at-phidot are",
}
"""What the library calls arguments of `optimise`, and the options that set them."""


def bounds_of(walker: Walker, over: list[str], bound: list[str]) -> dict[str, tuple[float, float]]:
    """The bounds of the parameters that are free."""
    from walker_jax.gaits import check_parameter

    names = [name.replace("-", "_") for name in over]
    bounds: dict[str, tuple[float, float]] = {}
    for text in bound:
        name, _, ends = text.partition("=")
        low, _, high = ends.partition(":")
        try:
            pair = float(low), float(high)
        except ValueError:
            raise WrongUse(f"--bound must be NAME=LO:HI, not {text}") from None
        name = name.replace("-", "_")
        if name in bounds:
            raise WrongUse(f"--bound is given twice for {name}")
        bounds[name] = pair
    if not names:
        raise WrongUse("--over is required: a parameter that is free, such as slope")
    for name in names:
        check_parameter(walker, name)
        if name not in bounds:
            raise WrongUse(f"--bound is required for {name}: {name}=LO:HI")
    for name in bounds:
        if name not in names:
            raise WrongUse(f"--bound is of {name}, which is not free: add --over {name}")
    return {name: bounds[name] for name in names}


def objective_of(texts: list[str]) -> str | dict[str, float]:
    """One objective by name, or the weights of several."""
    if len(texts) == 1 and "=" not in texts[0]:
        return texts[0]
    weights: dict[str, float] = {}
    for text in texts:
        name, _, weight = text.partition("=")
        try:
            value = float(weight)
        except ValueError:
            raise WrongUse(f"--objective must be one NAME, or NAME=WEIGHT, not {text}") from None
        if name in weights:
            raise WrongUse(f"--objective is given twice for {name}")
        weights[name] = value
    return weights


@app.command()
@takes_walker
def sweep(
    walker: Walker,
    over: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=LO:HI:N", help="Values of a parameter; give it again for others."
        ),
    ] = None,
    theta: Annotated[
        Axis | None, typer.Option(metavar="LO HI N", help="Stance angle, rad (default: all).")
    ] = None,
    sum_: Annotated[
        Axis | None, typer.Option("--sum", metavar="LO HI N", help="theta + thetadot.")
    ] = None,
    at_phidot: Annotated[
        float | None, typer.Option(help=f"{PHIDOT_HELP}: where the slice is.")
    ] = None,
    levels: Annotated[int, typer.Option(min=0, help="Of refinement of the areas.")] = 2,
    check: Annotated[int, typer.Option(min=0, help="Starts that check each area.")] = 500_000,
    robust: Annotated[
        bool, typer.Option("--robust", help="All numbers of `robustness` too; half a minute each.")
    ] = False,
    strides: Annotated[int, typer.Option(min=1, help="Strides at most.")] = 200,
    workers: Workers = None,
    scheduler: Scheduler = None,
    out: Out = Path("sweep.zarr"),
    figure: PictureOfData = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Compute basins, gaits and areas over one or more parameters, all combinations of them.

    What has been computed is kept as it goes: after an interruption the same command goes on. The
    picture shows the area over the first two parameters.
    """
    from walker_jax import figures
    from walker_jax.sweep import check_values

    values = values_of(over or [])
    if not values:
        raise WrongUse("--over is required: a parameter and its values, such as slope=0.002:0.01:5")
    check_values(walker, {name: np.array(some) for name, some in values.items()})
    cluster = cluster_of(workers, scheduler)
    grid = region_of(walker, theta, sum_, at_phidot)
    about = {name: v for name, v in description(walker).items() if name not in values}
    request = {
        "command": "sweep",
        "walker": about,
        "over": values,
        "axes": {} if grid is None else grid.box,
        "levels": levels,
        "check": check,
        "robust": robust,
        "strides": strides,
        "version": version("walker-jax"),
    }
    figure, data = made_before(out, figure, request, overwrite=overwrite)
    if data is None:
        options: Any = {"out": out, "request": request, "overwrite": overwrite}
        options |= {"levels": levels, "check": check, "robust": robust, "strides": strides}
        options |= {"cluster": cluster, "progress": True}
        data = wj.sweep(walker, values, grid, **options)
    draw(figures.sweep(data), figure, request)
    names = [*values]
    table = data[[name for name in data if set(data[name].dims) == set(names)]].load()
    rows = table.stack(point=names).to_dataframe()[[str(name) for name in table]].reset_index()
    if as_json:
        print_json({"walker": about, "points": rows.to_dict(orient="records")})
        return
    shown = [*names, "total_area", "total_area_error", "multiplier", "speed", "failed"]
    shown += ["least_disturbance", "least_fall", "step_down", "step_down_fall"]
    shown = [name for name in shown if name in rows]
    print(rows[shown].map("{:.6g}".format).to_string(index=False))
    print(f"  data set {out}, picture {figure}")


def values_of(over: list[str]) -> dict[str, list[float]]:
    """The values of each parameter that --over names."""
    from walker_jax.sweep import MOST

    values: dict[str, list[float]] = {}
    for text in over:
        name, _, span = text.partition("=")
        try:
            low, high, count = span.split(":")
            ends = float(low), float(high)
            number = int(count)
        except ValueError:
            raise WrongUse(f"--over must be NAME=LO:HI:N, not {text}") from None
        if not ends[0] < ends[1] or number < 2 or not math.isfinite(ends[1] - ends[0]):
            raise WrongUse(f"--over {text} must have LO below HI, both finite, and N of 2 or more")
        name = name.replace("-", "_")
        if name in values:
            raise WrongUse(f"--over is given twice for {name}")
        if number > MOST:
            raise WrongUse(f"--over {text} must have N of at most {MOST}")
        spaced, least = np.linspace(*ends, number), 1e-12 * (ends[1] - ends[0])
        values[name] = [float(f"{x:.12g}") if abs(x) > least else 0.0 for x in spaced]
    return values


@app.command()
def export(
    data: Annotated[Path, typer.Argument(metavar="DATA", help="A data set that a command left.")],
    file: Annotated[Path, typer.Argument(metavar="FILE.nc", help="Where it goes.")],
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Copy a data set that another command has left to a NetCDF file."""
    if file.suffix != ".nc":
        raise WrongUse(f"FILE.nc must end in .nc, not {file}")
    copied = store.export(data, file, overwrite=overwrite)
    answer = {"data": str(data), "file": str(file), "variables": sorted(map(str, copied.variables))}
    if as_json:
        print_json(answer)
        return
    print(f"{data}: {', '.join(answer['variables'])}\n  NetCDF file {file}")


@app.command()
def reproduce(
    out: Annotated[Path, typer.Option(help="The folder of the report.")] = Path("report"),
    quick: Annotated[
        bool, typer.Option("--quick", help="With fewer cells and slopes, without exact areas.")
    ] = False,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Reproduce the paper of Schwab and Wisse (2001): every figure and number, in a report.

    An interrupted run goes on where it was.
    """
    from walker_jax import paper

    clock = Stopwatch()
    numbers = paper.reproduce(out, quick=quick, overwrite=overwrite, progress=True)
    differ = [number for number in numbers if not number.agrees]
    if as_json:
        listed = [number._asdict() for number in numbers]
        seconds = clock.seconds()
        print_json({"report": str(out / "report.html"), "numbers": listed, "seconds": seconds})
        return
    agree = len(numbers) - len(differ)
    print(f"{agree} of {len(numbers)} numbers agree at the digits that the paper prints; not so:")
    for one in differ:
        print(f"  {one.where}, {one.what}: printed {one.printed}, ours {one.ours}. {one.why}")
    print(f"  report {out / 'report.html'}")


def optimum(data) -> dict:
    """The answer of `optimise`."""
    names = data["parameter"].values.tolist()
    named = lambda key: dict(zip(names, data[key].values.tolist(), strict=True))
    both = lambda key: {end: float(data[f"{key}_{end}"]) for end in ("start", "optimum")}
    held = data["measure"].values[data["binding"].values]
    return {
        "start": named("start"),
        "optimum": named("optimum"),
        "objective": both("objective"),
        "exact": both("exact"),
        "exact_error": {end: float(data[f"exact_{end}_error"]) for end in ("start", "optimum")},
        "at_bound": [name for name, side in named("at_bound").items() if side],
        "binding": held.tolist(),
        "evaluations": data.sizes["evaluation"],
        "converged": bool(data["converged"]),
    }


def print_optimum(walker: Walker, answer: dict, objective: str) -> None:
    """The answer of `optimise`, in words."""
    print(f"{objective}, {said(walker)}")
    for end in ("start", "optimum"):
        values = ", ".join(f"{name} {value:.8g}" for name, value in answer[end].items())
        exact, error = answer["exact"][end], answer["exact_error"][end]
        print(f"  {end:8} {values}: {exact:.7g}" + (f" +- {error:.1g}" if error else ""))
    before, after = answer["exact"]["start"], answer["exact"]["optimum"]
    factor = f", by a factor of {after / before:.3f}" if before > 0 else ""
    change = f"{after - before:+.4g}{factor}"
    print(f"  exactly, it changed by {change}")
    inside = "inside the bounds" if not answer["at_bound"] else ""
    place = inside or f"at a bound of {', '.join(answer['at_bound'])}"
    limit = f", held by the limit of {', '.join(answer['binding'])}" * bool(answer["binding"])
    end = "converged" if answer["converged"] else "not converged"
    print(f"  {place}{limit}; {end}, {answer['evaluations']} evaluations")


def measures(data, slope: float) -> dict:
    """The answer of `robustness` on one slope."""
    number = lambda name: float(data[name]) if name in data else None
    failure = lambda name: wj.Outcome(int(data[name])).name if name in data else None
    interval = lambda name: {
        "value": number(name),
        "low": number(f"{name}_low"),
        "high": number(f"{name}_high"),
    }
    answer = {
        "slope": slope,
        "area": number("total_area"),
        "area_error": number("total_area_error"),
    }
    if int(data["gait_period"]) == 0:
        absent = ("gait", "least_disturbance", "least_fall", "step_down", "step_down_failure")
        absent += ("step_down_fall", "basin_stability", "boundary_dimension")
        return answer | dict.fromkeys(absent)
    return answer | {
        "gait": {
            "period": int(data["gait_period"]),
            "state": data["gait_state"].values,
            "multiplier": number("multiplier"),
            "step_time": number("step_time"),
        },
        "least_disturbance": {
            "size": number("least_disturbance"),
            "direction": data["direction"].values,
            "state": data["failing_state"].values,
            "failure": failure("failure"),
            "strides": int(data["failing_strides"]),
        },
        "least_fall": {
            "size": number("least_fall"),
            "direction": data["fall_direction"].values,
            "state": data["fall_state"].values,
            "failure": failure("fall_failure"),
            "strides": int(data["fall_strides"]),
        }
        if "least_fall" in data
        else None,
        "step_down": number("step_down"),
        "step_down_failure": failure("step_down_failure"),
        "step_down_fall": number("step_down_fall"),
        "basin_stability": {
            **interval("stability"),
            "disturbances": float(data.attrs["disturbances"]),
            "median_strides": number("median_strides"),
            "slowest_strides": number("slowest_strides"),
        },
        "boundary_dimension": interval("dimension"),
    }


def said_of(disturbance: dict) -> str:
    """A least disturbance in words."""
    along = ", ".join(f"{value:.4f}" for value in disturbance["direction"])
    how = "comes to another motion"
    if disturbance["failure"] != "STRIDE":
        how = f"{disturbance['failure']} after {disturbance['strides']} strides"
    return f"{disturbance['size']:.8f} along ({along}): {how}"


def print_measures(row: dict) -> None:
    """The answer of `robustness` on one slope, in words."""
    print(f"  slope {row['slope']:g}: area {row['area']:.7g} +- {row['area_error']:.1g}")
    if row["gait"] is None:
        print("    no gait attracts")
        return
    gait, least = row["gait"], row["least_disturbance"]
    survived, dimension = row["basin_stability"], row["boundary_dimension"]
    print(f"    gait of period {gait['period']}, largest multiplier {gait['multiplier']:.6f}")
    print(f"    least disturbance {said_of(least)}")
    if least["failure"] == "STRIDE" and row["least_fall"] is not None:
        print(f"    least one from which it falls {said_of(row['least_fall'])}")
    down = f"{row['step_down']:.8f}"
    if row["step_down_failure"] == "STRIDE":
        down += f": comes to another motion; falls from {row['step_down_fall']:.8f}"
    print(f"    least step down {down}")
    print(
        f"    {survived['value']:.1%} ({survived['low']:.1%} to {survived['high']:.1%}) of "
        f"disturbances up to {survived['disturbances']:g} of the gait's state are survived; "
        f"half of them are over in {survived['median_strides']:g} strides, "
        f"95 of 100 in {survived['slowest_strides']:g}"
    )
    print(
        f"    dimension of the boundary {dimension['value']:.3f} "
        f"({dimension['low']:.3f} to {dimension['high']:.3f})"
    )


def filled(axes: dict, values: dict, default: Axis | None = None) -> dict:
    """The axes, those that are not given with values of their own or the default one."""
    return {
        name: values.get(name, default) if axis is None else axis for name, axis in axes.items()
    }


class Stopwatch:
    """Wall-clock time, that in which JAX traced or compiled anything apart."""

    def __init__(self):
        self.compiling: list[tuple[float, float]] = []
        self.start = time.perf_counter()
        jax.monitoring.register_event_duration_secs_listener(self.record)

    def record(self, event: str, duration_secs: float, **kwargs: str | int) -> None:
        if "/compile" in event or "compilation_cache" in event:
            now = time.perf_counter()
            self.compiling.append((max(now - duration_secs, self.start), now))

    def seconds(self) -> dict[str, float]:
        """Seconds so far; what was compiled in several threads at once counts once."""
        total, end = 0.0, self.start
        for begin, finish in sorted(self.compiling):
            total += max(0.0, finish - max(begin, end))
            end = max(end, finish)
        return {"compile": total, "run": time.perf_counter() - self.start - total}


def finite(**values: float) -> None:
    for name, value in values.items():
        if not math.isfinite(value):
            raise WrongUse(f"{name} must be finite, not {value}")


def print_json(answer: dict) -> None:
    print(json.dumps(plain(answer), allow_nan=False))


def plain(value):
    """The same in what JSON has: null for NaN and infinities."""
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value


def keep_compiled() -> None:
    """Keep what XLA compiles where kernels are, so that the next start is fast."""
    folder = cache_folder()
    if folder is None or "JAX_COMPILATION_CACHE_DIR" in os.environ:
        return
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return
    if os.access(folder, os.W_OK):
        jax.config.update("jax_compilation_cache_dir", str(folder))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0)


FEW_COLLECTIONS = 50_000
"""New objects after which Python looks for garbage: traces are many objects, of which most live on,
and at its default of 700 a sixth of a short command is spent on looking."""


def main() -> NoReturn:
    gc.set_threshold(FEW_COLLECTIONS)
    jax.config.update("jax_enable_x64", True)
    keep_compiled()
    signal.signal(signal.SIGTERM, terminate)
    try:
        code = app(standalone_mode=False)
    except store.Occupied as error:
        what, *help_ = error.args
        stop(2, ": ".join([what, *(with_options_named(words, PLACES) for words in help_)]))
    except WrongUse as error:
        stop(2, error)
    except ComputationFailed as error:
        stop(1, error)
    except Interrupted as error:
        stop(130, ": ".join(["interrupted", *error.args]))
    except Terminated as error:
        stop(143, ": ".join(["terminated", *notes_of(error)]))
    except Exception as error:
        # typer's own: wrong usage
        message = getattr(error, "format_message", None)
        stop(2, message() or "name a command, one of those above") if message else stop(
            1, f"{type(error).__name__}: {error}"
        )
    if code == 130:  # what typer makes of Ctrl-C before a command begins
        stop(130, "interrupted")
    sys.exit(code if isinstance(code, int) else 0)


def notes_of(interruption: BaseException) -> list[str]:
    """How the work is resumed, as the library says, with options as here."""
    notes = getattr(interruption, "__notes__", [])
    notes = [note for note in notes if note.startswith(store.RESUME)]
    return [note.replace("without overwrite", "without --overwrite", 1) for note in notes]


def terminate(signal_number: int, frame: object) -> NoReturn:
    raise Terminated


def stop(code: int, reason) -> NoReturn:
    print(f"walker-jax: {' '.join(str(reason).split())}", file=sys.stderr)
    sys.exit(code)

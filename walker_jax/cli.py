"""The command `walker-jax`. Each command asks the library, prints a summary, and keeps the result.

Answers go to standard output; progress, warnings and the one line that says what is wrong go to
standard error. Exit code 0: done; 2: wrong usage; 1: the computation failed.
"""

import json
import math
import os
import sys
import time
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Literal, NoReturn

import jax
import numpy as np
import platformdirs
import typer

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    help="Passive dynamic walkers: their gaits, and the basins of attraction of these.",
)

Slope = Annotated[float, typer.Option(help="Slope of the ground, rad.")]
Json = Annotated[bool, typer.Option("--json", help="Print the answer as JSON.")]
Out = Annotated[Path, typer.Option(help="Where the data set goes (Zarr).")]
PictureOfData = Annotated[
    Path | None,
    typer.Option(
        "--figure", help="Where the picture goes (default: the name of the data set with .png)."
    ),
]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace what is there.")]
Axis = tuple[float, float, int]

PICTURES = (".png", ".svg", ".pdf")  # those that carry a title, by which a picture is known again


class NotFound(Exception):
    """A search that found nothing, and why."""


@app.callback()
def common() -> None:
    """Passive dynamic walkers: their gaits, and the basins of attraction of these."""


@app.command()
def walk(
    slope: Slope = 0.004,
    theta: Annotated[float, typer.Option(help="Stance angle at the start, rad.")] = 0.2,
    thetadot: Annotated[float, typer.Option(help="Its rate, rad per sqrt(l/g).")] = -0.21645,
    strides: Annotated[int, typer.Option(min=1, help="Strides at most.")] = 9,
    as_json: Json = False,
) -> None:
    """Walk from one start, stride by stride, until a failure."""
    import walker_jax as wj

    finite(theta=theta, thetadot=thetadot)
    walker = wj.SimplestWalker(slope)
    states, names, times = [np.array([theta, thetadot])], [], []
    for _ in range(strides):
        result = wj.stride(walker, states[-1])
        names.append(wj.Outcome(int(result.outcome)).name)
        times.append(float(result.time))
        if result.outcome != wj.Outcome.STRIDE:
            break
        states.append(np.asarray(result.state))
    if as_json:
        print_json({"states": states, "outcomes": names, "times": times})
        return
    print(f"{'stride':>6}  {'theta':>10}  {'thetadot':>10}  {'time':>8}  outcome")
    for i, (state, name, duration) in enumerate(zip(states, names, times, strict=False), start=1):
        print(f"{i:6}  {state[0]:10.6f}  {state[1]:10.6f}  {duration:8.4f}  {name}")
    if len(states) > len(names):
        print(f"{'next':>6}  {states[-1][0]:10.6f}  {states[-1][1]:10.6f}")


@app.command()
def gait(
    slope: Slope = 0.004,
    period: Annotated[int, typer.Option(min=1, help="Strides in a cycle.")] = 1,
    all_: Annotated[
        bool, typer.Option("--all", help="All gaits of the period, stable or not.")
    ] = False,
    guess: Annotated[
        tuple[float, float] | None,
        typer.Option(metavar="THETA THETADOT", help="Where the search begins."),
    ] = None,
    figure: Annotated[
        Path | None, typer.Option(help="Where a picture of the multipliers goes.")
    ] = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Find the gaits of the simplest walker: cycles of strides, and their stability."""
    import walker_jax as wj
    from walker_jax import figures, store

    walker = wj.SimplestWalker(slope)
    if guess is not None:
        finite(theta=guess[0], thetadot=guess[1])
    if guess is not None and all_:
        raise ValueError("--guess and --all exclude each other: give one of them")
    request = {
        "command": "gait",
        "walker": {"name": "SimplestWalker", "slope": slope},
        "period": period,
        "guess": guess,
        "all": all_,
        "version": version("walker-jax"),
    }
    if figure is not None:
        check_suffix(figure)
        store.check_picture(figure, request, overwrite=overwrite)

    found = []
    if all_ or (period > 1 and guess is None):
        found = wj.find_gaits(walker, period)
        found.sort(key=lambda gait: np.abs(gait.multipliers[0]))
        found = found if all_ else found[:1]
    # the long gait of period one is not the most stable one on every slope
    if period == 1 or guess is not None:
        first = wj.find_gait(walker, guess, period)
        same = lambda gait: np.allclose(gait.states, first.states, rtol=0, atol=1e-8)
        found = [first] * bool(first.found) + [gait for gait in found if not same(gait)]
        if not found:
            raise NotFound(f"no gait of period {period} found at slope {slope:g}: {end_of(first)}")
    if not found:
        raise NotFound(f"no gait of period {period} found at slope {slope:g}")
    if figure is not None:
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
        print_json({"slope": slope, "gaits": gaits})
        return
    for one in found:
        kind = "stable" if one.stable else "unstable"
        values = ", ".join(f"{value:.8g}" for value in one.multipliers)
        print(f"{kind} gait of period {period} at slope {slope:g} rad, multipliers {values}")
        for state, duration in zip(one.states, one.step_times, strict=True):
            print(f"  theta {state[0]:.13f}  thetadot {state[1]:.13f}  step time {duration:.10f}")
    if figure is not None:
        print(f"picture {figure}")


@app.command()
def bifurcation(
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
    import walker_jax as wj
    from walker_jax import figures, store

    walker = wj.SimplestWalker(low)
    wj.SimplestWalker(high)
    if not low < high:
        raise ValueError(f"--from {low:g} must be below --to {high:g}")
    request = {
        "command": "bifurcation",
        "walker": {"name": "SimplestWalker"},
        "slope": [low, high],
        "period_max": period_max,
        "strides": strides,
        "version": version("walker-jax"),
    }
    figure = picture_of(out, figure)
    store.check_picture(figure, request, overwrite=overwrite)
    data = store.find(out, request, overwrite=overwrite)
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
    print(f"Gaits of the simplest walker from slope {low:g} to {high:g} rad")
    for title, key in (
        ("doublings of the long gait", "doublings"),
        ("doublings of other gaits", "other_doublings"),
        ("folds", "folds"),
    ):
        print(f"  {title}:{'' if answer[key] else ' none'}")
        for event in answer[key]:
            periods = f"{event['from']} to {event['to']}" if "to" in event else event["period"]
            theta, thetadot = event["state"]
            print(f"    period {periods} at {event['slope']:.12f}, ({theta:.6f}, {thetadot:.6f})")
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


def end_of(gait) -> str:
    """How a search ended that found no gait."""
    if not np.isfinite(gait.residual):
        return "a search began, or came, where no stride is made"
    if gait.residual > 1e-6:
        return f"the search ended where a stride misses the next state by {gait.residual:.2g}"
    return "the search came to one of a shorter period"


def picture_of(out: Path, figure: Path | None) -> Path:
    """Where the picture of a data set goes, both places checked."""
    if not out.name:
        raise ValueError(f"--out {out} is not the name of a data set")
    figure = figure or out.with_suffix(".png")
    check_suffix(figure)
    if out.absolute() in (figure.absolute(), *figure.absolute().parents):
        raise ValueError(f"--figure {figure} must be another place than --out {out}")
    return figure


def check_suffix(figure: Path) -> None:
    if figure.suffix not in PICTURES:
        raise ValueError(f"--figure {figure} must end in one of {', '.join(PICTURES)}")


def draw(axes, path: Path, request: dict) -> None:
    """Save the picture to which axes belong, signed with the request."""
    from walker_jax import store

    picture = axes.get_figure(root=True)
    picture.savefig(path, dpi=150, metadata={"Title": store.signature(request)})


@app.command()
def basin(
    slope: Slope = 0.004,
    theta: Annotated[Axis, typer.Option(metavar="LO HI N", help="Stance angle, rad.")] = (
        0.0,
        0.4,
        200,
    ),
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
    method: Annotated[
        Literal["cell-map", "direct"], typer.Option(help="Cell mapping, or direct iteration.")
    ] = "cell-map",
    strides: Annotated[
        int | None, typer.Option(min=1, help="Strides at most, direct only (default: 200).")
    ] = None,
    out: Out = Path("basin.zarr"),
    figure: PictureOfData = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Compute and draw the basin of attraction of the simplest walker's gait."""

    import walker_jax as wj
    from walker_jax import figures, store

    walker = wj.SimplestWalker(slope)
    if strides is not None and method != "direct":
        raise ValueError("--strides is for --method direct alone")
    strides = strides or 200
    if thetadot is not None and sum_ is not None:
        raise ValueError("--sum and --thetadot exclude each other: give one of them")
    if thetadot is not None:
        axes = {"theta": theta, "thetadot": thetadot}
        grid = wj.Grid.plain(**axes)
    else:
        axes = {"theta": theta, "sum": sum_ or (-0.04, 0.01, 250)}
        grid = wj.Grid.sheared(**axes)
    if min(grid.shape) < 2:
        raise ValueError(f"a picture needs 2 cells or more along each axis, not {grid.shape}")
    request = {
        "command": "basin",
        "walker": {"name": "SimplestWalker", "slope": slope},
        "axes": {name: [float(low), float(high), n] for name, (low, high, n) in axes.items()},
        "method": method,
        **({"strides": strides} if method == "direct" else {}),
        "version": version("walker-jax"),
    }
    figure = picture_of(out, figure)
    store.check_picture(figure, request, overwrite=overwrite)
    data = store.find(out, request, overwrite=overwrite)
    reused = data is not None
    clock = Stopwatch()
    if data is None:
        data = wj.basin(walker, grid, method, strides=strides, progress=True)
    seconds = clock.seconds()
    if not reused:
        data = store.save(data, out, request)
    draw(figures.basin(data), figure, request)

    fates = {
        name: int((data["fate"] == code).sum()) for name, code in wj.Outcome.__members__.items()
    }
    attractors = [
        {
            "period": int(data["period"][i]) or None,
            "states": data["states"].values[i][: max(1, int(data["period"][i]))],
            "cells": int(data["cells"][i]),
            "area": float(data["area"][i]),
        }
        for i in range(data.sizes["number"])
    ]
    if as_json:
        print_json(
            {
                "slope": slope,
                "method": method,
                "cells": int(data["fate"].size),
                "area": float(data["area"].sum()),
                "attractors": attractors,
                "fates": fates,
                "seconds": seconds,
            }
        )
        return
    print(f"Basin of attraction, {request['walker']['name']}, slope {slope:g} rad, {method}")
    for i, one in enumerate(attractors):
        states = ", ".join(f"({state[0]:.6f}, {state[1]:.6f})" for state in one["states"][:4])
        more = ", ..." if len(one["states"]) > 4 else ""
        period = f"period {one['period']}" if one["period"] else "no period"
        size = f"{one['cells']} cell{'s' * (one['cells'] > 1)}, area {one['area']:.6g}"
        print(f"  attractor {i}: {period}, {size}, at {states}{more}")
    print(f"  area {float(data['area'].sum()):.6g} in all")
    print(
        "  cells: "
        + ", ".join(f"{n} {name}" for name, n in fates.items() if n or name == "UNDECIDED")
    )
    lost = int(((data["fate"] == 0) & (data["attractor"] < 0)).sum())
    if lost:
        print(f"  {lost} cells walk on without coming near a known attractor")
    if reused:
        print(f"  taken from {out}, computed before")
    else:
        made = int(data["strides"].sum() + (data["fate"] != wj.Outcome.STRIDE).sum())
        made = data["fate"].size if method == "cell-map" else made
        print(
            f"  {made / max(seconds['run'], 1e-9):,.0f} strides per second; "
            f"{seconds['compile']:.1f} s to compile, {seconds['run']:.2f} s to run"
        )
    print(f"  data set {out}, picture {figure}")


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
            raise ValueError(f"{name} must be finite, not {value}")


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
    """Keep compiled programs in the user's cache directory, so that the next start is fast."""
    folder = Path(platformdirs.user_cache_dir("walker-jax"))
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return
    if os.access(folder, os.W_OK):
        jax.config.update("jax_compilation_cache_dir", str(folder))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.1)


def main() -> NoReturn:
    jax.config.update("jax_enable_x64", True)
    keep_compiled()
    try:
        code = app(standalone_mode=False)
    except ValueError as error:
        stop(2, error)
    except NotFound as error:
        stop(1, error)
    except KeyboardInterrupt:
        stop(130, "interrupted")
    except Exception as error:
        # typer's own: wrong usage
        message = getattr(error, "format_message", None)
        stop(2, message()) if message else stop(1, f"{type(error).__name__}: {error}")
    if code == 130:  # what typer makes of Ctrl-C
        stop(130, "interrupted")
    sys.exit(code if isinstance(code, int) else 0)


def stop(code: int, reason) -> NoReturn:
    print(f"walker-jax: {' '.join(str(reason).split())}", file=sys.stderr)
    sys.exit(code)

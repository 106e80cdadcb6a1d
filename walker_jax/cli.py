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
Axis = tuple[float, float, int]

PICTURES = (".png", ".svg", ".pdf")  # those that carry a title, by which a picture is known again


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
    out: Annotated[Path, typer.Option(help="Where the data set goes (Zarr).")] = Path("basin.zarr"),
    figure: Annotated[
        Path | None,
        typer.Option(help="Where the picture goes (default: the name of the data set with .png)."),
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace what is there.")] = False,
    as_json: Json = False,
) -> None:
    """Compute and draw the basin of attraction of the simplest walker's gait."""

    import walker_jax as wj
    from walker_jax import figures, store

    walker = wj.SimplestWalker(slope)
    if strides is not None and method != "direct":
        raise ValueError("--strides is for --method direct alone")
    strides = strides or 200
    if not out.name:
        raise ValueError(f"--out {out} is not the name of a data set")
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
    figure = figure or out.with_suffix(".png")
    if figure.suffix not in PICTURES:
        raise ValueError(f"--figure {figure} must end in one of {', '.join(PICTURES)}")
    if out.absolute() in (figure.absolute(), *figure.absolute().parents):
        raise ValueError(f"--figure {figure} must be another place than --out {out}")
    store.check_picture(figure, request, overwrite=overwrite)

    data = store.find(out, request, overwrite=overwrite)
    reused = data is not None
    clock = Stopwatch()
    if data is None:
        data = wj.basin(walker, grid, method, strides=strides, progress=True)
    seconds = clock.seconds()
    if not reused:
        data = store.save(data, out, request)
    picture = figures.basin(data).get_figure(root=True)
    assert picture is not None
    picture.savefig(figure, dpi=150, metadata={"Title": store.signature(request)})

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

"""`walker-jax bifurcation`."""

import functools
import math
from importlib.metadata import version
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

import walker_jax as wj
from walker_jax import storage
from walker_jax.checks import WrongUse
from walker_jax.cli.answers import description, draw, made_before, print_json
from walker_jax.cli.app import app
from walker_jax.cli.options import Json, Out, Overwrite, PictureOfData, takes_walker
from walker_jax.walkers.model import Walker


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
    from walker_jax.walkers.parameters import check_parameter, with_parameter

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
        data = storage.save(data, out, request)
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

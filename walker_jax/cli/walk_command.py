"""`walker-jax walk`."""

import math
from collections.abc import Iterable
from pathlib import Path
from typing import NoReturn

import walker_jax as wj
from walker_jax.cli import library as lib
from walker_jax.cli.answers import OVERWRITE, check_picture, in_words, is_map, request_for, terms_of
from walker_jax.cli.commands import command
from walker_jax.cli.options import option, refuse
from walker_jax.cli.section import begin_at, has_plane, start_on, start_option
from walker_jax.cli.unit_options import UNITS, chosen_units, units_named
from walker_jax.refusals import WrongUse

PAPER_START = {"theta": 0.2, "thetadot": -0.21645}
"""The start of the walk in Table 1 of Schwab and Wisse (2001)."""
FRAME_INTERVAL = 0.15
"""Time between two frames of a film: 1/20 s for legs of one metre."""


@command(
    examples=(
        "walk",
        "walk --theta 0.16 --thetadot -0.17 --strides 20",
        "walk --animate walk.gif",
        "walk --slope 0.009 --ground 0.0005 --seed 1 --strides 100 --animate rough.gif",
    ),
    time="A few seconds; a film half a minute.",
)
def walk(
    walker: "wj.System",
    start: dict[str, float] = start_option(),
    strides: int = option(9, "Strides at most.", most=1_000_000),
    ground: float | None = option(
        None, "Standard deviation of the steps of rough ground.", least=0
    ),
    seed: int = option(0, "Seed of the ground.", least=0, needs="ground"),
    animate: Path | None = option(
        None, "Where a film goes, .gif, or .mp4 if the program ffmpeg is installed."
    ),
    units: dict[str, float] = UNITS,
    overwrite: bool = OVERWRITE,
):
    """Walk from one start, stride by stride, until a failure.

    With --ground each foothold is higher or lower than the one before, at random. States are full
    ones then: the legs' angles and their rates.

    By default the simplest walker starts at theta 0.2, thetadot -0.21645, any other in its gait. A
    film shows the walker, about as fast as one with legs of one metre, and its trajectory in the
    basin.
    """
    if not lib.is_planar(walker):
        other = f"not for {walker.label()}: leave it out"
        refuse(f"is for walkers in the plane, {other}", ground=ground)
        if walker.picture() is None:
            refuse(f"is for walkers, {other}", animate=animate)
    usual = PAPER_START if lib.moves_like(walker, wj.SimplestWalker) else {}
    given = start_on(walker, start, **usual)
    chosen = chosen_units(units, walker)
    rough, heights = {}, None
    if ground is not None:
        rough = {"ground": ground, "seed": seed}
        heights = ground * lib.numpy.random.default_rng(seed).normal(size=strides)
    request = request_for("walk", walker, start=given, strides=strides, **rough)
    check_picture(animate, request, overwrite=overwrite, film=True)
    with lib.bar("walk", True):
        begin = begin_at(walker, given)
        made = wj.walk(walker, begin, strides, ground=heights)
    outcomes = lib.numpy.asarray(made.outcomes)
    if outcomes[0] == wj.Outcome.OUTSIDE:
        refuse_start(walker, begin, start)
    completed = int((outcomes == wj.Outcome.STRIDE).sum())
    count = min(completed + 1, strides)
    coordinates = wj.State._fields if rough else walker.section
    sizes = [*map(chosen.size, lib.units_of_section(coordinates))]
    states = lib.numpy.asarray(made.states)[: completed + 1] * sizes
    ends = [lib.name_of_outcome(one, walker.failures) for one in outcomes[:count].tolist()]
    times = lib.numpy.asarray(made.times)[:count] * chosen.size(lib.TIME)
    if animate is not None:
        motion = wj.motion(walker, begin, strides, step=FRAME_INTERVAL, ground=heights)
        data = None
        if has_plane(walker):
            window = lib.film_window(walker, lib.numpy.asarray(begin))
            data = wj.basin(walker, window, "direct", progress=True)
        signature = lib.storage.signature(request)
        wj.figures.film(motion, animate, data, signature=signature, progress=True)
    yield {"states": states, "outcomes": ends, "times": times, **units_named(units)}
    row = lambda values: "  ".join(f"{value:10.6f}" for value in values)
    heads = "  ".join(f"{name:>10}" for name in coordinates)
    timeless, step = is_map(walker, times), terms_of(walker).step
    if units:
        yield "Angles in rad, rates in rad/s, times in s."
    yield f"{step}  {heads}  " + ("" if timeless else f"{'time':>8}  ") + "outcome"
    for i, (state, end, duration) in enumerate(zip(states, ends, times, strict=False), start=1):
        time = "" if timeless else f"{'-' if math.isnan(duration) else f'{duration:.4f}':>8}  "
        yield f"{i:{len(step)}}  {row(state)}  {time}{in_words(end, walker)}"
    if len(states) > len(ends):
        yield f"{'next':>{len(step)}}  {row(states[-1])}"
        yield f"It makes all its {step}s: a larger --strides shows whether it goes on."
    else:
        why = "another --seed gives other ground" if rough else "walker-jax explain says why"
        yield f"It ends in {step} {len(ends)}: {why}."
    if animate is not None:
        yield f"film {animate}"


def refuse_start(walker: "wj.System", begin: list[float], given: Iterable[str]) -> NoReturn:
    """Raise `WrongUse` for a start that is not feasible, with the condition that it violates.

    The user gave these of its coordinates.
    """
    feasible = type(walker).feasible
    about = feasible.__doc__ if feasible is not wj.System.feasible else None
    condition = (about or "").strip().partition("\n")[0].rstrip(".")
    why = f": {condition}" if condition else ""
    given = [*given] or walker.section
    other = f"give another {' or '.join(given)}"
    raise WrongUse(f"{begin} is not a feasible start{why}", other, of=" ".join(given))

"""`walker-jax walk`."""

import math
from pathlib import Path
from typing import NoReturn

import walker_jax as wj
from walker_jax.cli import library as lib
from walker_jax.cli.answers import Files, check_picture, in_words, is_map, request_for, terms_of
from walker_jax.cli.commands import command
from walker_jax.cli.options import Group, option, refuse
from walker_jax.cli.section import Start, has_own_options, has_plane
from walker_jax.cli.unit_options import InUnits
from walker_jax.refusals import WrongUse

PAPER_START = {"theta": 0.2, "thetadot": -0.21645}
"""The start of the walk in Table 1 of Schwab and Wisse (2001)."""
FRAME_INTERVAL = 0.15
"""Time between two frames of a film: 1/20 s for legs of one metre."""


class Walk(Group):
    strides: int = option(9, "Strides at most.", most=1_000_000)
    ground: float | None = option(None, "Standard deviation of the steps of rough ground.", least=0)
    seed: int | None = option(None, "Seed of the ground (default: 0).", least=0)
    animate: Path | None = option(
        None, "Where a film goes, .gif, or .mp4 if the program ffmpeg is installed."
    )


@command(
    examples=(
        "walk",
        "walk --theta 0.16 --thetadot -0.17 --strides 20",
        "walk --animate walk.gif",
        "walk --slope 0.009 --ground 0.0005 --seed 1 --strides 100 --animate rough.gif",
    ),
    time="A few seconds; a film half a minute.",
)
def walk(walker: "wj.System", start: Start, asked: Walk, units: InUnits, files: Files):
    """Walk from one start, stride by stride, until a failure.

    With --ground each foothold is higher or lower than the one before, at random. States are full
    ones then: the legs' angles and their rates.

    By default the simplest walker starts at theta 0.2, thetadot -0.21645, any other in its gait. A
    film shows the walker, about as fast as one with legs of one metre, and its trajectory in the
    basin.
    """
    if not lib.is_planar(walker):
        other = f"not for {walker.label()}: leave it out"
        refuse(f"is for walkers in the plane, {other}", ground=asked.ground)
        if walker.picture() is None:
            refuse(f"is for walkers, {other}", animate=asked.animate)
    if asked.ground is None:
        refuse("is for --ground alone: give it too", seed=asked.seed)
    usual = PAPER_START if lib.moves_like(walker, wj.SimplestWalker) else {}
    given, strides, film = start.coordinates(walker, **usual), asked.strides, asked.animate
    units.check(walker)
    ground, heights = {}, None
    if asked.ground is not None:
        ground = {"ground": asked.ground, "seed": asked.seed or 0}
        random = lib.numpy.random.default_rng(asked.seed or 0)
        heights = asked.ground * random.normal(size=strides)
    request = request_for("walk", walker, start=given, strides=strides, **ground)
    check_picture(film, request, overwrite=files.overwrite, film=True)
    with lib.bar("walk", True):
        begin = start.begin(walker, **usual)
        made = wj.walk(walker, begin, strides, ground=heights)
    outcomes = lib.numpy.asarray(made.outcomes)
    if outcomes[0] == wj.Outcome.OUTSIDE:
        refuse_start(walker, begin)
    completed = int((outcomes == wj.Outcome.STRIDE).sum())
    count = min(completed + 1, strides)
    coordinates = wj.State._fields if ground else walker.section
    states = units.states(lib.numpy.asarray(made.states)[: completed + 1], coordinates)
    ends = [lib.name_of_outcome(one, walker.failures) for one in outcomes[:count].tolist()]
    times = units.times(lib.numpy.asarray(made.times)[:count])
    if film is not None:
        motion = wj.motion(walker, begin, strides, step=FRAME_INTERVAL, ground=heights)
        data = None
        if has_plane(walker):
            window = lib.film_window(walker, lib.numpy.asarray(begin))
            data = wj.basin(walker, window, "direct", progress=True)
        signature = lib.storage.signature(request)
        wj.figures.film(motion, film, data, signature=signature, progress=True)
    yield {"states": states, "outcomes": ends, "times": times, **units.named}
    row = lambda values: "  ".join(f"{value:10.6f}" for value in values)
    heads = "  ".join(f"{name:>10}" for name in coordinates)
    timeless, step = is_map(walker, times), terms_of(walker).step
    if units.chosen:
        yield "Angles in rad, rates in rad/s, times in s."
    yield f"{step}  {heads}  " + ("" if timeless else f"{'time':>8}  ") + "outcome"
    for i, (state, end, duration) in enumerate(zip(states, ends, times, strict=False), start=1):
        time = "" if timeless else f"{'-' if math.isnan(duration) else f'{duration:.4f}':>8}  "
        yield f"{i:{len(step)}}  {row(state)}  {time}{in_words(end, walker)}"
    if len(states) > len(ends):
        yield f"{'next':>{len(step)}}  {row(states[-1])}"
        yield f"It makes all its {step}s: a larger --strides shows whether it goes on."
    else:
        why = "another --seed gives other ground" if ground else "walker-jax explain says why"
        yield f"It ends in {step} {len(ends)}: {why}."
    if film is not None:
        yield f"film {film}"


def refuse_start(walker: "wj.System", start: list[float]) -> NoReturn:
    """Raise `WrongUse` for a start that is not feasible, with the condition that it violates."""

    form = "--{}" if has_own_options(walker) else "--start {}=VALUE"
    options = " and ".join(map(form.format, walker.section))
    feasible = type(walker).feasible
    about = feasible.__doc__ if feasible is not wj.System.feasible else None
    condition = (about or "").strip().partition("\n")[0].rstrip(".")
    why = f": {condition}" if condition else ""
    raise WrongUse(f"{options} must be a feasible start, not {start}{why}")

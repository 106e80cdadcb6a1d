"""`walker-jax walk`."""

import math
from pathlib import Path
from typing import Any, NoReturn

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

    def heights(self) -> Any:
        """Return the heights of the steps of rough ground, if it is rough."""
        if self.ground is None:
            return None
        return self.ground * lib.numpy.random.default_rng(self.seed or 0).normal(size=self.strides)


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
    simplest = lib.moves_like(walker, wj.SimplestWalker)
    usual = PAPER_START if simplest else {}
    given = start.coordinates(walker, **usual)
    units.check(walker)
    rough = asked.ground is not None
    ground = {"ground": asked.ground, "seed": asked.seed or 0} if rough else {}
    request = request_for("walk", walker, start=given, strides=asked.strides, **ground)
    check_picture(asked.animate, request, overwrite=files.overwrite, film=True)
    with lib.bar("walk", True):
        begin = start.begin(walker, **usual)
        made = wj.walk(walker, begin, asked.strides, ground=asked.heights())
    outcomes = lib.numpy.asarray(made.outcomes)
    if outcomes[0] == wj.Outcome.OUTSIDE:
        refuse_start(walker, begin)
    completed = int((outcomes == wj.Outcome.STRIDE).sum())
    count = min(completed + 1, asked.strides)
    names = lib.State._fields if rough else walker.section
    answer: dict[str, Any] = {
        "states": units.states(lib.numpy.asarray(made.states)[: completed + 1], names),
        "outcomes": [
            lib.name_of_outcome(one, walker.failures) for one in outcomes[:count].tolist()
        ],
        "times": units.times(lib.numpy.asarray(made.times)[:count]),
        **units.named,
    }
    if asked.animate is not None:
        draw_film(walker, begin, asked, asked.animate, lib.storage.signature(request))
    yield answer
    row = lambda values: "  ".join(f"{value:10.6f}" for value in values)
    heads = "  ".join(f"{name:>10}" for name in names)
    timeless, step = is_map(walker, answer["times"]), terms_of(walker).step
    if units.chosen:
        yield "Angles in rad, rates in rad/s, times in s."
    yield f"{step}  {heads}  " + ("" if timeless else f"{'time':>8}  ") + "outcome"
    strides = zip(answer["states"], answer["outcomes"], answer["times"], strict=False)
    for i, (state, name, duration) in enumerate(strides, start=1):
        time = "" if timeless else f"{'-' if math.isnan(duration) else f'{duration:.4f}':>8}  "
        yield f"{i:{len(step)}}  {row(state)}  {time}{in_words(name, walker)}"
    if len(answer["states"]) > len(answer["outcomes"]):
        yield f"{'next':>{len(step)}}  {row(answer['states'][-1])}"
        yield f"It makes all its {step}s: a larger --strides shows whether it goes on."
    else:
        why = "another --seed gives other ground" if rough else "walker-jax explain says why"
        yield f"It ends in {step} {len(answer['outcomes'])}: {why}."
    if asked.animate is not None:
        yield f"film {asked.animate}"


def draw_film(walker: "wj.System", begin: Any, asked: Walk, place: Path, signature: str) -> None:
    """Save the film of a walk."""
    how: Any = {"step": FRAME_INTERVAL, "ground": asked.heights()}
    motion, data = wj.motion(walker, begin, asked.strides, **how), None
    if has_plane(walker):
        data = wj.basin(walker, lib.film_window(walker, begin), "direct", progress=True)
    wj.figures.film(motion, place, data, signature=signature, progress=True)


def refuse_start(walker: "wj.System", start: list[float]) -> NoReturn:
    """Raise `WrongUse` for a start that is not feasible, with the condition that it violates."""

    form = "--{}" if has_own_options(walker) else "--start {}=VALUE"
    options = " and ".join(map(form.format, walker.section))
    feasible = type(walker).feasible
    about = feasible.__doc__ if feasible is not wj.System.feasible else None
    condition = (about or "").strip().partition("\n")[0].rstrip(".")
    why = f": {condition}" if condition else ""
    raise WrongUse(f"{options} must be a feasible start, not {start}{why}")

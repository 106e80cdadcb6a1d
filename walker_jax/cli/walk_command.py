"""`walker-jax walk`."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from jaxtyping import Float

import walker_jax as wj
from walker_jax import storage
from walker_jax.basins.windows import film_window
from walker_jax.checks import WrongUse
from walker_jax.cli.answers import check_film, request_for, tell
from walker_jax.cli.conclusions import conclude_walk
from walker_jax.cli.groups import option
from walker_jax.cli.options import (
    OUTPUT,
    check_finite,
    refuse_without_ground,
    refuse_without_picture,
)
from walker_jax.cli.section import Start, begin_at, has_own_options, has_plane
from walker_jax.cli.walker_options import takes_walker
from walker_jax.execution.progress import bar
from walker_jax.systems.outcomes import name_of_outcome, outcome_in_words
from walker_jax.systems.system import System
from walker_jax.walkers.model import State, moves_like

PAPER_START = {"theta": 0.2, "thetadot": -0.21645}
"""The start of the walk in Table 1 of Schwab and Wisse (2001)."""
FRAME_INTERVAL = 0.15
"""Time between two frames of a film: 1/20 s for legs of one metre."""


@dataclass(frozen=True)
class Options:
    theme = "Walk"
    strides: int = option(9, "Strides at most.", min=1, max=1_000_000)
    ground: float | None = option(None, "Standard deviation of the steps of rough ground.", min=0)
    seed: int = option(0, "Seed of random numbers.", min=0)
    animate: Path | None = option(
        None, "Where a film goes, .gif, or .mp4 if the program ffmpeg is installed."
    )
    overwrite: bool = option(False, "Replace what is there.", **OUTPUT)
    as_json: bool = option(False, "Print the answer as JSON.", "--json", **OUTPUT)

    def heights(self) -> Float[np.ndarray, " strides"] | None:
        """Return the heights of the steps of rough ground, if it is rough."""
        if self.ground is None:
            return None
        return self.ground * np.random.default_rng(self.seed).normal(size=self.strides)


@takes_walker(systems=True)
def walk(walker: System, start: Start, options: Options) -> None:
    """Walk from one start, stride by stride, until a failure.

    With --ground each foothold is higher or lower than the one before, at random. States are full
    ones then: the legs' angles and their rates.

    By default the simplest walker starts at theta 0.2, thetadot -0.21645, any other in its gait. A
    film shows the walker, about as fast as one with legs of one metre, and its trajectory in the
    basin.
    """
    check_finite(ground=options.ground)
    refuse_without_ground(walker, ground=options.ground)
    refuse_without_picture(walker, animate=options.animate)
    given = start.coordinates(walker)
    if moves_like(walker, wj.SimplestWalker):
        given = PAPER_START | given
    ground = {} if options.ground is None else {"ground": options.ground, "seed": options.seed}
    request = request_for("walk", walker, start=given, strides=options.strides, **ground)
    if options.animate is not None:
        check_film(options.animate, request, overwrite=options.overwrite)
    with bar("walk", True):
        begin = begin_at(walker, given)
        made = wj.walk(walker, begin, options.strides, ground=options.heights())
    outcomes = np.asarray(made.outcomes)
    if outcomes[0] == wj.Outcome.OUTSIDE:
        refuse_start(walker, begin)
    completed = int((outcomes == wj.Outcome.STRIDE).sum())
    count = min(completed + 1, options.strides)
    answer: dict[str, Any] = {
        "states": np.asarray(made.states)[: completed + 1],
        "outcomes": [name_of_outcome(one, walker.failures) for one in outcomes[:count].tolist()],
        "times": np.asarray(made.times)[:count],
    }
    if options.animate is not None:
        draw_film(walker, begin, options, options.animate, storage.signature(request))
    rough = options.ground is not None
    coordinates = State._fields if rough else walker.section
    lines = [*walk_in_words(answer, coordinates, rough=rough)]
    lines += [f"film {options.animate}"] * (options.animate is not None)
    tell(answer, lines, as_json=options.as_json)


def draw_film(walker: System, begin: Any, options: Options, place: Path, signature: str) -> None:
    """Save the film of a walk."""
    from walker_jax import figures

    heights, data = options.heights(), None
    motion = wj.motion(walker, begin, options.strides, step=FRAME_INTERVAL, ground=heights)
    if has_plane(walker):
        data = wj.basin(walker, film_window(walker, begin), "direct", progress=True)
    figures.film(motion, place, data, signature=signature, progress=True)


def walk_in_words(answer: dict, coordinates: tuple[str, ...], *, rough: bool) -> Iterator[str]:
    """Write a line for each stride."""
    row = lambda values: "  ".join(f"{value:10.6f}" for value in values)
    heads = "  ".join(f"{name:>10}" for name in coordinates)
    yield f"{'stride':>6}  {heads}  {'time':>8}  outcome"
    strides = zip(answer["states"], answer["outcomes"], answer["times"], strict=False)
    for i, (state, name, duration) in enumerate(strides, start=1):
        time = "-" if np.isnan(duration) else f"{duration:.4f}"
        yield f"{i:6}  {row(state)}  {time:>8}  {outcome_in_words(name)}"
    if len(answer["states"]) > len(answer["outcomes"]):
        yield f"{'next':>6}  {row(answer['states'][-1])}"
    yield conclude_walk(answer["outcomes"], rough=rough)


def refuse_start(walker: System, start: Float[np.ndarray, " section"]) -> NoReturn:
    """Raise `WrongUse` for a start that is not feasible, with the condition that it violates."""
    form = "--{}" if has_own_options(walker) else "--start {}=VALUE"
    options = " and ".join(map(form.format, walker.section))
    feasible = type(walker).feasible
    about = feasible.__doc__ if feasible is not System.feasible else None
    condition = (about or "").strip().partition("\n")[0].rstrip(".")
    why = f": {condition}" if condition else ""
    raise WrongUse(f"{options} must be a feasible start, not {start.tolist()}{why}")

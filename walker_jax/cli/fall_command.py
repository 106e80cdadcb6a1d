"""`walker-jax fall`."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

import walker_jax as wj
from walker_jax import storage
from walker_jax.checks import WrongUse
from walker_jax.cli.answers import check_figure, check_film, draw, request_for, tell
from walker_jax.cli.conclusions import conclude_fall
from walker_jax.cli.groups import option
from walker_jax.cli.options import OUTPUT, check_finite
from walker_jax.cli.walk_command import FRAME_INTERVAL
from walker_jax.cli.walker_options import takes_walker
from walker_jax.execution.progress import bar
from walker_jax.stability.disturbances import BEYOND
from walker_jax.stability.probable_falls import ProbableFall
from walker_jax.systems.outcomes import Outcome, outcome_in_words
from walker_jax.walkers.model import Walker, check_planar
from walker_jax.walkers.parameters import describe_in_words

CONVERGED = 1e-6
"""Residual (rad) above which the answer warns that the search has not converged."""


@dataclass(frozen=True)
class Disturbances:
    """Standard deviations of the disturbances in each stride."""

    theme = "Disturbances"
    ground: float | None = option(None, "Standard deviation of steps (default: 0.0002).", min=0)
    tilt: float = option(0.0, "Standard deviation of changes of the slope, rad.", min=0)
    push: float = option(0.0, "Standard deviation of pushes, changes of thetadot.", min=0)
    strides: int = option(12, "Number of disturbed strides.", min=1, max=32)
    way: Literal["forward", "backward", "running", "stopped"] | None = option(
        None, "The fall that counts (default: any)."
    )

    def deviations(self) -> wj.Disturbance:
        """Return the deviations of steps, slopes and pushes; by default there are only steps."""
        check_finite(ground=self.ground, tilt=self.tilt, push=self.push)
        none = self.ground is None and not (self.tilt or self.push)
        ground = 2e-4 if none else self.ground or 0.0
        if not (ground or self.tilt or self.push):
            raise WrongUse("--ground must be above 0, not 0.0, unless --tilt or --push is given")
        return wj.Disturbance(ground, self.tilt, self.push)


@dataclass(frozen=True)
class Pictures:
    theme = "Output"
    figure: Path | None = option(None, "Where a picture goes.")
    animate: Path | None = option(None, "Where a film of the fall goes, on steps alone.")
    overwrite: bool = option(False, "Replace what is there.", **OUTPUT)
    as_json: bool = option(False, "Print the answer as JSON.", "--json", **OUTPUT)


@takes_walker()
def fall(walker: Walker, disturbances: Disturbances, pictures: Pictures) -> None:
    """Find the most probable fall: the least disturbances that topple the walker.

    Under slight disturbances nearly all falls are like this one, or with --way all of that kind.
    The mean number of strides until such a fall follows from its action.
    """
    check_planar(walker)
    deviations = disturbances.deviations()
    way = None if disturbances.way is None else Outcome[disturbances.way.upper()]
    about = {"deviations": list(deviations), "strides": disturbances.strides, "way": way}
    request = request_for("fall", walker, **about)
    if pictures.figure is not None:
        check_figure(pictures.figure, request, overwrite=pictures.overwrite)
    if pictures.animate is not None:
        if deviations.slope or deviations.push:
            raise WrongUse("--animate is for steps alone: leave out --tilt and --push")
        check_film(pictures.animate, request, overwrite=pictures.overwrite)
    with bar("search for falls", True):
        found = wj.most_probable_fall(walker, deviations, strides=disturbances.strides, outcome=way)
    if pictures.figure is not None:
        from walker_jax import figures

        draw(figures.probable_fall(found, walker), pictures.figure, request)
    if pictures.animate is not None:
        draw_film(walker, found, pictures.animate, request)
    answer: dict[str, Any] = {"walker": request["walker"], "deviations": deviations._asdict()}
    answer |= {name: getattr(found, name) for name in ("action", "disturbances", "strides")}
    answer |= {"outcome": found.outcome.name, "residual": found.residual}
    answer |= {"mean_strides": found.mean_strides(), "actions": found.actions}
    answer["log_mean_strides"] = found.log_mean_strides()
    lines = [*fall_in_words(walker, found, deviations, chosen=way is not None)]
    told = conclude_fall(
        converged=found.residual < CONVERGED,
        chosen=way is not None,
        steps_only=not (deviations.slope or deviations.push),
        filmed=pictures.animate is not None,
    )
    lines.append(f"  {told}")
    shown = {"picture": pictures.figure, "film": pictures.animate}
    lines += [f"{name} {place}" for name, place in shown.items() if place is not None]
    tell(answer, lines, as_json=pictures.as_json)


def draw_film(walker: Walker, found: ProbableFall, place: Path, request: dict) -> None:
    """Save the film of this fall, on steps just above the least ones."""
    from walker_jax import figures

    heights = np.zeros(found.strides + 1)
    disturbed = BEYOND[0] * found.disturbances[:, 0]
    count = min(len(disturbed), len(heights))
    heights[:count] = disturbed[:count]
    begin = wj.find_gait(walker).states[0]
    motion = wj.motion(walker, begin, len(heights), step=FRAME_INTERVAL, ground=heights)
    figures.film(motion, place, signature=storage.signature(request), progress=True)


def fall_in_words(
    walker: Walker, found: ProbableFall, deviations: wj.Disturbance, *, chosen: bool
) -> Iterator[str]:
    """Write the answer of `fall`."""
    yield f"Most probable fall, {describe_in_words(walker)}"
    words = outcome_in_words(found.outcome.name)
    yield f"  {words} after {found.strides} strides; action {found.action:.6g}"
    mean = found.mean_strides()
    rare = (
        f"10^{found.log_mean_strides() / math.log(10):.1f}" if math.isinf(mean) else f"{mean:.4g}"
    )
    yield f"  strides to {'that' if chosen else 'a'} fall, on average: {rare}"
    if not found.residual < CONVERGED:
        yield f"  not converged: {found.residual:.2g} rad off the least one; strides are rough"
    kinds = [name for name, value in deviations._asdict().items() if value]
    yield "  " + "  ".join([f"{'stride':>6}", *(f"{name:>13}" for name in kinds)])
    for i, row in enumerate(found.disturbances, start=1):
        shown = [value for value, one in zip(row, deviations, strict=True) if one]
        yield "  " + "  ".join([f"{i:6}", *(f"{value:13.6g}" for value in shown)])

"""`walker-jax fall`."""

import math
from pathlib import Path

import walker_jax as wj
from walker_jax.cli import library as lib
from walker_jax.cli.answers import OVERWRITE, check_picture, draw, request_for
from walker_jax.cli.commands import command
from walker_jax.cli.options import Choice, option
from walker_jax.cli.walk_command import FRAME_INTERVAL
from walker_jax.refusals import WrongUse

CONVERGED = 1e-6
"""Residual (rad) above which the answer warns that the search has not converged."""
STEPS = 2e-4
"""Standard deviation of steps where no disturbance is given."""


@command(
    examples=(
        "fall --walker spring --slope 0.01 --hip-stiffness 0.2 --figure fall.png",
        "fall --walker round-foot --slope 0.01 --ground 0.0004",
        "fall --slope 0.009 --push 0.001 --way backward",
    ),
    time="Half a minute.",
)
def fall(
    walker: "wj.Walker",
    ground: float | None = option(
        None, f"Standard deviation of steps (default: {STEPS}).", least=0
    ),
    tilt: float = option(0.0, "Standard deviation of changes of the slope, rad.", least=0),
    push: float = option(0.0, "Standard deviation of pushes, changes of thetadot.", least=0),
    strides: int = option(12, "Number of disturbed strides.", most=32),
    way: str | None = option(
        None,
        "The fall that counts (default: any).",
        type=Choice("forward", "backward", "running", "stopped"),
    ),
    figure: Path | None = option(None, "Where a picture goes."),
    animate: Path | None = option(None, "Where a film of the fall goes, on steps alone."),
    overwrite: bool = OVERWRITE,
):
    """Find the most probable fall: the least disturbances that topple the walker.

    Under slight disturbances nearly all falls are like this one, or with --way all of that kind.
    The mean number of strides until such a fall follows from its action.
    """
    lib.check_planar(walker)
    others = tilt or push
    ground = STEPS if ground is None and not others else ground or 0.0
    if not (ground or others):
        raise WrongUse("--ground must be above 0, not 0.0, unless --tilt or --push is given")
    deviations = wj.Disturbance(ground, tilt, push)
    outcome = None if way is None else wj.Outcome[way.upper()]
    about = {"deviations": list(deviations), "strides": strides, "way": outcome}
    request = request_for("fall", walker, **about)
    check_picture(figure, request, overwrite=overwrite)
    if animate is not None and (deviations.slope or deviations.push):
        raise WrongUse("--animate is for steps alone: leave out --tilt and --push")
    check_picture(animate, request, overwrite=overwrite, film=True)
    with lib.bar("search for falls", True):
        found = wj.most_probable_fall(walker, deviations, strides=strides, outcome=outcome)
    if figure is not None:
        draw(wj.figures.probable_fall(found, walker), figure, request)
    if animate is not None:
        draw_film(walker, found, animate, request)
    yield {
        "walker": request["walker"],
        "deviations": deviations._asdict(),
        "action": found.action,
        "disturbances": found.disturbances,
        "strides": found.strides,
        "outcome": found.outcome.name,
        "residual": found.residual,
        "mean_strides": found.mean_strides(),
        "actions": found.actions,
        "log_mean_strides": found.log_mean_strides(),
    }
    yield f"Most probable fall, {lib.describe_in_words(walker)}"
    words = lib.outcome_in_words(found.outcome.name)
    yield f"  {words} after {found.strides} strides; action {found.action:.6g}"
    power = f"10^{found.log_mean_strides() / math.log(10):.1f}"
    mean = power if math.isinf(found.mean_strides()) else f"{found.mean_strides():.4g}"
    yield f"  strides to {'a' if way is None else 'that'} fall, on average: {mean}"
    if not found.residual < CONVERGED:
        yield f"  not converged: {found.residual:.2g} rad off the least one; strides are rough"
    kinds = [name for name, value in deviations._asdict().items() if value]
    yield "  " + "  ".join([f"{'stride':>6}", *(f"{name:>13}" for name in kinds)])
    for i, row in enumerate(found.disturbances, start=1):
        values = [value for value, one in zip(row, deviations, strict=True) if one]
        yield "  " + "  ".join([f"{i:6}", *(f"{value:13.6g}" for value in values)])
    if found.residual < CONVERGED:
        kind = "" if way is None else "of this kind "
        yield f"  Under slight disturbances nearly all falls {kind}are like this one."
    else:
        yield "  The search has not converged: another --strides may give a more probable fall."
    if figure is not None:
        yield f"picture {figure}"
    if animate is not None:
        yield f"film {animate}"


def draw_film(walker: "wj.Walker", found: "lib.ProbableFall", place: Path, request: dict) -> None:
    """Save the film of this fall, on steps just above the least ones; the highest one is slowed."""
    heights = lib.numpy.zeros(found.strides + 1)
    disturbed = lib.BEYOND[0] * found.disturbances[: len(heights), 0]
    heights[: len(disturbed)] = disturbed
    begin = wj.find_gait(walker).states[0]
    motion = wj.motion(walker, begin, len(heights), step=FRAME_INTERVAL, ground=heights)
    decisive = int(lib.numpy.abs(heights).argmax())
    signature = lib.storage.signature(request)
    wj.figures.film(motion, place, slow=decisive, signature=signature, progress=True)

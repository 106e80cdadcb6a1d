"""`walker-jax viable`."""

from typing import Any

import walker_jax as wj
from walker_jax.cli import library as lib
from walker_jax.cli.answers import Output, Pieces, request_for, terms_of
from walker_jax.cli.commands import command
from walker_jax.cli.options import RANGE, Axis, hyphenated, named, option
from walker_jax.cli.section import axes_option, grid_of, window_on
from walker_jax.refusals import WrongUse


@command(
    examples=(
        "viable --walker powered --action push-off=0:0.1:17 --theta 0 0.8 160 --sum -0.4 0.05 180",
        "viable --system torso-wheel --action lean=0.1:0.9:9 --axis thetadot=-1.2:0:30 --axis "
        "psi=-0.4:1.2:32 --axis psidot=-1:1:20",
    ),
    time="Half a minute for the first example.",
    out="viable.zarr",
)
def viable(
    walker: "wj.System",
    pieces: Pieces,
    output: Output,
    actions: dict[str, Axis] = named(
        "A parameter that is chosen anew before each stride, with N values; all combinations of "
        "several.",
        RANGE,
        flags=["--action"],
    ),
    axes: dict[str, Any] = axes_option("Window"),
    no_bounds: bool = option(False, "Do not bound the area, which halves the time."),
    levels: int = option(
        0, "Halve cells between the bounds this many times: narrows the bounds.", least=0, most=8
    ),
):
    """Compute how large the basin could be: from where some choice of actions walks for ever.

    Before each stride a controller chooses a value for each --action, such as the push-off. The
    viability kernel holds the states from which it can go on for ever on the window; beyond it no
    controller prevents a failure. Those from which a few strides lead into the passive basin are
    counted too. The window must hold all coordinates of the section: of two, its default is that of
    the command basin; of three, --axis gives each, and the picture is the slice in the middle.
    """
    known = lib.numbers_of(walker)
    if not actions:
        example = "--action push-off=0:0.1:16"
        raise WrongUse(f"--action NAME={RANGE} is required, such as {example}")
    for name, (low, high, _) in actions.items():
        if name not in known:
            names = ", ".join(map(hyphenated, known))
            raise WrongUse(f"--action must be of {names}, not of {hyphenated(name)}")
        lib.check_parameter(walker, name, low, high)
    if len(walker.section) > 2 and not axes:
        section = ", ".join(walker.section)
        raise WrongUse(
            f"--axis NAME={RANGE} is required for each of {section}: a slice is not enough"
        )
    axes = window_on(walker, axes, most=3)
    if no_bounds and levels:
        raise WrongUse("--levels narrows the bounds: leave out --no-bounds")
    how: Any = {"bounds": not no_bounds, "levels": levels}
    request = request_for("viable", walker, axes=axes, actions=actions, **how)
    how |= {"cluster": pieces.cluster, **output.place(request)}

    compute = lambda: wj.viable(walker, grid_of(walker, axes), actions, **how)
    data = output.produce(request, compute, "viability", kept=True)
    answer = {"walker": request["walker"], "actions": actions} | lib.summarise_viability(data)
    yield answer
    yield f"Viability kernel, {lib.describe_in_words(walker)}"
    ranges = [f"{name} {low:g} to {high:g}" for name, (low, high, _) in actions.items()]
    yield f"  actions: {', '.join(ranges)}"
    between = ""
    if answer["inner_area"] is not None:
        between = f", between {answer['inner_area']:.4g} and {answer['outer_area']:.4g}"
    yield f"  area {answer['area']:.6g}{between}; passive basin {answer['target_area']:.6g}"
    for n, one in enumerate(answer["levels"] if levels else []):
        areas = f"between {one['inner_area']:.4g} and {one['outer_area']:.4g}"
        yield f"  level {n}: {areas}, {one['mapped']} cells mapped"
    step = terms_of(walker).step
    for n, area in enumerate(answer["capturable"], 1):
        yield f"  caught within {n} {step}{'s' * (n > 1)}: {area:.6g}"
    yield (
        "  In this window, as far as the grid tells, no controller with these actions has a "
        "larger basin than the kernel."
    )
    yield output.places()

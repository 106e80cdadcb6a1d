"""`walker-jax viable`."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import walker_jax as wj
from walker_jax.basins.windows import fill_around_gait, grid_along
from walker_jax.checks import WrongUse
from walker_jax.cli.answers import Output, request_for
from walker_jax.cli.conclusions import conclude_kernel
from walker_jax.cli.groups import option
from walker_jax.cli.options import RANGE_FORM, Pieces, hyphenated, read_range, refuse_again
from walker_jax.cli.section import Window
from walker_jax.cli.walker_options import takes_walker
from walker_jax.control.viability import summarise_viability
from walker_jax.systems.system import System, numbers_of
from walker_jax.walkers.parameters import check_parameter, describe_in_words


@dataclass(frozen=True)
class WholeWindow(Window):
    """A window without slices."""

    at_phidot: float | None = option(None, "", hidden=True)
    axis: list[str] | None = option(
        None, "An axis by name, for each coordinate of the section.", metavar=RANGE_FORM
    )


@dataclass(frozen=True)
class Options:
    theme = "Actions"
    action: list[str] | None = option(
        None,
        "A parameter that is chosen anew before each stride, with N values; all combinations of "
        "several.",
        metavar=RANGE_FORM,
    )
    no_bounds: bool = option(False, "Do not bound the area, which halves the time.")
    levels: int = option(
        0,
        "Halve cells between the bounds this many times: narrows the bounds.",
        min=0,
        max=8,
    )


@takes_walker(systems=True)
def viable(
    walker: System,
    window: WholeWindow,
    options: Options,
    pieces: Pieces,
    output: Output = Output(Path("viable.zarr")),
) -> None:
    """Compute how large the basin could be: from where some choice of actions walks for ever.

    Before each stride a controller chooses a value for each --action, such as the push-off. The
    viability kernel holds the states from which it can go on for ever on the window; beyond it no
    controller prevents a failure. Those from which a few strides lead into the passive basin are
    counted too. The window must hold all coordinates of the section: of two, its default is that of
    the command basin; of three, --axis gives each, and the picture is the slice in the middle.
    """
    actions = actions_of(walker, options.action or [])
    if len(walker.section) > 2 and not window.axis:
        section = ", ".join(walker.section)
        raise WrongUse(
            f"--axis NAME=LO:HI:N is required for each of {section}: a slice is not enough"
        )
    axes = window.axes(walker, most=3)
    how: dict[str, Any] = {"bounds": not options.no_bounds, "levels": options.levels}
    if options.no_bounds and options.levels:
        raise WrongUse("--levels narrows the bounds: leave out --no-bounds")
    request = request_for("viable", walker, axes=axes, actions=actions, **how)
    how |= {"cluster": pieces.cluster(), "progress": True, **output.place(request)}

    def compute():
        return wj.viable(walker, grid_along(fill_around_gait(walker, axes)), actions, **how)

    data = output.produce(request, compute, "viability", kept=True)
    answer = {"walker": request["walker"], "actions": actions} | summarise_viability(data)
    output.tell(answer, kernel_in_words(walker, answer))


def actions_of(walker: System, texts: list[str]) -> dict[str, tuple[float, float, int]]:
    """Read the range of each parameter that --action names."""
    if not texts:
        raise WrongUse(f"--action {RANGE_FORM} is required, such as --action push-off=0:0.1:16")
    actions: dict[str, tuple[float, float, int]] = {}
    for text in texts:
        name, low, high, count = read_range("--action", text)
        refuse_again("--action", name, actions)
        if name not in (known := numbers_of(walker)):
            names = ", ".join(map(hyphenated, known))
            raise WrongUse(f"--action must be of {names}, not of {hyphenated(name)}")
        check_parameter(walker, name, low, high)
        actions[name] = low, high, count
    return actions


def kernel_in_words(walker: System, answer: dict) -> Iterator[str]:
    """Write the answer of `viable`."""
    yield f"Viability kernel, {describe_in_words(walker)}"
    ranges = [f"{name} {low:g} to {high:g}" for name, (low, high, _) in answer["actions"].items()]
    yield f"  actions: {', '.join(ranges)}"
    between = ""
    if answer["inner_area"] is not None:
        between = f", between {answer['inner_area']:.4g} and {answer['outer_area']:.4g}"
    yield f"  area {answer['area']:.6g}{between}; passive basin {answer['target_area']:.6g}"
    levels = answer["levels"] if len(answer["levels"]) > 1 else []
    for n, one in enumerate(levels):
        areas = f"between {one['inner_area']:.4g} and {one['outer_area']:.4g}"
        yield f"  level {n}: {areas}, {one['mapped']} cells mapped"
    for n, area in enumerate(answer["capturable"], 1):
        yield f"  caught within {n} {'stride' if n == 1 else 'strides'}: {area:.6g}"
    yield f"  {conclude_kernel(answer['area'], answer['target_area'])}"

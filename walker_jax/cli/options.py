"""Options that several commands have, and checks of what is given for them."""

import math
from collections.abc import Callable, Container
from dataclasses import dataclass
from typing import Annotated, Any

import typer

from walker_jax.checks import WrongUse
from walker_jax.cli.groups import option
from walker_jax.cli.rewording import option_of
from walker_jax.systems.system import System
from walker_jax.walkers.model import Walker
from walker_jax.walkers.parameters import check_parameter

Json = Annotated[bool, typer.Option("--json", help="Print the answer as JSON.")]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace what is there.")]
OUTPUT = {"rich_help_panel": "Output"}
"""Of options in another group, which the help has beside those of output."""
RANGE_FORM = "NAME=LO:HI:N"
PHIDOT_HELP = "Rate between the legs, on sections that have it"


@dataclass(frozen=True)
class Pieces:
    """Who computes the pieces of a data set."""

    theme = "Processes"
    workers: int | None = option(None, "Processes that share the cores (Dask).", min=1)
    scheduler: str | None = option(
        None, "Of a Dask cluster, to compute pieces there.", metavar="ADDRESS"
    )

    def cluster(self) -> int | str | None:
        """Worker processes, the scheduler's, or, by None, this process."""
        return self.scheduler if self.workers is None else self.workers


def refuse(reason: str, **options: Any) -> None:
    """Refuse the first of these options that is given, for a reason."""
    for name, given in options.items():
        if given is not None:
            raise WrongUse(f"{option_of(name)} {reason}")


def refuse_for_systems(walker: System, **options: Any) -> None:
    """Refuse options that only walkers have."""
    if not isinstance(walker, Walker):
        refuse(f"is for walkers, not for {walker.label()}: leave it out", **options)


def check_finite(**options: float | None) -> None:
    """Refuse NaN and infinity for options of these names."""
    for name, value in options.items():
        if value is not None and not math.isfinite(value):
            raise WrongUse(f"{option_of(name)} must be finite, not {value}")


def check_range(walker: System, name: str, low: float, high: float) -> None:
    """Refuse values that the parameter cannot have, and those that --from and --to do not order."""
    check_parameter(walker, name, low, high)
    if not low < high:
        raise WrongUse(f"--from {low:g} must be below --to {high:g}")


def read_numbers(
    option: str, form: str, kinds: tuple[Callable, ...], text: str
) -> tuple[str, list[Any]]:
    """The name of a parameter and the numbers in a text like NAME=LO:HI, numbers of these kinds.

    The name may have hyphens or underscores.
    """
    name, _, numbers = text.partition("=")
    try:
        pairs = zip(kinds, numbers.split(":"), strict=True)
        return underscored(name), [kind(number) for kind, number in pairs]
    except ValueError:
        raise WrongUse(f"{option} must be {form}, not {text}") from None


def read_range(option: str, text: str) -> tuple[str, float, float, int]:
    """The name of a parameter, the ends of its range, and how many values it has there."""
    kinds = float, float, int
    name, (low, high, count) = read_numbers(option, RANGE_FORM, kinds, text)
    if not low < high or count < 2 or not math.isfinite(high - low):
        raise WrongUse(f"{option} {text} must have LO below HI, both finite, and N of 2 or more")
    return name, low, high, count


def refuse_again(option: str, name: str, earlier: Container[str]) -> None:
    """Refuse an option that was given for a name before."""
    if name in earlier:
        raise WrongUse(f"{option} is given twice for {hyphenated(name)}")


def hyphenated(name: str) -> str:
    """A name of the library as users type it."""
    return name.replace("_", "-")


def underscored(name: str) -> str:
    """A name as users type it, as the library has it."""
    return name.replace("-", "_")

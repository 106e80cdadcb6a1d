"""Options that several commands share, and checks of their values."""

import math
from collections.abc import Callable, Container
from dataclasses import dataclass
from typing import Annotated, Any

import typer

from walker_jax.checks import WrongUse
from walker_jax.cli.groups import option
from walker_jax.cli.rewording import option_of
from walker_jax.systems.system import System
from walker_jax.walkers.model import is_planar
from walker_jax.walkers.parameters import check_parameter

Json = Annotated[bool, typer.Option("--json", help="Print the answer as JSON.")]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace what is there.")]
OUTPUT = {"rich_help_panel": "Output"}
"""Setting that puts an option among those of output in the help, whatever its group."""
RANGE_FORM = "NAME=LO:HI:N"
PHIDOT_HELP = "Rate between the legs, on sections that have it"


@dataclass(frozen=True)
class Pieces:
    """The processes that compute the pieces of a data set."""

    theme = "Processes"
    workers: int | None = option(None, "Processes that share the cores (Dask).", min=1)
    scheduler: str | None = option(
        None, "Scheduler of a Dask cluster, to compute pieces there.", metavar="ADDRESS"
    )

    def cluster(self) -> int | str | None:
        """Return the number of workers or the scheduler's address; None stands for this process."""
        return self.scheduler if self.workers is None else self.workers


def refuse(reason: str, **options: Any) -> None:
    """Refuse the first of these options that is given, for this reason."""
    for name, given in options.items():
        if given is not None:
            raise WrongUse(f"{option_of(name)} {reason}")


def refuse_without_picture(walker: System, **options: Any) -> None:
    """Refuse options that are only for systems whose walks are drawn."""
    if walker.picture() is None:
        refuse(f"is for walkers, not for {walker.label()}: leave it out", **options)


def refuse_without_ground(walker: System, **options: Any) -> None:
    """Refuse options that are only for systems on ground that may be rough."""
    if not is_planar(walker):
        refuse(f"is for walkers in the plane, not for {walker.label()}: leave it out", **options)


def check_finite(**options: float | None) -> None:
    """Refuse NaN and infinity as values of these options."""
    for name, value in options.items():
        if value is not None and not math.isfinite(value):
            raise WrongUse(f"{option_of(name)} must be finite, not {value}")


def check_range(walker: System, name: str, low: float, high: float) -> None:
    """Refuse values that the parameter cannot have, and a range that does not rise."""
    check_parameter(walker, name, low, high)
    if not low < high:
        raise WrongUse(f"--from {low:g} must be below --to {high:g}")


def read_numbers(
    option: str, form: str, kinds: tuple[Callable, ...], text: str
) -> tuple[str, list[Any]]:
    """Read a text like NAME=LO:HI: the name of a parameter, and numbers of these kinds.

    The name may have hyphens or underscores.
    """
    name, _, numbers = text.partition("=")
    try:
        pairs = zip(kinds, numbers.split(":"), strict=True)
        return underscored(name), [kind(number) for kind, number in pairs]
    except ValueError:
        raise WrongUse(f"{option} must be {form}, not {text}") from None


def read_range(option: str, text: str) -> tuple[str, float, float, int]:
    """Read the name of a parameter, the ends of its range, and the number of its values."""
    kinds = float, float, int
    name, (low, high, count) = read_numbers(option, RANGE_FORM, kinds, text)
    if not low < high or count < 2 or not math.isfinite(high - low):
        raise WrongUse(f"{option} {text} must have LO below HI, both finite, and N of 2 or more")
    return name, low, high, count


def refuse_again(option: str, name: str, earlier: Container[str]) -> None:
    """Refuse an option that is given twice for the same name."""
    if name in earlier:
        raise WrongUse(f"{option} is given twice for {hyphenated(name)}")


def hyphenated(name: str) -> str:
    """Return a name of the library as users type it."""
    return name.replace("_", "-")


def underscored(name: str) -> str:
    """Return a typed name as it is in the library."""
    return name.replace("-", "_")

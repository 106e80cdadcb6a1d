"""The options that say which walker, or other system, a command is about."""

import inspect
import math
from collections.abc import Callable, Mapping, Sequence
from itertools import zip_longest
from typing import Annotated

import typer

from walker_jax.checks import WrongUse
from walker_jax.cli.groups import argument, arguments_of, with_arguments
from walker_jax.cli.list_walkers import ListWalkers
from walker_jax.cli.rewording import option_of
from walker_jax.systems.family import SYSTEMS
from walker_jax.systems.system import System
from walker_jax.walkers.family import WALKERS
from walker_jax.walkers.parameters import (
    Option,
    Parameter,
    options,
    parameters_of,
    with_parameter,
)
from walker_jax.walkers.references import find_system, find_walker, installed_walkers

PANEL = "Walker"
"""The panel of the help that holds these options."""
DEFAULT = "simplest"
"""The walker of a command that names none."""
PREFIX = "walker_"
"""Of the arguments for a walker's parameters: those of commands may have the same names."""
Kinds = Mapping[str, type[System] | System]
"""The walkers, or the system, that a command offers, by their names."""


def takes_walker(
    *, systems: bool = False, ranges_over: str | None = None, or_one_value: bool = False
) -> Callable:
    """Decorate a command whose first argument is a walker: `with_walker_options` replaces it.

    With `systems`, it takes any other system too. `ranges_over` is its argument that names the
    parameter that goes from --from to --to, and has no one value; without a range it may have,
    with `or_one_value`.
    """

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        vars(command).update(systems=systems, ranges_over=ranges_over, or_one_value=or_one_value)
        return command

    return decorate


def offered_kinds(command: Callable[..., None], args: Sequence[str]) -> Kinds:
    """The package's walkers, or the walker or system that the arguments of a command name."""
    name = value_of("--walker", args)
    system = value_of("--system", args) if vars(command)["systems"] else None
    if name is not None and system is not None:
        raise WrongUse("--walker and --system exclude each other: give one of them")
    name = DEFAULT if name is None else name
    try:
        if system is not None:
            return {system: find_system(system)}
        return WALKERS if name in WALKERS else {name: find_walker(name)}
    except WrongUse as error:
        raise WrongUse(f"--{error}") from error


def value_of(option: str, args: Sequence[str]) -> str | None:
    """The last value that arguments give to an option, if any."""
    value = None
    for one, following in zip_longest(args, args[1:]):
        if one == option:
            value = following
        elif one.startswith(f"{option}="):
            value = one.partition("=")[2]
    return value


def with_walker_options(command: Callable[..., None], kinds: Kinds) -> Callable[..., None]:
    """The command with options for the walkers that it offers, in the place of its walker."""
    offered, owners = offered_parameters(kinds)
    ranges_over: str | None = vars(command)["ranges_over"]

    def takes(walker, list_walkers, system=None, **given):
        values = {parameter: given.pop(PREFIX + parameter) for parameter in offered}
        values = {one: value for one, value in values.items() if value is not None}
        if ranges_over is not None:
            over, low = offered.get(given[ranges_over].replace("-", "_")), given["low"]
            if over is not None and (low is not None or not vars(command)["or_one_value"]):
                values |= lowest_value(over, low, values)
        checks = {one.name: given.pop(PREFIX + one.name) for one in offered_options(kinds)}
        chosen = [one for one, chosen in checks.items() if chosen]
        return command(walker=build_walker(kinds, system or walker, values, chosen), **given)

    accepted = walker_options(offered, owners, kinds)
    if vars(command)["systems"]:
        accepted.insert(1, SYSTEM_OPTION)
    return with_arguments([*accepted, *arguments_of(command)[1:]], command, takes)


def lowest_value(over: Parameter, low: float | None, given: Mapping[str, float]) -> dict:
    """The value from which a parameter goes up, if one is given; refuses one value of it."""
    if over.name in given:
        raise WrongUse(f"{option_of(over.name)} is not for this command: give --from and --to")
    if low is None and math.isnan(over.default):
        raise WrongUse(f"--from is required: the range of {option_of(over.name)[2:]}")
    return {} if low is None else {over.name: low}


def offered_parameters(kinds: Kinds) -> tuple[dict[str, Parameter], dict[str, list[str]]]:
    """The parameters of all walkers, and the names of the walkers that have them."""
    offered: dict[str, Parameter] = {}
    owners: dict[str, list[str]] = {}
    for name, kind in kinds.items():
        for one in parameters_of(kind):
            offered.setdefault(one.name, one)
            owners.setdefault(one.name, []).append(name)
    return offered, owners


def walker_options(
    offered: dict[str, Parameter], owners: dict[str, list[str]], kinds: Kinds
) -> list[inspect.Parameter]:
    """`--walker`, an option for each parameter, `--list-walkers`."""

    def help_of(one: Parameter) -> str:
        about = "; ".join(filter(None, (one.meaning, one.unit)))
        defaults = "required" if math.isnan(one.default) else f"default: {one.default:g}"
        for name in owners[one.name]:
            own = next(each.default for each in parameters_of(kinds[name]) if each.name == one.name)
            if own != one.default and not math.isnan(own):
                defaults += f", {name}: {own:g}"
        return f"{whose_option(owners[one.name], kinds)}{about} ({defaults})".strip()

    names = f"Its model: {' | '.join(WALKERS)}, or one's own, FILE.py:CLASS."
    model = typer.Option(
        help=names, rich_help_panel=PANEL, metavar="NAME", autocompletion=names_that_begin
    )
    accepted = [argument("walker", Annotated[str, model], DEFAULT)]
    for one in offered.values():
        number = typer.Option(
            option_of(one.name), help=help_of(one), rich_help_panel=PANEL, show_default=False
        )
        accepted.append(argument(PREFIX + one.name, Annotated[float | None, number], None))
    for one, whose in offered_options(kinds).items():
        about = f"{whose_option(whose, kinds)}{one.meaning}."
        flag = typer.Option(option_of(one.name), help=about, rich_help_panel=PANEL)
        accepted.append(argument(PREFIX + one.name, Annotated[bool, flag], False))
    return [*accepted, argument("list_walkers", ListWalkers, False)]


SYSTEM = Annotated[
    str | None,
    typer.Option(
        help=f"Any other system instead: {' | '.join(SYSTEMS)}, or one's own, FILE.py:NAME.",
        rich_help_panel=PANEL,
        metavar="NAME",
        autocompletion=lambda incomplete: [one for one in SYSTEMS if one.startswith(incomplete)],
    ),
]
SYSTEM_OPTION = argument("system", SYSTEM, None)
"""The option `--system`."""


def names_that_begin(incomplete: str) -> list[str]:
    """The walkers, those of other packages too, whose names begin so; for a shell to complete."""
    return [name for name in (*WALKERS, *installed_walkers()) if name.startswith(incomplete)]


def whose_option(owners: list[str], kinds: Kinds) -> str:
    """The walkers that have an option, unless all do."""
    return "" if len(owners) == len(kinds) else f"{', '.join(owners)}: "


def offered_options(kinds: Kinds) -> dict[Option, list[str]]:
    """What strides may be checked for, and the names of the walkers that have it."""
    offered: dict[Option, list[str]] = {}
    for name, kind in kinds.items():
        for one in options(kind) if isinstance(kind, type) else ():
            offered.setdefault(one, []).append(name)
    return offered


def build_walker(kinds: Kinds, name: str, values: dict[str, float], checks: list[str]) -> System:
    """The walker of that name, with default values for parameters that are not given."""
    kind = kinds[name]
    described = {one.name: one for one in parameters_of(kind)}
    for parameter in values:
        if parameter not in described:
            has = ", ".join(map(option_of, described))
            raise WrongUse(f"{option_of(parameter)} is not a parameter of {name}, which has {has}")
    owners = {one.name: whose for one, whose in offered_options(kinds).items()}
    for check in checks:
        if name not in owners[check]:
            whose = ", ".join(owners[check])
            raise WrongUse(f"{option_of(check)} is not an option of {name}, but of {whose}")
    values = {one.name: one.default for one in described.values()} | values
    for parameter, value in values.items():
        if math.isnan(value) and math.isnan(described[parameter].default):
            raise WrongUse(f"{option_of(parameter)} is required: {name} has no default for it")
    numbers = {parameter: described[parameter].convert(v) for parameter, v in values.items()}
    if isinstance(kind, type):
        return kind(**numbers, **dict.fromkeys(checks, True))
    for parameter in values:
        kind = with_parameter(kind, parameter, numbers[parameter])
    return kind

"""The options that say which walker a command is about."""

import functools
import inspect
from collections.abc import Callable
from typing import Annotated

import typer

from walker_jax.checks import WrongUse
from walker_jax.cli.list_walkers import ListWalkers
from walker_jax.cli.rewording import option_of, with_options_named
from walker_jax.walkers.family import WALKERS
from walker_jax.walkers.model import Walker
from walker_jax.walkers.parameters import Option, Parameter, options, parameters

PANEL = "Walker"
"""The panel of the help that holds these options."""


def takes_walker(*, without: tuple[str, ...] = ()) -> Callable:
    """Decorate a command whose first argument is a walker: it gets options for the walker instead.

    `without` are parameters that the command sets itself, from options of its own.
    """
    offered, owners = offered_parameters(without)
    accepted = walker_options(offered, owners)

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        @functools.wraps(command)
        def with_options(**given):
            name = given.pop("walker")
            given.pop("list_walkers")
            values = {parameter: given.pop(parameter) for parameter in offered}
            values = {one: value for one, value in values.items() if value is not None}
            checks = {one.name: given.pop(one.name) for one in offered_options()}
            chosen = [one for one, chosen in checks.items() if chosen]
            return command(build_walker(name, values, chosen), **given)

        own = list(inspect.signature(command).parameters.values())[1:]
        own = [one.replace(kind=inspect.Parameter.KEYWORD_ONLY) for one in own]
        signature = inspect.Signature([*accepted, *own])
        vars(with_options)["__signature__"] = signature  # which typer reads
        with_options.__annotations__ = {one.name: one.annotation for one in (*accepted, *own)}
        return with_options

    return decorate


def offered_parameters(
    without: tuple[str, ...],
) -> tuple[dict[str, Parameter], dict[str, list[str]]]:
    """The parameters of all walkers, but `without`, and the names of the walkers that have them."""
    offered: dict[str, Parameter] = {}
    owners: dict[str, list[str]] = {}
    for name, kind in WALKERS.items():
        for one in parameters(kind):
            if one.name not in without:
                offered.setdefault(one.name, one)
                owners.setdefault(one.name, []).append(name)
    return offered, owners


def walker_options(
    offered: dict[str, Parameter], owners: dict[str, list[str]]
) -> list[inspect.Parameter]:
    """`--walker`, an option for each parameter, and `--list-walkers`."""

    def help_of(one: Parameter) -> str:
        defaults = f"default: {one.default:g}"
        for name in owners[one.name]:
            if (own := default_of(name, one.name)) != one.default:
                defaults += f", {name}: {own:g}"
        return f"{whose_option(owners[one.name])}{one.meaning}; {one.unit} ({defaults})"

    def option(name: str, annotation: object, default: object) -> inspect.Parameter:
        keyword = inspect.Parameter.KEYWORD_ONLY
        return inspect.Parameter(name, keyword, default=default, annotation=annotation)

    names = " | ".join(WALKERS)
    model = typer.Option(help=f"Its model: {names}.", rich_help_panel=PANEL, metavar="NAME")
    accepted = [option("walker", Annotated[str, model], "simplest")]
    for one in offered.values():
        number = typer.Option(help=help_of(one), rich_help_panel=PANEL, show_default=False)
        accepted.append(option(one.name, Annotated[float | None, number], None))
    for one, names in offered_options().items():
        about = f"{whose_option(names)}{one.meaning}."
        flag = typer.Option(option_of(one.name), help=about, rich_help_panel=PANEL)
        accepted.append(option(one.name, Annotated[bool, flag], False))
    return [*accepted, option("list_walkers", ListWalkers, False)]


def whose_option(owners: list[str]) -> str:
    """The walkers that have an option, unless all do."""
    return "" if len(owners) == len(WALKERS) else f"{', '.join(owners)}: "


def default_of(walker: str, parameter: str) -> float:
    """The default of a parameter of the walker with that name."""
    return next(one.default for one in parameters(WALKERS[walker]) if one.name == parameter)


def offered_options() -> dict[Option, list[str]]:
    """What strides may be checked for, and the names of the walkers that have it."""
    offered: dict[Option, list[str]] = {}
    for name, kind in WALKERS.items():
        for one in options(kind):
            offered.setdefault(one, []).append(name)
    return offered


def build_walker(name: str, values: dict[str, float], checks: list[str]) -> Walker:
    """The walker of that name, with default values for parameters that are not given."""
    if name not in WALKERS:
        raise WrongUse(f"--walker must be one of {', '.join(WALKERS)}, not {name}")
    defaults = {one.name: one.default for one in parameters(WALKERS[name])}
    named = {parameter: option_of(parameter) for parameter in defaults}
    for parameter in values:
        if parameter not in defaults:
            has = ", ".join(named.values())
            raise WrongUse(f"{option_of(parameter)} is not a parameter of {name}, which has {has}")
    own = [one.name for one in options(WALKERS[name])]
    for check in checks:
        if check not in own:
            raise WrongUse(f"{option_of(check)} is not an option of {name}")
    try:
        return WALKERS[name](**(defaults | values), **dict.fromkeys(checks, True))
    except WrongUse as error:
        raise WrongUse(with_options_named(str(error), named)) from error

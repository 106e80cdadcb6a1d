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
from walker_jax.walkers.parameters import Parameter, parameters

PANEL = "Walker"
"""The panel of the help that holds these options."""


def takes_walker(*, without: tuple[str, ...] = ()) -> Callable:
    """Decorate a command whose first argument is a walker: it gets options for the walker instead.

    `without` are parameters that the command sets itself, from options of its own.
    """
    offered, owners = offered_parameters(without)
    options = walker_options(offered, owners)

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        @functools.wraps(command)
        def with_options(**given):
            name = given.pop("walker")
            given.pop("list_walkers")
            values = {parameter: given.pop(parameter) for parameter in offered}
            values = {one: value for one, value in values.items() if value is not None}
            return command(build_walker(name, values), **given)

        own = list(inspect.signature(command).parameters.values())[1:]
        own = [one.replace(kind=inspect.Parameter.KEYWORD_ONLY) for one in own]
        signature = inspect.Signature([*options, *own])
        vars(with_options)["__signature__"] = signature  # which typer reads
        with_options.__annotations__ = {one.name: one.annotation for one in (*options, *own)}
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
        whose = "" if len(owners[one.name]) == len(WALKERS) else f" {', '.join(owners[one.name])}:"
        return f"{whose} {one.meaning}; {one.unit} (default: {one.default:g})".strip()

    def option(name: str, annotation: object, default: object) -> inspect.Parameter:
        keyword = inspect.Parameter.KEYWORD_ONLY
        return inspect.Parameter(name, keyword, default=default, annotation=annotation)

    names = " | ".join(WALKERS)
    model = typer.Option(help=f"Its model: {names}.", rich_help_panel=PANEL, metavar="NAME")
    options = [option("walker", Annotated[str, model], "simplest")]
    for one in offered.values():
        number = typer.Option(help=help_of(one), rich_help_panel=PANEL, show_default=False)
        options.append(option(one.name, Annotated[float | None, number], None))
    return [*options, option("list_walkers", ListWalkers, False)]


def build_walker(name: str, values: dict[str, float]) -> Walker:
    """The walker of that name, with default values for parameters that are not given."""
    if name not in WALKERS:
        raise WrongUse(f"--walker must be one of {', '.join(WALKERS)}, not {name}")
    defaults = {one.name: one.default for one in parameters(WALKERS[name])}
    options = {parameter: option_of(parameter) for parameter in defaults}
    for parameter in values:
        if parameter not in defaults:
            has = ", ".join(options.values())
            raise WrongUse(f"{option_of(parameter)} is not a parameter of {name}, which has {has}")
    try:
        return WALKERS[name](**(defaults | values))
    except WrongUse as error:
        raise WrongUse(with_options_named(str(error), options)) from error

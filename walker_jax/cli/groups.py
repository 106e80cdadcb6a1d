"""Groups of options: dataclasses whose fields are the options of a command, by the same names."""

import dataclasses
import functools
import inspect
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Annotated, Any, Literal, get_args, get_origin

import typer

from walker_jax.cli.rewording import option_of

Command = Callable[..., None]
PLACEHOLDERS = {int: "N", float: "X", Path: "FILE", str: "NAME"}
"""Word that stands for a value in the help, by its type."""


def option(default: Any, help: str, *flags: str, **settings: Any) -> Any:
    """Make a field of a group: an option with this help and other settings of `typer.Option`."""
    return dataclasses.field(default=default, metadata={"option": (flags, help, settings)})


def placeholder(kind: Any) -> str | None:
    """Return the word for a value of this type in the help; None for a flag."""
    if get_origin(kind) is Literal:
        return "|".join(get_args(kind))
    inner = (placeholder(one) for one in get_args(kind))  # of a union, or of a list
    return PLACEHOLDERS.get(kind) or next(filter(None, inner), None)


def argument(name: str, annotation: Any, default: Any) -> inspect.Parameter:
    """Make an argument of a command, which typer turns into an option."""
    keyword = inspect.Parameter.KEYWORD_ONLY
    return inspect.Parameter(name, keyword, default=default, annotation=annotation)


def is_group(kind: Any) -> bool:
    """Return whether a class is a group of options; walkers are dataclasses too."""
    fields = dataclasses.fields(kind) if dataclasses.is_dataclass(kind) else ()
    return any("option" in field.metadata for field in fields)


def arguments_of(command: Command) -> list[inspect.Parameter]:
    """Return the arguments of a command, with each group replaced by its fields."""
    found = []
    for one in inspect.signature(command).parameters.values():
        if not is_group(one.annotation):
            found.append(argument(one.name, one.annotation, one.default))
            continue
        given = {} if one.default is one.empty else vars(one.default)
        for field in dataclasses.fields(one.annotation):
            flags, text, settings = field.metadata["option"]
            flags = flags or [option_of(field.name)] * (field.default is False)  # no --no-...
            said = {
                "metavar": placeholder(field.type),
                "rich_help_panel": getattr(one.annotation, "theme", None),
            }
            settings = said | settings
            annotation = Annotated[field.type, typer.Option(*flags, help=text, **settings)]
            found.append(argument(field.name, annotation, given.get(field.name, field.default)))
    return found


def ungrouped(command: Command) -> Command:
    """Return the command with the options of its groups as single arguments."""
    groups = {
        one.name: one.annotation
        for one in inspect.signature(command).parameters.values()
        if is_group(one.annotation)
    }

    def takes(**given):
        for name, group in groups.items():
            own = {field.name: given.pop(field.name) for field in dataclasses.fields(group)}
            given[name] = group(**own)
        return command(**given)

    return with_arguments(arguments_of(command), command, takes)


def with_arguments(own: Iterable[inspect.Parameter], command: Command, takes: Command) -> Command:
    """Return `takes` under the name of the command, with these arguments for typer to read."""
    functools.update_wrapper(takes, command)
    vars(takes)["__signature__"] = inspect.Signature([*own])  # typer reads it
    takes.__annotations__ = {one.name: one.annotation for one in own}
    return takes

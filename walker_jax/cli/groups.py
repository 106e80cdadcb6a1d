"""Options of commands in groups: dataclasses, whose fields are options by the same names."""

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
"""What stands for a value in the help, by its type."""


def option(default: Any, help: str, *flags: str, **settings: Any) -> Any:
    """A field of a group: an option with this help, and what else `typer.Option` takes."""
    return dataclasses.field(default=default, metadata={"option": (flags, help, settings)})


def placeholder(kind: Any) -> str | None:
    """A word for a value of this type, in the help; that of a flag has none."""
    if get_origin(kind) is Literal:
        return "|".join(get_args(kind))
    inner = (placeholder(one) for one in get_args(kind))  # of a union, or of a list
    return PLACEHOLDERS.get(kind) or next(filter(None, inner), None)


def argument(name: str, annotation: Any, default: Any) -> inspect.Parameter:
    """An argument of a command, which typer makes an option of."""
    keyword = inspect.Parameter.KEYWORD_ONLY
    return inspect.Parameter(name, keyword, default=default, annotation=annotation)


def is_group(kind: Any) -> bool:
    """Whether a class is a group of options; walkers are dataclasses too."""
    fields = dataclasses.fields(kind) if dataclasses.is_dataclass(kind) else ()
    return any("option" in field.metadata for field in fields)


def arguments_of(command: Command) -> list[inspect.Parameter]:
    """The arguments of a command, with the fields of groups in their places."""
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
    """The command with the options of its groups one by one."""
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
    """`takes` as the command: it has these arguments, and calls the command with its own."""
    functools.update_wrapper(takes, command)
    vars(takes)["__signature__"] = inspect.Signature([*own])  # which typer reads
    takes.__annotations__ = {one.name: one.annotation for one in own}
    return takes

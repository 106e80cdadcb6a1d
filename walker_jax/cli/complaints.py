"""Errors of typer in the package's own words: what is wrong, with which value, and what to do.

The texts of typer come from click or, in later versions, from pydantic; this module reads both. A
text of another kind stays as it is.
"""

import difflib
import re
from collections.abc import Sequence
from typing import Any

LONGEST = 60
"""Most characters of a value that are shown."""


def complaint(error: Any) -> str:
    """Write one line for an error of typer."""
    if hasattr(error, "possibilities"):
        bare = {one.strip("-"): one for one in error.possibilities or ()}
        similar = difflib.get_close_matches(error.option_name.strip("-"), bare)
        instead = did_you_mean([bare[one] for one in similar]) or help_for(error)
        return f"{shown(error.option_name)} is not an option: {instead}"
    if hasattr(error, "option_name"):
        return wrong_count(error)
    if hasattr(error, "param_type"):
        return f"{name_of(error.param)} is required: {help_for(error)}"
    if getattr(error, "param", None) is not None:
        return wrong_value(error)
    if not error.format_message():
        return "name a command, one of those above"
    said = error.format_message().rstrip(".")
    command = re.match(r"No such command (['\"])(.*?)\1(\.|$)", said, re.DOTALL)
    if command:
        return no_command(error, command[2])
    extra = re.match(r"Got unexpected extra arguments?(\(s\))? \((.*)\)$", said, re.DOTALL)
    if extra:
        return extra_argument(error, extra[2])
    return f"{shown(said, 2 * LONGEST)}: {help_for(error)}"


def no_command(error: Any, name: str) -> str:
    """Suggest the commands that may be meant, or the list of all."""
    similar = difflib.get_close_matches(name, error.ctx.command.list_commands(error.ctx))
    return (
        f"{shown(name)} is not a command: {did_you_mean(similar) or 'walker-jax --help lists all'}"
    )


def extra_argument(error: Any, words: str) -> str:
    """Suggest the option that may be meant by the first unexpected word."""
    first = (words.split() or [""])[0]
    known = [name for one in error.ctx.command.params for name in one.opts]
    similar = difflib.get_close_matches(f"--{first}", known, cutoff=0.8)
    instead = did_you_mean(similar) or help_for(error)
    return f"{shown(first)} is an argument too many: {instead}"


def did_you_mean(similar: Sequence[str]) -> str:
    """Ask whether one of these names is meant; return an empty text if there are none."""
    return f"did you mean {' or '.join(similar)}?" if similar else ""


def wrong_count(error: Any) -> str:
    """Describe an option with too few values, or a flag with a value."""
    option, count = shown(error.option_name), re.search(r"requires (\w+) argument", error.message)
    if count is None:
        return f"{option} must be given without a value"
    values = f"{count[1]} values" if count[1].isdigit() else "a value"
    return f"{option} must have {values}: {help_for(error)}"


def wrong_value(error: Any) -> str:
    """Describe which value an option or argument must have, and which it has."""
    name, message = name_of(error.param), error.message.rstrip(".")
    by_pydantic = getattr(error.__cause__, "errors", None)
    value = by_pydantic()[0]["input"] if by_pydantic else message.partition(" is not ")[0]
    end = message.removeprefix(str(value))  # so that the words of the value cannot mislead
    choices = re.search(r" is not one of (.+)$", end)
    if choices:
        must = f"one of {choices[1]}".replace("'", "")
    elif re.search(r" is not in the range |greater than|less than", end):
        must = in_bounds(error.param)
    elif re.search(r"valid (float|number)", end):
        must = "a number"
    elif re.search(r"valid integer", end):
        must = "a whole number"
    else:
        return f"{name} is not valid: {shown(message, 2 * LONGEST)}; {help_for(error)}"
    return f"{name} must be {must}, not {shown(str(value).strip(QUOTE))}"


QUOTE = "'"


def in_bounds(param: Any) -> str:
    """Write the bounds of an option in words."""
    at = param if hasattr(param, "min") else param.type
    bounds = {"at least": at.min, "at most": at.max}
    return " and ".join(f"{limit} {value}" for limit, value in bounds.items() if value is not None)


def name_of(param: Any) -> str:
    """Return an option as it is typed, or an argument as the help names it."""
    return param.opts[0] if param.param_type_name == "option" else param.opts[0].upper()


def help_for(error: Any) -> str:
    """Write where to find help."""
    if error.ctx is None:
        return "see --help of the command"
    command = "" if error.ctx.parent is None else f" {error.ctx.info_name}"
    return f"see walker-jax{command} --help"


def shown(value: str, longest: int = LONGEST) -> str:
    """Return the beginning of a value, on one line; quotes stand for an empty value."""
    return " ".join(value.split())[:longest] or "''"

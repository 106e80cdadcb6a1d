"""The pages of help: of a command its purpose, examples, then its options, theme by theme."""

import textwrap
from collections.abc import Iterable, Iterator
from typing import Any

import click

COLUMN = 21
"""Width of the column of options; their meanings stand beside it."""
MANY = 6
"""Parameters of a walker that leave no room for all else on a page of a terminal."""
OF_WALKERS = {"theta", "thetadot", "sum", "phidot", "at_phidot", "guess"}
"""Options for coordinates that only walkers have: the help of other systems leaves them out."""


def help_page(command: Any, ctx: click.Context, width: int) -> Iterator[str]:
    """Yield the parts of the help; beside a walker of many parameters, other options are named."""
    whole = ctx.obj is None or len(ctx.obj.described) < MANY
    first, *more = command.help.split("\n\n")
    arguments = [str(one.metavar) for one in command.params if isinstance(one, click.Argument)]
    yield " ".join(["walker-jax", command.name, *arguments, "[OPTIONS]"])
    yield fill(first, width)
    examples = (fill(f"  walker-jax {line}", width, 6) for line in command.examples)
    yield "\n".join(["Examples:", *examples])
    themes: dict[str, list[Any]] = {}
    for one in command.get_params(ctx):
        if not (ctx.obj and ctx.obj.system and one.name in OF_WALKERS):
            themes.setdefault(getattr(one, "theme", "Output"), []).append(one)
    described, *others = themes.items()
    for theme, options in (described, *others) if whole else (described,):
        yield section(theme, ((as_typed(one), meaning(one)) for one in options), width)
    if not whole:
        names = (f"{theme}: {', '.join(map(written, options))}" for theme, options in others)
        yield "\n".join(fill(line, width, 2) for line in names)
        yield fill(f"walker-jax {command.name} --help describes these.", width)
    yield from (fill(text, width) for text in more)
    yield fill(f"Time on two cores: {command.time}", width)


def list_page(group: Any, ctx: click.Context, width: int) -> Iterator[str]:
    """Yield the parts of the help of the program: its commands, and the options of all of them."""
    commands = ((name, group.get_command(ctx, name)) for name in group.list_commands(ctx))
    first_lines = ((name, one.help.partition("\n\n")[0]) for name, one in commands)
    options = ((as_typed(one), meaning(one)) for one in group.get_params(ctx))
    yield "walker-jax COMMAND [OPTIONS]"
    yield fill(group.help, width)
    yield section("Commands", first_lines, width, 14)
    yield section("Options", options, width)
    yield "walker-jax COMMAND --help has examples, and the options of a command."


def section(title: str, rows: Iterable[tuple[str, str]], width: int, column: int = COLUMN) -> str:
    """Write names and their meanings side by side, or one below the other if a name is long."""
    lines, indent = [f"{title}:"], column + 2
    for name, text in rows:
        beside = fill(" " * indent + text, width, indent)
        typed = f"  {name}"
        short = len(typed) <= column
        lines.append(f"{typed:{indent}}{beside.lstrip()}" if short else f"{typed}\n{beside}")
    return "\n".join(lines)


def fill(text: str, width: int, indent: int = 0) -> str:
    """Break a text into lines, indented from the second one on; words and options stay whole."""
    how: Any = {"break_on_hyphens": False, "break_long_words": False}
    return textwrap.fill(text, width, subsequent_indent=" " * indent, **how)


def as_typed(param: Any) -> str:
    """Write an option as it is typed, with the placeholder of its value."""
    if isinstance(param, click.Argument):
        return str(param.metavar)
    return written(param) if param.is_flag else f"{written(param)} {param.metavar}"


def written(param: Any) -> str:
    """Write the names of an option, the short one first."""
    return "/".join([", ".join(sorted(param.opts, key=len)), *param.secondary_opts])


def meaning(param: Any) -> str:
    """Write the help of an option, and its default."""
    text, default = param.help.removesuffix("."), param.default
    if param.required:
        return f"{text} (required)."
    if getattr(param, "is_flag", False) or default in (None, ()):
        return param.help
    return f"{text} (default: {default})."

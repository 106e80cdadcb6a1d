"""The help of a command: its purpose, examples, then its options, theme by theme."""

import textwrap
from collections.abc import Callable
from typing import Any

import typer
from typer.core import TyperCommand
from typer.main import get_command

from walker_jax.cli.examples import DURATIONS, EXAMPLES

FLAGS = 21
"""Width of the column of options; their meanings stand beside it."""
WIDTH, LINES = 80, 60
"""A page of a terminal; a walker of many parameters leaves no room there for all else."""
OTHERS = "Output"
"""Theme of the options without a group."""


class HelpfulCommand(TyperCommand):
    """A command whose help begins with examples and fits on a page or two of a terminal."""

    def format_help(self, ctx, formatter) -> None:
        whole = self.page(ctx, WIDTH).count("\n") < LINES
        formatter.write(self.page(ctx, formatter.width, whole=whole) + "\n")

    def page(self, ctx, width: int, *, whole: bool = True) -> str:
        """Write the help; unless it is `whole`, options after the first theme are only named."""
        name = str(self.name)
        arguments = [one.name.upper() for one in self.params if one.param_type_name != "option"]
        usage = " ".join([f"walker-jax {name}", *arguments, "[OPTIONS]"])
        first, *more = (self.help or "").split("\n\n")
        examples = (fill(f"  walker-jax {line}", width, 6) for line in EXAMPLES[name])
        parts = [f"{usage}\n\n{fill(first, width)}", "\n".join(["Examples:", *examples])]
        described, *others = self.themes(ctx).items()
        for theme, options in (described, *others) if whole else (described,):
            parts.append("\n".join([f"{theme}:", *(row(one, width) for one in options)]))
        if not whole:
            names = (f"{theme}: {', '.join(map(flags_of, options))}" for theme, options in others)
            parts.append("\n".join(fill(line, width, 2) for line in names))
            parts.append(fill(f"walker-jax {name} --help describes these.", width))
        parts += [fill(text, width) for text in more]
        parts.append(fill(f"Time on two cores: {DURATIONS[name]}", width))
        return "\n\n".join(parts)

    def themes(self, ctx) -> dict[str, list[Any]]:
        """Return the arguments and the visible options, by their themes."""
        found: dict[str, list[Any]] = {}
        for one in self.get_params(ctx):
            if not getattr(one, "hidden", False):
                theme = getattr(one, "rich_help_panel", None) or OTHERS
                found.setdefault(theme, []).append(one)
        return found


def command_of(name: str, text: str, function: Callable[..., None]) -> TyperCommand:
    """Make the command that calls a function, with this text in its help."""
    single = typer.Typer(add_completion=False)
    single.command(name, cls=HelpfulCommand, help=text)(function)
    command = get_command(single)
    assert isinstance(command, TyperCommand)  # and no group, as there is one command
    return command


def fill(text: str, width: int, indent: int = 0) -> str:
    """Break a text into lines, indented from the second one on; words and options stay whole."""
    spaces = " " * indent
    how: Any = {"break_on_hyphens": False, "break_long_words": False}
    return textwrap.fill(text, width, subsequent_indent=spaces, **how)


def row(param: Any, width: int) -> str:
    """Write an option and its meaning side by side, or one below the other if it is long."""
    typed, indent = f"  {as_typed(param)}", FLAGS + 2
    text = fill(" " * indent + meaning(param), width, indent)
    return f"{typed:{indent}}{text.lstrip()}" if len(typed) <= FLAGS else f"{typed}\n{text}"


def as_typed(param: Any) -> str:
    """Write an option as it is typed, with the placeholder of its value."""
    if param.param_type_name != "option":
        return param.name.upper()
    flags = flags_of(param)
    return flags if param.is_flag else f"{flags} {param.metavar}"


def flags_of(param: Any) -> str:
    """Write the names of an option, the short one first."""
    return "/".join([", ".join(sorted(param.opts, key=len)), *param.secondary_opts])


def meaning(param: Any) -> str:
    """Write the help of an option, and its default."""
    text, default = param.help or "", param.default
    if param.required:
        return f"{text.removesuffix('.')} (required)."
    if default is None or isinstance(default, bool) or not getattr(param, "show_default", True):
        return text
    return f"{text.removesuffix('.')} (default: {default})."

"""The help of a command: what it does, examples, then its options, theme by theme."""

import textwrap
from typing import Any

from typer.core import TyperCommand

from walker_jax.cli.examples import DURATIONS, EXAMPLES

FLAGS = 21
"""Width of the column of options; what they mean stands beside it."""
OTHERS = "Output"
"""The theme of options of no group."""


class HelpfulCommand(TyperCommand):
    """A command whose help begins with examples and fits on a page or two of a terminal."""

    def format_help(self, ctx, formatter) -> None:
        self.width = formatter.width
        arguments = [one.name.upper() for one in self.params if one.param_type_name != "option"]
        usage = " ".join([f"walker-jax {self.name}", *arguments, "[OPTIONS]"])
        first, *more = (self.help or "").split("\n\n")
        parts = [f"{usage}\n\n{self.paragraph(first)}", self.examples()]
        for theme, options in self.themes(ctx).items():
            parts.append("\n".join([f"{theme}:", *map(self.row, options)]))
        parts += [self.paragraph(text) for text in more]
        parts.append(self.paragraph(f"Time on two cores: {DURATIONS[str(self.name)]}"))
        formatter.write("\n\n".join(parts) + "\n")

    def paragraph(self, text: str) -> str:
        return textwrap.fill(text, self.width, break_on_hyphens=False)

    def examples(self) -> str:
        lines = (f"walker-jax {line}" for line in EXAMPLES[str(self.name)])
        fill = textwrap.TextWrapper(
            self.width,
            initial_indent="  ",
            subsequent_indent="      ",
            break_on_hyphens=False,
            break_long_words=False,
        )
        return "\n".join(["Examples:", *map(fill.fill, lines)])

    def themes(self, ctx) -> dict[str, list[Any]]:
        """The arguments and the options that are not hidden, by their theme."""
        found: dict[str, list[Any]] = {}
        for one in self.get_params(ctx):
            if not getattr(one, "hidden", False):
                theme = getattr(one, "rich_help_panel", None) or OTHERS
                found.setdefault(theme, []).append(one)
        return found

    def row(self, param: Any) -> str:
        """An option and what it means, side by side, or below where the option is long."""
        typed, indent = f"  {as_typed(param)}", " " * (FLAGS + 2)
        text = textwrap.fill(
            meaning(param),
            self.width,
            initial_indent=indent,
            subsequent_indent=indent,
            break_on_hyphens=False,
        )
        return f"{typed:{FLAGS + 2}}{text.lstrip()}" if len(typed) <= FLAGS else f"{typed}\n{text}"


def as_typed(param: Any) -> str:
    """An option as it is typed, with what stands for its values."""
    if param.param_type_name != "option":
        return param.name.upper()
    flags = "/".join([", ".join(sorted(param.opts, key=len)), *param.secondary_opts])
    return flags if param.is_flag else f"{flags} {param.metavar}"


def meaning(param: Any) -> str:
    """The help of an option, and its default."""
    text, default = param.help or "", param.default
    if param.required:
        return f"{text.removesuffix('.')} (required)."
    if default is None or isinstance(default, bool) or not getattr(param, "show_default", True):
        return text
    return f"{text.removesuffix('.')} (default: {default})."

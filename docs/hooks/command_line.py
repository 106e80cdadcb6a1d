"""The options of every command of walker-jax, from the program itself."""

import re

PLACE = "<!-- the options of every command -->"
WALKER = "Walker"
"""The theme of the options that describe a walker, the same in every command that takes one."""


def on_page_markdown(markdown, *, page, config, files):
    if PLACE not in markdown:
        return markdown
    from walker_jax.cli.app import COMMANDS, load

    commands = [load(name) for name in COMMANDS]
    walkers = {
        row: None for command in commands for row in rows(command, lambda theme: theme == WALKER)
    }
    parts = ["### Options of the walker", table(walkers)]
    for command in commands:
        own = rows(command, lambda theme: theme != WALKER)
        parts += [f"### walker-jax {command.name}", command.help, table(own)]
    return markdown.replace(PLACE, "\n\n".join(parts) + "\n")


def on_page_content(html, *, page, config, files):
    """Mark options in the text, which a browser would break after their hyphens."""
    option = lambda found: f'<span class="option">{found[0]}</span>'
    inline = r"(?<!</span>)<code>[^<]*--[^<]*</code>"
    return re.sub(inline, lambda code: re.sub(r"--[\w-]+", option, code[0]), html)


def rows(command, of) -> list[str]:
    """The rows of a command's arguments and options under themes of its help."""
    context = command.make_context(command.name, [], resilient_parsing=True)
    records = [
        one.get_help_record(context)
        for one in command.params
        if of(getattr(one, "rich_help_panel", None))
    ]
    escaped = [[text.replace("|", "\\|") for text in record] for record in records if record]
    return [f"| `{flag}` | {text} |" for flag, text in escaped]


def table(lines) -> str:
    return "\n".join(["| | |", "|---|---|", *lines])

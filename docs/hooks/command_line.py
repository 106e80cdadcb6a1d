"""The options of every command of walker-jax, from the program itself."""

import re

PLACE = "<!-- the options of every command -->"


def on_page_markdown(markdown, *, page, config, files):
    if PLACE not in markdown:
        return markdown
    from click import Context

    from walker_jax.cli.app import NAMES, load
    from walker_jax.cli.walker_options import DESCRIBED, Chosen, option_for

    def table(options):
        rows = (one.get_help_record(Context(load("walk"))) for one in options)
        escaped = ([part.replace("|", "\\|") for part in row] for row in rows if row and row[1])
        rows = [f"| `{flag}` | {text} |" for flag, text in escaped]
        return "\n".join(["| | |", "|---|---|", *rows])

    parts = ["### Options of the walker", table(Chosen("simplest", ()).options(systems=True))]
    for walker, described in DESCRIBED.items():
        parts += [f"`--walker {walker}`:", table(map(option_for, described))]
    for name in NAMES:
        command = load(name)
        parts += [f"### walker-jax {name}", command.help, command.epilog, table(command.params)]
    return markdown.replace(PLACE, "\n\n".join(parts) + "\n")


def on_page_content(html, *, page, config, files):
    """Mark options in the text, which a browser would break after their hyphens."""
    option = lambda found: f'<span class="option">{found[0]}</span>'
    inline = r"(?<!</span>)<code>[^<]*--[^<]*</code>"
    return re.sub(inline, lambda code: re.sub(r"--[\w-]+", option, code[0]), html)

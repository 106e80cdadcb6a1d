"""Messages of the library in the words of the command line."""

import re
from collections.abc import Mapping

OPTIONS = {
    "another out": "another --out",
    "another figure": "another --figure",
    "another animate": "another --animate",
    "another guess": "another --guess",
    "another slope": "another --slope",
    "a guess": "--guess THETA THETADOT",
    "the guess": "--guess",
    "or overwrite": "or --overwrite",
    "with overwrite": "with --overwrite",
    "without overwrite": "without --overwrite",
    "at_least": "--at-least",
    "at_most": "--at-most",
    "bounds of": "--bound of",
    "walker must": "--walker must",
    "objective must": "--objective must",
    "parameter must": "--over must",
    "grid is": "--theta, --sum and --at-phidot are",
}
"""Arguments of the library, as its messages name them, and the options that set them."""
OPTIONS_OF_SYSTEMS = OPTIONS | {
    "another guess": "another --start",
    "a guess": "--start NAME=VALUE",
    "the guess": "--start",
    "walker must": "--system must",
}
"""The same of a command with --system."""
GIVE = re.compile(r"(?<=; give )((?:\w+, )+)(?=or )")
"""Arguments of which a message of `gaits.selection.require_gait` lists some."""


def option_of(argument: str) -> str:
    """The option that sets an argument of the same name."""
    return f"--{argument.replace('_', '-')}"


def with_options_named(message: str, options: Mapping[str, str] = OPTIONS) -> str:
    """A message of the library that names options in the place of arguments."""
    # \b and the look-behind leave options, and longer words, as they are.
    message = GIVE.sub(
        lambda found: re.sub(r"\w+", lambda one: option_of(one[0]), found[0]), message
    )
    pattern = rf"(?<![\w-])({'|'.join(options)})\b"
    return re.sub(pattern, lambda found: options[found[0]], message)

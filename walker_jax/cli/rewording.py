"""Messages of the library with command-line options in the places of arguments."""

from typing import Any

OPTIONS = {"parameter": "--over", "bounds": "--bound", "grid": "--axis"}
"""Options whose names are not those of the arguments that they set."""


def option_of(argument: str) -> str:
    """Return the option that sets an argument of the same name."""
    return f"--{argument.replace('_', '-')}"


def message_of(error: Any) -> str:
    """Return the message of a `Refusal`, with options in the places of its arguments."""
    *before, last = map(str, error.args)
    words = last.split(" ")
    for argument in error.arguments:
        places = [i for i, word in enumerate(words) if word.rstrip(",:;") == argument]
        for i in places[-1:]:
            words[i] = words[i].replace(argument, OPTIONS.get(argument) or option_of(argument))
    return ": ".join([*before, " ".join(words)])

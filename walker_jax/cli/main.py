"""The command `walker-jax`. Each command calls the library, prints a summary, and saves the result.

Answers go to standard output; progress, warnings and the one line that says what is wrong go to
standard error. Exit code 0: done; 2: wrong usage; 1: the computation failed; 130: interrupted by
Ctrl-C; 143: terminated by SIGTERM.
"""

import atexit
import gc
import logging
import os
import signal
import sys
import warnings
from typing import NoReturn

import click

from walker_jax.cli.app import Interrupted, app, resume_notes
from walker_jax.cli.commands import complaint
from walker_jax.refusals import Refusal, WrongUse

FEW_COLLECTIONS = 50_000
"""Number of new objects after which Python looks for garbage. Tracing makes many objects, and most
of them live on. With the default of 700 a short command spends a sixth of its time on looking."""


LONGEST = 187
"""Most characters of a reason, so that a line with the program's name has less than 200."""


class Terminated(BaseException):
    """The process was told to end; unfinished files are removed on the way out."""


def main() -> NoReturn:
    gc.set_threshold(FEW_COLLECTIONS)
    atexit.register(gc.freeze)  # or Python looks for garbage before it ends, which takes a second
    # Before NumPy is loaded. Matrices are small here: more threads only wait for each other.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # Notebooks name theirs, which may not be installed here. Pictures are only written to files.
    os.environ["MPLBACKEND"] = "Agg"
    signal.signal(signal.SIGTERM, terminate)
    # One line, without the place in the code.
    warnings.formatwarning = lambda message, *_, **__: f"walker-jax: {message}\n"
    try:
        code = app.main(prog_name="walker-jax", standalone_mode=False)
    except click.Abort:  # Ctrl-C before a command begins
        stop(130, "interrupted")
    except Interrupted as error:
        stop(130, ": ".join(["interrupted", *error.args]))
    except Terminated as error:
        stop(143, ": ".join(["terminated", *resume_notes(error)]))
    except Exception as error:
        stop(*verdict(error))
    sys.exit(code if isinstance(code, int) else 0)


def verdict(error: Exception) -> tuple[int, str]:
    """Return the exit code for an error, and the reason to print."""
    if isinstance(error, click.UsageError):
        return 2, complaint(error)
    if not isinstance(error, Refusal):
        return 1, f"{type(error).__name__}: {error}"
    return (2 if isinstance(error, WrongUse) else 1), str(error)


def terminate(signal_number: int, frame: object) -> NoReturn:
    raise Terminated


def stop(code: int, reason: str) -> NoReturn:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a second one would be a traceback
    logging.getLogger("asyncio").disabled = True  # it would list the writes that end here
    print(f"walker-jax: {on_one_line(reason)}", file=sys.stderr)
    sys.exit(code)


def on_one_line(reason: str) -> str:
    """Put a reason on one line; cut the middles of long words, then of the line, if it is too long.

    The beginning, which says what is wrong, and the end, which says what to do, stay.
    """
    line = " ".join(reason.split())
    if len(line) > LONGEST:
        line = " ".join(without_middle(word, LONGEST // 3) for word in line.split())
    return without_middle(line, LONGEST)


def without_middle(text: str, longest: int) -> str:
    half = (longest - 3) // 2
    return text if len(text) <= longest else f"{text[:half]}...{text[-half:]}"

"""The command `walker-jax`. Each command asks the library, prints a summary, and keeps the result.

Answers go to standard output; progress, warnings and the one line that says what is wrong go to
standard error. Exit code 0: done; 2: wrong usage; 1: the computation failed; 130: interrupted by
Ctrl-C; 143: terminated by SIGTERM.
"""

import gc
import os
import signal
import sys
from typing import NoReturn

import jax

from walker_jax import storage
from walker_jax.checks import ComputationFailed, WrongUse
from walker_jax.cli import (  # noqa: F401 (each registers its command)
    basin_command,
    bifurcation_command,
    export_command,
    gait_command,
    optimise_command,
    reproduce_command,
    robustness_command,
    sweep_command,
    walk_command,
)
from walker_jax.cli.app import Interrupted, Terminated, app, notes_of
from walker_jax.cli.options import PLACES, with_options_named
from walker_jax.kernels.object_cache import cache_folder


def keep_compiled() -> None:
    """Keep what XLA compiles where kernels are, so that the next start is fast."""
    folder = cache_folder()
    if folder is None or "JAX_COMPILATION_CACHE_DIR" in os.environ:
        return
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return
    if os.access(folder, os.W_OK):
        jax.config.update("jax_compilation_cache_dir", str(folder))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0)


FEW_COLLECTIONS = 50_000
"""New objects after which Python looks for garbage: traces are many objects, of which most live on,
and at its default of 700 a sixth of a short command is spent on looking."""


def main() -> NoReturn:
    gc.set_threshold(FEW_COLLECTIONS)
    jax.config.update("jax_enable_x64", True)
    keep_compiled()
    signal.signal(signal.SIGTERM, terminate)
    try:
        code = app(standalone_mode=False)
    except storage.StoreConflict as error:
        what, *help_ = error.args
        stop(2, ": ".join([what, *(with_options_named(words, PLACES) for words in help_)]))
    except WrongUse as error:
        stop(2, error)
    except ComputationFailed as error:
        stop(1, error)
    except Interrupted as error:
        stop(130, ": ".join(["interrupted", *error.args]))
    except Terminated as error:
        stop(143, ": ".join(["terminated", *notes_of(error)]))
    except Exception as error:
        # typer's own: wrong usage
        message = getattr(error, "format_message", None)
        stop(2, message() or "name a command, one of those above") if message else stop(
            1, f"{type(error).__name__}: {error}"
        )
    if code == 130:  # what typer makes of Ctrl-C before a command begins
        stop(130, "interrupted")
    sys.exit(code if isinstance(code, int) else 0)


def terminate(signal_number: int, frame: object) -> NoReturn:
    raise Terminated


def stop(code: int, reason) -> NoReturn:
    print(f"walker-jax: {' '.join(str(reason).split())}", file=sys.stderr)
    sys.exit(code)

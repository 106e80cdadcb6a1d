"""The program: a group of commands, each loaded when it is named.

Their modules load without JAX, and so do their help pages and refusals of misspelt options.
"""

import difflib
from importlib import import_module

import click
from click.core import augment_usage_errors

from walker_jax.cli import library as lib
from walker_jax.cli.commands import QUIET, SETTINGS, Command, meant
from walker_jax.cli.information import COMPLETION, LIST_WALKERS, VERSION
from walker_jax.cli.options import shown
from walker_jax.refusals import WrongUse

NAMES = (
    "walk explain gait bifurcation chart explore basin boundary viable prove robustness fall "
    "continuation optimise sweep fit export reproduce"
).split()
"""The commands; `basin` is in `basin_command.py`."""


def load(name: str) -> Command:
    """Return the command of this name."""
    return getattr(import_module(f"walker_jax.cli.{name}_command"), name)


class Interrupted(BaseException):
    """The command was interrupted; the arguments say how to resume the work."""


class Commands(click.Group):
    """The group of commands."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return [*NAMES]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        return load(cmd_name) if cmd_name in NAMES else None

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        with augment_usage_errors(ctx):
            return super().parse_args(ctx, args)

    def resolve_command(self, ctx: click.Context, args: list[str]):
        if args[0] not in NAMES and not ctx.resilient_parsing:
            similar = meant(difflib.get_close_matches(args[0], NAMES))
            instead = similar or "walker-jax --help lists all"
            raise WrongUse(f"{shown(args[0])} is not a command: {instead}")
        return super().resolve_command(ctx, args)

    def invoke(self, ctx: click.Context) -> None:
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt as interruption:  # click would keep only that there was one
            raise Interrupted(*resume_notes(interruption)) from interruption


def resume_notes(interruption: BaseException) -> list[str]:
    """Return how to resume the work: the library's notes on an interruption, reworded."""
    notes = getattr(interruption, "__notes__", [])
    if not notes:
        return []
    hints = [note for note in notes if note.startswith(lib.storage.RESUME_HINT)]
    return [hint.replace("without overwrite", "without --overwrite", 1) for hint in hints]


def require_command() -> None:
    """Print the help and refuse a command line without a command."""
    ctx = click.get_current_context()
    if ctx.invoked_subcommand is None:
        print(ctx.get_help())
        raise WrongUse("name a command, one of those above")


app = Commands(
    "walker-jax",
    context_settings=SETTINGS,
    callback=require_command,
    invoke_without_command=True,
    params=[LIST_WALKERS, VERSION, COMPLETION, QUIET],
    help="Passive dynamic walkers: their gaits, and the basins of attraction of these.",
    epilog="walker-jax COMMAND --help has examples, and the options of a command.",
)

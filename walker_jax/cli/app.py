"""The application: a group of commands, each loaded only after its arguments have been checked.

So neither a help page nor a misspelt option loads JAX or the module of a command.
"""

import inspect
from collections.abc import Callable, Sequence
from importlib import import_module
from typing import Annotated

import typer
from typer.core import TyperCommand, TyperGroup

from walker_jax.cli.groups import argument, arguments_of, ungrouped, with_arguments
from walker_jax.cli.help_pages import command_of
from walker_jax.cli.known_options import check_known, refuse_both
from walker_jax.cli.list_walkers import ListWalkers
from walker_jax.cli.version import Version
from walker_jax.refusals import WrongUse

COMMANDS = {
    "walk": "Walk from one start, stride by stride, until a failure.",
    "explain": "Say why the stride from one start ends as it does, and whether a model fits "
    "together.",
    "gait": "Find the gaits of a walker: cycles of strides, and their stability.",
    "bifurcation": "Follow the gaits over the slope, or another parameter: how each is born, "
    "doubles and ends.",
    "chart": "Chart two parameters: curves of bifurcations, and the periods of attractors between "
    "them.",
    "explore": "Explore basins in a browser: drag the slope, watch the basin; click a start, watch "
    "it walk.",
    "basin": "Compute and draw the basin of attraction of a walker's gait.",
    "boundary": "Measure the boundary between walking and falling: its entropy, its saddles, Wada.",
    "viable": "Compute how large the basin could be: from where some choice of actions walks for "
    "ever.",
    "prove": "Prove that all starts near a gait walk for ever, or which of a window do.",
    "robustness": "Measure how large a disturbance a gait survives, on one slope or over many.",
    "fall": "Find the most probable fall: the least disturbances that topple the walker.",
    "continuation": "Follow the attractors over a parameter, and the fractions of a region that "
    "converge to each.",
    "optimise": "Design a walker: the parameters with the largest basin, or another objective, by "
    "gradient.",
    "sweep": "Compute basins, gaits and areas over one or more parameters, all combinations of "
    "them.",
    "export": "Copy a data set that another command has left to a NetCDF file.",
    "reproduce": "Reproduce the paper of Schwab and Wisse (2001): every figure and number, in a "
    "report.",
}
"""The commands and the first lines of their help; `basin` is a function in `basin_command.py`."""


class Interrupted(BaseException):
    """The command was interrupted; the arguments say how to resume the work."""


class Commands(TyperGroup):
    """The group of commands; until one is loaded, only names and first lines of help are known."""

    def __init__(self, **settings):
        super().__init__(**settings)
        for name, first_line in COMMANDS.items():
            self.add_command(TyperCommand(name, help=first_line))

    def resolve_command(self, ctx, args):
        name, _, rest = super().resolve_command(ctx, args)
        check_known(str(name), rest, ctx)
        from walker_jax.cli.startup import configure_jax  # loads JAX

        configure_jax()
        return name, load(str(name), rest), rest

    def invoke(self, ctx):
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt as interruption:  # typer would keep only the exit code
            raise Interrupted(*resume_notes(interruption)) from interruption


def load(name: str, args: Sequence[str] | None = None):
    """Load the command of that name, with its options.

    Its help lists the options of the walker that its arguments name. If `args` is None it lists
    those of all walkers.
    """
    function = ungrouped(getattr(import_module(f"walker_jax.cli.{name}_command"), name))
    if "ranges_over" in vars(function):  # a walker is its first argument
        from walker_jax.cli.walker_options import with_walker_options

        function = with_walker_options(function, args)
    text = flowing(inspect.cleandoc(function.__doc__ or ""))
    command = command_of(name, text, with_quiet(function))
    check_flags(command)
    return command


def check_flags(command: TyperCommand) -> None:
    """Refuse a walker if one of its parameters has the same option as the command itself."""
    taken = {"--help"}
    for one in command.params:
        for flag in (*one.opts, *one.secondary_opts):
            if flag in taken:
                name = flag.removeprefix("--").replace("-", "_")
                raise WrongUse(f"{flag} is an option of the command: rename the parameter {name}")
            taken.add(flag)


def with_quiet(command: Callable[..., None]) -> Callable[..., None]:
    """Return the command with the option `--quiet`, which acts by its callback."""

    def takes(quiet, **given):
        refuse_both(given)  # not yet checked for walkers and systems outside the package
        return command(**given)

    own = [*arguments_of(command), argument("quiet", Quiet, False)]
    return with_arguments(own, command, takes)


def silence(requested: bool) -> bool:
    """Show no progress from now on, if that is requested."""
    if requested:
        from walker_jax.execution.progress import be_quiet

        be_quiet()
    return requested


Quiet = Annotated[
    bool,
    typer.Option("--quiet", callback=silence, help="Print the answer, or the error, alone."),
]


def flowing(text: str) -> str:
    """Put each paragraph on one line."""
    return "\n\n".join(" ".join(paragraph.split()) for paragraph in text.split("\n\n"))


def resume_notes(interruption: BaseException) -> list[str]:
    """Return how to resume the work: the library's notes on an interruption, reworded."""
    notes = getattr(interruption, "__notes__", [])
    if not notes:
        return []
    from walker_jax.storage import RESUME_HINT  # loaded already, as it left the notes

    hints = [note for note in notes if note.startswith(RESUME_HINT)]
    return [hint.replace("without overwrite", "without --overwrite", 1) for hint in hints]


app = typer.Typer(
    cls=Commands,
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Passive dynamic walkers: their gaits, and the basins of attraction of these.",
)


@app.callback()
def accept_options(
    list_walkers: ListWalkers = False,
    version: Version = False,
    quiet: Quiet = False,
) -> None:
    """The options of the group act by their own callbacks."""

"""The application that the commands belong to."""

import typer
from typer.core import TyperGroup

from walker_jax import storage
from walker_jax.cli.options import ListWalkers


class Commands(TyperGroup):
    """The commands; what interrupts them carries notes on what they leave."""

    def invoke(self, ctx):
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt as interruption:  # of which typer would keep no more than a code
            raise Interrupted(*notes_of(interruption)) from interruption


app = typer.Typer(
    cls=Commands,
    add_completion=False,
    no_args_is_help=True,
    help="Passive dynamic walkers: their gaits, and the basins of attraction of these.",
)


class Interrupted(BaseException):
    """The command was interrupted, and what there is to say of what it leaves."""


class Terminated(BaseException):
    """The command is to end at once, what it has begun to write removed."""


@app.callback()
def common(list_walkers: ListWalkers = False) -> None:
    """Passive dynamic walkers: their gaits, and the basins of attraction of these."""


def notes_of(interruption: BaseException) -> list[str]:
    """How the work is resumed, as the library says, with options as here."""
    notes = getattr(interruption, "__notes__", [])
    notes = [note for note in notes if note.startswith(storage.RESUME_HINT)]
    return [note.replace("without overwrite", "without --overwrite", 1) for note in notes]

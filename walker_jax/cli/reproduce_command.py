"""`walker-jax reproduce`."""

from pathlib import Path

from walker_jax.cli import library as lib
from walker_jax.cli.answers import OVERWRITE, Stopwatch
from walker_jax.cli.commands import command
from walker_jax.cli.options import option


@command(
    examples=("reproduce --quick --out quick", "reproduce --out report"),
    time="Forty seconds; with --quick less.",
)
def reproduce(
    out: Path = option(Path("report"), "Where the report goes.", metavar="FOLDER"),
    quick: bool = option(False, "With fewer cells and slopes, without exact areas."),
    overwrite: bool = OVERWRITE,
):
    """Reproduce the paper of Schwab and Wisse (2001): every figure and number, in a report.

    The same command resumes an interrupted run.
    """
    clock, page = Stopwatch(), out / "report.html"
    how = {"quick": quick, "overwrite": overwrite, "progress": True}
    numbers = lib.reproduction.reproduce(out, **how)
    told = [number._asdict() for number in numbers]
    yield {"report": str(page), "numbers": told, "seconds": clock.seconds()}
    differ = [number for number in numbers if not number.agrees]
    agree = f"{len(numbers) - len(differ)} of {len(numbers)} numbers agree"
    yield f"{agree} at the digits that the paper prints; not so:"
    for one in differ:
        printed = f"printed {one.printed}, ours {one.ours}"
        yield f"  {one.where}, {one.what}: {printed}. {one.why}"
    yield f"  report {page}"

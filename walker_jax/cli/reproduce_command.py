"""`walker-jax reproduce`."""

from pathlib import Path
from typing import Annotated

import typer

from walker_jax.cli.answers import Stopwatch, print_json
from walker_jax.cli.options import Json, Overwrite


def reproduce(
    out: Annotated[Path, typer.Option(help="The folder of the report.")] = Path("report"),
    quick: Annotated[
        bool, typer.Option("--quick", help="With fewer cells and slopes, without exact areas.")
    ] = False,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Reproduce the paper of Schwab and Wisse (2001): every figure and number, in a report.

    The same command resumes an interrupted run.
    """
    from walker_jax.paper import reproduction

    clock = Stopwatch()
    numbers = reproduction.reproduce(out, quick=quick, overwrite=overwrite, progress=True)
    differ = [number for number in numbers if not number.agrees]
    if as_json:
        listed = [number._asdict() for number in numbers]
        seconds = clock.seconds()
        print_json({"report": str(out / "report.html"), "numbers": listed, "seconds": seconds})
        return
    agree = len(numbers) - len(differ)
    print(f"{agree} of {len(numbers)} numbers agree at the digits that the paper prints; not so:")
    for one in differ:
        print(f"  {one.where}, {one.what}: printed {one.printed}, ours {one.ours}. {one.why}")
    print(f"  report {out / 'report.html'}")

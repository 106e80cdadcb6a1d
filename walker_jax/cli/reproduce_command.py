"""`walker-jax reproduce`."""

from pathlib import Path
from typing import Annotated

import typer

from walker_jax.cli.answers import Stopwatch, tell
from walker_jax.cli.options import Json, Overwrite


def reproduce(
    out: Annotated[Path, typer.Option(metavar="FOLDER", help="Where the report goes.")] = Path(
        "report"
    ),
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
    report = out / "report.html"
    answer = {"report": str(report), "numbers": [number._asdict() for number in numbers]}
    differ = [number for number in numbers if not number.agrees]
    agree = f"{len(numbers) - len(differ)} of {len(numbers)} numbers agree"
    lines = [f"{agree} at the digits that the paper prints; not so:"]
    for one in differ:
        printed = f"printed {one.printed}, ours {one.ours}"
        lines.append(f"  {one.where}, {one.what}: {printed}. {one.why}")
    lines.append(f"  report {report}")
    tell(answer | {"seconds": clock.seconds()}, lines, as_json=as_json)

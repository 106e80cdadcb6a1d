"""`walker-jax export`."""

from pathlib import Path
from typing import Annotated

import typer

from walker_jax import storage
from walker_jax.checks import WrongPlace
from walker_jax.cli.answers import tell
from walker_jax.cli.options import Json, Overwrite


def export(
    data: Annotated[Path, typer.Argument(metavar="DATA", help="A data set that a command left.")],
    file: Annotated[Path, typer.Argument(metavar="FILE.nc", help="Where it goes.")],
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Copy a data set that another command has left to a NetCDF file."""
    if file.suffix != ".nc":
        raise WrongPlace(f"FILE.nc must end in .nc, not {file}")
    copied = storage.export(data, file, overwrite=overwrite)
    answer = {"data": str(data), "file": str(file), "variables": sorted(map(str, copied.variables))}
    lines = [f"{data}: {', '.join(answer['variables'])}"]
    lines.append(f"  NetCDF file {file}: xarray.open_dataset and other programs read it")
    tell(answer, lines, as_json=as_json)

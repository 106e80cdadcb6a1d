"""`walker-jax export`."""

from pathlib import Path

from walker_jax.cli import library as lib
from walker_jax.cli.answers import OVERWRITE
from walker_jax.cli.commands import command
from walker_jax.cli.options import argument, option, refuse
from walker_jax.cli.unit_options import UNITS, chosen_units

PROGRAMS = {
    ".nc": "xarray.open_dataset and other programs read it",
    ".mat": "load of MATLAB and Octave reads it",
    ".csv": "a table, with units in brackets",
    ".tex": r"a table for \input, with the package booktabs",
}
TABLES = ".csv", ".tex"


@command(
    examples=(
        "export basin.zarr basin.nc",
        "export sweep.zarr sweep.csv --units length=0.8 --units mass=10",
        "export basin.zarr cells.csv --rows fate",
    ),
    time="A second.",
)
def export(
    data: Path = argument("DATA"),
    file: Path = argument("FILE"),
    units: dict[str, float] = UNITS,
    rows: str | None = option(
        None, "Of a table: a variable, by whose dimensions its rows are.", metavar="VARIABLE"
    ),
    overwrite: bool = OVERWRITE,
):
    """Copy a data set that another command has left to a file for other programs.

    The ending of FILE says which: .nc, NetCDF; .csv; .tex, LaTeX; .mat, MATLAB. A table has a row
    for each point of the dimensions that most variables have, or that the variable of --rows has.
    Variables say their units, with --units those of SI.
    """
    convert = chosen_units(units).convert if units else lib.with_units
    if file.suffix not in TABLES:
        refuse(f"is for tables, {' and '.join(TABLES)}: leave it out", rows=rows)
    how = {"overwrite": overwrite, "rows": rows, "convert": convert}
    copied = lib.storage.export(data, file, **how)
    variables = sorted(map(str, copied.variables))
    yield {"data": str(data), "file": str(file), "variables": variables}
    yield f"{data}: {', '.join(variables)}"
    yield f"  {file}: {PROGRAMS[file.suffix]}"

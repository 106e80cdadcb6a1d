"""`walker-jax export`."""

from pathlib import Path

from walker_jax.cli import library as lib
from walker_jax.cli.answers import Files
from walker_jax.cli.commands import command
from walker_jax.cli.options import Group, argument, option, refuse
from walker_jax.cli.unit_options import InUnits

PROGRAMS = {
    ".nc": "xarray.open_dataset and other programs read it",
    ".mat": "load of MATLAB and Octave reads it",
    ".csv": "a table, with units in brackets",
    ".tex": r"a table for \input, with the package booktabs",
}
TABLES = ".csv", ".tex"


class Places(Group):
    data: Path = argument("DATA", "A data set that a command left.")
    file: Path = argument("FILE", "Where it goes: .nc, NetCDF; .csv; .tex, LaTeX; .mat, MATLAB.")
    rows: str | None = option(
        None, "Of a table: a variable, by whose dimensions its rows are.", metavar="VARIABLE"
    )


@command(
    examples=(
        "export basin.zarr basin.nc",
        "export sweep.zarr sweep.csv --units length=0.8 --units mass=10",
        "export basin.zarr cells.csv --rows fate",
    ),
    time="A second.",
)
def export(places: Places, units: InUnits, files: Files):
    """Copy a data set that another command has left to a file for other programs.

    The ending of the file says which: NetCDF, CSV, LaTeX or MATLAB. A table has a row for each
    point of the dimensions that most variables have, or that the variable of --rows has. Variables
    say their units, with --units those of SI.
    """
    data, file, chosen = places.data, places.file, units.chosen
    convert = lib.with_units if chosen is None else chosen.convert
    if file.suffix not in TABLES:
        refuse(f"is for tables, {' and '.join(TABLES)}: leave it out", rows=places.rows)
    how = {"overwrite": files.overwrite, "rows": places.rows, "convert": convert}
    copied = lib.storage.export(data, file, **how)
    variables = sorted(map(str, copied.variables))
    yield {"data": str(data), "file": str(file), "variables": variables}
    yield f"{data}: {', '.join(variables)}"
    yield f"  {file}: {PROGRAMS[file.suffix]}"

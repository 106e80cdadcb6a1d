"""`walker-jax export`."""

from pathlib import Path

from walker_jax.cli.answers import Files
from walker_jax.cli.commands import command
from walker_jax.cli.options import Group, argument
from walker_jax.refusals import WrongPlace


class Places(Group, theme="Places"):
    data: Path = argument("DATA", "A data set that a command left.")
    file: Path = argument("FILE.nc", "Where it goes.")


@command(
    *(Places, Files), examples=("export basin.zarr basin.nc",), time="A second.", walkers=False
)
def export(places: Places, files: Files) -> None:
    """Copy a data set that another command has left to a NetCDF file."""
    from walker_jax import storage

    data, file = places.data, places.file
    if file.suffix != ".nc":
        raise WrongPlace(f"FILE.nc must end in .nc, not {file}")
    copied = storage.export(data, file, overwrite=files.overwrite)
    answer = {"data": str(data), "file": str(file), "variables": sorted(map(str, copied.variables))}
    lines = [f"{data}: {', '.join(answer['variables'])}"]
    lines.append(f"  NetCDF file {file}: xarray.open_dataset and other programs read it")
    files.tell(answer, lines)

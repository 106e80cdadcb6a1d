"""Recordings read from files and from arrays: columns by name, units, experiments."""

import csv
from collections.abc import Iterator, Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from walker_jax.checks import WrongUse, array, check_kind, is_number, numbers, short
from walker_jax.fitting.recordings import (
    UNITS,
    Recording,
    Recordings,
    make_recording,
    strikes_at_changes,
)


def read_recordings(
    source: Any,
    columns: Mapping[str, str] | Sequence[str] | None = None,
    *,
    time: str = "time",
    units: Mapping[str, str | float] | None = None,
    strikes: Any = None,
    inputs: Sequence[str] = (),
    experiment: str | None = None,
) -> Recordings:
    """Read recordings of walks, from files or arrays, for `fit`.

    ```python
    samples = {"time": [0, 0.1, 0.2, 0.3, 0.4], "stance": [12.0, 10.0, 8.0, 5.5, 3.0]}
    wj.read_recordings(
        samples, {"theta": "stance"}, units={"theta": "deg"}, strikes=[0, 0.2, 0.4]
    )
    ```

    **Arguments:**

    - `source`: a file, by its name's end CSV, Parquet (with pandas and its reader), NetCDF or
      MATLAB's `.mat` (not its version 7.3); or columns by name, such as a dictionary of arrays, a
      pandas table or an xarray data set; or a list of these, each an experiment.
    - `columns`: for coordinates of the system's state, the names of their columns; or names that
      are those of the columns too. By default the columns other than `time` that are left over.
    - `time`: the name of the column of times.
    - `units`: of coordinates and of time, by their names: "deg", "ms" or another word, or the size
      of the unit, by which numbers are multiplied: -1 turns a sign. By default they are in the
      units of the system.
    - `strikes`: times of heel strikes, in the unit of time; or the name of a column that changes at
      each; its values, 0 and 1, then tell which of two systems stands. By default they are found
      where a coordinate jumps as legs exchange roles.
    - `inputs`: names of columns that are inputs of the system, such as a motor's command.
    - `experiment`: the name of a column that numbers experiments.

    **Returns** recordings, a tuple that is shown as a table. NaN in a coordinate is a gap. Raises
    `ValueError` for columns that are not there, for times that go back, for angles beyond a half
    turn, and for a column of NaN alone.
    """
    sources = source if isinstance(source, list | tuple) else [source]
    sizes = units or {}

    def read(table: Mapping[str, Any]) -> Recording:
        """Read one experiment."""
        column = lambda name, of="columns": numbers(name, table[check_name(table, name, of)])
        measured = lambda name, of: column(of) * unit_of(sizes, name)
        stance, legs = 0, strikes if isinstance(strikes, str) else None
        at = column(time, "time") * unit_of(sizes, time)
        if legs is not None:
            ends, stance = strikes_at_changes(at, column(legs, "strikes"))
        else:
            ends = None if strikes is None else numbers("strikes", strikes) * unit_of(sizes, time)
        left = [one for one in table if one not in {time, legs, experiment, *inputs}]
        named = left if columns is None else columns
        named = dict(named) if isinstance(named, Mapping) else {one: one for one in named}
        if unknown := [*({*sizes} - {*named, *inputs, time})]:
            raise WrongUse(
                f"units must be of columns that are read, not of {unknown[0]!r}", of="units"
            )
        values = {name: measured(name, of) for name, of in named.items()}
        return make_recording(at, values, ends, {one: measured(one, one) for one in inputs}, stance)

    return Recordings(read(part) for one in sources for part in split(columns_of(one), experiment))


def split(table: Mapping[str, Any], experiment: str | None) -> Iterator[dict[str, Any]]:
    """Return the rows of each experiment, in the order of the first of each."""
    columns = {name: array(name, one) for name, one in table.items()}
    if experiment is None:
        yield columns
        return
    which = columns[check_name(columns, experiment, "experiment")]
    _, first = np.unique(which, return_index=True)
    for value in which[np.sort(first)]:
        yield {name: one[which == value] for name, one in columns.items()}


def unit_of(units: Mapping[str, str | float], name: str) -> float:
    """Return the size of the unit of a column; 1 if none is given."""
    unit = units.get(name, 1.0)
    if isinstance(unit, str) and unit in UNITS:
        return UNITS[unit]
    if not is_number(unit) or not np.isfinite(unit) or unit == 0:
        raise WrongUse(
            f"units must be numbers or {', '.join(UNITS)}, not {short(unit)}", of="units"
        )
    return float(unit)


def check_name(table: Mapping[str, Any], name: str, argument: str) -> str:
    """Raise `WrongUse` for a column that is not there, which an argument names."""
    if name not in table:
        raise WrongUse(
            f"{argument} must be among {', '.join(table)}, not {short(name)}", of=argument
        )
    return name


def columns_of(source: Any) -> Mapping[str, Any]:
    """Return the columns of a table or file by name."""
    if isinstance(source, str | PathLike):
        return columns_in(Path(source))
    if isinstance(source, xr.Dataset):
        return columns_of_data(source)
    if hasattr(source, "columns") and not isinstance(source, Mapping):  # a pandas table
        return {str(name): np.asarray(source[name]) for name in source.columns}
    check_kind("source", source, Mapping)
    return source


def columns_in(path: Path) -> Mapping[str, Any]:
    """Read the columns of a file."""
    if not path.is_file():
        raise WrongUse(f"source must be a file, not {short(str(path))}", of="source")
    match path.suffix.lower():
        case ".csv":
            return columns_of_csv(path)
        case ".parquet":
            return columns_of_parquet(path)
        case ".nc":
            with xr.open_dataset(path) as data:
                return columns_of_data(data.load())
        case ".mat":
            from scipy.io import loadmat  # only here, as it takes a while to load

            found = loadmat(path, squeeze_me=True)
            return {name: one for name, one in found.items() if np.ndim(one) == 1}
    raise WrongUse(
        f"source must end in .csv, .parquet, .nc or .mat, not {path.suffix!r}", of="source"
    )


def columns_of_csv(path: Path) -> dict[str, Any]:
    """Read a CSV file whose first row names the columns; empty cells and words are NaN."""
    with path.open(newline="", encoding="utf-8-sig") as file:
        head, *rows = csv.reader(file)
    rows = [row for row in rows if row]
    short_rows = [i for i, row in enumerate(rows) if len(row) != len(head)]
    if short_rows:
        raise WrongUse(
            f"source must have {len(head)} cells in each row, but row {short_rows[0] + 2} has "
            f"{len(rows[short_rows[0]])}",
            of="source",
        )
    columns = zip(*rows, strict=True) if rows else [()] * len(head)
    return {name.strip(): list(map(cell, one)) for name, one in zip(head, columns, strict=True)}


def cell(text: str) -> float:
    """Return the number in a cell; NaN if there is none."""
    try:
        return float(text)
    except ValueError:
        return np.nan


def columns_of_parquet(path: Path) -> Mapping[str, Any]:
    """Read a Parquet file by pandas, if it is there with a reader."""
    try:
        import pandas

        return columns_of(pandas.read_parquet(path))
    except ImportError:
        raise WrongUse(
            "source must not be Parquet here: install pandas and pyarrow", of="source"
        ) from None


def columns_of_data(data: xr.Dataset) -> dict[str, Any]:
    """Return the variables and coordinates of one dimension."""
    return {str(name): one.values for name, one in data.variables.items() if one.ndim == 1}

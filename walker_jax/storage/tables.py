"""Data sets for other programs: NetCDF and MATLAB files, and tables of rows as CSV or LaTeX."""

import importlib.util
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from walker_jax.checks import WrongUse
from walker_jax.storage.damage import Damaged
from walker_jax.storage.datasets import load
from walker_jax.storage.places import (
    ANOTHER_PLACE_OR_OVERWRITE,
    StoreConflict,
    atomic_file,
    check_writable,
)

if TYPE_CHECKING:
    import pandas
    import xarray

FORMATS = ".nc", ".csv", ".tex", ".mat"
"""Endings of files to which data sets are copied."""
DIGITS = 6
"""Significant digits of a LaTeX table; CSV has all."""
ESCAPED = str.maketrans({one: f"\\{one}" for one in "_%&#$"} | {"√": r"$\sqrt{}$", "²": "$^2$"})
"""Characters that LaTeX reads otherwise."""


def export(
    path: Path,
    file: Path,
    *,
    overwrite: bool = False,
    convert: "Callable[[xarray.Dataset], xarray.Dataset]" = lambda data: data,
    rows: str | None = None,
) -> "xarray.Dataset":
    """Copy the data set at `path` to a file, as its ending says, and return it.

    **Arguments:**

    - `file`: .nc, NetCDF; .mat, MATLAB; .csv or .tex, a table.
    - `convert`: is given the data set, and returns the one that is written, as in other units.
    - `rows`: the variable whose dimensions are the rows of a table, as in `table_of`.

    Raises `StoreConflict` if there is another file, or if `path` is not a data set, or a damaged or
    unfinished one; `ValueError` if nothing can be written, or h5netcdf is not installed.
    """
    if file.suffix not in FORMATS:
        raise WrongUse(f"file must end in one of {', '.join(FORMATS)}, not {file}", of="file")
    if file.suffix == ".nc" and None in map(importlib.util.find_spec, ("h5netcdf", "h5py")):
        raise WrongUse("NetCDF takes h5netcdf and h5py: pip install 'walker_jax[netcdf]'")
    check_writable(file)
    if file.exists() and not (overwrite and file.is_file()):
        hint = ANOTHER_PLACE_OR_OVERWRITE.format("file")
        raise StoreConflict(f"{file} exists", hint, of="overwrite")
    try:
        data = load(path)
    except Damaged as error:
        hint = "the command that made it replaces it with overwrite"
        raise Damaged(*error.args, hint, of="overwrite") from error
    if data is None:
        raise StoreConflict(f"{path} is not a data set", "give the place of one")
    if data.attrs.get("unfinished"):
        raise StoreConflict(f"{path} is unfinished: the command that began it resumes it")
    data = convert(data)
    with atomic_file(file) as draft:
        if file.suffix == ".nc":
            small = [name for name in data.variables if data[name].dtype.kind in "iuf"]
            encoding = {name: {"zlib": True} for name in small}
            data.to_netcdf(draft, engine="h5netcdf", encoding=encoding)
        elif file.suffix == ".mat":
            write_mat(data, draft)
        else:
            table = table_of(data, rows)
            csv = file.suffix == ".csv"
            lines = table.to_csv(index=False, lineterminator="\n") if csv else as_tex(table)
            draft.write_text(lines, encoding="utf-8")
    return data


def table_of(data: "xarray.Dataset", rows: str | None = None) -> "pandas.DataFrame":
    """Return a table with a row for each point of some dimensions: those of a variable.

    By default they are the dimensions of most variables. Its columns are all variables over these;
    of those over one more dimension, `coordinate`, each part is a column. They are in the order of
    their names, after the dimensions, and have their units.
    """
    import pandas as pd
    import xarray

    if rows is not None and rows not in data:
        names = ", ".join(map(str, data.variables))
        raise WrongUse(f"rows must be one of {names}, not {rows}", of="rows")
    counted = Counter(one.dims for one in data.data_vars.values() if one.dims)
    if rows is None and not counted:
        raise WrongUse("data has no variable with dimensions, and so no rows")
    dims = data[rows].dims if rows is not None else counted.most_common(1)[0][0]
    columns: dict[str, Any] = {}
    others = sorted(str(name) for name in data.variables if name not in dims)
    for name in (*dims, *others):  # a folder of variables has no order
        one = data[name]
        if one.dims == dims or name in dims:
            columns[with_unit(str(name), one.attrs)] = one
        elif one.dims == (*dims, "coordinate"):
            for i, each in enumerate(names_of_parts(data, one.shape[-1])):
                columns[with_unit(f"{name}_{each}", one.attrs, i)] = one.isel(coordinate=i)
    whole = zip(columns, xarray.broadcast(*columns.values()), strict=True)
    return pd.DataFrame({name: one.values.ravel() for name, one in whole})


def names_of_parts(data: "xarray.Dataset", count: int) -> list[str]:
    """Return the names of the parts of a state: the coordinates of the section."""
    section = data.attrs.get("section", "")
    names = section.replace(",", " ").split() if isinstance(section, str) else [*section]
    return names if len(names) == count else [str(i) for i in range(count)]


def with_unit(name: str, attributes: Any, part: int = 0) -> str:
    """Return the name of a column, with its unit if that is known."""
    units = str(attributes.get("units", "")).split(", ")
    unit = units[min(part, len(units) - 1)]
    return f"{name} ({unit})" if unit else name


def as_tex(table: "pandas.DataFrame") -> str:
    """Write a table as a LaTeX `tabular`, with the rules of the package booktabs."""
    row = lambda cells: " & ".join(map(in_tex, cells)) + r" \\"
    body = [row(cells) for cells in table.itertuples(index=False)]
    lines = [rf"\begin{{tabular}}{{{'r' * len(table.columns)}}}", r"\toprule", row(table.columns)]
    return "\n".join([*lines, r"\midrule", *body, r"\bottomrule", r"\end{tabular}", ""])


def in_tex(cell: Any) -> str:
    """Write a cell of a LaTeX table."""
    if isinstance(cell, float):
        return "--" if cell != cell else f"{cell:.{DIGITS}g}"
    return str(cell).translate(ESCAPED)


def write_mat(data: "xarray.Dataset", file: Path) -> None:
    """Write a MATLAB file: each variable, and structs of the units and of the attributes."""
    from scipy.io import savemat

    as_mat = lambda one: one.astype(object) if one.dtype.kind in "UOST" else one
    values = {str(name): as_mat(one.values) for name, one in data.variables.items()}
    units = {str(name): one.attrs.get("units", "") for name, one in data.variables.items()}
    dims = {str(name): " ".join(map(str, one.dims)) for name, one in data.variables.items()}
    further = {"units": units, "dimensions": dims, "attributes": dict(data.attrs)}
    with file.open("wb") as opened:
        savemat(opened, values | further, long_field_names=True, oned_as="column")

"""Data sets for other programs: tables of rows as CSV or LaTeX, and MATLAB's files."""

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any

from walker_jax.checks import WrongUse

if TYPE_CHECKING:
    import pandas
    import xarray

DIGITS = 6
"""Significant digits of a LaTeX table; CSV has all."""
ESCAPED = str.maketrans({one: f"\\{one}" for one in "_%&#$"} | {"√": r"$\sqrt{}$", "²": "$^2$"})
"""Characters that LaTeX reads otherwise."""


def table_of(data: "xarray.Dataset", rows: str | None = None) -> "pandas.DataFrame":
    """Return a table with a row for each point of some dimensions: those of a variable.

    By default they are the dimensions of most variables. Its columns are all variables over these;
    of those over one more dimension, `coordinate`, each part is a column. They are in the order of
    their names, after the dimensions, and have their units.
    """
    import pandas as pd

    if rows is not None and rows not in data:
        names = ", ".join(map(str, data.variables))
        raise WrongUse(f"rows must be one of {names}, not {rows}", of="rows")
    counted = Counter(one.dims for one in data.data_vars.values() if one.dims)
    if rows is None and not counted:
        raise WrongUse("data has no variable with dimensions, and so no rows")
    dims = data[rows].dims if rows is not None else counted.most_common(1)[0][0]
    parts: dict[str, Any] = {}
    others = sorted(str(name) for name in data.variables if name not in dims)
    for name in (*dims, *others):  # a folder of variables has no order
        one = data[name]
        if one.dims == dims or name in dims:
            parts[with_unit(str(name), one.attrs)] = one
        elif one.dims == (*dims, "coordinate"):
            for i, each in enumerate(names_of_parts(data, one.shape[-1])):
                parts[with_unit(f"{name}_{each}", one.attrs, i)] = one.isel(coordinate=i)
    template = next(one for one in parts.values() if one.dims == dims)
    columns = {
        name: one.broadcast_like(template).transpose(*dims).values.ravel()
        for name, one in parts.items()
    }
    return pd.DataFrame(columns)


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

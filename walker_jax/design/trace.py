"""The trace of an optimisation: what was measured at which place, kept on disk."""

from collections.abc import Callable, Iterable
from contextlib import nullcontext

import numpy as np
import xarray as xr
from jaxtyping import Float

from walker_jax.checks import WrongUse
from walker_jax.design.evaluation import Row, measured
from walker_jax.design.limits import Limits
from walker_jax.design.problem import Problem, description
from walker_jax.execution.progress import console
from walker_jax.gaits.cycles import Gait
from walker_jax.gaits.search import find_gait


class Trace:
    """What has been measured so far."""

    def __init__(
        self,
        problem: Problem,
        known: xr.Dataset | None,
        keep: Callable[[xr.Dataset], object] | None,
        progress: bool,
    ):
        self.problem, self.keep = problem, keep
        self.rows: list[Row] = []
        if known is not None:
            check_known(problem, known)
        self.known = {} if known is None else {key(row): row for row in rows_of(known)}
        self.gaits: dict[bytes, Gait] = {}
        self.limits = Limits(problem, self.gait)
        self.console = console(progress)

    def gait(self, values: Float[np.ndarray, " parameters"]) -> Gait:
        """That of the walker with these parameters."""
        if values.tobytes() not in self.gaits:
            walker, tolerance = self.problem.built(values), self.problem.tolerance
            self.gaits[values.tobytes()] = find_gait(walker, tolerance=tolerance)
        return self.gaits[values.tobytes()]

    def measure(self, run: int, stage: int, place: Float[np.ndarray, " parameters"]) -> Row:
        """Measure the walker at a place, unless that is known."""
        values = self.problem.values(place)
        row = self.known.get((stage, values.tobytes()))
        if row is None:
            status = self.console.status(f"{len(self.rows) + 1}: {self.problem.named(values)}")
            with nullcontext() if self.console.quiet else status:
                row = measured(self.problem, stage, values, self.gait)
            self.known[key(row)] = row
            self.rows.append(row._replace(run=run))
            if self.keep is not None:
                visited = {key(one) for one in self.rows}
                left = [one for place, one in self.known.items() if place not in visited]
                self.keep(self.data([*self.rows, *left]))
        else:
            self.rows.append(row._replace(run=run))
        return self.rows[-1]

    def data(self, rows: list[Row] | None = None) -> xr.Dataset:
        """The measurements, as `optimise` returns them."""
        rows = self.rows if rows is None else rows
        problem, count = self.problem, len(rows)
        dims = dict.fromkeys(("parameters", "gradient", "gradient_error"), "parameter")
        dims |= {"measures": "measure"}
        coords = {"parameter": strings(problem.names), "measure": strings(problem.measures)}
        data = xr.Dataset(coords=coords, attrs=description(problem))
        for name in Row._fields:
            own = [dims[name]] if name in dims else []
            shape = [count, *(len(coords[dim]) for dim in own)]
            column = np.array([getattr(row, name) for row in rows]).reshape(shape)
            data[name] = ["evaluation", *own], column
        return data


def strings(values: Iterable[str]) -> np.ndarray:
    """An array of them, of a type that has a place in a store."""
    return np.array(list(values), dtype=object)


def key(row: Row) -> tuple[int, bytes]:
    """By which a measurement is found again."""
    return int(row.stage), row.parameters.tobytes()


def rows_of(data: xr.Dataset) -> list[Row]:
    """The measurements in a data set."""
    return [Row(*row) for row in zip(*(data[name].values for name in Row._fields), strict=True)]


def check_known(problem: Problem, known: xr.Dataset) -> None:
    """Refuse measurements that were made for something else."""
    for name, value in description(problem).items():
        own = name.startswith("walker_") and name.removeprefix("walker_") in problem.names
        if not own and name != "version" and known.attrs.get(name) != value:
            raise WrongUse(
                f"known must be of the same {name}, {value!r}, not {known.attrs.get(name)!r}"
            )

"""The trace of an optimisation: its measurements and their places, kept on disk."""

import threading
import time
from collections.abc import Callable, Generator, Iterable
from contextlib import closing
from functools import partial

import numpy as np
import xarray as xr
from jaxtyping import Float

from walker_jax.basins.attracting_gaits import compare_with_search
from walker_jax.checks import WrongUse
from walker_jax.design.area_gradients import AreaSettings, MeasuredArea
from walker_jax.design.budget import Budget
from walker_jax.design.evaluation import HOW_MEASURED, Evaluation, evaluate_objective
from walker_jax.design.limits import Limits
from walker_jax.design.problem import Problem, describe_problem
from walker_jax.design.tolerances import gait_with_most_starts
from walker_jax.execution.progress import bar, in_words
from walker_jax.execution.threads import side_by_side
from walker_jax.gaits.cycles import Gait
from walker_jax.gaits.search import search_gait
from walker_jax.systems.angles import turns_of
from walker_jax.systems.outcomes import join_names
from walker_jax.systems.system import System, has_gait_region

KEPT_AREAS = 4
"""Areas that are kept, with their cells, until their gradients are measured."""


class Trace:
    """The measurements so far, and roughly how many are `expected`."""

    def __init__(
        self,
        problem: Problem,
        known: xr.Dataset | None,
        keep: Callable[[xr.Dataset], object] | None,
        progress: bool,
        expected: int,
        budget: Budget | None = None,
    ):
        self.problem, self.keep = problem, keep
        self.rows: list[Evaluation] = []
        self.lock = threading.Lock()
        """Climbs run side by side, but add rows one at a time."""
        self.measuring: dict[tuple, threading.Lock] = {}
        """Locks by key, so that two climbs do not make the same measurement."""
        self.failure: BaseException | None = None
        """The error that `keep` has raised; it ends all climbs."""
        if known is not None:
            check_known(problem, known)
        self.known = {} if known is None else {key_of(row): row for row in evaluations_in(known)}
        self.measured = dict(self.known)
        """The known measurements, and those that were made beside others, but not yet taken."""
        self.gaits: dict[bytes, Gait] = {}
        self.areas: dict[tuple, MeasuredArea] = {}
        self.limits = Limits(problem, self.gait)
        self.progress, self.expected, self.began = progress, expected, time.perf_counter()
        self.budget = Budget() if budget is None else budget

    def gait(self, values: Float[np.ndarray, " parameters"]) -> Gait:
        """Return the walker's gait with the largest basin in the grid.

        If no gait attracts there, return that of a search, which may be unstable.
        """
        if values.tobytes() not in self.gaits:
            self.gaits[values.tobytes()] = gait_with_most_starts(self.problem, values)
        return self.gaits[values.tobytes()]

    def measure_area(
        self, key: tuple, how: AreaSettings, walker: System, *, keep: bool
    ) -> MeasuredArea:
        """Measure a walker's area, or take the kept one; keep it if its gradient may follow."""
        with self.lock:
            area = self.areas.pop(key, None)
        if area is None:
            area = how.measure(walker)
        with self.lock:
            if keep:
                self.areas[key] = area
            while len(self.areas) > KEPT_AREAS:
                self.areas.pop(next(iter(self.areas)))
        return area

    def note(self, values: Float[np.ndarray, " parameters"]) -> str:
        """Say how the gait of `find_gait` differs from the measured one; empty if it does not."""
        problem = self.problem
        walker = problem.walker_at(values)
        of_gaits = {*problem.measures} - {problem.size}
        if not of_gaits or not has_gait_region(walker) or not self.gait(values).found:
            return ""
        searched = search_gait(walker, tolerance=problem.tolerance)
        return compare_with_search(self.gait(values), searched, turns_of(walker))

    def measure(
        self,
        run: int,
        stage: int,
        place: Float[np.ndarray, " parameters"],
        *,
        value_only: bool = False,
    ) -> Evaluation:
        """Measure the walker at a place, or return the known measurement.

        With `value_only` the gradient may be missing. That of an area may take two areas more for
        each parameter, and any takes programs of its own before the first is measured; other
        gradients are always measured.
        """
        (row,) = self.measure_each(run, stage, [place], value_only=value_only)
        return row

    def measure_each(
        self,
        run: int,
        stage: int,
        places: Iterable[Float[np.ndarray, " parameters"]],
        *,
        value_only: bool = False,
    ) -> Generator[Evaluation, None, None]:
        """Measure the walker at several places side by side, in order, as `measure` does.

        Rows are added one by one as they are taken. Close it to stop the other measurements.
        """
        value_only = value_only and (bool(self.problem.size) or self.budget.first is None)
        with_gradient = stage >= 0 and not value_only

        def find_or_measure(values: Float[np.ndarray, " parameters"]) -> Evaluation:
            key = key_at(stage, values)
            measure_area = partial(self.measure_area, key, keep=stage >= 0 and value_only)
            with self.lock:
                mine = self.measuring.setdefault(key, threading.Lock())
            with mine:
                row = self.find(key, with_gradient)
                if row is None:
                    with self.budget.measuring((key[0], value_only)):
                        row = evaluate_objective(
                            *(self.problem, stage, values, self.gait, measure_area),
                            value_only=value_only,
                        )
                    self.measured[key] = row
                return row

        all_values = [self.problem.values(place) for place in places]
        with closing(side_by_side(find_or_measure, all_values)) as measured:
            for values in all_values:
                with bar(self.label(values), self.progress):
                    row = next(measured)
                own = row._replace(run=run, stage=stage)
                self.add(key_at(stage, values), row, own)
                yield own

    def measure_batch(
        self,
        place: Float[np.ndarray, " parameters"],
        measure_area: Callable[[AreaSettings, System], MeasuredArea],
    ) -> Evaluation:
        """Measure the walker at a place with its gradient, its area by a batch of starts."""
        values = self.problem.values(place)
        key = key_at(0, values)
        with bar(self.label(values), self.progress):
            row = self.find(key, True)
            if row is None:
                with self.budget.measuring("batch"):
                    row = evaluate_objective(self.problem, 0, values, self.gait, measure_area)
        own = row._replace(run=0, stage=0)
        self.add(key, row, own)
        return own

    def find(self, key: tuple, with_gradient: bool) -> Evaluation | None:
        """Return an earlier measurement; None if there is none, or it lacks a needed gradient."""
        row = self.measured.get(key)
        return None if row is None or (with_gradient and not row.has_gradient) else row

    def add(self, key: tuple, row: Evaluation, own: Evaluation) -> None:
        """Add a row with its own run and stage; keep the trace if the measurement is new."""
        with self.lock:
            if self.failure is not None:
                raise self.failure
            new = self.known.get(key) is not row
            self.known[key] = row
            self.insert(own)
            try:
                if new:
                    self.keep_all()
            except BaseException as failure:
                self.failure = failure
                raise

    def insert(self, row: Evaluation) -> None:
        """Append a row, or put it in place of the same measurement without a gradient."""
        about = lambda one: (one.run, one.stage, one.parameters.tobytes())
        for i, one in enumerate(self.rows):
            if row.has_gradient and not one.has_gradient and about(one) == about(row):
                self.rows[i] = row
                return
        self.rows.append(row)

    def rows_of(self, run: int, stage: int) -> list[Evaluation]:
        """Return the measurements of one stage of a run so far."""
        with self.lock:
            return [row for row in self.rows if (row.run, row.stage) == (run, stage)]

    def sort_runs(self) -> None:
        """Sort the measurements by run, as runs were made side by side."""
        self.rows.sort(key=lambda row: row.run)

    def keep_all(self) -> None:
        """Keep the trace, together with the other known measurements."""
        if self.keep is not None:
            visited = {key_of(one) for one in self.rows}
            left = [one for place, one in self.known.items() if place not in visited]
            self.keep(self.data([*self.rows, *left]))

    def label(self, values: Float[np.ndarray, " parameters"]) -> str:
        """Return the progress label of a measurement: its number, and the time left."""
        done = len(self.rows)
        each = (time.perf_counter() - self.began) / max(done, 1)
        left = f", {in_words(each * max(self.expected - done, 1))} left" if done else ""
        number = f"measurement {done + 1} of about {max(self.expected, done + 1)}{left}"
        return f"{number}: {self.problem.describe_values(values)}"

    def data(self, rows: list[Evaluation] | None = None) -> xr.Dataset:
        """Return the measurements as in the result of `optimise`."""
        rows = self.rows if rows is None else rows
        problem, count = self.problem, len(rows)
        dims = dict.fromkeys(("parameters", "gradient", "gradient_error"), "parameter")
        dims |= {"measures": "measure"}
        coords = {
            "parameter": string_array(problem.names),
            "measure": string_array(problem.measures),
        }
        data = xr.Dataset(coords=coords, attrs=describe_problem(problem))
        for name in Evaluation._fields:
            own = [dims[name]] if name in dims else []
            shape = [count, *(len(coords[dim]) for dim in own)]
            column = np.array([getattr(row, name) for row in rows]).reshape(shape)
            data[name] = ["evaluation", *own], column
        return data


def string_array(values: Iterable[str]) -> np.ndarray:
    """Return an array of strings, of a type that a store can hold."""
    return np.array(list(values), dtype=object)


def key_at(stage: int, values: Float[np.ndarray, " parameters"]) -> tuple[int, bytes]:
    """Return the key of a measurement: the first stage that measures alike, and the parameters."""
    alike = stage if stage < 0 else HOW_MEASURED.index(HOW_MEASURED[stage])
    return alike, values.tobytes()


def key_of(row: Evaluation) -> tuple[int, bytes]:
    """Return the key of a measurement."""
    return key_at(int(row.stage), row.parameters)


def evaluations_in(data: xr.Dataset) -> list[Evaluation]:
    """Return the measurements in a data set."""
    return [
        Evaluation(*row)
        for row in zip(*(data[name].values for name in Evaluation._fields), strict=True)
    ]


def check_known(problem: Problem, known: xr.Dataset) -> None:
    """Refuse measurements of another problem, or of a walker with other options."""
    about = describe_problem(problem)
    whole = [*about, *(name for name in known.attrs if name.startswith(("walker_", "code")))]
    for name in dict.fromkeys([*whole, "density"]):
        own = name.startswith("walker_") and name.removeprefix("walker_") in problem.names
        value, other = about.get(name), known.attrs.get(name)
        other = other.tolist() if isinstance(other, np.ndarray) else other  # from NetCDF
        if isinstance(other, list) and isinstance(value, str):  # names in an older data set
            other = join_names(other)
        if not own and name != "version" and other != value:
            raise WrongUse(f"known must be of the same {name}, {value!r}, not {other!r}")

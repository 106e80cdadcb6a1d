"""The time that an optimisation may take, by a clock that only the work itself moves."""

from concurrent.futures import CancelledError
from typing import Any

import numpy as np
import pytest
import xarray as xr
from optima import FEW, SLOPES, WALKER

import walker_jax as wj
from walker_jax import figures
from walker_jax.cli.optimise_command import optimum_in_words
from walker_jax.design.budget import Budget
from walker_jax.design.evaluation import ENDS_STAGE, HURRIED_ENDS_STAGE, Evaluation
from walker_jax.design.optimisation import optimise
from walker_jax.design.results import runs, summarise_optimum
from walker_jax.execution.tiles import stopping

FIRST, LATER, ALONE, VIEW = 12.0, 3.0, 1.0, 5.0
"""Seconds of the first measurement, of later ones with and without a gradient, and of basins."""
KERNEL = 0.25
"""Seconds between two kernels: work that is to stop goes on for as long."""
TOP = 0.0123
"""The slope at which the made-up objective is largest."""


class Clock:
    """Seconds that pass only while `work` is done, in kernels, before each of which it may stop."""

    def __init__(self, monkeypatch):
        self.now, self.at_ends = 1000.0, LATER
        self.begun: list[tuple[float, float]] = []
        """When each piece of work began, and when it was done."""
        for name in ("budget.perf_counter", "trace.time.perf_counter"):
            monkeypatch.setattr(f"walker_jax.design.{name}", lambda: self.now)

    def work(self, seconds):
        begun = self.now
        for _ in range(round(seconds / KERNEL)):
            if any(one.is_set() for one in stopping.get()):
                raise CancelledError
            self.now += KERNEL
        self.begun.append((begun, self.now))


@pytest.fixture
def clock(monkeypatch):
    """A clock, which measurements and basins move on that are made up."""
    clock = Clock(monkeypatch)

    def evaluate(problem, stage, values, *_, value_only=False):
        later = clock.at_ends if stage == ENDS_STAGE else ALONE if value_only else LATER
        clock.work(later if clock.begun else FIRST)
        away, unknown = values - TOP, np.nan if value_only else 0.0
        value = 1 - float(np.sum(away**2))
        uphill, error = -2 * away + unknown, np.full(len(values), unknown)
        of_all = np.full(len(problem.measures), value)
        return Evaluation(-1, stage, values, value, 0.0, uphill, error, of_all, 0)

    def basins(*_):
        clock.work(VIEW)
        return {"fate_start": 0, "fate_optimum": 0}

    monkeypatch.setattr("walker_jax.design.trace.evaluate_objective", evaluate)
    monkeypatch.setattr("walker_jax.design.trace.Trace.note", lambda *_: "")
    monkeypatch.setattr("walker_jax.design.optimisation.compare_basins", basins)
    return clock


def optimum_within(clock, seconds, **options) -> tuple[xr.Dataset, float]:
    """Optimise a walker's slope; return the result, and how long it took."""
    began, clock.begun[:] = clock.now, []
    given: dict[str, Any] = {"grid": FEW, "starts": 1, "progress": False, "objective": "speed"}
    given |= {"seconds": seconds} | options
    return optimise(WALKER, SLOPES, **given), clock.now - began


@pytest.mark.parametrize("starts", [1, 3])
def test_an_optimisation_holds_its_budget(clock, starts):
    """After the first measurement it takes at most a third longer than is left of the time."""
    ended = []
    for seconds in (1e-9, 11.0, 13.0, 17.0, 24.0, 40.0):
        found, took = optimum_within(clock, seconds, starts=starts, scan=3)
        assert found.first_seconds == FIRST == clock.begun[0][1] - clock.begun[0][0]
        assert all(begun >= clock.begun[0][1] for begun, _ in clock.begun[1:])
        assert took - FIRST <= 4 / 3 * max(0.0, seconds - FIRST) + starts * KERNEL
        assert found.out_of_time and found.found and not found.converged
        assert float(found.objective_optimum) == found.value.where(found.stage >= 0).max()
        assert float(found.exact_optimum) == float(found.objective_optimum)
        assert -3 not in found.stage  # rough measurements of the ends would be the same again
        ended.append(float(found.objective_optimum))
    assert ended[0] == ended[1] <= ended[2] and np.all(np.diff(ended) >= 0) and ended[-1] > ended[0]


def test_the_first_value_is_known_before_its_gradient(clock):
    """A gradient that would take too long, with programs of its own, is given up."""
    found, took = optimum_within(clock, FIRST + KERNEL)
    assert took <= FIRST + 2 * KERNEL and found.found and found.out_of_time
    assert found.evaluation.size == 1 and np.isnan(found.gradient).all()
    assert float(found.objective_start) == 1 - (0.004 - TOP) ** 2


def test_with_enough_time_nothing_is_left_out(clock):
    whole, _ = optimum_within(clock, None, scan=3)
    found, took = optimum_within(clock, 1000.0, scan=3)
    assert took < 900 and found.converged and not found.out_of_time
    assert "first_seconds" not in whole
    xr.testing.assert_identical(found.drop_vars("first_seconds"), whole)
    assert {"scan_value", "fate_start"} <= {*found} and {-2, -1} < {*found.stage.values.tolist()}


def test_ends_scan_and_basins_have_a_third_more(clock, monkeypatch):
    """A climb that converges leaves them what it did not use; without time they are left out."""
    monkeypatch.setattr("walker_jax.execution.threads.cores", lambda: 1)
    _, climbed = optimum_within(clock, 1e6)
    climbed -= 2 * LATER + VIEW
    seconds, ends = climbed + KERNEL, FIRST + (climbed + KERNEL - FIRST) * 4 / 3
    points = int((ends - climbed - 2 * LATER) / LATER)
    few = points - round(FIRST / LATER)
    for scan, more, wanted in (
        (few, 0.0, (True, True, True)),
        (few + 2, 0.0, (True, True, False)),
        (points + 1, 0.0, (True, False, False)),
        (1, 20.0, (False, True, True)),  # of the ends the second would not fit
    ):
        clock.at_ends = LATER + more
        found, took = optimum_within(clock, seconds, scan=scan)
        assert found.converged and bool(found.out_of_time) != all(wanted)
        made = (found.stage == -2).sum() == 2, "scan_value" in found, "fate_start" in found
        assert made == wanted and took <= ends + 2 * KERNEL


def test_areas_at_the_ends_are_rough_once_time_is_over(clock):
    hurried, _ = optimum_within(clock, 40.0, objective="area")
    whole, _ = optimum_within(clock, 1000.0, objective="area")
    assert HURRIED_ENDS_STAGE in hurried.stage and ENDS_STAGE not in hurried.stage
    assert hurried.out_of_time and not hurried.converged
    assert ENDS_STAGE in whole.stage and HURRIED_ENDS_STAGE not in whole.stage


def test_results_without_all_their_parts_are_told_and_drawn(clock):
    found, _ = optimum_within(clock, 1.0, scan=3)
    assert found.start.item() == found.optimum.item() == 0.004
    answer = summarise_optimum(found)
    assert answer["first_seconds"] == FIRST and answer["out_of_time"]
    told = "\n".join(optimum_in_words(WALKER, answer, "speed"))
    assert "out of time after a first measurement of 12 s: the same command goes on" in told
    assert [one.best for one in runs(found, "slope")] == [True]
    figures.optimum(found)
    again, took = optimum_within(clock, 30.0, known=found)
    assert float(again.objective_optimum) > float(found.objective_optimum) and took <= 40.0


def test_no_measurement_begins_that_would_not_fit(clock):
    """By the time of the last of its kind, the first excepted: it compiles programs."""
    budget = Budget(20.0)
    assert budget.left() == np.inf and not budget.is_over()
    with budget.measuring("a"):
        clock.now += FIRST
    budget.begin()
    assert budget.first == FIRST and budget.left() == 8.0
    with budget.measuring("a"):
        clock.now += 5.0
    assert not budget.ran_out
    with pytest.raises(CancelledError), budget.measuring("a"):
        pass
    assert budget.ran_out
    with budget.measuring("b"):
        clock.now += 3.0
    assert budget.is_over() and budget.try_in_time(lambda: 1) is None
    for _ in range(2):
        budget.extend()
        assert budget.left() == pytest.approx(8 / 3)
    assert budget.try_in_time(lambda: 1) == 1 and budget.try_in_time(lambda: 1, 3.0) is None
    assert budget.try_in_time(lambda: clock.work(5.0)) is None and budget.is_over()


def test_training_holds_its_budget_too(clock):
    """Its checks of walkers on the way, by areas, have the third that comes on top."""
    from discs import COUNT, disc

    machine = disc(np.full(COUNT, 0.1))
    grid = wj.Grid.plain(x=(-1.5, 1.5, 4), y=(-1.5, 1.5, 4))
    how: Any = {"parameters": "w", "grid": grid, "levels": 0, "progress": False, "steps": 50}
    for seconds, checks in ((1.0, 0), (14.5, 1), (20.0, 3), (60.0, 6)):
        began, clock.begun[:] = clock.now, []
        found = optimise(machine, None, "area", seconds=seconds, **how)
        took, left = clock.now - began, max(0.0, seconds - FIRST)
        assert took - FIRST <= 4 / 3 * left + KERNEL and bool(found.out_of_time)
        assert float(found.objective_optimum) >= float(found.objective_start)
        steps = int((found.stage == 0).sum())
        assert steps == 1 + left // LATER
        assert int((found.stage == 1).sum()) == checks

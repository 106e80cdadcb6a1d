"""Summaries of results, and the gaits and windows that are taken where none is named."""

import numpy as np
import pytest
import xarray as xr

import walker_jax as wj
from walker_jax import Outcome
from walker_jax.basins import basin_summary, windows
from walker_jax.basins.attracting_gaits import compare_with_search, is_same_cycle
from walker_jax.cli.robustness_command import measures_in_words
from walker_jax.fractals.dimensions import Uncertainty
from walker_jax.gaits import reasons, selection
from walker_jax.gaits.gait_summary import (
    find_stable_intervals,
    summarise_bifurcations,
    summarise_gait,
)
from walker_jax.gaits.search import search_gait
from walker_jax.stability import gait_robustness
from walker_jax.stability.disturbances import LeastDisturbance
from walker_jax.stability.robustness_fields import FIELDS, summarise_robustness, without_gait
from walker_jax.stability.sampling import BasinStability
from walker_jax.stability.steps_down import LeastStepDown
from walker_jax.storage.schema import check_dataset
from walker_jax.walkers.parameters import describe_in_words, describe_walker, space_decimals

WALKER = wj.SimplestWalker(0.004)
GRID = wj.Grid.sheared(theta=(0.05, 0.35, 30), sum=(-0.03, 0.01, 20))


def test_walkers_are_described_by_name_and_parameters():
    walker = wj.SpringWalker(0.005, 0.25)
    about = {"name": "SpringWalker", "slope": 0.005, "hip_stiffness": 0.25}
    assert describe_walker(walker) == about
    assert describe_in_words(walker) == "SpringWalker, slope 0.005, hip_stiffness 0.25"


def test_spaced_values_are_those_that_one_would_type():
    assert space_decimals(0.0, 0.3, 4) == [0.0, 0.1, 0.2, 0.3]
    assert space_decimals(-0.3, 0.3, 7) == [-0.3, -0.2, -0.1, 0.0, 0.1, 0.2, 0.3]
    assert space_decimals(0.001, 0.019, 19) == [i / 1000 for i in range(1, 20)]
    np.testing.assert_allclose(space_decimals(1e-14, 4e-14, 10), np.linspace(1e-14, 4e-14, 10))


def test_the_long_gait_comes_first_then_the_others_each_once():
    (alone,) = selection.select_gaits(WALKER)
    every = selection.select_gaits(WALKER, every=True)
    np.testing.assert_array_equal(every[0].states, alone.states)
    assert len(every) >= 2 and not np.allclose(every[1].states, every[0].states)
    summarised = summarise_gait(every[0])
    assert summarised["period"] == 1 and summarised["stable"] is True
    values = [complex(*pair) for pair in summarised["multipliers"]]
    np.testing.assert_array_equal(values, every[0].multipliers)


def test_of_long_periods_the_smallest_multiplier_is_taken(monkeypatch):
    gait = wj.find_gait(WALKER)
    made_up = [gait._replace(multipliers=np.array([m, 0j])) for m in (-1.5, 0.5j, 0.75)]
    monkeypatch.setattr(selection, "find_gaits", lambda *_, **__: list(made_up))
    largest = lambda gaits: [one.multipliers[0] for one in gaits]
    assert largest(selection.select_gaits(WALKER, 2)) == [0.5j]
    assert largest(selection.select_gaits(WALKER, 2, every=True)) == [0.5j, 0.75, -1.5]


@pytest.mark.parametrize(
    ("residual", "period", "guessed", "reason"),
    [
        (None, 2, False, "none of the searches"),
        (np.nan, 2, False, "none of the searches"),
        (np.nan, 1, False, "no stride from where the search begins"),
        (np.nan, 1, True, "no stride from the guess"),
        (np.nan, 2, True, "fewer than 2 strides from the guess"),
        (1e-3, 1, True, "misses the next state by 0.001"),
        (1e-9, 2, True, "shorter period"),
        (1e-9, 1, True, "too close to a bifurcation"),
    ],
)
def test_reasons_where_no_gait_is_found(residual, period, guessed, reason):
    gait = wj.find_gait(WALKER)
    search = None if residual is None else gait._replace(residual=np.array(residual))
    assert reason in reasons.reason_without_gait(WALKER, period, search, guessed=guessed)


def test_where_no_gait_is_found_what_makes_it_needless_is_named():
    with pytest.raises(
        wj.ComputationFailed, match=r"slope 0\.5: .*; give theta, sum, or another slope$"
    ):
        selection.require_gait(wj.SimplestWalker(0.5), ("theta", "sum"))
    with pytest.raises(wj.ComputationFailed, match=r"try another guess, or another slope$"):
        selection.select_gaits(WALKER, 1, np.array([0.2, -0.4]))


class Around(wj.SimplestWalker):
    """A walker whose region lies around its gait, as that of a robot does."""

    def basin_region(self, gait):
        return wj.Grid.plain(theta=(0, gait()[0], 9), thetadot=(gait()[1], 0, 9))


def test_a_command_names_the_options_that_make_a_gait_needless():
    from walker_jax.cli.options import Option, message_of

    known = [*map(Option, ("axis", "theta", "sum", "slope"))]
    with pytest.raises(wj.ComputationFailed) as error:
        windows.window_of_basin(Around(0.5))
    assert message_of(error.value, known).endswith("give --axis, or another --slope")
    with pytest.raises(wj.ComputationFailed) as error:
        selection.require_gait(wj.SimplestWalker(0.5), ("theta", "sum"))
    assert message_of(error.value, known).endswith("give --theta, --sum, or another --slope")


def test_an_error_has_as_many_parameters_as_there_is_room_for(monkeypatch):
    """And all the options that make the gait needless, whose search is made up to fail."""
    from walker_jax.cli.options import Option, message_of

    failed = wj.find_gait(WALKER)._replace(residual=np.array(1e-3), found=np.array(False))
    monkeypatch.setattr(selection, "search_gait", lambda *_, **__: failed)
    axes = {"theta": None, "sum": None, "phidot": None}
    with pytest.raises(wj.ComputationFailed) as error:
        windows.fill_around_gait(wj.RoundFootWalker(0.5), axes)
    known = [*map(Option, ("theta", "sum", "phidot", "slope"))]
    assert message_of(error.value, known) == (
        "no gait of period 1 found for RoundFootWalker, slope 0.5, hip_mass 1, ...: "
        "Newton's iteration diverged: a stride misses the next state by 0.001; "
        "give --theta, --sum, --phidot, or another --slope"
    )


def test_windows_lie_around_the_gait_or_are_those_of_the_paper():
    axes = {"theta": None, "sum": (-0.1, 0.0, 10)}
    assert windows.fill_from_paper(WALKER, axes) == {"theta": (0.0, 0.4, 200), "sum": axes["sum"]}
    walker = wj.SpringWalker(0.004, 0.5)
    assert windows.fill_from_paper(walker, axes) == axes
    filled = windows.fill_around_gait(WALKER, axes)  # as around that of any walker
    gait = wj.find_gait(WALKER).states[0]
    assert filled["theta"] == (0.0, pytest.approx(2.5 * float(gait[0])), 200)
    assert filled["sum"] == axes["sum"]
    assert windows.grid_along(filled).contains(np.asarray(gait)[None] + [[0, -0.05]]).all()
    plain = windows.outline({"theta": None, "thetadot": (-1.0, 0.0, 3), "phidot": None})
    assert plain.names == ("theta", "thetadot") and plain.fixed == ("phidot",)
    with pytest.raises(ValueError, match="low must be below high"):
        windows.outline({"theta": None, "sum": (0.0, -1.0, 3)})
    assert windows.film_window(WALKER, gait).shape == (200, 250)
    assert windows.film_window(walker, gait).contains(np.asarray(gait)[None]).all()


class Unchanged(wj.SimplestWalker):
    """The simplest walker by another name."""


class Lifted(wj.SimplestWalker):
    """One whose foot is never in contact."""

    def contact(self, state):
        return super().contact(state) + 1.0


def test_a_walker_of_own_equations_has_not_the_papers_window():
    axes = {"theta": None, "sum": None}
    assert windows.fill_from_paper(Unchanged(0.004), axes) == windows.PAPER_WINDOW
    assert windows.fill_from_paper(Lifted(0.004), axes) == axes
    assert windows.film_window(Unchanged(0.004), np.array([0.2, -0.2])).shape == (200, 250)
    assert reason_without_gait(Unchanged) == (
        "it makes no stride from where the search begins (explain says why)"
    )


@pytest.mark.slow
def test_such_a_walker_is_searched_for_over_the_section():
    assert reason_without_gait(Lifted) == (
        "none of the 80000 starts over the section makes a stride (explain says why)"
    )


def reason_without_gait(kind):
    failed = wj.find_gait(WALKER)._replace(residual=np.nan)
    return reasons.reason_without_gait(kind(0.004), 1, failed, guessed=False)


def test_cells_are_counted_a_few_rows_at_a_time_as_all_at_once(monkeypatch):
    data = wj.basin(WALKER, GRID, "direct", strides=5)
    data["attractor"][:] = np.where(np.arange(20) % 2, data["attractor"], -1)
    whole = basin_summary.tally(data)
    assert whole.fates.sum() == GRID.size
    fate, attractor = data["fate"].values, data["attractor"].values
    assert whole.fates[Outcome.FORWARD] == (fate == Outcome.FORWARD).sum() > 0
    assert whole.unmatched == ((fate == 0) & (attractor < 0)).sum() > 0
    assert whole.strides == data["strides"].values.sum() + (fate != 0).sum()
    monkeypatch.setattr(basin_summary, "CELLS_AT_ONCE", 70)
    for one, other in zip(whole, basin_summary.tally(data), strict=True):
        np.testing.assert_array_equal(one, other)


NO_TORI = {
    "torus_branch": ("torus", np.zeros(0, int)),
    "torus_period": ("torus", np.zeros(0, int)),
    "torus_value": ("torus", np.zeros(0)),
    "torus_states": (("torus", "phase", "coordinate"), np.zeros((0, 2, 2))),
    "torus_multipliers": (("torus", "order", "part"), np.zeros((0, 2, 2))),
}


def test_bifurcations_are_listed_by_period_then_slope():
    """One cascade, another doubling, and a fold beyond the loss of walking. All is made up."""
    data = xr.Dataset(
        {
            "event_fold": ("event", [False, False, True, False, True, False]),
            "event_branch": ("event", [1, 0, 2, 2, 3, 4]),
            "event_period": ("event", [2, 1, 3, 3, 5, 1]),
            "event_value": ("event", [0.0177, 0.0151, 0.02, 0.0201, 0.01, 0.003]),
            "event_states": (("event", "phase", "coordinate"), np.arange(24.0).reshape(6, 2, 2)),
            "cascade": ("event", [True, True, False, False, False, False]),
            **NO_TORI,
            "lost": ("end", [0.019, 0.0191]),
            **gaits_of({2: ([0.0202, 0.0201, 0.02005, 0.0201], [False, False, True, False])}),
        },
        attrs={"parameter": "slope"},
    )
    found = summarise_bifurcations(data)
    periods = [(one["from"], one["to"], one["slope"]) for one in found["doublings"]]
    assert periods == [(1, 2, 0.0151), (2, 4, 0.0177)]
    assert found["doublings"][0]["state"].tolist() == [4, 5]
    assert [one["slope"] for one in found["other_doublings"]] == [0.003, 0.0201]
    assert [(one["period"], one["slope"]) for one in found["folds"]] == [(3, 0.02), (5, 0.01)]
    assert found["lost"] == {"below": 0.019, "above": 0.0191}
    assert found["stable_beyond"] == [{"period": 3, "from": 0.02, "to": 0.0201}]


def gaits_of(branches):
    """Slopes of gaits on branches by their numbers, and which are stable."""
    number = np.repeat([*branches], [len(slopes) for slopes, _ in branches.values()])
    slopes, stable = zip(*branches.values(), strict=True)
    columns = {"branch": number, "value": np.concatenate(slopes), "stable": np.concatenate(stable)}
    return {name: ("gait", column) for name, column in columns.items()}


def test_stable_intervals_end_in_bifurcations_or_branches():
    """Of branches from folds beyond 0.019, which are made up."""
    between_folds = [0.025, 0.021, 0.022, 0.024, 0.028, 0.025], [False, *4 * [True], False]
    beyond_the_range = [0.03, 0.021, 0.025, 0.03], [False, False, True, True]
    to_a_torus = [0.022, 0.021, 0.022, 0.025], [False, True, True, False]
    never = [0.025, 0.022, 0.025], [False, False, False]
    none_between = [0.0203, 0.0203], [False, False]
    branches = between_folds, beyond_the_range, to_a_torus, never, none_between
    event = lambda values: ("event", values)
    data = xr.Dataset(
        {
            "event_branch": event([0, 0, 1, 2, 3, 3, 4, 4]),
            "event_value": event([0.03, 0.02, 0.02, 0.02, 0.02, 0.03, 0.02, 0.0201]),
            "event_fold": event([*7 * [True], False]),
            "event_period": event([3, 3, 4, 5, 6, 6, 7, 7]),
            "torus_branch": ("torus", [2]),
            "torus_value": ("torus", [0.024]),
            **gaits_of(dict(enumerate(branches))),
        }
    )
    found = find_stable_intervals(data, 0.019)
    assert [(one["period"], one["from"], one["to"]) for one in found] == [
        (3, 0.02, 0.03),
        (4, 0.02, 0.03),
        (5, 0.02, 0.024),
        (7, 0.02, 0.0201),
    ]
    assert find_stable_intervals(data, 0.0201) == []


def made_up_robustness(monkeypatch, walker: wj.Walker = WALKER, grid=GRID):
    """What `robustness` returns for made-up measures of the gait, and after a fine basin."""
    gait = wj.find_gait(walker)
    point = (0.002, np.array([0.6, 0.8]), np.asarray(gait.states[0]), 0, Outcome.FORWARD, 6)
    answers = {
        "least_disturbance_if_any": LeastDisturbance(*point),
        "least_step_down": LeastStepDown(0.001, np.zeros(4), 0, Outcome.FORWARD, 6),
        "basin_stability": BasinStability(
            *map(np.asarray, (0.3, 0.2, 0.4, 8 * [0], 0, 20.0, np.inf))
        ),
        "boundary_dimension": Uncertainty(1.25, 1.0, 1.5, 0.75, np.zeros(0), np.zeros(0)),
    }
    for name, answer in answers.items():
        monkeypatch.setattr(gait_robustness, name, lambda *_, answer=answer, **__: answer)
    return wj.robustness(walker, grid, levels=0, check=0, strides=200)


def test_robustness_says_where_a_search_ends_in_another_gait(monkeypatch):
    owner, other = wj.find_gait(WALKER), wj.find_gait(WALKER, [0.1453, -0.1553])
    assert owner.stable and not other.stable and not is_same_cycle(owner, other)
    monkeypatch.setattr(gait_robustness, "search_gait", lambda *_, **__: other)
    data = made_up_robustness(monkeypatch)
    assert float(data["multiplier"]) == pytest.approx(np.abs(owner.multipliers[0]), rel=1e-9)
    words = compare_with_search(owner, other)
    assert summarise_robustness(data, {"slope": 0.004})["note"] == words
    assert "an unstable gait, multiplier 3.21277, at (0.148778, -0.158807), not that" in words


def test_a_search_agrees_with_a_basin_from_whichever_state():
    walker = wj.SimplestWalker(0.0165)
    two = wj.find_gait(walker, [0.2379, -0.2338], 2)
    one, none = wj.find_gait(walker), search_gait(walker, [0.7, -0.01])
    assert two.stable and one.found and not one.stable and not none.found
    turned = two._replace(states=np.roll(two.states, 1, axis=0))
    assert compare_with_search(two, turned) == compare_with_search(None, one) == ""
    assert compare_with_search(None, none) == ""
    assert compare_with_search(two, none) == "find_gait without a guess finds no gait"
    assert "an unstable gait" in compare_with_search(two, one)
    assert compare_with_search(None, two).endswith("to which no cell converges")


def test_the_schema_of_robustness_has_all_that_it_adds(monkeypatch):
    data = made_up_robustness(monkeypatch)
    basin = wj.refine(WALKER, GRID, 0, check=0)
    assert {*FIELDS} == {*data} - {*basin} == {*without_gait(WALKER)}
    check_dataset(data, "robustness")
    check_dataset(basin.assign(without_gait(WALKER)).assign_attrs(data.attrs), "robustness")


def test_a_summary_of_robustness_has_none_for_what_is_not_there(monkeypatch):
    data = made_up_robustness(monkeypatch)
    found = summarise_robustness(data, {"slope": 0.004})
    assert found["gait"]["period"] == 1 and found["slope"] == 0.004 and found["note"] == ""
    least = found["least_disturbance"]
    assert (least["size"], least["failure"], least["strides"]) == (0.002, "FORWARD", 6)
    assert list(found["basin_stability"]) == [
        *("value", "low", "high", "in_time", "disturbances", "median_strides", "slowest_strides"),
        *("mean_strides", "pace", "median_pace", "mean_shock", "largest_shock"),
    ]
    assert found["boundary_dimension"] == {"value": 1.25, "low": 1.0, "high": 1.5}
    nowhere = summarise_robustness(data.assign(without_gait(WALKER)), {"slope": 0.2})
    assert list(nowhere) == list(found)
    assert nowhere["at_border"] == found["at_border"] == int(data.at_border)
    assert summarise_robustness(data.assign(at_border=5), {"slope": 0.004})["at_border"] == 5
    assert all(nowhere[name] is None for name in [*nowhere][5:])
    assert summarise_robustness(data.assign(at_border=np.nan), {"slope": 0.2})["at_border"] is None


def test_walks_on_rough_ground_are_in_the_summary_and_its_words(monkeypatch):
    walks = {"steps_to_fall": 120.0, "steps_to_fall_low": 100.0, "steps_to_fall_high": np.inf}
    data = made_up_robustness(monkeypatch).assign(walks).assign_attrs(ground=0.002)
    found = summarise_robustness(data, {"slope": 0.004})
    expected = {"mean": 120.0, "low": 100.0, "high": np.inf, "ground": 0.002}
    assert found["steps_to_fall"] == expected
    assert [*measures_in_words(found, "")][-1].endswith(
        "deviation 0.002 it falls after 120 strides on average (100 to inf)"
    )

"""Charts of two parameters, of the map of Hénon, whose curves are known in closed form."""

import json
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.text import Text
from unchecked import unchecked

import walker_jax as wj
from walker_jax import storage
from walker_jax.figures.chart_plots import NOT_KNOWN
from walker_jax.gaits import charts
from walker_jax.gaits.charts import Found, lies_on, shifted, words_in
from walker_jax.gaits.codimension_two import criteria
from walker_jax.gaits.event_curves import EventCurve
from walker_jax.gaits.event_paths import Ranges
from walker_jax.gaits.events import Bifurcation
from walker_jax.gaits.gait_summary import summarise_chart
from walker_jax.integrators.integrator import Integrator
from walker_jax.storage.schema import check_dataset
from walker_jax.walking.iteration import with_parameters

BOUNDS = {"a": (-0.3, 1.3), "b": (-1.1, 0.6)}


@pytest.fixture(scope="module")
def charted():
    system = wj.systems.HenonMap(0.1, 0.3)
    gait = wj.find_gait(system, [[0.7, 0.2]])
    return wj.chart(system, BOUNDS, gait, period_max=2, cells=(16, 17), strides=400)


def test_curves_of_a_chart(charted):
    check_dataset(charted, "chart")
    kinds, periods = words_in(charted, "line_kind"), charted["line_period"].values.tolist()
    found = sorted(zip(kinds, periods, strict=True))
    assert found == [("doubling", 1), ("doubling", 2), ("fold", 1), ("neimark-sacker", 1)]
    exact = {
        ("fold", 1): lambda a, b: a + (1 - b) ** 2 / 4,
        ("doubling", 1): lambda a, b: a - 3 * (1 - b) ** 2 / 4,
        ("doubling", 2): lambda a, b: a - (1 - b) ** 2 - (1 + b) ** 2 / 4,
        ("neimark-sacker", 1): lambda a, b: b + 1,
    }
    for i, one in enumerate(zip(kinds, periods, strict=True)):
        a, b = charted["curve_value"].values[charted["curve"].values == i].T
        np.testing.assert_allclose(exact[one](a, b), 0, atol=1e-12)
    torus = kinds.index("neimark-sacker")
    names = words_in(charted, "special_kind")
    assert names[:1] == ["1:4 resonance"] or "1:4 resonance" in names
    at = charted["special_value"].values[names.index("1:4 resonance")]
    np.testing.assert_allclose(at, [0, -1], rtol=0, atol=1e-10)
    assert charted["special_curve"].values[names.index("1:4 resonance")] == torus


def test_cells_of_a_chart(charted):
    a, b = np.meshgrid(charted["first"].values, charted["second"].values, indexing="ij")
    fate, period = charted["cell_fate"].values, charted["cell_period"].values
    stable = (a > -((1 - b) ** 2) / 4 + 0.02) & (a < 3 * (1 - b) ** 2 / 4 - 0.02) & (b > -1)
    assert (period[stable] == 1).all() and (fate[stable] == 0).all() and stable.sum() > 100
    doubled = (a > 3 * (1 - b) ** 2 / 4 + 0.05) & (a < (1 - b) ** 2 + (1 + b) ** 2 / 4 - 0.05)
    doubled &= b > -1
    assert (period[doubled] == 2).all() and doubled.sum() > 10
    assert (fate[a < -((1 - b) ** 2) / 4 - 0.02] == -1).all()


def test_a_bifurcation_is_on_a_curve_from_any_state_on():
    """The cycle of period 3 on the curve may begin with any of its states, in its own order."""
    cycle = np.array([[0.1, 0.2], [0.5, 0.1], [0.9, 0.7]])
    lines = np.linspace(0, 1, 5)
    curve = EventCurve(
        *("doubling", ("a", "b"), np.stack([lines, 2 * lines], 1), np.tile(cycle, (5, 1, 1))),
        *(np.zeros((5, 2), complex), np.zeros(5), [], ("", "")),
    )
    ranges = Ranges(np.zeros(2), np.array([1.0, 2.0]))
    lies = lambda states, kind="doubling", at=(0.3, 0.6): lies_on(
        curve, Found(np.array(at), Bifurcation(kind, 0.3, states, np.zeros(2), cycle, 0.0)), ranges
    )
    assert all(lies(np.roll(cycle, shift, axis=0)) for shift in range(3))
    assert not lies(cycle[::-1]) and not lies(cycle + 0.1) and not lies(cycle[:2])
    assert not lies(cycle, at=(0.3, 0.7)) and not lies(cycle, "fold")


def test_values_that_move_leave_places_without_any():
    values = np.arange(12.0).reshape(3, 2, 2)
    for by in (1, -1, 2, -2):
        moved = shifted(values, by, 0)
        kept = slice(by, None) if by > 0 else slice(None, by)
        came = slice(None, -by) if by > 0 else slice(-by, None)
        np.testing.assert_array_equal(moved[kept], values[came])
        assert np.isnan(moved).all(axis=(1, 2)).sum() == abs(by)
    np.testing.assert_array_equal(shifted(values, 1, 1)[:, 1], values[:, 0])
    np.testing.assert_array_equal(shifted(values, -1, 1)[:, 0], values[:, 1])
    assert np.isnan(shifted(values, -1, 1)[:, 1]).all()


def test_a_gait_far_from_its_guess_is_another_one(monkeypatch):
    """Gaits move by 1 over the known points: half of that is near, in each coordinate."""

    def newton(systems, guesses, *_):
        off = np.array([[0.4, -0.4], [0.1, 0.6], [0.0, 0.0]])[np.arange(len(guesses)) % 3]
        found = np.arange(len(guesses)) % 3 != 2
        states = guesses + off[:, None]
        return SimpleNamespace(found=found, states=states, stable=found)

    monkeypatch.setattr(charts, "iterate_newton", newton)
    monkeypatch.setattr(charts, "MOST_TRIES", 1)
    values = np.array([[0.5, 0.5], [0.5, 1.5], [1.5, 0.5]])
    known = np.concatenate([values, [[0.0, 0.0], [1.0, 0.5], [0.5, 1.0]]], axis=1)
    ranges = Ranges(np.zeros(2), np.array([2.0, 2.0]))
    systems = with_parameters(wj.systems.HenonMap(), ("a", "b"), np.tile(values, (2, 1))[:4])
    gaits, stable = charts.spread_gaits(
        systems, np.tile(values, (2, 1))[:4], known, (2, 2), ranges, Integrator(1e-10)
    )
    np.testing.assert_allclose(gaits[0], [0.4, -0.4])
    assert np.isnan(gaits[1:3]).all() and stable.tolist() == [True, False, False, False]


def test_criteria_of_codimension_two_are_their_formulas():
    """Of the polynomial (x - m) (x - 1/2) of two multipliers, and the coefficient 3 of the form."""
    doubled = criteria("doubling", np.array([-1.0, 0.5 + 0j]), np.zeros(0), 3.0)
    # chi(1) = 2 (1/2) = 1, and chi'(-1) = -1 - 1/2
    assert doubled == pytest.approx(
        {"1:2 resonance": -1.5, "fold-flip": 1.0, "generalised flip": -4.5}
    )
    fold = criteria("fold", np.array([1.0, 0.5 + 0j]), np.zeros(0), 3.0)
    assert fold == pytest.approx({"cusp": 1.5, "1:1 resonance": 0.5, "fold-flip": 3.0})
    pair = np.exp([1.2j, -1.2j])
    torus = criteria("neimark-sacker", np.append(pair, 0.5), np.array([np.cos(1.2)]), 3.0)
    cosine = np.cos(1.2)
    assert torus == pytest.approx(
        {
            **{"1:1 resonance": cosine - 1, "1:2 resonance": cosine + 1},
            **{"1:3 resonance": cosine + 0.5, "1:4 resonance": cosine},
            **{"Chenciner": 1.5, "fold-Neimark-Sacker": 0.5, "flip-Neimark-Sacker": -1.5},
        }
    )


def test_the_summary_of_a_chart_is_json(charted):
    answer = summarise_chart(charted)
    (doubling,) = [
        one for one in answer["curves"] if (one["kind"], one["period"]) == ("doubling", 1)
    ]
    assert doubling["criticality"] == ["supercritical"]
    assert {end["reason"] for end in doubling["ends"]} == {"the end of the range"}
    assert sum(answer["cells"].values()) == pytest.approx(1)
    from walker_jax.cli.answers import jsonable

    json.dumps(jsonable(answer), allow_nan=False)


def test_undecided_cells_are_a_class_of_their_own(charted):
    """In the summary and in the picture, beside those that fail and those without a gait."""
    from walker_jax import figures

    data = charted.copy(deep=True)
    data["cell_fate"].values[:2, :3] = wj.Outcome.UNDECIDED
    data["cell_fate"].values[2, :3] = wj.Outcome.OUTSIDE
    before, after = (summarise_chart(one)["cells"] for one in (charted, data))
    assert "undecided" not in before
    assert after["undecided"] == pytest.approx(6 / (16 * 17))
    assert sum(after.values()) == pytest.approx(1) and after["fails"] > 0
    ax = figures.chart(data)
    assert {"undecided", "fails"} <= {one.get_text() for one in ax.figure.findobj(Text)}
    image = np.asarray(ax.images[0].get_array())
    np.testing.assert_array_equal(image[0, 0], np.round(255 * np.array(to_rgb(NOT_KNOWN))))
    assert not np.allclose(image[0, 2], image[0, 0])


def test_a_point_that_two_curves_share_is_drawn_once(charted):
    """Curves of folds and of doublings both have a fold-flip, for instance."""
    from walker_jax import figures

    count = charted.sizes["special"]
    shared = charted.isel(special=[*range(count), 0])
    words = lambda data: [one.get_text() for one in figures.chart(data).figure.findobj(Text)]
    assert count > 1 and words(shared) == words(charted)
    shared["special_value"].values[-1, 0] += 0.1
    apart = words(shared)
    assert f"{count + 1} codimension-two points" in ", ".join(apart)
    assert len(apart) == len(words(charted)) + 1


def test_a_chart_without_curves_is_kept(tmp_path):
    """And drawn: of a gait that is stable all over the bounds."""
    from walker_jax import figures

    system = wj.systems.HenonMap(0.1, 0.3)
    gait = wj.find_gait(system, [[0.7, 0.2]])
    bounds = {"a": (0.05, 0.2), "b": (0.2, 0.35)}
    data = wj.chart(system, bounds, gait, period_max=1, cells=(3, 2), strides=5)
    assert data.sizes["line"] == data.sizes["special"] == 0
    request = {"command": "chart", "version": "0"}
    kept = storage.save(data, tmp_path / "chart.zarr", request)
    check_dataset(kept, "chart")
    assert (kept["cell_period"].values == 1).all()
    assert figures.chart(kept).get_xlabel() == "a"


def test_charts_that_are_refused():
    system = wj.systems.HenonMap(0.1, 0.3)
    gait = wj.find_gait(system, [[0.7, 0.2]])
    for bounds, message in (
        ({"a": (0.2, 1), "b": (0, 1)}, r"bounds must hold the values of the system, a 0\.1 and b"),
        ({"a": (0, 1), "c": (0, 1)}, "parameter must be one of the walker's, a, b, not 'c'"),
        ({"a": (1, 0), "b": (0, 1)}, r"bounds of a must be \(low, high\) with low below"),
        ({"a": (0, 1)}, "parameters must be two different names"),
    ):
        with pytest.raises(ValueError, match=message):
            wj.chart(system, bounds, gait)
    with pytest.raises(ValueError, match="gait must be one of this system"):
        wj.chart(wj.systems.HenonMap(0.2, 0.3), BOUNDS, gait)
    with pytest.raises(ValueError, match="gait must be one state on the section x, y, not of"):
        other = wj.systems.HenonMap(0.6, 0.3)
        double = wj.find_gait(other, [[0.97, -0.09], [-0.3, 0.29]], period=2)
        wj.chart(other, BOUNDS, double)
    with pytest.raises(ValueError, match="cells must be at least 2, not 1"):
        wj.chart(system, BOUNDS, gait, cells=(1, 4))
    with unchecked(), pytest.raises(ValueError, match="cells must be two numbers, not 3"):
        wj.chart(system, BOUNDS, gait, cells=3)  # pyright: ignore[reportArgumentType] (wrong use)


def test_the_command_answers_keeps_and_draws(run, tmp_path):
    command = ["chart", "--system", "henon", "--a", "0.1", "--over", "a=0:0.6:6"]
    command += ["--over", "b=0.1:0.5:4", "--period-max", "1", "--strides", "50"]
    command += ["--start", "x=0.7", "--start", "y=0.2"]
    code, out, _ = run(*command)
    assert code == 0 and "doubling of period 1, supercritical:" in out
    code, out, _ = run(*command, "--json")
    answer = json.loads(out)
    assert code == 0 and answer["parameters"] == ["a", "b"]
    (curve,) = answer["curves"]
    assert curve["kind"] == "doubling" and len(curve["ends"]) == 2
    assert (tmp_path / "chart.png").read_bytes().startswith(b"\x89PNG")
    assert run(*command[:-4], "--json")[0] == 2  # of another request


@pytest.mark.parametrize(
    ("over", "message"),
    [
        (["a=0:1:5"], "--over is required twice"),
        (["a=0:1:5", "a=0:1:5"], "--over is given twice for a"),
        (["a=0:1:5", "b=0.4:1:5"], "--over b=0.4:1:5 must hold the b 0.3"),
    ],
)
def test_wrong_ranges_of_the_command(run, over, message):
    given = [text for one in over for text in ("--over", one)]
    code, _, err = run("chart", "--system", "henon", "--a", "0.1", *given)
    assert code == 2 and message in err and err.count("\n") == 1


class Invariant(wj.System):
    """The logistic map, and a second coordinate that stays at zero."""

    r: float = 2.5
    pull: float = 0.5
    section = "x", "y"

    def advance(self, x):
        return jnp.stack([self.r * x[0] * (1 - x[0]), self.pull * x[1]]), 0, 1.0

    def gait_region(self):
        return wj.Grid.plain(x=(0.1, 0.9, 4), y=(-0.1, 0.1, 2))


def test_a_coordinate_that_never_changes_hides_no_gait():
    system = Invariant()
    gait = wj.find_gait(system, [[0.6, 0.0]])
    bounds = {"r": (2.2, 3.2), "pull": (0.3, 0.7)}
    data = wj.chart(system, bounds, gait, period_max=1, cells=(10, 4), strides=400)
    r = np.broadcast_to(data["first"].values[:, None], (10, 4))
    period = data["cell_period"].values
    assert (period[r < 2.95] == 1).all() and (period[r > 3.05] == 2).all()

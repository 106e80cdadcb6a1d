"""Charts of two parameters, of the map of Hénon, whose curves are known in closed form."""

import json

import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.text import Text
from unchecked import unchecked

import walker_jax as wj
from walker_jax import storage
from walker_jax.figures.chart_plots import NOT_KNOWN
from walker_jax.gaits.charts import words_in
from walker_jax.gaits.gait_summary import summarise_chart
from walker_jax.storage.schema import check_dataset

BOUNDS = {"a": (-0.3, 1.3), "b": (-1.1, 0.6)}


@pytest.fixture(scope="module")
def charted():
    system = wj.HenonMap(0.1, 0.3)
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
    np.testing.assert_allclose(image[0, 0], to_rgb(NOT_KNOWN), atol=1e-12)
    assert not np.allclose(image[0, 2], image[0, 0])


def test_a_chart_without_curves_is_kept(tmp_path):
    """And drawn: of a gait that is stable all over the bounds."""
    from walker_jax import figures

    system = wj.HenonMap(0.1, 0.3)
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
    system = wj.HenonMap(0.1, 0.3)
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
        wj.chart(wj.HenonMap(0.2, 0.3), BOUNDS, gait)
    with pytest.raises(ValueError, match="gait must be one state on the section x, y, not of"):
        other = wj.HenonMap(0.6, 0.3)
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

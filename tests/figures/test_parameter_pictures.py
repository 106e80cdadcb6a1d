"""Pictures of gaits over a parameter, and of their multipliers."""

import matplotlib.pyplot as plt
import numpy as np
import pytest
from made_up_results import BRANCHES, EVENTS, NOTHING, diagram, every_fate, gait
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from parts_of_pictures import annotations, box, figure_of, legend, lightness, lines, signs, words

from walker_jax import figures
from walker_jax.figures import style, text
from walker_jax.figures.branch_plots import places_near
from walker_jax.figures.sweep_plots import colours_of

PICTURES = [figures.gait_branches, figures.largest_multiplier, figures.bifurcation_diagram]


def test_branches_are_solid_where_stable_and_dashed_elsewhere():
    ax = figures.gait_branches(diagram())
    solid, dashed = lines(ax, dashed=False), lines(ax, dashed=True)
    assert [len(line) for line in solid] == [3, 3, 3, 3, 3, 3]  # of periods 1, 2, 2, 3, 3, 3
    assert [len(line) for line in dashed] == [3, 2, 2, 2, 3, 3, 3]  # two of period 1
    np.testing.assert_allclose(solid[0], [(0.010, 0.20), (0.014, 0.24), (0.015, 0.25)])
    np.testing.assert_allclose(dashed[0], [(0.015, 0.25), (0.016, 0.26), (0.020, 0.28)])
    np.testing.assert_allclose(solid[2][-1], (0.019, 0.30))  # the second phase
    # The branch turns round at the fold, which lies beyond its points.
    np.testing.assert_allclose(solid[3][:, 0], [0.0115, 0.012, 0.013])
    np.testing.assert_allclose(dashed[4][:, 0], [0.020, 0.012, 0.0115])


def test_a_stable_part_between_two_bifurcations_is_solid():
    branches = {"one": [(0.01, [0.1], 2.0, False), (0.02, [0.2], -2.0, False)]}
    events = [(True, 0, 0.012, [0.12], 1.0, False), (False, 0, 0.013, [0.13], -1.0, False)]
    ax = figures.gait_branches(diagram(branches, events))
    (solid,) = lines(ax, dashed=False)
    np.testing.assert_allclose(solid, [(0.012, 0.12), (0.013, 0.13)])
    assert len(lines(ax, dashed=True)) == 2


def test_folds_and_period_doublings_are_marked_at_each_phase():
    ax = figures.gait_branches(diagram())
    np.testing.assert_allclose(signs(ax, "o"), [(0.015, 0.25), (0.019, 0.215), (0.019, 0.30)])
    np.testing.assert_allclose(signs(ax, "<")[:, 1], [0.111, 0.131, 0.151])
    kinds, periods = legend(ax)[:4], legend(ax)[4:]
    assert kinds == ["stable", "unstable", "fold", "period doubling"]
    assert periods == ["period 1", "period 2", "period 3"]
    assert "4 branches, 1 fold, 2 period doublings" in words(ax)


def test_step_times_of_period_one_stand_beside_branches():
    ax = figures.gait_branches(diagram())
    (low,), (high,) = annotations(ax, "4.04"), annotations(ax, "4.06")
    assert low.xy == pytest.approx((1, 0.27))
    assert high.xy == pytest.approx((1, 0.28))
    figure_of(ax).draw_without_rendering()
    assert not box(low).overlaps(box(high)) and box(low).x0 > ax.bbox.x1


def test_periods_are_told_apart_even_in_grey():
    shades = [lightness(255 * np.array(to_rgb(colour))) for colour, _ in style.PERIODS]
    assert min(np.diff(shades)) > 6
    markers = [marker for _, marker in (*style.PERIODS, style.LONGER)]
    assert len(set(markers)) == len(markers)
    branches = {"long": BRANCHES["long"], "doubled": BRANCHES["doubled"]}
    ax = figures.gait_branches(diagram(branches, EVENTS[:1]))
    colour = {str(line.get_color()) for line in ax.lines}
    assert colour == {style.PERIODS[0][0], style.PERIODS[1][0]}


def test_the_largest_multiplier_is_drawn_along_the_cascade_only():
    ax = figures.largest_multiplier(diagram())
    solid, dashed = lines(ax, dashed=False), lines(ax, dashed=True)
    assert len(solid) == len(dashed) == 2
    assert solid[0][0] == pytest.approx((0.010, 0.5))
    for one, other, value in ((solid[0], dashed[0], 0.015), (solid[1], dashed[1], 0.019)):
        assert one[-1] == pytest.approx((value, 1)) == other[0]
    assert dashed[1][-1] == pytest.approx((0.020, 3))
    assert all((line[:, 1] <= 1 + 1e-9).all() for line in solid)
    np.testing.assert_allclose(signs(ax, "o"), [(0.015, 1), (0.019, 1)])
    (one,) = (line for line in ax.lines if line.get_transform() == ax.get_yaxis_transform())
    assert one.get_ydata() == [1, 1]
    assert ax.get_ylim() == (0, 2)
    assert legend(ax) == ["period 1, doubles at 0.01500", "period 2, doubles at 0.01900"]


def test_between_points_the_largest_multiplier_has_its_kink():
    branches = {"one": [(0.0, [0.2], 0.0, True), (1.0, [0.2], 0.0, True)]}
    data = diagram(branches, [])
    data["multipliers"].values[:] = [[[0, 0.5], [0, -0.5]], [[-0.8, 0], [-0.3125, 0]]]
    (line,) = lines(figures.largest_multiplier(data), dashed=False)
    trace = -1.1125 * line[:, 0]  # and the product of the two is 0.25 throughout
    root = np.sqrt(np.maximum(trace**2 / 4 - 0.25, 0))
    np.testing.assert_allclose(line[:, 1], np.maximum(0.5, abs(trace) / 2 + root), atol=1e-7)


def test_every_state_of_what_walks_on_is_a_dot():
    ax = figures.bifurcation_diagram(diagram())
    (dots,) = (line for line in ax.lines if line.get_rasterized())
    assert dots.get_linestyle() == "None"
    x, y = np.asarray(dots.get_xydata()).T
    np.testing.assert_allclose(x, np.repeat([0.01, 0.0125, 0.015], 4))
    np.testing.assert_allclose(y, np.tile([0.20, 0.22, 0.24, 0.26], 3))
    (unstable,) = lines(ax, dashed=True)
    np.testing.assert_allclose(unstable[:, 0], [0.015, 0.016, 0.020])


def test_few_dots_are_large_enough_to_be_seen():
    def size(count):
        few = diagram().isel(sample=np.arange(count) % 5)
        data = few.assign(sample_value=("sample", np.linspace(0.01, 0.02, count)))
        return figures.bifurcation_diagram(data).lines[0].get_markersize()

    assert size(1) == size(5) == 3 and size(200) == 1
    assert size(61) == pytest.approx(1.5)


def test_lines_meet_at_a_neimark_sacker_point():
    """It lies between two points, as a fold does; the pair has the modulus 1 there."""
    branches = {"one": [(0.010, [0.20], 0.5, True), (0.020, [0.30], 1.5, False)]}
    found = {"branch": 0, "period": 1, "value": 0.017, "states": [[0.27, 0.1]] + [[np.nan] * 2] * 2}
    found["multipliers"] = [[0.6, 0.8], [0.6, -0.8]]
    data = diagram(branches, [])
    dims = {f"torus_{name}": data[f"torus_{name}"].dims for name in found}
    data = data.drop_dims("torus").assign(
        {f"torus_{name}": (dims[f"torus_{name}"], [value]) for name, value in found.items()}
    )
    ax = figures.gait_branches(data)
    (solid,), (dashed,) = lines(ax, dashed=False), lines(ax, dashed=True)
    np.testing.assert_allclose(solid, [(0.010, 0.20), (0.017, 0.27)])
    np.testing.assert_allclose(dashed, [(0.017, 0.27), (0.020, 0.30)])
    np.testing.assert_allclose(signs(ax, "s"), [(0.017, 0.27)])
    multipliers = figures.largest_multiplier(data)
    (solid,), (dashed,) = (lines(multipliers, dashed=one) for one in (False, True))
    np.testing.assert_allclose([solid[-1], dashed[0]], [(0.017, 1), (0.017, 1)])


def test_a_line_stands_where_walking_is_lost():
    ax = figures.bifurcation_diagram(diagram(lost=(0.0180, 0.0182)))
    (line,) = (line for line in ax.lines if line.get_transform() == ax.get_xaxis_transform())
    assert line.get_xdata() == pytest.approx([0.0181, 0.0181])
    (label,) = annotations(ax, "walking is lost between 0.01800 and 0.01820")
    figure_of(ax).draw_without_rendering()
    assert box(label).y0 > ax.bbox.y1
    assert legend(ax) == ["attractor", "unstable gait", "walking is lost"]
    for lost in ((0.02, np.nan), (np.nan, 0.01)):
        ax = figures.bifurcation_diagram(diagram(lost=lost))
        assert not any("lost" in text for text in words(ax))


@pytest.mark.parametrize("draw", PICTURES)
def test_pictures_of_a_parameter_have_names_units_and_its_range(draw):
    ax = draw(diagram())
    assert ax.get_xlabel() == "slope (rad)"
    assert ax.get_xlim() == pytest.approx((0.01, 0.02))
    assert ax.get_ylabel() in (text.AXIS_LABELS["theta"], "modulus of the largest multiplier")
    assert ax.get_title(loc="left").startswith("SimplestWalker: ")
    other = diagram().assign_attrs(parameter="foot_radius", walker_slope=0.004)
    assert draw(other).get_xlabel() == "foot radius"
    assert draw(other).get_title(loc="left").startswith("SimplestWalker, slope 0.004 rad: ")


@pytest.mark.parametrize("draw", PICTURES)
@pytest.mark.parametrize("data", [NOTHING, diagram(walks=False, lost=(np.nan, 0.01))])
def test_pictures_of_nothing_that_walks_are_drawn(draw, data):
    figure_of(draw(data)).draw_without_rendering()


@pytest.mark.parametrize("draw", PICTURES)
def test_pictures_of_a_parameter_are_drawn_where_they_are_told(draw):
    axes = Figure(layout="constrained").subplots(1, 2)
    assert draw(diagram(), axes[1]) is axes[1]
    assert axes[1].has_data() and not axes[0].has_data()


@pytest.mark.parametrize("draw", [*PICTURES, figures.bifurcations])
def test_other_data_is_refused_by_pictures_of_a_parameter(draw):
    wrong = [
        (every_fate(), "branch"),
        (diagram().drop_vars(["event_fold", "stable"]), "stable, event_fold"),
        (diagram().drop_attrs(), "attribute parameter"),
    ]
    for data, name in wrong:
        with pytest.raises(ValueError, match=f"^data must be .* without {name}") as e:
            draw(data)
        assert "\n" not in str(e.value)


def test_all_of_a_parameter_is_one_picture_with_a_cascade(tmp_path):
    figure = figures.bifurcations(diagram())
    gaits, attractors, multiplier, cascade = figure.axes
    assert multiplier.get_xlim() == gaits.get_xlim() == attractors.get_xlim()
    low, high = cascade.get_xlim()
    assert 0.01 < low < 0.015 and 0.0181 < high < 0.02
    low, high = cascade.get_ylim()
    assert 0.18 < low < 0.20 and 0.26 < high < 0.28
    figure.savefig(tmp_path / "bifurcations.png", dpi=50)
    assert (tmp_path / "bifurcations.png").stat().st_size > 0


@pytest.mark.slow
def test_all_of_a_parameter_without_a_cascade_is_three_pictures():
    for data in (NOTHING, diagram(lost=(np.nan, np.nan)), diagram(walks=False)):
        figure = figures.bifurcations(data)
        figure.draw_without_rendering()
        assert len(figure.axes) == 3
    assert plt.get_fignums() == []


def test_multipliers_are_filled_inside_the_unit_circle_only():
    stable, unstable = (0.3 + 0.4j, 0.3 - 0.4j), (-1.5, 0.2)
    ax = figures.multipliers([gait(2, *unstable), gait(1, *stable, stable=True)])
    (circle,) = (patch for patch in ax.patches if isinstance(patch, Circle))
    assert circle.center == (0, 0) and circle.radius == 1
    assert ax.get_aspect() == 1
    for marker, values, filled in (("o", stable, True), ("s", unstable, False)):
        (line,) = (line for line in ax.lines if line.get_marker() == marker)
        x, y = np.asarray(line.get_xydata()).T
        np.testing.assert_allclose(x + 1j * y, values)
        assert (line.get_markerfacecolor() == line.get_color()) == filled
    assert legend(ax) == ["stable", "unstable", "period 1", "period 2"]
    assert "of 2 gaits, 1 of them stable" in words(ax)
    alike = figures.multipliers([gait(1, *stable, stable=True), gait(1, *unstable)])
    assert legend(alike) == ["stable", "unstable"]  # no sign stands there twice
    assert "of 2 gaits of period 1, 1 of them stable" in words(alike)


def test_step_times_stand_apart_within_the_range():
    places = places_near(np.array([1.0, 1.1, 1.2]), 0.0, 10.0)
    np.testing.assert_allclose(places, [1.35 - 0.9, 1.35, 1.35 + 0.9])  # not below the range
    np.testing.assert_allclose(places_near(np.array([4.0, 6.0]), 0.0, 10.0), [4.0, 6.0])
    np.testing.assert_allclose(places_near(np.array([4.0, 4.1]), 0.0, 10.0), [3.6, 4.5])
    assert len(places_near(np.zeros(0), 0.0, 1.0)) == 0


def test_attractors_have_the_colours_of_their_periods():
    colours = colours_of([1, 3, 2, 2, 0])
    own = [style.period_style(period)[0] for period in (1, 3, 2)]
    assert colours[:3] == own and len(set(colours)) == 5
    assert colours_of([0] * 20)[-1] == style.LONGER[0]


@pytest.mark.parametrize("value", [12345.6, -37.25, 2.51, 1.5 + 9j, -400 - 3j, -3e7])
def test_large_multipliers_are_on_a_logarithmic_scale(value):
    ax = figures.multipliers([gait(1, value, 0.1)])
    assert signs(ax, "o") == pytest.approx(np.array([(value.real, value.imag), (0.1, 0)]))
    figure_of(ax).draw_without_rendering()
    place = lambda z: ax.transData.transform((complex(z).real, complex(z).imag))
    assert ax.bbox.contains(*place(value))
    middle, unit = place(0), place(1)[0] - place(0)[0]
    assert place(2)[0] - middle[0] == pytest.approx(2 * unit)  # linear up to there
    assert unit > 0.08 * ax.bbox.width
    circle = place(1j) - middle
    np.testing.assert_allclose(circle, [0, unit], atol=1e-6)  # as high as wide
    steps = np.diff([place(10.0**k)[0] for k in range(1, 9)])
    np.testing.assert_allclose(steps, steps[0], rtol=1e-6)


def test_multipliers_near_the_circle_need_no_other_scale():
    ax = figures.multipliers([gait(1, -1.9, 0.1)])
    assert ax.get_xscale() == ax.get_yscale() == "linear"


def test_multipliers_of_failed_searches_are_left_out():
    for gaits in ([], [gait(1, np.nan, np.nan, found=False)]):
        ax = figures.multipliers(gaits)
        figure_of(ax).draw_without_rendering()
        assert len(signs(ax, "o")) == 0 and legend(ax) == []
    axes = Figure(layout="constrained").subplots(1, 2)
    assert figures.multipliers([gait(1, 0.5, 0)], axes[0]) is axes[0]
    assert not axes[1].has_data()

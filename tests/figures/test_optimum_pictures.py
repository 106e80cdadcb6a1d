"""Pictures of optimisations."""

from itertools import combinations

import matplotlib.pyplot as plt
import numpy as np
import pytest
from made_up_results import FATES, optimum, robust
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from parts_of_pictures import colours, legend, lightness, line, words

from walker_jax import figures
from walker_jax.figures import optimum_plots, style


def shaded(ax):
    """Where the ground is shaded, from left to right."""
    spans = [patch.get_window_extent() for patch in ax.patches]
    ends = [ax.transData.inverted().transform(span.get_points())[:, 0] for span in spans]
    return np.sort(np.array(ends).reshape(-1, 2), axis=0)


def test_the_scan_is_dashed_where_limits_do_not_allow_it():
    data = optimum()
    ax = figures.optimisation(data)
    # The optimum, at 0.003, is a point of it.
    at, value = [0, 0.003, 0.004, 0.008, 0.012, 0.016, 0.02], [5, 4, 3.7, 2.5, 1.5, 1, 0.5]
    nan = np.nan
    np.testing.assert_allclose(line(ax, linewidth=2.5)[:, 0], at)
    np.testing.assert_allclose(line(ax, linewidth=2.5)[:, 1], [nan, 4, 3.7, 2.5, nan, nan, 0.5])
    np.testing.assert_allclose(line(ax, linestyle="--"), np.column_stack([at, value]))
    np.testing.assert_allclose(shaded(ax), [[0, 0.003], [0.008, 0.02]], atol=1e-12)
    assert {"scan, others as in the optimum", "speed below 0.06"} < set(legend(ax))
    other = figures.optimisation(data, "hip_stiffness")
    scan = data.isel(parameter=1)
    np.testing.assert_array_equal(
        line(other, linewidth=2.5), np.column_stack([scan["scan_parameters"], scan["scan_value"]])
    )
    assert len(other.patches) == 0 and "speed below 0.06" not in legend(other)
    assert "scan" in legend(figures.optimisation(data.isel(parameter=[0])))


@pytest.mark.parametrize(
    "limits, words",
    [
        ("{}", "no gait"),
        ('{"speed": [0.06, 0.1]}', "speed below 0.06 or speed above 0.1"),
        (
            '{"spectral-radius": [null, 0.9], "step-length": [0.2, null]}',
            "modulus of the largest multiplier above 0.9 or step length below 0.2",
        ),
    ],
)
def test_limits_are_told_in_words(limits, words):
    assert words in legend(figures.optimisation(optimum(limits=limits)))


def test_start_and_optimum_are_marked_even_at_bounds():
    ax = figures.optimisation(optimum())
    np.testing.assert_array_equal(line(ax, markersize=12), [[0.010, 2.02]])
    np.testing.assert_array_equal(line(ax, marker="*"), [[0.003, 4.04]])
    assert ax.get_xlim() == (0, 0.02) and ax.get_xlabel() == "slope (rad)"
    assert legend(ax)[:2] == ["start, at 0.01", "optimum, at 0.003"]
    ax = figures.optimisation(optimum(), "hip_stiffness")
    np.testing.assert_array_equal(line(ax, marker="*"), [[2, 4.04]])
    (star,) = (one for one in ax.lines if one.get_marker() == "*")
    assert ax.get_xlim() == (0, 2) and ax.get_xlabel() == "hip stiffness"
    assert not star.get_clip_on()


def test_the_run_to_the_optimum_is_joined_others_are_faint():
    data = optimum()
    ax = figures.optimisation(data)
    way = [[0.010, 2], [0.006, 3], [0.0035, 3.8], [0.003, 4]]
    np.testing.assert_array_equal(line(ax, linewidth=0.8, alpha=1), way)
    faint = [[0.018, 1], [0.012, 1.5]]
    np.testing.assert_array_equal(line(ax, linewidth=0.8, alpha=optimum_plots.FAINT), faint)
    shades, sizes, names = ([stage[i] for stage in optimum_plots.STAGES] for i in range(3))
    for stage, dots in enumerate([way[:2], way[2:3], [], way[3:]]):
        look = {"marker": "o", "alpha": 1, "color": shades[stage]}
        np.testing.assert_array_equal(line(ax, **look), np.reshape(dots, (-1, 2)))
    light = [lightness(255 * np.array(to_rgb(colour))) for colour, *_ in optimum_plots.STAGES]
    assert max(np.diff(light)) < -10 and max(np.diff(sizes)) < 0
    assert "other runs" in legend(ax) and legend(ax)[-4:-1] == [names[0], names[1], names[3]]
    alone = figures.optimisation(data.isel(evaluation=slice(2, None)))
    assert "other runs" not in legend(alone)


@pytest.mark.parametrize(
    "changes, subject, note",
    [
        ({}, "area of the basin", "2.02 to 4.04 (× 2)"),
        (
            {"objective": '{"spectral-radius": 1.0}', "sign": -1.0},
            "modulus of the largest multiplier",
            "2.02 to 4.04 (× 2; small is better)",
        ),
        (
            {"objective": '{"area": 2.0, "speed": 0.1, "cost-of-transport": -0.5}'},
            "2 area + 0.1 speed − 0.5 cost of transport",
            "2.02 to 4.04 (× 2)",
        ),
        ({"objective": '{"least-disturbance": -1.0}'}, "− 1 least disturbance", "2.02 to 4.04"),
    ],
    ids=["one", "small", "sum", "negative"],
)
def test_the_title_tells_the_objective_and_what_was_reached(changes, subject, note):
    data = optimum(**changes)
    ax = figures.optimisation(data)
    above = ax.get_title(loc="left").replace("\n", " ")
    assert above == f"SpringWalker, foot radius 0.3: {subject}"  # without what was free
    assert ax.get_ylabel() == subject
    assert words(ax)[0].startswith(note) and words(ax)[0].endswith("held by a limit of speed")
    assert words(figures.optimisation(data, "hip_stiffness"))[0].endswith("at the upper bound")
    inside = data.assign(binding=("measure", [False, False]), converged=False)
    (line,) = words(figures.optimisation(inside))
    assert "inside the bounds" in line and line.endswith("not converged")


def test_from_nothing_there_is_no_factor():
    (note,) = words(figures.optimisation(optimum().assign(exact_start=0.0)))
    assert note == "0 to 4.04, held by a limit of speed"


def test_an_optimisation_without_scan_or_of_one_place_is_drawn():
    bare = optimum(basins=False).drop_vars(["scan_parameters", "scan_value", "scan_allowed"])
    one = bare.isel(evaluation=[2, -2, -1])
    for data in (bare, one):
        figure = figures.optimum(data)
        figure.draw_without_rendering()
        assert [len(ax.patches) for ax in figure.axes] == [0, 0]
        assert not any("scan" in text for text in legend(figure.axes[0]))


def test_basins_before_and_after_have_the_colours_of_a_basin():
    data = optimum()
    figure = figures.basins_before_and_after(data)
    start, best = figure.axes
    assert start.get_xlim() == best.get_xlim() == pytest.approx((0, 0.4))
    assert start.get_ylim() == best.get_ylim() == pytest.approx((-0.04, 0.01))
    expected = {outcome: colour for outcome, (colour, *_) in style.SIGNS.items()}
    expected |= {-1: style.BASINS[0], 0: style.UNMATCHED}
    for ax, name in ((start, "fate_start"), (best, "fate_optimum")):
        for fate in FATES.tolist():
            (colour,) = np.unique(colours(ax)[data[name].values == fate], axis=0)
            np.testing.assert_array_equal(colour, np.round(255 * np.array(to_rgb(expected[fate]))))
    assert start.get_title(loc="left") == "Start: slope 0.01 rad, hip stiffness 1"
    assert best.get_title(loc="left").split() == "Optimum: slope 0.003 rad, hip stiffness 2".split()
    (below,) = figure.legends
    told = [text.get_text() for text in below.get_texts()]
    assert {"basin of attraction", "converges to no known attractor", "runs"} < set(told)
    assert len(told) == 8


def test_the_area_of_basins_is_told_where_it_was_optimised():
    first, second = figures.basins_before_and_after(optimum(objective='{"area": 2.0}')).axes
    assert "1.01 × 10$^{0}$" in words(first)[0] and "2.02 × 10$^{0}$" in words(second)[0]
    for objective in ('{"area": 1.0, "speed": 1.0}', '{"speed": 1.0}'):
        assert words(figures.basins_before_and_after(optimum(objective=objective)).axes[0]) == []
    region = '{"theta": [0, 0.4, 80], "sum": [-0.04, 0.01, 60], "phidot": -0.1}'
    (note,) = words(figures.basins_before_and_after(optimum(region=region)).axes[0])
    assert " ".join(note.split()).endswith("; in the slice at $\\dot{\\varphi}$ = −0.1")


def test_an_optimisation_is_one_picture_without_overlaps(tmp_path):
    figure = figures.optimum(optimum())
    slope, stiffness, start, best = figure.axes
    assert slope.get_title(loc="left") == "Slope"
    assert stiffness.get_title(loc="left") == "Hip stiffness"
    assert len(start.images) == len(best.images) == 1
    figure.savefig(tmp_path / "optimum.png", dpi=50)
    assert (tmp_path / "optimum.png").stat().st_size > 0
    boxes = [ax.get_tightbbox() for ax in figure.axes]
    boxes += [below.get_window_extent() for below in figure.legends]
    for one, other in combinations(boxes, 2):
        assert one is not None and other is not None and not one.overlaps(other)
    keys = [key for key in slope.get_children() if isinstance(key, Legend)]
    extents = [slope.bbox, *(key.get_window_extent() for key in keys)]
    assert len(extents) == 2
    for one, other in combinations(extents, 2):
        assert not one.overlaps(other)
    assert len(figures.optimum(optimum().isel(parameter=[0])).axes) == 3
    assert plt.get_fignums() == []


def test_an_optimisation_is_drawn_where_it_is_told():
    axes = Figure(layout="constrained").subplots(1, 2)
    assert figures.optimisation(optimum(), "slope", axes[1]) is axes[1]
    assert axes[1].has_data() and not axes[0].has_data()


def test_an_optimisation_that_led_nowhere_is_refused():
    nowhere = optimum().assign(found=False)
    for draw in (figures.optimisation, figures.optimum):
        for data in (nowhere, optimum().drop_vars("found")):
            with pytest.raises(ValueError, match="must be of an optimisation that found"):
                draw(data)
        with pytest.raises(ValueError, match="must be of the kind 'optimisation', not"):
            draw(robust())
    with pytest.raises(ValueError, match="must be one of slope, hip_stiffness, not 'feet'"):
        figures.optimisation(optimum(), "feet")
    with pytest.raises(ValueError, match="must hold fate_start and fate_optimum"):
        figures.basins_before_and_after(optimum(basins=False))

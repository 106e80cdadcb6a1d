"""Pictures of robustness, sweeps and metastable walking, and what all pictures have in common."""

from inspect import isfunction, signature
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pytest
import xarray as xr
from made_up_results import (
    charted,
    completed,
    diagram,
    every_fate,
    fitted,
    gait,
    lives,
    metastable,
    optimum,
    robust,
    swept,
    table,
    transients,
    with_exponents,
)
from matplotlib.collections import QuadMesh
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from matplotlib.text import Text
from parts_of_pictures import extents, figure_of, labels, legend

import walker_jax as wj
from walker_jax import Grid, Outcome, figures
from walker_jax.figures.layout import in_lines
from walker_jax.figures.text import NO_BREAK, walker_title
from walker_jax.walkers.parameters import attributes_of

# Robustness


def test_the_least_disturbance_is_drawn_up_to_the_boundary():
    ax = figures.disturbance(robust())
    curve, gait, nearest = (np.asarray(line.get_xydata()) for line in ax.lines)
    away = curve - [0.2, -0.015]
    away[:, 1] -= away[:, 0]  # from theta + thetadot to thetadot
    np.testing.assert_allclose(np.linalg.norm(away, axis=1), 0.05, rtol=1e-12)
    np.testing.assert_allclose(gait, [[0.2, -0.015]], atol=1e-15)
    np.testing.assert_allclose(nearest, [[0.15, -0.065]], atol=1e-15)
    low, high = ax.get_xlim()
    assert low < curve[:, 0].min() and curve[:, 0].max() < high
    assert "nearest start that falls forward after 7 strides" in legend(ax)
    assert "basin of attraction" in legend(ax) and "0.05" in ax.texts[0].get_text()
    other = figures.disturbance(robust(failure=int(Outcome.STRIDE)))
    assert "nearest start that converges to another attractor" in legend(other)


def test_the_nearest_fall_is_drawn_beside_a_nearer_motion():
    falls = {
        "least_fall": 0.08,
        "fall_direction": ("coordinate", np.array([0.0, 1.0])),
        "fall_state": ("coordinate", np.array([0.2, -0.135])),
        "fall_failure": int(Outcome.BACKWARD),
        "fall_strides": 3,
    }
    ax = figures.disturbance(robust(failure=int(Outcome.STRIDE), **falls))
    _, outer, *_, fall = (np.asarray(line.get_xydata()) for line in ax.lines)
    away = outer - [0.2, -0.015]
    away[:, 1] -= away[:, 0]  # from theta + thetadot to thetadot
    np.testing.assert_allclose(np.linalg.norm(away, axis=1), 0.08, rtol=1e-12)
    np.testing.assert_allclose(fall, [[0.2, 0.065]], atol=1e-15)
    low, high = ax.get_xlim()
    assert low < outer[:, 0].min() and outer[:, 0].max() < high
    told = legend(ax)
    assert "nearest start that converges to another attractor" in told
    assert "nearest start that falls backward after 3 strides" in told
    assert "0.05 to another attractor, 0.08 to a failure" in ax.texts[0].get_text()
    figure_of(ax).canvas.draw()
    assert len(figures.disturbance(robust(**falls)).lines) == 3  # one point: it falls there


def test_the_table_marks_falls_beyond_another_motion():
    data = table(least_fall=[1e-3, 3e-3, np.nan])
    ax = figures.robustness_measures(data)
    (marks,) = (line for line in ax.lines if "falls" in str(line.get_label()))
    np.testing.assert_array_equal(np.asarray(marks.get_xydata()), [[0.008, 1.5]])
    assert ax.get_ylim()[1] > 1.5
    same = figures.robustness_measures(table(least_fall=[1e-3, 2e-3, np.nan]))
    assert len(same.lines) == 3


def test_the_least_disturbance_is_drawn_over_larger_cells():
    coarse = robust(Grid.sheared(theta=(0, 0.4, 4), sum=(-0.04, 0.01, 2)), least_disturbance=1e-4)
    ax = figures.disturbance(coarse)
    low, high = ax.get_xlim()
    assert low < 0.2 < high and high - low < 1e-3
    figure_of(ax).canvas.draw()


def test_without_a_disturbance_a_basin_stands_alone():
    assert len(figures.robustness(robust()).axes) == 2
    lost = robust(least_disturbance=np.nan, gait_period=0)
    assert len(figures.robustness(lost).axes) == 1
    assert len(figures.robustness(every_fate()).axes) == 1
    with pytest.raises(ValueError, match="must hold the least disturbance"):
        figures.disturbance(lost)
    with pytest.raises(ValueError, match="must be of the kind 'robustness', not one without"):
        figures.disturbance(every_fate())


def test_measures_of_robustness_are_parts_of_their_largest():
    ax = figures.robustness_measures(table())
    area, least, multiplier = (np.asarray(line.get_xydata()) for line in ax.lines)
    np.testing.assert_array_equal(area, [[0.004, 1], [0.008, 0.5], [0.012, 0]])
    np.testing.assert_array_equal(least, [[0.004, 0.5], [0.008, 1], [0.012, np.nan]])
    np.testing.assert_array_equal(multiplier[:2], [[0.004, 0.6], [0.008, 0.9]])
    assert legend(ax) == [
        "area of the basin (largest 0.002)",
        "least disturbance (largest 0.002)",
        "modulus of the largest multiplier",
    ]
    assert len({line.get_color() for line in ax.lines}) == 3
    assert ax.get_title(loc="left") == "SimplestWalker: robustness"


def test_nothing_walks_anywhere():
    nowhere = [np.nan] * 3
    names = ("least_disturbance", "multiplier", "dimension_low", "dimension", "dimension_high")
    data = table(total_area=[0.0] * 3, **dict.fromkeys(names, nowhere))
    figure = figures.robustness_table(data)
    figure.canvas.draw()
    assert len(figure.axes) == 4


def test_each_measure_of_robustness_has_a_panel_with_its_unit():
    data = table(least_fall=[1e-3, 3e-3, np.nan], gait_period=[2, 4, 0])
    figure = figures.robustness_table(data)
    area, least, multiplier, dimension = figure.axes
    np.testing.assert_array_equal(area.lines[0].get_ydata(), [2e-3, 1e-3, 0])
    np.testing.assert_array_equal(least.lines[0].get_ydata(), [1e-3, 2e-3, np.nan])
    np.testing.assert_array_equal(np.asarray(least.lines[1].get_xydata()), [[0.008, 3e-3]])
    np.testing.assert_array_equal(multiplier.lines[0].get_ydata(), [0.6, 0.9, np.nan])
    assert [one.get_text() for one in multiplier.texts][:2] == ["2", "4"]
    assert [ax.get_ylabel().partition(" (")[0] for ax in figure.axes] == [
        "area of the basin",
        "least disturbance",
        "modulus of the largest multiplier",
        "dimension",
    ]
    assert "rad²" in area.get_ylabel() and dimension.get_title(loc="left")
    titles = [text.get_text() for text in figure.texts]
    assert titles == ["SimplestWalker: robustness"]


def test_the_dimension_is_drawn_with_its_interval():
    ax = figures.boundary_dimension(table())
    (band,) = ax.collections
    corners = np.asarray(band.get_paths()[0].vertices)
    assert {1.0, 1.1, 1.3, 1.5} <= set(np.round(corners[:, 1], 12).tolist())
    (low, high), smooth = ax.get_ylim(), ax.lines[1].get_ydata()
    assert low < 1 and high > 1.5 and set(np.asarray(smooth)) == {1}
    with pytest.raises(ValueError, match="must be of the kind 'robustness table'"):
        figures.boundary_dimension(robust())


# Optimisations


def test_the_area_over_one_parameter_has_its_error():
    ax = figures.sweep(swept(3))
    (line, _, (bars,)) = ax.containers[0]
    np.testing.assert_array_equal(line.get_xdata(), [0.002, 0.004, 0.006])
    np.testing.assert_allclose(np.asarray(line.get_ydata(), float), [np.nan, 0.002, 0.003])
    ends = [segment[:, 1] for segment in bars.get_segments() if len(segment)]
    np.testing.assert_allclose(ends, [[0.0018, 0.0022], [0.0027, 0.0033]])
    assert "slope" in ax.get_xlabel() and "area of the basin" in ax.get_ylabel()
    assert "3 basins" in (note := ax.texts[0].get_text()) and "1 failed" in note


def test_values_of_a_sweep_may_come_in_any_order():
    data = swept(3, 2)
    ax, turned = map(figures.sweep, (data, data.isel(slope=[2, 0, 1], hip_stiffness=[1, 0])))
    meshes: Any = (ax.collections[0], turned.collections[0])
    one, other = (np.ma.filled(mesh.get_array(), -1) for mesh in meshes)
    np.testing.assert_array_equal(one, other)
    assert ax.get_xlim() == turned.get_xlim() and ax.get_ylim() == turned.get_ylim()


def test_the_zero_line_is_shown_below_positive_exponents():
    data = with_exponents()
    ax = figures.lyapunov_exponents(data.assign(exponents=abs(data["exponents"]) + 0.2))
    assert ax.get_ylim()[0] <= 0


def test_the_area_over_two_parameters_is_a_colour():
    ax = figures.sweep(swept(3, 2))
    collections: Any = ax.collections
    (mesh,) = collections
    corners = np.asarray(mesh.get_coordinates())
    middle = (corners[:-1, :-1] + corners[1:, 1:]) / 2
    shown = {
        (round(float(x), 6), round(float(y), 6)): area
        for (x, y), area in zip(
            middle.reshape(-1, 2), np.ma.filled(mesh.get_array(), np.nan).ravel(), strict=True
        )
    }
    data = swept(3, 2)["total_area"]
    assert len(shown) == 6
    for (slope, stiffness), area in shown.items():
        there = float(data.sel(slope=slope, hip_stiffness=stiffness))
        assert area == pytest.approx(there, nan_ok=True)
    assert "slope" in ax.get_xlabel() and "stiffness" in ax.get_ylabel()
    bar = ax.figure.axes[-1]
    assert bar is not ax and "area of the basin" in bar.get_ylabel()


def test_more_parameters_are_at_their_first_values_and_named():
    data = swept(3, 2, 2)
    ax = figures.sweep(data)
    collections: Any = ax.collections
    (mesh,) = collections
    expected = data["total_area"].isel(foot_mass=0).values.T
    np.testing.assert_allclose(np.ma.filled(mesh.get_array(), np.nan), expected)
    note = ax.texts[0].get_text()
    assert "3 × 2 × 2 basins" in note and "0.1" in note
    line = figures.sweep(data.isel(hip_stiffness=0, foot_mass=0), Figure().add_subplot())
    assert line.containers


def test_a_saddle_is_drawn_with_its_ways_out():
    found = transients()
    attractor = found.saddle[10:20]
    ax = figures.chaotic_saddle(found, attractor, gait(3, 12.5, 0.002))
    drawn = [np.asarray(line.get_xydata()) for line in ax.lines]
    summed = lambda states: np.column_stack([states[:, 0], states[:, 0] + states[:, 1]])
    for states in (found.saddle, attractor, *found.escapes[:, -6:]):
        assert any(one.shape == states.shape and np.allclose(one, summed(states)) for one in drawn)
    assert {"saddle", "gait of period 3", "on the way to a failure"} <= set(legend(ax))
    low, high = ax.get_xlim()
    assert low < 0.2 and high > 0.3 and "dimension 1.24" in ax.texts[0].get_text()
    alone = figures.chaotic_saddle(found._replace(escapes=found.escapes[:0]))
    assert legend(alone) == ["saddle"]
    with pytest.raises(ValueError, match="found must have two coordinates, not x"):
        figures.chaotic_saddle(found._replace(section=("x",)))


def test_the_target_need_not_be_viable():
    """Its cells are a quarter of the grid, and those of the kernel another one."""
    data = VIABLE.assign(capture=xr.where(FATE == 1, 0, -1))
    names = legend(figures.capturability(data))
    assert names == ["target: 0.25", "viable: 0.25", "bound to fail"]
    everywhere = figures.viability(VIABLE.assign(capture=0 * FATE))
    assert "target" in legend(everywhere) and "inner bound" in legend(everywhere)


def test_the_law_of_a_crisis_is_a_line_in_logarithms():
    values, years, errors, law = lives()
    ax = figures.crisis_law(values, years, errors, law, {"theory": 0.75}, {"gate": 0.01905})
    named = {str(one.get_label()): np.asarray(one.get_xydata()) for one in ax.lines}
    lines = {name: np.log(data) for name, data in named.items() if name[0] != "_"}
    slope = lambda name: np.divide(*np.diff(lines[name], axis=0)[0, ::-1])
    assert slope("fitted exponent 0.80 (0.70 to 0.90)") == pytest.approx(-0.8)
    assert slope("theory: 0.75") == pytest.approx(-0.75)
    fitted = np.exp(lines["fitted exponent 0.80 (0.70 to 0.90)"])
    np.testing.assert_allclose(fitted[[0, -1], 1], years[[0, -1]], rtol=1e-9)
    assert " gate " in [one.get_text() for one in ax.texts]
    with pytest.raises(ValueError, match=r"values must be above the crisis, 0\.019"):
        figures.crisis_law(values - 0.01, years, errors, law)


def test_cells_of_metastable_walking_are_drawn_whole():
    ax = figures.metastability(metastable())
    (mesh,) = [one for one in ax.collections if isinstance(one, QuadMesh)]
    drawn = np.ma.filled(np.ma.asarray(mesh.get_array()), 0)
    assert drawn.sum() == pytest.approx(1, abs=1e-12)
    half = drawn.shape[1] // 2
    assert drawn[:, :half].sum() == pytest.approx(0.75, abs=1e-12)
    columns = np.flatnonzero(drawn.sum(axis=0))
    assert np.diff(columns).max() <= half / 8 + 1  # of points of a cell, eight along each edge
    corners = np.asarray(mesh.get_coordinates())
    np.testing.assert_allclose(corners[0, 0, 0], 0.19, rtol=0, atol=0.002)
    np.testing.assert_allclose(corners[0, -1, 0], 0.23, rtol=0, atol=0.002)
    assert "100.0 ± 2.0" in ax.texts[0].get_text()
    rare = metastable().assign(mean_strides=3.91e12, mean_strides_error=1e11)
    assert "after 3.91e+12 ± 2e+11 strides" in figures.metastability(rare).texts[0].get_text()


# Pictures on axes that are given.

WALKED = completed(
    xr.Dataset(
        {
            "stride": ("frame", [0, 0, 0, 1, 1, 1]),
            "time": ("frame", [0.0, 2.0, 3.9, 3.9, 6.0, 7.8]),
            "theta": ("frame", [0.2, 0.0, -0.2, 0.2, 0.0, -0.2]),
            "phi": ("frame", [0.4, 0.1, -0.4, 0.4, 0.1, -0.4]),
            "outcome": ("made", [Outcome.STRIDE, Outcome.FORWARD]),
        },
        attrs={"walker": "SimplestWalker", "walker_slope": 0.0165},
    ),
    "walk",
)
AREAS = completed(
    xr.Dataset(
        {"slope": ("slope", [0.01, 0.02]), "area": ("slope", [2e-3, 1e-3])}
        | {"mapped_area": ("slope", [2e-3, 1e-3])}
    ),
    "areas over slopes",
)
EDGES = completed(every_fate().assign_coords(edge=[0, 1]), "boundary").assign(
    edge_kind=("edge", np.array(["forward", ""], object))
)
FATE = every_fate(fates=(0, 1, 2, 3))["fate"]
VIABLE = completed(
    xr.Dataset(
        {
            "viable": FATE == 0,
            "inner": FATE == 0,
            "outer": FATE <= 1,
            "failure": FATE,
            "capture": (
                FATE.dims,
                np.where(FATE == 0, np.arange(FATE.size).reshape(FATE.shape), -1),
            ),
            "safe_actions": (FATE == 0) * 2,
            "push_off": ("action_number", [0.0, 0.05, 0.1]),
            "axis": ("axis", np.array(FATE.dims, object)),
            "upper": ("axis", [1.0, 1.0]),
            "shear": (("coordinate", "axis"), [[1.0, 0.0], [-1.0, 1.0]]),
        },
        attrs={"walker": "PoweredWalker", "walker_slope": 0.0165, "actions": ["push_off"]}
        | {"area": 0.01, "inner_area": 0.009, "outer_area": 0.011, "target_area": 0.001},
    ),
    "viability",
)
PROVED = completed(
    xr.Dataset(
        {
            "proved": ("cell", [1, 0, -1, 1]),
            "level": ("cell", [0, 1, 1, 0]),
            "place": (("cell", "axis"), [[0, 0], [2, 0], [3, 0], [0, 1]]),
            "axis": ("axis", np.array(["theta", "sum"], object)),
            "lower": ("axis", [0.0, -0.04]),
            "upper": ("axis", [0.4, 0.01]),
            "count": ("axis", [2, 2]),
            "shear": (("coordinate", "axis"), [[1.0, 0.0], [-1.0, 1.0]]),
            "trap_centre": ("coordinate", [0.15, -0.16]),
            "trap_factor": (("coordinate", "column"), [[2.0, 0.0], [1.0, 0.5]]),
            "trap_size": ((), 0.002),
        },
        attrs={"walker": "SimplestWalker", "walker_slope": 0.004, "all_walk": 0, "radius": 0.0}
        | {"area_lower": 0.001, "area_upper": 0.002},
    ),
    "proof",
)
GAITS = [gait(1, 0.63, 0.1, stable=True), gait(2, -4, 0.3), gait(1, 30, 5.0)]
FITTED = fitted(6)
SHARED_GRID = Grid.plain(theta=(0, 0.8, 20), thetadot=(-1.2, 0, 15))
SHARES = np.linspace(0, 1, 20)[:, None] > np.linspace(0.2, 0.6, 40)[:, None, None] + np.zeros(15)
GIVEN_AXES: dict[str, Any] = {
    "basin": [every_fate()],
    "boundary": [EDGES],
    "gait_branches": [diagram()],
    "largest_multiplier": [diagram()],
    "bifurcation_diagram": [diagram()],
    "lyapunov_exponents": [with_exponents()],
    "chart": [charted()],
    "chaotic_saddle": [transients()],
    "crisis_law": [*lives(), {"predicted": 0.75}, {"a further way out": 0.01905}],
    "stability_and_area": [diagram(), AREAS],
    "metastability": [metastable()],
    "multipliers": [GAITS],
    "proof": [PROVED],
    "optimisation": [optimum()],
    "disturbance": [robust()],
    "robustness_measures": [table()],
    "boundary_dimension": [table()],
    "sweep": [swept(3, 2)],
    "leg_angles": [WALKED],
    "capturability": [VIABLE],
    "viability": [VIABLE],
    "fitted_samples": [FITTED],
    "fit_residuals": [FITTED],
    "fit_correlations": [FITTED],
    "basin_band": [SHARED_GRID, SHARES],
}
PARTS = ["title", "subtitle", "legend", "labels"]


def test_an_edge_state_says_where_it_leads_whatever_the_failure():
    """Also to a lean, to the edge of the starts, and to a failure of a system's own."""
    kinds = {"sideways": "a lean at its limit", "outside": "the edge of feasible starts"}
    kinds |= {"hits_the_wall": "hits the wall"}
    for kind, words in kinds.items():
        edges = EDGES.assign(edge_saddle=EDGES["edge_saddle"] * np.nan)
        edges["edge_kind"] = "edge", np.array([kind, ""], object)
        said = legend(figures.boundary(edges))
        assert any(one.endswith(f": leads to {words}") for one in said), said


def test_every_picture_on_given_axes_has_the_same_options():
    public = {name: getattr(figures, name) for name in dir(figures)}
    takes = {name: signature(one).parameters for name, one in public.items() if isfunction(one)}
    assert {name for name, found in takes.items() if "ax" in found} == set(GIVEN_AXES)
    for name in GIVEN_AXES:
        only = [one.name for one in takes[name].values() if one.kind is one.VAR_KEYWORD]
        assert only == ["style"], name
    assert PARTS == [*figures.Style.__annotations__]
    with pytest.raises(ValueError, match="style must be of title, subtitle, legend, labels, not t"):
        figures.basin(every_fate(), **{"tilte": True})  # pyright: ignore[reportArgumentType] (wrong use)


PAIRS = [*zip([*GIVEN_AXES][::2], [*GIVEN_AXES, "robustness_measures"][1::2], strict=True)]
OTHER_PAIRS = [pytest.param(pair, marks=pytest.mark.slow) for pair in PAIRS[1:-1]]


@pytest.mark.parametrize("names", [PAIRS[0], *OTHER_PAIRS, PAIRS[-1]], ids=" and ".join)
def test_two_pictures_stay_in_their_halves_of_a_figure(names):
    figure = Figure(figsize=(10, 4.4), layout="constrained")
    halves = [[ax] for ax in figure.subplots(1, 2)]
    for name, half in zip(names, halves, strict=True):
        known = {*figure.axes}
        getattr(figures, name)(*GIVEN_AXES[name], ax=half[0])
        half += [ax for ax in figure.axes if ax not in known]
    figure.draw_without_rendering()
    whole = figure.bbox
    left, right = ([*extents(axes)] for axes in halves)
    for one in (*left, *right):
        assert whole.x0 <= one.x0 and one.x1 <= whole.x1
        assert whole.y0 <= one.y0 and one.y1 <= whole.y1
    assert max(one.x1 for one in left) <= min(one.x0 for one in right)
    for (ax, *_), name in zip(halves, names, strict=True):
        assert ax.bbox.height > 0.15 * whole.height and ax.bbox.width > 0.1 * whole.width, name


@pytest.mark.parametrize("name", GIVEN_AXES)
def test_each_part_of_a_picture_can_be_left_out(name):
    draw = lambda **options: getattr(figures, name)(*GIVEN_AXES[name], **options)
    every, none = draw(), draw(**dict.fromkeys(PARTS, False))
    assert every.get_title(loc="left") and every.get_xlabel() and every.get_ylabel()
    for ax in figure_of(none).axes:
        assert not ax.get_title(loc="left") and not ax.get_xlabel() and not ax.get_ylabel()
        assert not legend(ax) and not [one for one in ax.texts if one.get_text()]
    own = draw(title="My own", subtitle=False, legend=False)
    assert own.get_title(loc="left") == "My own" and own.get_xlabel() == every.get_xlabel()
    assert not legend(own) and len(own.texts) < len(every.texts)


def test_titles_have_parameters_that_differ_from_defaults():
    for walker, words in (
        (wj.PoweredWalker(slope=0.004, hip_stiffness=8.0), "slope 0.004 rad, hip stiffness 8"),
        (wj.KneedWalker(slope=0.05), "slope 0.05 rad"),
    ):
        name = type(walker).__name__
        title = walker_title(xr.Dataset(attrs={"walker": name} | attributes_of(walker)))
        assert title.replace(NO_BREAK, " ") == f"{name}, {words}"


ABOUT = {"slope": 0.0125, "hip_stiffness": 0.2345, "hip_damping": 0.0123, "foot_mass": 0.1234}
TITLED = {"walker": "SpringWalker"} | {f"walker_{name}": value for name, value in ABOUT.items()}


@pytest.mark.parametrize("halves", [False, True])
@pytest.mark.parametrize("name", ["basin", "gait_branches", "bifurcation_diagram"])
def test_long_titles_stay_on_the_picture(name, halves):
    """Also beside another picture, although bold letters are wider."""
    ax = Figure((10, 4.4), layout="constrained").subplots(1, 2)[0] if halves else None
    (data,) = GIVEN_AXES[name]
    ax = getattr(figures, name)(data.assign_attrs(TITLED), ax=ax)
    stays(figure_of(ax), figure_of(ax).axes[-1].bbox.x0 if halves else figure_of(ax).bbox.x1)


def test_long_titles_stay_above_several_pictures():
    figure = figures.bifurcations(diagram().assign_attrs(TITLED))
    stays(figure, figure.bbox.x1)


def stays(figure, right):
    """Check that a title with all its words ends before this place (pixels)."""
    figure.draw_without_rendering()
    (title,) = (one for one in figure.findobj(Text) if "SpringWalker" in one.get_text())
    box = title.get_window_extent()
    assert title.get_text().replace("\n", " ").count(", ") == len(ABOUT)
    assert figure.bbox.x0 <= box.x0 and box.x1 <= right and box.y1 <= figure.bbox.y1


def test_lines_of_text_end_between_phrases_not_in_a_formula():
    """A formula counts as one letter, and a phrase stays whole even where it does not fit."""
    text = f"one{NO_BREAK}phrase, $a + b$ and  two"
    assert in_lines(text, 22) == "one phrase, $a + b$ and  two"
    assert in_lines(text, 21) == "one phrase, $a + b$ and\ntwo"
    assert in_lines(text, 13) == "one phrase, $a + b$\nand  two"
    assert in_lines(text, 3) == "one phrase,\n$a + b$\nand\ntwo"
    assert in_lines("", 10) == "" and in_lines("a\nb $", 90) == "a\nb $"


def test_the_largest_value_inside_a_range_is_marked():
    area, least, *_ = figures.robustness_table(table()).axes
    assert "largest at slope 0.008" in [one.get_text() for one in least.texts]
    assert not any("largest" in one.get_text() for one in area.texts)  # it is at an end


def test_a_proof_shows_its_disc_its_gait_and_the_whole_trap():
    ax = figures.proof(PROVED.assign_attrs(radius=0.1))
    named = {str(one.get_label()): np.asarray(one.get_xydata()) for one in ax.lines}
    disc = named["starts within 0.1 of the gait"]
    away = disc - [0.15, -0.01]  # theta and theta + thetadot of the trap's centre
    away[:, 1] -= away[:, 0]
    np.testing.assert_allclose(np.linalg.norm(away, axis=1), 0.1, rtol=1e-12)
    np.testing.assert_allclose(named["gait"], [[0.15, -0.01]], atol=1e-15)
    for values, (low, high) in zip(named["trap"].T, (ax.get_xlim(), ax.get_ylim()), strict=True):
        assert low < values.min() and values.max() < high
    assert "gait" in legend(figures.proof(PROVED)) and len(figures.proof(PROVED).lines) == 3


def test_a_sweep_ends_at_its_values():
    assert figures.sweep(swept(3, 2)).get_xlim() == pytest.approx((0.002, 0.006))
    low, high = figures.sweep(swept(3)).get_xlim()
    assert (low, high) == pytest.approx((0.002, 0.006), abs=2e-4)


def test_sizes_of_text_are_those_of_rcparams():
    sizes: Any = {"axes.titlesize": 7, "axes.labelsize": 6, "legend.fontsize": 5, "font.size": 8}
    with plt.rc_context(sizes):
        ax = figures.basin(every_fate())
    (title,) = (one for one in ax.findobj(Text) if one.get_text() == ax.get_title(loc="left"))
    assert title.get_fontsize() == 7
    assert ax.xaxis.label.get_fontsize() == ax.yaxis.label.get_fontsize() == 6
    (first, *_) = [one for one in ax.get_children() if isinstance(one, Legend)]
    assert {one.get_fontsize() for one in first.get_texts()} == {5}
    assert labels(ax)["leaves the grid"].get_fontsize() == pytest.approx(8 * 0.833)
    (note,) = (one for one in ax.texts if "direct iteration" in one.get_text())
    assert note.get_fontsize() == 8


def test_pictures_for_print_have_the_width_of_a_column(tmp_path):
    usual = figures.basin(every_fate())
    with figures.for_print(3.4, size=7):
        ax = figures.basin(every_fate())
        table_of = figures.robustness_table(table())
        named = figures.basin(every_fate(), title="A basin")
        figure_of(ax).savefig(tmp_path / "basin.svg")
    assert figure_of(ax).get_size_inches()[0] == pytest.approx(3.4)
    assert table_of.get_size_inches()[0] == pytest.approx(3.4)
    wide, high = figure_of(usual).get_size_inches()
    assert figure_of(ax).get_size_inches()[1] == pytest.approx(3.4 * high / wide)
    assert not ax.get_title(loc="left") and named.get_title(loc="left") == "A basin"
    assert ax.xaxis.label.get_fontproperties().get_size_in_points() == 7
    sizes = [[one.get_markersize() for one in each.lines] for each in (ax, usual)]
    assert 0 < len(sizes[0]) and max(sizes[0]) < 0.7 * min(sizes[1])
    assert "basin of attraction" in (tmp_path / "basin.svg").read_text()  # no outlines of letters
    after = figures.basin(every_fate())
    assert figure_of(after).get_size_inches()[0] == wide
    assert after.get_title(loc="left") == usual.get_title(loc="left") != ""


def test_fits_are_drawn_with_their_residuals():
    figure = figures.fit(FITTED)
    samples, residuals = figure.axes
    seen = lambda ax: [one for one in ax.lines if len(np.asarray(one.get_xdata()))]
    assert len(seen(samples)) == 2 + 2 * 6 and len(seen(residuals)) == 2 + 1
    drawn = np.asarray(seen(samples)[1].get_xydata())
    after = (FITTED["time"] - FITTED["begin"]).transpose("step", "sample")
    np.testing.assert_allclose(drawn[:, 0], after.values.ravel())
    np.testing.assert_allclose(drawn[:, 1], FITTED["recorded"].values[..., 1].ravel())
    ax = figures.fit_correlations(FITTED)
    assert [one.get_text() for one in ax.texts][:4] == ["1.00", "-0.50", "-0.50", "1.00"]


def test_the_band_of_a_basin_lies_where_draws_differ():
    """Half of the draws walk beyond the middle of their edges, 0.4 of 0.8."""
    ax = figures.basin_band(SHARED_GRID, SHARES)
    (middle,) = ax.collections[1].get_paths()
    # cells are centred: the edge of half of the draws lies at 0.4 of the cells' numbers
    edge = np.interp(0.4 * 19, np.arange(20), np.asarray(SHARED_GRID.axes["theta"]))
    assert np.abs(np.asarray(middle.vertices)[:, 0] - edge).max() < 0.04
    with pytest.raises(ValueError, match="draws must be of shape"):
        figures.basin_band(SHARED_GRID, SHARES[0])

"""Pictures, drawn from small data sets made by hand: what stands where, and in which colour."""

import re
import subprocess
import sys
from inspect import signature
from itertools import chain, combinations
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pytest
import xarray as xr
from matplotlib.collections import QuadMesh
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from matplotlib.patches import Circle
from matplotlib.text import Annotation, Text

from walker_jax import Grid, Outcome, figures
from walker_jax.figures import optimum_plots, style, text
from walker_jax.gaits.cycles import Gait
from walker_jax.storage.schema import attributes_of, variables_of
from walker_jax.systems.outcomes import OWN

SHEARED = Grid.sheared(theta=(0, 0.4, 80), sum=(-0.04, 0.01, 60))
PLAIN = Grid.plain(theta=(0, 0.8, 80), thetadot=(-1.2, 0, 60))
WORDS = {
    Outcome.STRIDE: "basin of attraction",
    Outcome.FORWARD: "falls forward",
    Outcome.BACKWARD: "falls backward",
    Outcome.RUNNING: "runs",
    Outcome.STOPPED: "stops on both feet",
    Outcome.OUTSIDE: "not a feasible start",
    Outcome.UNDECIDED: "undecided",
    Outcome.LEFT_GRID: "leaves the grid",
}


def completed(data, kind, *parameters):
    """With zeros for what else a data set of a kind holds, which pictures do not read."""
    placeholders = {"*parameters": parameters, "?parameter": parameters, "*grid": ("theta", "sum")}
    types = {"integer": int, "real": float, "boolean": bool, "text": object}
    for name, one in variables_of(kind).items():
        if name not in data and not one.when:
            dims = [own for dim in one.dims.split() for own in placeholders.get(dim, (dim,))]
            shape = [data.sizes.get(dim, 2) for dim in dims]
            data = data.assign({name: (dims, np.zeros(shape, types[one.type]))})
    return data.assign_attrs(dict.fromkeys(attributes_of(kind), "") | data.attrs)


def deep(data):
    """A basin over three dimensions, the same at each phidot."""
    over = {name: data[name].expand_dims(phidot=3) for name in ("fate", "attractor", "strides")}
    return data.assign(over)


def data_set(grid, fate, attractor=None, cycles=()):
    """A data set of the form that `walker_jax.basin` returns."""
    attractor = np.where(fate == Outcome.STRIDE, 0, -1) if attractor is None else attractor
    states = np.full((len(cycles), max(map(len, cycles), default=0), 2), np.nan)
    for row, cycle in zip(states, cycles, strict=True):
        row[: len(cycle)] = cycle
    cells = np.array([np.sum(attractor == i) for i in range(len(cycles))], int)
    return xr.Dataset(
        {
            "fate": (grid.names, fate.astype(np.int8)),
            "attractor": (grid.names, attractor.astype(np.int32)),
            "strides": (grid.names, np.zeros(grid.shape, np.int32)),
            "period": ("number", np.array([len(cycle) for cycle in cycles], np.int32)),
            "states": (("number", "phase", "coordinate"), states),
            "cells": ("number", cells),
            "area": ("number", cells * grid.cell_area),
            "at_border": 0,
        },
        coords={
            **grid.axes,
            "number": np.arange(len(cycles)),
        },
        attrs={
            "walker": "SimplestWalker",
            "walker_slope": 0.0165,
            "method": "direct",
            "section": ["theta", "thetadot"],
        },
    )


def every_fate(grid=SHEARED, cycle=((0.17, -0.18), (0.19, -0.21)), fates=(7, 0, 1, 2, 3, 4, 5, 6)):
    """Bands across the picture, one of each fate; eight are wide enough for their labels."""
    width = grid.shape[1]
    bands = np.array(fates)[np.arange(width) * len(fates) // width]
    return data_set(grid, np.tile(bands, (grid.shape[0], 1)), cycles=[cycle])


def colours(ax):
    """Colour of each cell, its indices in the order of the data set's dimensions."""
    (image,) = ax.images
    assert image.origin == "lower"
    return np.asarray(image.get_array()).swapaxes(0, 1)


def legend(ax):
    """Texts of the legends."""
    children = ax.get_children()
    return [t.get_text() for c in children if isinstance(c, Legend) for t in c.get_texts()]


def labels(ax) -> dict[str, Annotation]:
    """The labels of the regions, which stand in data coordinates, by their text."""
    return {text.get_text(): text for text in ax.texts if text.xycoords == "data"}


def figure_of(ax) -> Figure:
    return ax.get_figure(root=True)


def luminance(colour):
    """Relative luminance of an sRGB colour."""
    rgb = np.asarray(to_rgb(colour))
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    return linear @ [0.2126, 0.7152, 0.0722]


def lightness(rgb):
    """CIE L*, 0 for black to 100 for white, of 8-bit sRGB."""
    return 116 * np.cbrt(luminance(np.asarray(rgb) / 255)) - 16


def fate_at(data, place):
    """Fate of the cell that holds a point of the picture."""
    names = data["fate"].dims
    where = dict(zip(names, place, strict=True))
    return int(data["fate"].sel(where, method="nearest"))


def test_every_fate_is_told_from_the_others_even_in_grey():
    data = every_fate(fates=range(len(Outcome)))
    found = colours(figures.basin(data))
    colour = {}
    for outcome in Outcome:
        (colour[outcome],) = np.unique(found[data["fate"].values == outcome], axis=0)
    anywhere = Outcome.STRIDE, Outcome.OUTSIDE, Outcome.UNDECIDED, Outcome.LEFT_GRID
    falls = Outcome.FORWARD, Outcome.BACKWARD, Outcome.RUNNING, Outcome.STOPPED
    of_planes = *anywhere, *falls
    of_package, own = [one for one in Outcome if one not in OWN], (*of_planes, *OWN)
    for one, other in chain(combinations(of_package, 2), combinations(own, 2)):
        assert abs(lightness(colour[one]) - lightness(colour[other])) > 6, (one, other)
    assert min(colour, key=lambda outcome: lightness(colour[outcome])) == Outcome.STRIDE


def test_a_region_is_labelled_inside_itself():
    data = every_fate()
    ax = figures.basin(data)
    found = labels(ax)
    for outcome, words in WORDS.items():
        assert fate_at(data, found[words].xy) == outcome, words
    letters = {"F": Outcome.FORWARD, "B": Outcome.BACKWARD, "R": Outcome.RUNNING}
    fate = np.repeat(list(letters.values()), 30)[:80, None] * np.ones(60, int)
    data = data_set(SHEARED, fate)
    found = labels(figures.basin(data))
    for letter, outcome in letters.items():
        assert fate_at(data, found[letter].xy) == outcome, letter


def test_labels_stand_out_from_their_regions():
    data = every_fate()
    ax = figures.basin(data)
    found = colours(ax)
    for words, label in labels(ax).items():
        (background,) = np.unique(found[data["fate"].values == fate_at(data, label.xy)], axis=0)
        low, high = sorted([luminance(background / 255), luminance(label.get_color())])
        assert (high + 0.05) / (low + 0.05) > 4.5, words


def test_a_label_keeps_away_from_other_regions_and_from_the_dots():
    fate = np.full(SHEARED.shape, Outcome.FORWARD)
    fate[20:60, 15:45] = Outcome.STRIDE
    state = np.array([0.2, -0.215])  # in the middle of the basin
    ax = figures.basin(data_set(SHEARED, fate, cycles=[[state]]))
    figure_of(ax).draw_without_rendering()
    box = labels(ax)["A"].get_window_extent()
    (low, high, dot) = ax.transData.transform(
        [(0.1, -0.0275), (0.3, -0.0025), (state[0], state.sum())]
    )
    assert (low < box.p0).all() and (box.p1 < high).all()
    assert not box.padded(4).contains(*dot)


def test_what_is_too_small_for_a_label_is_in_the_legend_with_its_cells():
    fate = np.full(SHEARED.shape, Outcome.FORWARD)
    fate[40, 30] = Outcome.STOPPED
    fate[50:52, 40] = Outcome.UNDECIDED
    ax = figures.basin(data_set(SHEARED, fate))
    assert legend(ax) == ["stops on both feet (1 cell)", "undecided (2 cells)"]
    assert set(labels(ax)) == {"F", "falls forward"}


def test_how_many_are_undecided_is_always_told():
    ax = figures.basin(data_set(SHEARED, np.full(SHEARED.shape, Outcome.UNDECIDED)))
    assert legend(ax) == ["undecided (4,800 cells)"]


@pytest.mark.parametrize("grid", [SHEARED, PLAIN], ids=["sheared", "plain"])
def test_a_dot_marks_each_state_of_the_attractor(grid):
    cycle = np.array([(0.17, -0.18), (0.19, -0.21)])
    ax = figures.basin(every_fate(grid, cycle))
    (line,) = ax.lines
    second = cycle[:, 1] if grid is PLAIN else cycle.sum(axis=1)
    np.testing.assert_allclose(
        np.asarray(line.get_xydata()), np.column_stack([cycle[:, 0], second])
    )
    (entry,) = [text for text in legend(ax) if "attractor" in text]
    assert "period 2" in entry and "(0.1700, −0.1800), (0.1900, −0.2100)" in entry


def test_an_attractor_beyond_the_grid_is_said_to_be():
    ax = figures.basin(every_fate(cycle=[(0.5, -0.5)]))
    assert any(text.endswith("(outside the picture)") for text in legend(ax))
    assert ax.get_xlim() == pytest.approx((0, 0.4))


def test_large_basins_have_their_own_colours_and_small_ones_share_one():
    fate = np.full(SHEARED.shape, Outcome.STRIDE)
    attractor = np.zeros(SHEARED.shape, int)
    attractor[:, 25:] = 1
    attractor[70:, :5] = 2
    attractor[0, 0], attractor[0, 1], attractor[0, 2] = 3, 4, -1
    cycles = [[(0.01 * i, -0.01 * i)] for i in range(5)]
    ax = figures.basin(data_set(SHEARED, fate, attractor, cycles))
    found = colours(ax)
    colour = [np.unique(found[attractor == i], axis=0) for i in range(-1, 5)]
    assert all(len(one) == 1 for one in colour)
    none, first, second, *others = np.concatenate(colour)
    np.testing.assert_array_equal(others, [others[0]] * 3)
    for one, other in combinations([none, first, second, others[0]], 2):
        assert (one != other).any()
    assert abs(lightness(first) - lightness(second)) > 10
    assert len(ax.lines) == 2 and ax.lines[0].get_marker() != ax.lines[1].get_marker()
    assert ax.lines[0].get_xdata() == [0.01]  # the largest first
    assert {"other attractors (52 cells)", "converges to no known attractor (1 cell)"} < set(
        legend(ax)
    )


def test_artefacts_of_cells_are_no_basin_however_large_they_are():
    fate = np.full(SHEARED.shape, Outcome.STRIDE)
    attractor = np.zeros(SHEARED.shape, int)
    attractor[:, 25:], attractor[0, 0] = 1, 2
    data = data_set(SHEARED, fate, attractor, [[(0.01 * i, -0.01 * i)] for i in range(3)])
    with_two = figures.basin(data)
    assert sum("attractor" in text for text in legend(with_two)) == 3
    ax = figures.basin(data.assign(artefact=("number", np.array([False, True, True]))))
    (line,) = ax.lines
    assert line.get_xdata() == [0.0]
    made_up, found = attractor > 0, colours(ax)
    assert len(np.unique(found[made_up], axis=0)) == len(np.unique(found[~made_up], axis=0)) == 1
    assert (found[0, 0] != found[0, 1]).any()
    assert f"artefacts of cell mapping ({made_up.sum():,} cells)" in legend(ax)
    assert not any("other attractors" in text for text in legend(ax))


@pytest.mark.parametrize(
    "grid, x, y",
    [
        (SHEARED, "stance leg angle $\\theta$ (rad)", "theta + \\dot"),
        (PLAIN, "stance leg angle $\\theta$ (rad)", "stance leg rate $\\dot{\\theta}$"),
    ],
    ids=["sheared", "plain"],
)
def test_axes_have_names_units_and_the_edges_of_the_cells(grid, x, y):
    ax = figures.basin(every_fate(grid))
    assert x in ax.get_xlabel() and y in ax.get_ylabel()
    assert "(rad, time in √(l/g))" in ax.get_ylabel()
    (low_x, low_y), (high_x, high_y) = grid.lower, grid.upper
    edges = (low_x, high_x, low_y, high_y)
    assert ax.images[0].get_extent() == pytest.approx(edges)
    assert (*ax.get_xlim(), *ax.get_ylim()) == pytest.approx(edges)


def test_the_title_tells_the_walker_the_method_and_the_area():
    data = every_fate()
    ax = figures.basin(data)
    assert ax.get_title(loc="left") == "SimplestWalker, slope 0.0165 rad"
    (note,) = {text.get_text() for text in ax.texts} - set(labels(ax))
    mantissa, exponent = f"{float(data['area'].sum()):.2e}".split("e")
    assert "direct iteration on 80 × 60 cells" in note
    assert f"{mantissa} × 10$^{{{int(exponent)}}}$" in note


@pytest.mark.filterwarnings("ignore")  # of zarr, that its format may change
def test_a_data_set_read_from_a_file_gives_the_same_picture(tmp_path):
    data = every_fate()
    data.to_zarr(tmp_path / "basin.zarr")
    before, after = figures.basin(data), figures.basin(xr.open_zarr(tmp_path / "basin.zarr"))
    np.testing.assert_array_equal(colours(before), colours(after))
    assert legend(before) == legend(after)
    assert [text.get_text() for text in before.texts] == [text.get_text() for text in after.texts]
    np.testing.assert_array_equal(before.lines[0].get_xydata(), after.lines[0].get_xydata())


@pytest.mark.parametrize(
    "data",
    [
        every_fate().isel(theta=0),
        every_fate().isel(theta=[0]),
        deep(every_fate()),
    ],
    ids=["one", "one-cell", "three"],
)
def test_two_dimensions_are_drawn_and_nothing_else(data):
    with pytest.raises(
        ValueError, match="data must have a fate over 2 x 2 cells or more, not"
    ) as e:
        figures.basin(data)
    assert "\n" not in str(e.value)


def test_a_data_set_without_fates_is_refused():
    for draw in (figures.basin, figures.basin_slices, figures.robustness):
        with pytest.raises(ValueError, match=r"^data must be .* without fate$"):
            draw(every_fate().drop_vars("fate"))


def test_a_refusal_of_three_dimensions_says_how_to_take_a_slice():
    data = deep(every_fate())
    with pytest.raises(ValueError, match=r"take a slice, data\.isel\(phidot=0\), or") as error:
        figures.basin(data)
    (slicing,) = re.findall(r"data\.isel\(phidot=0\)", str(error.value))
    assert figures.basin(eval(slicing)).has_data()
    for other in (
        every_fate().expand_dims(slope=3).drop_dims("number"),
        every_fate().isel(theta=0),
    ):
        with pytest.raises(ValueError) as error:
            figures.basin(other)
        assert "slice" not in str(error.value)


def test_a_slice_of_a_data_set_with_more_dimensions_is_drawn():
    data = deep(every_fate()).isel(phidot=1)
    np.testing.assert_array_equal(
        colours(figures.basin(data)), colours(figures.basin(every_fate()))
    )


def test_it_draws_where_it_is_told_and_opens_no_window(tmp_path):
    axes = Figure(figsize=(9, 4), layout="constrained").subplots(1, 2)
    assert figures.basin(every_fate(), axes[1]) is axes[1]
    assert len(axes[1].images) == 1 and not axes[0].has_data()
    figure_of(figures.basin(every_fate())).savefig(tmp_path / "basin.png", dpi=50)
    assert (tmp_path / "basin.png").stat().st_size > 0
    assert plt.get_fignums() == []


def test_importing_the_package_does_not_load_matplotlib():
    check = "import sys, walker_jax; sys.exit('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", check], timeout=120).returncode == 0


# Gaits and bifurcations.

BRANCHES: dict[str, list[tuple[float, list[float], float, bool]]] = {
    "long": [
        (0.010, [0.20], 0.5, True),
        (0.014, [0.24], 0.9, True),
        (0.016, [0.26], -1.1, False),
        (0.020, [0.28], -1.5, False),
    ],
    "short": [(0.010, [0.19], 3.0, False), (0.020, [0.27], 4.0, False)],
    "doubled": [
        (0.015, [0.25, 0.25], 1.0, True),
        (0.018, [0.22, 0.29], -0.6, True),
        (0.020, [0.21, 0.31], -3.0, False),
    ],
    "folded": [
        (0.020, [0.10, 0.12, 0.14], 3.0, False),
        (0.012, [0.11, 0.13, 0.15], 2.0, False),
        (0.012, [0.112, 0.132, 0.152], 0.5, True),
        (0.013, [0.115, 0.135, 0.155], 0.1, True),
    ],
}
"""Value, states, largest multiplier and stability of the points of each branch."""
EVENTS: list[tuple[bool, int, float, list[float], float, bool]] = [
    (False, 0, 0.015, [0.25], -1.0, True),
    (False, 2, 0.019, [0.215, 0.30], -1.0, True),
    (True, 3, 0.0115, [0.111, 0.131, 0.151], 1.0, False),
]
"""Whether it is a fold, branch, value, states, largest multiplier, whether of the cascade."""


def diagram(branches=BRANCHES, events=EVENTS, walks=True, lost=(0.0180, 0.0182)):
    """A data set of the form that `walker_jax.bifurcation_diagram` returns."""
    numbers = [i for i, branch in enumerate(branches.values()) for _ in branch]
    points = [point for branch in branches.values() for point in branch]

    def states(cycles):
        found = np.full((len(cycles), 3, 2), np.nan)
        for row, cycle in zip(found, cycles, strict=True):
            row[: len(cycle)] = np.column_stack([cycle, np.negative(cycle)])
        return found

    def parts(largest):
        found = np.zeros((len(largest), 2, 2))
        found[:, 0, 0] = largest
        return found

    sample = np.linspace(0.01, 0.02, 5)
    orbit = np.full((5, 2, 4, 2), np.nan)
    fate = np.full((5, 2), Outcome.FORWARD, np.int8)
    if walks:
        fate[:3, 0] = Outcome.STRIDE
        orbit[:3, 0] = 0.2 + np.arange(8).reshape(4, 2) / 100
        orbit[1, 1, :2] = 0.4  # of one that falls later
    cycle = ("phase", "coordinate")
    part = ("order", "part")
    return xr.Dataset(
        {
            "branch": ("gait", np.array(numbers, int)),
            "period": ("gait", np.array([len(point[1]) for point in points], int)),
            "value": ("gait", np.array([point[0] for point in points], float)),
            "states": (("gait", *cycle), states([point[1] for point in points])),
            "step_times": (("gait", "phase"), 3.5 + 2 * states([p[1] for p in points])[..., 0]),
            "multipliers": (("gait", *part), parts([point[2] for point in points])),
            "stable": ("gait", np.array([point[3] for point in points], bool)),
            "on_cascade": ("gait", np.isin(numbers, (0, 2))),
            "event_fold": ("event", np.array([event[0] for event in events], bool)),
            "event_branch": ("event", np.array([event[1] for event in events], int)),
            "event_period": ("event", np.array([len(event[3]) for event in events], int)),
            "event_value": ("event", np.array([event[2] for event in events], float)),
            "event_states": (("event", *cycle), states([event[3] for event in events])),
            "event_multipliers": (("event", *part), parts([event[4] for event in events])),
            "cascade": ("event", np.array([event[5] for event in events], bool)),
            "torus_branch": ("torus", np.zeros(0, int)),
            "torus_period": ("torus", np.zeros(0, int)),
            "torus_value": ("torus", np.zeros(0)),
            "torus_states": (("torus", *cycle), states([])),
            "torus_multipliers": (("torus", *part), parts([])),
            "sample_value": ("sample", sample),
            "fate": (("sample", "start"), fate),
            "strides": (("sample", "start"), np.full((5, 2), 2000)),
            "attractor_period": (("sample", "start"), np.ones((5, 2), int)),
            "orbit": (("sample", "start", "recent", "coordinate"), orbit),
            "lost": ("side", np.array(lost, float)),
        },
        attrs={
            "walker": "SimplestWalker",
            "parameter": "slope",
            "section": ["theta", "thetadot"],
        },
    )


NOTHING = diagram({}, [], walks=False, lost=(np.nan, np.nan))
PICTURES = [figures.gait_branches, figures.largest_multiplier, figures.bifurcation_diagram]


def gait(period, *multipliers, stable=False, found=True):
    """A gait with these multipliers."""
    return Gait(
        states=np.full((period, 2), 0.2),
        multipliers=np.array(multipliers, complex),
        step_times=np.full(period, 3.8),
        stable=np.array(stable),
        residual=np.array(0.0),
        found=np.array(found),
    )


def lines(ax, dashed):
    """Points of the solid or of the dashed lines between points in data coordinates."""
    return [
        np.asarray(line.get_xydata())
        for line in ax.lines
        if line.get_transform() == ax.transData
        and line.get_linestyle() == ("--" if dashed else "-")
    ]


def signs(ax, marker):
    """Where a marker is drawn, in data coordinates."""
    found = [
        np.asarray(line.get_xydata())
        for line in ax.lines
        if line.get_marker() == marker and line.get_transform() == ax.transData
    ]
    return np.concatenate([np.zeros((0, 2)), *found])


def words(ax):
    """All texts of a picture but those of its legends."""
    return [text.get_text() for text in ax.texts]


def annotations(ax, text) -> list[Annotation]:
    """Those with this text."""
    return [t for t in ax.texts if isinstance(t, Annotation) and t.get_text() == text]


def box(text):
    """Where a text stands (pixels), without its arrow."""
    return Text.get_window_extent(text)


def test_each_branch_is_solid_where_it_is_stable_and_dashed_where_it_is_not():
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


def test_a_stable_part_without_points_between_two_bifurcations_is_solid():
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


def test_step_times_of_the_gaits_of_period_one_stand_beside_their_ends():
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


def test_the_largest_multiplier_is_drawn_along_the_cascade_and_no_other_branch():
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


def test_between_points_of_a_branch_the_largest_multiplier_has_its_kink():
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


def test_a_line_stands_where_walking_is_lost():
    ax = figures.bifurcation_diagram(diagram(lost=(0.0180, 0.0182)))
    (line,) = (line for line in ax.lines if line.get_transform() == ax.get_xaxis_transform())
    assert line.get_xdata() == pytest.approx([0.0181, 0.0181])
    (label,) = annotations(ax, "walking is lost between 0.01800 and 0.01820")
    figure_of(ax).draw_without_rendering()
    assert box(label).y0 > ax.bbox.y1
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


def test_all_of_a_parameter_is_one_picture_with_the_cascade_enlarged(tmp_path):
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


@pytest.mark.parametrize(
    "value, text",
    [
        (12345.6, "12,346"),
        (-37.25, "−37.2"),
        (2.51, "2.5"),
        (1.5 + 9j, "1.5 + 9.0i"),
        (-400 - 3j, "−400 − 3.0i"),
        (-3e7, "−3.00e+07"),
    ],
)
def test_a_multiplier_beyond_the_frame_is_at_the_rim_with_its_value(value, text):
    ax = figures.multipliers([gait(1, value, 0.1)])
    assert ax.get_xlim() == ax.get_ylim() == (-2.5, 2.5)
    assert signs(ax, "o") == pytest.approx(np.array([(0.1, 0)]))
    (label,), (arrow,) = annotations(ax, text), annotations(ax, "")
    x, y = label.xy
    assert arrow.xy == (x, y) and max(abs(x), abs(y)) == pytest.approx(2.5)
    assert np.angle(complex(x, y)) == pytest.approx(np.angle(value))
    figure_of(ax).draw_without_rendering()
    assert ax.bbox.contains(*box(label).p0) and ax.bbox.contains(*box(label).p1)


def test_many_multipliers_at_one_place_of_the_rim_do_not_overlap():
    ax = figures.multipliers([gait(1 + k % 9, 3.0 * 2**k, -3.0 - k) for k in range(12)])
    figure_of(ax).draw_without_rendering()
    rows = [text for text in ax.texts if text.get_text()]
    assert len(rows) == 17  # the note below the title is one
    for one, other in combinations(rows, 2):
        assert not box(one).overlaps(box(other))
    assert {"and 5 more, up to 6,144", "and 5 more, up to −14.0"} < set(words(ax))


def test_multipliers_of_no_gait_and_of_failed_searches_are_left_out():
    for gaits in ([], [gait(1, np.nan, np.nan, found=False)]):
        ax = figures.multipliers(gaits)
        figure_of(ax).draw_without_rendering()
        assert len(signs(ax, "o")) == 0 and legend(ax) == []
    axes = Figure(layout="constrained").subplots(1, 2)
    assert figures.multipliers([gait(1, 0.5, 0)], axes[0]) is axes[0]
    assert not axes[1].has_data()


# Robustness


def robust(grid=SHEARED, **changes):
    """What `walker_jax.robustness` returns: a basin to the right of theta = 0.15, its gait at 0.2.

    The nearest start that falls is at a distance of 0.05.
    """
    theta = grid.axes["theta"][:, None]
    fate = np.where(theta > 0.15, Outcome.STRIDE, Outcome.FORWARD) + np.zeros(grid.shape, int)
    values = {
        "gait_period": 1,
        "gait_state": ("coordinate", np.array([0.2, -0.215])),
        "least_disturbance": 0.05,
        "failing_state": ("coordinate", np.array([0.15, -0.215])),
        "failure": int(Outcome.FORWARD),
        "failing_strides": 7,
    }
    data = data_set(grid, fate, cycles=[((0.2, -0.215),)]).assign(values | changes)
    return completed(data, "robustness")


def table(slopes=(0.004, 0.008, 0.012), **changes):
    """What `walker_jax.robustness_table` returns, of a walker without a gait on the last slope."""
    over = {
        "total_area": [2e-3, 1e-3, 0.0],
        "total_area_error": [1e-6] * 3,
        "least_disturbance": [1e-3, 2e-3, np.nan],
        "multiplier": [0.6, 0.9, np.nan],
        "dimension_low": [1.0, 1.3, np.nan],
        "dimension": [1.05, 1.4, np.nan],
        "dimension_high": [1.1, 1.5, np.nan],
    }
    over = {name: ("slope", np.array(values)) for name, values in (over | changes).items()}
    data = xr.Dataset(over, {"slope": np.array(slopes)}, {"walker": "SimplestWalker"})
    return completed(data, "robustness table", "slope")


def test_the_least_disturbance_is_drawn_to_where_it_touches_the_boundary():
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


def test_the_nearest_fall_is_drawn_too_where_another_motion_is_nearer():
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


def test_the_table_marks_falls_that_are_farther_than_another_motion():
    data = table(least_fall=[1e-3, 3e-3, np.nan])
    ax = figures.robustness_measures(data)
    (marks,) = (line for line in ax.lines if "falls" in str(line.get_label()))
    np.testing.assert_array_equal(np.asarray(marks.get_xydata()), [[0.008, 1.5]])
    assert ax.get_ylim()[1] > 1.5
    same = figures.robustness_measures(table(least_fall=[1e-3, 2e-3, np.nan]))
    assert len(same.lines) == 3


def test_the_least_disturbance_is_drawn_over_cells_that_are_larger_than_it():
    coarse = robust(Grid.sheared(theta=(0, 0.4, 4), sum=(-0.04, 0.01, 2)), least_disturbance=1e-4)
    ax = figures.disturbance(coarse)
    low, high = ax.get_xlim()
    assert low < 0.2 < high and high - low < 1e-3
    figure_of(ax).canvas.draw()


def test_a_basin_stands_alone_where_there_is_no_disturbance_to_draw():
    assert len(figures.robustness(robust()).axes) == 2
    lost = robust(least_disturbance=np.nan, gait_period=0)
    assert len(figures.robustness(lost).axes) == 1
    assert len(figures.robustness(every_fate()).axes) == 1
    with pytest.raises(ValueError, match="must hold the least disturbance"):
        figures.disturbance(lost)
    with pytest.raises(ValueError, match="must be of the kind 'robustness', not one without"):
        figures.disturbance(every_fate())


def test_measures_of_robustness_are_parts_of_their_largest_on_one_axis():
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
    assert len(figure.axes) == 2


def test_the_dimension_is_drawn_with_its_interval_over_that_of_a_smooth_boundary():
    ax = figures.boundary_dimension(table())
    (band,) = ax.collections
    corners = np.asarray(band.get_paths()[0].vertices)
    assert {1.0, 1.1, 1.3, 1.5} <= set(np.round(corners[:, 1], 12).tolist())
    (low, high), smooth = ax.get_ylim(), ax.lines[1].get_ydata()
    assert low < 1 and high > 1.5 and set(np.asarray(smooth)) == {1}
    with pytest.raises(ValueError, match="must be of the kind 'robustness table'"):
        figures.boundary_dimension(robust())


# Optimisations

FATES = np.array([-1, 0, 1, 2, 3, 4, 5, 6], np.int8)


def optimum(basins=True, **changes):
    """What `walker_jax.optimise` returns, of two parameters: one held by a limit, one at a bound.

    Run 1 leads to the optimum, by a long step and a short one.
    """
    run, stage = np.array([0, 0, 1, 1, 1, 1, 1, 1]), np.array([0, 0, 0, 0, 1, 3, -2, -2])
    slope = [0.018, 0.012, 0.010, 0.006, 0.0035, 0.003, 0.010, 0.003]
    stiffness = [0.2, 0.5, 1.0, 1.6, 2.0, 2.0, 1.0, 2.0]
    found = {
        "run": ("evaluation", run),
        "stage": ("evaluation", stage),
        "parameters": (("evaluation", "parameter"), np.stack([slope, stiffness], axis=1)),
        "value": ("evaluation", np.array([1.0, 1.5, 2.0, 3.0, 3.8, 4.0, 2.02, 4.04])),
        "start": ("parameter", np.array([0.010, 1.0])),
        "optimum": ("parameter", np.array([0.003, 2.0])),
        "objective_optimum": 4.0,
        "exact_start": 2.02,
        "exact_optimum": 4.04,
        "at_bound": ("parameter", np.array([0, 1], np.int8)),
        "binding": ("measure", np.array([False, True])),
        "converged": True,
        "found": True,
        "scan_parameters": (
            ("parameter", "point"),
            np.stack([np.linspace(0.0, 0.02, 6), np.linspace(0, 2, 6)]),
        ),
        "scan_value": (
            ("parameter", "point"),
            np.array([[5.0, 3.7, 2.5, 1.5, 1.0, 0.5], [1.0, 1.5, 2.2, 2.9, 3.4, 4.0]]),
        ),
        "scan_allowed": (
            ("parameter", "point"),
            np.array([[False, True, True, False, False, True], [True] * 6]),
        ),
    }
    if basins:
        start = np.repeat(FATES, 10)[:, None] * np.ones(60, np.int8)
        fates = {"fate_start": start, "fate_optimum": start[::-1]}
        found |= {name: (("theta", "sum"), fate) for name, fate in fates.items()}
        found |= {name: (name, np.asarray(values)) for name, values in SHEARED.axes.items()}
    attrs = {
        "walker": "SpringWalker",
        "walker_slope": 0.01,
        "walker_hip_stiffness": 1.0,
        "walker_foot_radius": 0.3,
        "section": ["theta", "thetadot"],
        "objective": '{"area": 1.0}',
        "sign": 1.0,
        "bounds": '{"slope": [0.0, 0.02], "hip_stiffness": [0.0, 2.0]}',
        "limits": '{"speed": [0.06, null]}',
        "region": '{"theta": [0.0, 0.4, 80], "sum": [-0.04, 0.01, 60]}',
    }
    coords = {"parameter": ["slope", "hip_stiffness"], "measure": ["area", "speed"]}
    return completed(xr.Dataset(found, coords, attrs | changes), "optimum")


def line(ax, **look):
    """Points of the only line of this style."""
    (only,) = (one for one in ax.lines if all(getattr(one, f"get_{k}")() == look[k] for k in look))
    return np.asarray(only.get_xydata())


def shaded(ax):
    """Where the ground is shaded, from left to right."""
    spans = [patch.get_window_extent() for patch in ax.patches]
    ends = [ax.transData.inverted().transform(span.get_points())[:, 0] for span in spans]
    return np.sort(np.array(ends).reshape(-1, 2), axis=0)


def test_the_scan_is_dashed_on_shaded_ground_where_limits_do_not_allow_it():
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


def test_start_and_optimum_are_marked_with_the_exact_objective_even_at_bounds():
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


def test_the_run_to_the_optimum_is_joined_in_its_order_and_others_are_fainter():
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
def test_the_title_tells_the_objective_what_was_reached_and_where_it_ended(changes, subject, note):
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


def test_an_optimisation_without_a_scan_and_of_one_evaluation_is_drawn():
    bare = optimum(basins=False).drop_vars(["scan_parameters", "scan_value", "scan_allowed"])
    one = bare.isel(evaluation=[2, -2, -1])
    for data in (bare, one):
        figure = figures.optimum(data)
        figure.draw_without_rendering()
        assert [len(ax.patches) for ax in figure.axes] == [0, 0]
        assert not any("scan" in text for text in legend(figure.axes[0]))


def test_the_basins_before_and_after_have_the_colours_of_a_basin():
    data = optimum()
    figure = figures.basins_before_and_after(data)
    start, best = figure.axes
    assert start.get_xlim() == best.get_xlim() == pytest.approx((0, 0.4))
    assert start.get_ylim() == best.get_ylim() == pytest.approx((-0.04, 0.01))
    expected = {outcome: colour for outcome, (colour, *_) in style.FAILURES.items()}
    expected |= {-1: style.BASINS[0], 0: style.UNMATCHED}
    for ax, name in ((start, "fate_start"), (best, "fate_optimum")):
        for fate in FATES.tolist():
            (colour,) = np.unique(colours(ax)[data[name].values == fate], axis=0)
            np.testing.assert_array_equal(colour, np.round(255 * np.array(to_rgb(expected[fate]))))
    assert start.get_title(loc="left") == "Start: slope 0.01 rad, hip stiffness 1"
    assert best.get_title(loc="left") == "Optimum: slope 0.003 rad, hip stiffness 2"
    (below,) = figure.legends
    told = [text.get_text() for text in below.get_texts()]
    assert {"basin of attraction", "converges to no known attractor", "runs"} < set(told)
    assert len(told) == 8


def test_the_area_of_the_basins_is_told_where_it_alone_was_optimised():
    first, second = figures.basins_before_and_after(optimum(objective='{"area": 2.0}')).axes
    assert "1.01 × 10$^{0}$" in words(first)[0] and "2.02 × 10$^{0}$" in words(second)[0]
    for objective in ('{"area": 1.0, "speed": 1.0}', '{"speed": 1.0}'):
        assert words(figures.basins_before_and_after(optimum(objective=objective)).axes[0]) == []
    region = '{"theta": [0, 0.4, 80], "sum": [-0.04, 0.01, 60], "phidot": -0.1}'
    (note,) = words(figures.basins_before_and_after(optimum(region=region)).axes[0])
    assert note.endswith("; in the slice at $\\dot{\\varphi}$ = −0.1")


def test_an_optimisation_is_one_picture_in_which_nothing_overlaps(tmp_path):
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
    assert len(extents) == 4
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
    with pytest.raises(ValueError, match="must hold the basins at start and optimum"):
        figures.basins_before_and_after(optimum(basins=False))


def swept(*shape):
    """A data set of the form that `walker_jax.sweep` returns, over so many values of each."""
    values = {"slope": [0.002, 0.004, 0.006], "hip_stiffness": [0.0, 2.0], "foot_mass": [0.1, 0.3]}
    over = {name: values[name][:size] for name, size in zip(values, shape, strict=False)}
    area = 0.001 * (1 + np.arange(np.prod(shape))).reshape(shape)
    failed = np.zeros(shape, int)
    failed.flat[0] = 1
    data = xr.Dataset(
        {
            "total_area": ((*over,), np.where(failed, np.nan, area)),
            "total_area_error": ((*over,), area / 10),
            "failed": ((*over,), failed),
        },
        over,
        {"walker": "PointFootWalker", "walker_leg_length": 1.0, "section": ["theta", "thetadot"]},
    )
    return completed(data, "sweep", *over)


def test_the_area_over_one_parameter_has_its_error():
    ax = figures.sweep(swept(3))
    (line, _, (bars,)) = ax.containers[0]
    np.testing.assert_array_equal(line.get_xdata(), [0.002, 0.004, 0.006])
    np.testing.assert_allclose(np.asarray(line.get_ydata(), float), [np.nan, 0.002, 0.003])
    ends = [segment[:, 1] for segment in bars.get_segments() if len(segment)]
    np.testing.assert_allclose(ends, [[0.0018, 0.0022], [0.0027, 0.0033]])
    assert "slope" in ax.get_xlabel() and "area of the basin" in ax.get_ylabel()
    assert "3 basins" in (note := ax.texts[0].get_text()) and "1 failed" in note


def test_the_area_over_two_parameters_is_the_colour_of_its_place():
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


def test_of_more_parameters_the_others_are_at_their_first_values_and_named():
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


def metastable():
    """Two cells beside each other; the third edge is along the gap, which is not drawn."""
    found = {
        "survival": 0.99,
        "mean_strides": 100.0,
        "mean_strides_error": 1.0,
        "chance": ("cell", [0.75, 0.25]),
        "centre": (("cell", "direction"), [[0.20, -0.20, 0.0], [0.22, -0.21, 0.0]]),
        "edges": (("edge", "direction"), [[0.02, -0.01, 0], [0.0, 0.01, 0], [0, 0, 0.001]]),
    }
    directions = {"direction": np.array(["theta", "thetadot", "gap"], object)}
    attributes = {"walker": "SimplestWalker", "slope": 0.009, "section": ["theta", "thetadot"]}
    return completed(xr.Dataset(found, directions, attributes), "metastable walking")


def test_cells_of_metastable_walking_are_drawn_over_all_of_their_area():
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
    assert "100 ± 2" in ax.texts[0].get_text()


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
        },
        attrs={"walker": "PoweredWalker", "walker_slope": 0.0165, "actions": ["push_off"]}
        | {"area": 0.01, "inner_area": 0.009, "outer_area": 0.011, "target_area": 0.001},
    ),
    "viability",
)
GAITS = [gait(1, 0.63, 0.1, stable=True), gait(2, -4, 0.3), gait(1, 30, 5.0)]
GIVEN_AXES: dict[str, Any] = {
    "basin": [every_fate()],
    "boundary": [EDGES],
    "gait_branches": [diagram()],
    "largest_multiplier": [diagram()],
    "bifurcation_diagram": [diagram()],
    "stability_and_area": [diagram(), AREAS],
    "metastability": [metastable()],
    "multipliers": [GAITS],
    "optimisation": [optimum()],
    "disturbance": [robust()],
    "robustness_measures": [table()],
    "boundary_dimension": [table()],
    "sweep": [swept(3, 2)],
    "leg_angles": [WALKED],
    "viability": [VIABLE],
}
PARTS = ["title", "subtitle", "legend", "labels"]


def extents(axes):
    """Where axes are drawn, and the texts and legends around them."""
    for ax in axes:
        own = [one for one in ax.get_children() if isinstance(one, Text | Legend)]
        names = [ax.xaxis.label, ax.yaxis.label]
        words = [one for one in (*own, *names) if isinstance(one, Legend) or one.get_text()]
        yield from (ax.get_tightbbox(), *(one.get_window_extent() for one in words))


def test_every_picture_on_given_axes_has_the_same_options():
    takes = {
        name: signature(one).parameters for name, one in vars(figures).items() if callable(one)
    }
    assert {name for name, found in takes.items() if "ax" in found} == set(GIVEN_AXES)
    for name in GIVEN_AXES:
        only = [one.name for one in takes[name].values() if one.kind is one.KEYWORD_ONLY]
        assert only == PARTS, name


PAIRS = [*zip([*GIVEN_AXES][::2], [*GIVEN_AXES, "robustness_measures"][1::2], strict=True)]
OTHER_PAIRS = [pytest.param(pair, marks=pytest.mark.slow) for pair in PAIRS[1:-1]]


@pytest.mark.parametrize("names", [PAIRS[0], *OTHER_PAIRS, PAIRS[-1]], ids=" and ".join)
def test_two_pictures_stay_in_their_halves_of_a_small_figure(names):
    figure = Figure(figsize=(7, 2.6), layout="constrained")
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

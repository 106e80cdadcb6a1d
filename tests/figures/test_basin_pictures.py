"""Pictures of basins: what stands where, and in which colour."""

import re
import subprocess
import sys
from itertools import chain, combinations

import matplotlib.pyplot as plt
import numpy as np
import pytest
import xarray as xr
from made_up_results import PLAIN, SHEARED, data_set, deep, every_fate
from matplotlib.figure import Figure
from parts_of_pictures import annotations, colours, figure_of, labels, legend, lightness, luminance
from scipy.ndimage import distance_transform_edt

import walker_jax as wj
from walker_jax import Outcome, figures
from walker_jax.figures.regions import depths
from walker_jax.systems.outcomes import OWN

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


def fate_at(data, place):
    """Fate of the cell that holds a point of the picture."""
    names = data["fate"].dims
    where = dict(zip(names, place, strict=True))
    return int(data["fate"].sel(where, method="nearest"))


def test_every_fate_is_told_from_the_others_even_in_grey():
    own_failures = [Outcome(OWN + i) for i in range(4)]
    outcomes = [*Outcome, *own_failures]
    data = every_fate(fates=outcomes)
    found = colours(figures.basin(data))
    colour = {}
    for outcome in outcomes:
        (colour[outcome],) = np.unique(found[data["fate"].values == outcome], axis=0)
    anywhere = Outcome.STRIDE, Outcome.OUTSIDE, Outcome.UNDECIDED, Outcome.LEFT_GRID
    falls = Outcome.FORWARD, Outcome.BACKWARD, Outcome.RUNNING, Outcome.STOPPED
    of_planes = *anywhere, *falls
    of_package, own = [*Outcome], (*of_planes, *own_failures)
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


def test_a_label_keeps_away_from_other_regions_and_dots():
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


@pytest.mark.parametrize("share", [0, 0.5, 0.99, 1])
def test_depths_are_those_of_scipy(share):
    cells = np.random.default_rng(3).random((40, 23)) < share
    steps = np.array([0.3, 0.7])
    expected = distance_transform_edt(np.pad(cells, 1), sampling=steps)
    np.testing.assert_array_equal(depths(cells, steps), np.asarray(expected)[1:-1, 1:-1])


def test_what_is_too_small_for_a_label_is_in_the_legend():
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


def test_large_basins_have_own_colours_and_small_ones_share_one():
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
    assert "(rad" in ax.get_ylabel() and ax.get_ylabel().endswith("√(l/g))")
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
    [every_fate().isel(theta=0), every_fate().isel(theta=[0]), deep(every_fate())],
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


def test_a_zoom_shows_where_its_window_is():
    around = every_fate()
    origin, shear = np.array([0.2, -0.215]), np.array([[1.0, 0.0], [-1.0, 1.0]])
    half = {str(name): (-2e-11, 2e-11, size) for name, size in around["fate"].sizes.items()}
    data = data_set(wj.Grid(half, shear, origin), np.zeros(around["fate"].shape, int))
    with pytest.raises(ValueError, match="data must be of a window"):
        figures.zoomed_basin(data, around)
    data.attrs["origin"] = origin.tolist()
    figure = figures.zoomed_basin(data, around)
    figure.canvas.draw()
    left, right = figure.axes
    (window,) = annotations(left, "window")
    assert window.xy == pytest.approx((0.2, -0.015))
    note = "around $\\theta$ = 0.2000000000000000"
    assert any(note in text.get_text() and "−0.0149999" in text.get_text() for text in right.texts)
    assert right.get_xlabel() == "offset of stance leg angle $\\theta$ (rad)"
    assert left.get_xlabel() == "stance leg angle $\\theta$ (rad)"


def test_a_thinned_basin_may_be_thinned_again():
    data = every_fate()
    once = figures.thin(figures.thin(data, 8), 4)
    nx, ny = data["fate"].shape
    assert max(once["fate"].shape) <= 4 and list(once.attrs["shape"]) == [nx, ny]
    kept = once["fate"].size * once.attrs["thinned"]
    assert abs(kept / data["fate"].size - 1) < 0.5
    assert figures.thin(once).attrs == once.attrs
    said = [one.get_text() for one in figures.basin(once).texts]
    assert any(f"{nx} × {ny} cells" in one for one in said)

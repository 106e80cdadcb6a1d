import math
import signal
import subprocess
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from interruptions import stop_writes
from reference import DATA

import walker_jax as wj
from walker_jax import storage
from walker_jax.basins import attractor, methods
from walker_jax.basins.attractor import Attractor, all_motions
from walker_jax.basins.attractor_search import search
from walker_jax.basins.mapper import Mapper
from walker_jax.basins.schema import Basins
from walker_jax.cellmaps import resolve
from walker_jax.execution.tiles import compact_order
from walker_jax.integrators.integrator import Integrator
from walker_jax.storage import datasets
from walker_jax.systems.outcomes import OUTCOMES

REFERENCE = np.load(DATA / "strides_slope_0.004.npz")
PAPER = {"theta": (0, 0.4, 200), "sum": (-0.04, 0.01, 250)}


@pytest.fixture(scope="module")
def direct():
    return wj.basin(wj.SimplestWalker(0.004), wj.Grid.sheared(**PAPER), "direct")


@pytest.fixture(scope="module")
def mapped():
    return wj.basin(wj.SimplestWalker(0.004), wj.Grid.sheared(**PAPER))


def test_within_reach_of_several_attractors_the_nearest_counts():
    places = np.array([[0.1, 0.0], [0.2, 0.0], [0.3, 0.0]])
    cycles = [Attractor(place[None]) for place in places]
    points = np.array([[0.11, 0.01], [0.16, 0], [0.24, 0], [0.9, 0]])
    assert attractor.match_attractor(points, cycles, within=0.5).tolist() == [0, 1, 1, -1]
    assert attractor.match_attractor(points, cycles[::-1], within=0.5).tolist() == [2, 1, 1, -1]


def test_direct_iteration_gives_the_reference_fates(direct):
    assert (direct.fate.values != REFERENCE["fate"]).sum() <= 20
    falls = (direct.fate.values == REFERENCE["fate"]) & (REFERENCE["fate"] != 0)
    assert (direct.strides.values != REFERENCE["strides"])[falls].sum() <= 20
    assert float(direct.area.sum()) == pytest.approx(0.001214, abs=5e-7)


def test_direct_iteration_finds_the_gait(direct):
    assert direct.period.values.tolist() == [1]
    np.testing.assert_allclose(
        direct.states.values[0, 0], [0.1533895648762, -0.1560801466757], atol=1e-9
    )
    assert ((direct.attractor.values >= 0) == (direct.fate.values == 0)).all()


def test_strides_count_until_the_gait_is_reached(direct):
    """Until all coordinates are within 1e-6 of it."""
    cells = np.flatnonzero(direct.attractor.values.ravel() == 0)[::101]
    states = [wj.Grid.sheared(**PAPER).centres(cells)]
    for _ in range(64):
        states.append(np.asarray(wj.strides(wj.SimplestWalker(0.004), states[-1]).state))
    distance = np.abs(np.stack(states, axis=1) - direct.states.values[0, 0]).max(axis=2)
    first = (distance < 1e-6).argmax(axis=1)
    np.testing.assert_array_equal(direct.strides.values.ravel()[cells], first)
    assert len(cells) > 20 and first.min() > 0


def test_cell_mapping_agrees_with_iteration_but_for_cells(direct, mapped):
    agree = (mapped.fate == wj.Outcome.STRIDE) == (direct.fate == wj.Outcome.STRIDE)
    assert float(agree.mean()) >= 0.995
    gait = direct.states.values[0, 0]
    spacing = 0.002, 0.0002
    sums = mapped.states.values[..., 0], mapped.states.values.sum(axis=-1)
    near = [np.nanmin(np.abs(s - t)) for s, t in zip(sums, (gait[0], gait.sum()), strict=True)]
    assert near[0] <= 5 * spacing[0] and near[1] <= 5 * spacing[1]


def test_a_cell_goes_where_its_centre_goes(mapped):
    """Cells whose strides end off the grid, and those that fail at once, against the reference."""
    left = mapped.fate.values == wj.Outcome.LEFT_GRID
    theta, total = REFERENCE["next_theta"], REFERENCE["next_theta"] + REFERENCE["next_velocity"]
    inside = (theta >= 0) & (theta < 0.4) & (total >= -0.04) & (total < 0.01)
    first = mapped.strides.values == 0
    np.testing.assert_array_equal((REFERENCE["outcome"] == 0) & ~inside, left & first)
    failed = REFERENCE["outcome"] != 0
    np.testing.assert_array_equal(mapped.fate.values[failed], REFERENCE["outcome"][failed])
    assert (mapped.strides.values[failed] == 0).all()


def test_the_gait_of_period_two_after_the_doubling():
    walker = wj.SimplestWalker(0.016)
    data = wj.basin(walker, wj.Grid.sheared(theta=(0.1, 0.4, 40), sum=(-0.02, 0.01, 40)), "direct")
    assert data.period.values.tolist() == [2]
    states = data.states.values[0]
    assert states[0, 0] < states[1, 0]
    walked = np.asarray(wj.walk(walker, states[0], 2).states)
    np.testing.assert_allclose(walked[1:], states[[1, 0]], atol=1e-7)
    assert data.attrs["area"] == data.area.values.tolist() and data.area[0] > 0


@pytest.mark.parametrize(
    ("slope", "period"),
    [
        *(pytest.param(*row, marks=pytest.mark.slow) for row in ((0.0148, 1), (0.0152, 2))),
        (0.015, 1),
        (0.0151, 2),
    ],
)
def test_the_period_is_right_close_to_the_doubling_at_0_01509(slope, period):
    """Where walkers come near so slowly that successive states tell nothing."""
    walker = wj.SimplestWalker(slope)
    grid = wj.Grid.sheared(theta=(0.15, 0.35, 12), sum=(-0.02, 0.01, 12))
    data = wj.basin(walker, grid, "direct")
    assert data.period.values.tolist() == [period]
    assert ((data.attractor.values == 0) == (data.fate.values == 0)).all() and data.cells[0] > 0
    states = np.asarray(wj.walk(walker, data.states.values[0, 0], period).states)
    np.testing.assert_allclose(states[-1], states[0], atol=1e-11)
    assert period == 1 or np.abs(states[1] - states[0]).max() > 1e-4


@pytest.mark.slow
def test_a_motion_that_never_repeats_has_no_period(monkeypatch):
    """Beyond the cascade of doublings: survivors are on one attractor, without a period."""
    monkeypatch.setattr("walker_jax.basins.attractor_search.PATIENCE", 2)
    grid = wj.Grid.sheared(theta=(0.2, 0.3, 12), sum=(-0.01, 0.0, 12))
    data = wj.basin(wj.SimplestWalker(0.0186), grid, "direct", strides=60)
    assert data.period.values.tolist() == [0]
    assert ((data.attractor.values == 0) == (data.fate.values == 0)).all()
    assert np.isfinite(data.states.values[0, 0]).all()


def test_areas_are_those_of_the_section():
    """Of the same cells, by other coordinates of the box."""
    plain = wj.Grid.plain(theta=(0.1, 0.3, 20), thetadot=(-0.3, -0.1, 20))
    half = wj.Grid({"theta": (0.1, 0.3, 20), "half": (-0.15, -0.05, 20)}, np.diag([1.0, 2.0]))
    wanted, found = (wj.basin(wj.SimplestWalker(0.009), grid, "direct") for grid in (plain, half))
    assert found.cells.values.tolist() == wanted.cells.values.tolist() and found.cells[0] > 5
    np.testing.assert_allclose(wanted.area, wanted.cells * 0.01**2, rtol=1e-12)
    np.testing.assert_allclose(found.area, wanted.area, rtol=1e-12)


NAMES = [one.name for one in wj.Outcome]


def test_the_data_set_says_what_was_computed(direct):
    assert direct.fate.dims == ("theta", "sum") and direct.fate.shape == (200, 250)
    np.testing.assert_allclose(direct["theta"], REFERENCE["theta"], atol=1e-15)
    np.testing.assert_allclose(direct["sum"], REFERENCE["sum"], atol=1e-15)
    for key, value in {
        "walker": "SimplestWalker",
        "walker_slope": 0.004,
        "method": "direct",
        "tolerance": 1e-12,
        "version": f"walker-jax {wj.__version__}",
    }.items():
        assert direct.attrs[key] == value
    assert direct.fate.attrs["flag_meanings"].split() == NAMES


def test_cells_of_basins_at_the_border_of_the_grid_are_counted(direct):
    """The paper's window cuts the basin; a window that holds it all does not."""
    walks = direct.attractor.values >= 0
    assert int(direct.at_border) == walks.sum() - walks[1:-1, 1:-1].sum() > 0
    wide = wj.Grid.sheared(theta=(0, np.pi / 4, 40), sum=(-0.3, 0.3, 150))
    inside = wj.basin(wj.SimplestWalker(0.004), wide, "direct", strides=30)
    assert inside.cells.sum() > 0 == int(inside.at_border)


def test_attractors_are_numbered_by_period_then_angle():
    def cycle(*angles):
        return Attractor(np.array([[angle, -0.2] for angle in angles]))

    wandering = all_motions(np.array([[0.05, -0.2]]))
    found = [cycle(0.1, 0.3), wandering, cycle(0.2), cycle(0.15)]
    cells = np.array([0, 1, 2, 3, -1, 0])
    ordered = Basins(cells * 0, cells, cells * 0, found).sorted()
    assert [one.period for one in ordered.attractors] == [1, 1, 2, None]
    assert [one.states[0, 0] for one in ordered.attractors] == [0.15, 0.2, 0.1, 0.05]
    assert ordered.attractor.tolist() == [2, 3, 1, 0, -1, 2]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"method": "exact"}, "method .*'exact'"),
        ({"strides": 0}, "strides .*0"),
        ({"grid": wj.Grid.plain(thetadot=(-1, 0, 9), theta=(0, 1, 9))}, "order"),
        ({"grid": wj.Grid.plain(theta=(0, 1, 9))}, "grid .*theta, thetadot"),
        ({"grid": wj.Grid.sheared(theta=(0, 1, 40000), sum=(0, 1, 50000))}, "2000000000 cells"),
        ({"tolerance": 1e-30}, "tolerance .*1e-30"),
    ],
)
def test_wrong_requests_are_refused(arguments, message, monkeypatch):
    monkeypatch.setattr("walker_jax.checks.memory_of_machine", lambda: 8 * 2**30)
    arguments = {"grid": wj.Grid.sheared(theta=(0, 1, 3), sum=(0, 1, 3))} | arguments
    with pytest.raises(ValueError, match=message):
        wj.basin(wj.SimplestWalker(0.004), **arguments)


def test_strides_and_cycles_in_float32_are_close(direct):
    grid = wj.Grid.sheared(**PAPER)
    xs = grid.centres(np.arange(0, grid.size, 97))
    single = wj.strides(wj.SimplestWalker(0.004), xs.astype(np.float32))
    assert single.state.dtype == np.float32
    outcome = REFERENCE["outcome"].ravel()[::97]
    assert (single.outcome == outcome).mean() > 0.99
    walking = xs[direct.fate.values.ravel()[::97] == 0].astype(np.float32)
    found = search(wj.SimplestWalker(0.004), walking, Integrator(1e-6))
    assert [one.period for one in found] == [1]
    np.testing.assert_allclose(found[0].states, direct.states.values[0], atol=1e-4)


def test_a_slice_is_followed_directly_on_a_grid_of_the_section():
    walker = wj.RoundFootWalker(0.01)
    layer = wj.Grid.sheared(theta=(0, 0.4, 4), sum=(-0.1, 0, 4), phidot=0.0)
    with pytest.raises(ValueError, match=r"for a slice \(phidot fixed\)"):
        wj.basin(walker, layer)
    with pytest.raises(ValueError, match="3 dimensions of the section"):
        wj.basin(walker, wj.Grid.sheared(**PAPER), "direct")
    with pytest.raises(ValueError, match="2 dimensions of the section"):
        wj.basin(wj.SimplestWalker(0.004), layer, "direct")
    shape = {"theta": (0, 0.4, 4), "thetadot": (-0.1, 0, 4)}
    wrong = wj.Grid.plain(theta=(0, 0.4, 4), phidot=(-0.1, 0, 4), thetadot=0.0)
    unknown = wj.Grid.plain(**shape, turn=0.0)
    for grid in (wrong, unknown):
        with pytest.raises(ValueError, match="in the order of the section"):
            wj.basin(walker, grid, "direct")
    with pytest.raises(ValueError, match="region must have the 3 dimensions"):
        wj.find_gaits(walker, 1, layer)


@pytest.mark.slow
def test_a_basin_of_three_dimensions_and_a_slice_of_it():
    """The slice is a layer of the whole, and both come to the gait of Newton's search."""
    walker = wj.RoundFootWalker(0.01)
    axes = {"theta": (0.05, 0.45, 16), "sum": (-0.15, -0.02, 12)}
    whole = wj.basin(walker, wj.Grid.sheared(**axes, phidot=(-0.14, 0.06, 5)), "direct")
    layer = wj.basin(walker, wj.Grid.sheared(**axes, phidot=-0.04), "direct")
    assert whole.fate.dims == ("theta", "sum", "phidot") and layer.fate.dims == ("theta", "sum")
    assert float(layer.phidot) == -0.04 and float(whole.phidot[2]) == pytest.approx(-0.04)
    np.testing.assert_array_equal(whole.fate[:, :, 2], layer.fate)
    np.testing.assert_array_equal(whole.strides[:, :, 2], layer.strides)
    assert 10 < int((layer.fate == 0).sum()) < 150
    assert layer.period.values.tolist() == whole.period.values.tolist() == [1]
    gait = wj.find_gait(walker, layer.states.values[0, 0])
    np.testing.assert_allclose(layer.states.values[0, 0], gait.states[0], atol=1e-9)


@pytest.mark.slow
def test_cells_of_three_dimensions_show_the_one_attractor():
    walker = wj.RoundFootWalker(0.01)
    axes = {"theta": (0, 0.5, 20), "sum": (-0.17, -0.01, 20), "phidot": (-0.15, 0.05, 20)}
    data = wj.basin(walker, wj.Grid.sheared(**axes))
    true = ~data.artefact.values
    assert data.period.values[true].tolist() == [1] and int(data.cycles[0]) > 1
    gait = wj.find_gait(walker).states[0]
    np.testing.assert_allclose(data.states.values[0, 0], gait, rtol=0, atol=1e-9)


def test_where_cell_mapping_differs_and_what_it_makes_up():
    grid = wj.Grid.sheared(theta=(0, 0.4, 100), sum=(-0.04, 0.01, 100))
    walker = wj.SimplestWalker(0.004)
    found = wj.compare_methods(walker, grid)
    direct = wj.basin(walker, grid, "direct")
    np.testing.assert_array_equal(found.direct, direct.attractor >= 0)
    assert 0.001 < (found.mapped != found.direct).values.mean() < 0.005
    # several cells seem to stand still: one holds the gait, and another does not
    assert 0 < found.artefact.values.sum() < len(found.artefact)
    assert int(found.direct_attractors) == 1
    assert int(found["cells"][found.artefact].sum()) < 0.01 * int(found["cells"].sum())
    # beyond the loss of walking all that walks is made up
    lost = wj.compare_methods(
        wj.SimplestWalker(0.0195), wj.Grid.sheared(theta=(0, 0.4, 200), sum=(-0.04, 0.01, 250))
    )
    assert int(lost.direct_attractors) == 0 and not lost.direct.any()
    assert lost.mapped.any() and lost.artefact.values.all()


def test_a_cell_that_seems_to_stand_still_is_no_attractor(direct, mapped):
    """The unstable gait is in that cell; a walker from its centre falls."""
    assert mapped.period.values.tolist() == [1, 1]
    assert mapped.artefact.values.tolist() == [False, True]
    assert mapped.cycles.values.tolist() == [1, 1] and mapped.falling.values.tolist() == [0, 1]
    np.testing.assert_allclose(mapped.states[0], direct.states[0], rtol=0, atol=1e-9)
    assert mapped["cells"].values.tolist() == [3043, 1]
    fallen = wj.walk(wj.SimplestWalker(0.004), mapped.states.values[1, 0], 50).outcomes
    assert fallen[-1] not in (wj.Outcome.STRIDE, wj.Outcome.UNDECIDED)
    assert "artefact" not in direct


@pytest.mark.parametrize(
    ("slope", "joined"), [(0.0114, 1), pytest.param(0.0124, 3, marks=pytest.mark.slow), (0.0178, 3)]
)
def test_a_cycle_of_cells_belongs_to_where_most_centres_lead(slope, joined):
    """Every cycle, and the cells that lead to it, against walks from the centres one by one."""
    walker, grid = wj.SimplestWalker(slope), wj.Grid.sheared(**PAPER)
    data = wj.basin(walker, grid)
    ends = resolve(methods.cell_map(walker, grid, Integrator(1e-12)), sinks=OUTCOMES)
    lengths = [len(cycle) for cycle in ends.attractors]
    starts = grid.centres(np.concatenate(ends.attractors))
    x = starts
    for _ in range(300):
        x = wj.strides(walker, x).state
    fallen = np.asarray(np.isnan(x).any(axis=1))
    near = np.zeros((data.sizes["number"], len(x)), bool)
    for number in np.flatnonzero(~data.artefact.values):
        states = data.states.values[number, : int(data.period[number])]
        near[number] = (np.abs(x - states[:, None]).max(axis=2) < 1e-5).any(axis=0)
    assert (fallen | near.any(axis=0)).all()
    label = data.attractor.values.ravel()
    cycles, falling = np.zeros((2, data.sizes["number"]), int)
    for i, own in enumerate(np.split(np.arange(len(x)), np.cumsum(lengths)[:-1])):
        (number,) = np.unique(label[ends.attractor == i])
        share = near[:, own].mean(axis=1)
        if share.max() > 0.5:
            assert number == share.argmax()
        else:
            assert data.artefact[number] and int(data.period[number]) == len(own)
            np.testing.assert_array_equal(data.states[number, : len(own)], starts[own])
        cycles[number] += 1
        falling[number] += fallen[own].sum()
    np.testing.assert_array_equal(cycles, data.cycles)
    np.testing.assert_array_equal(falling, data.falling)
    assert cycles.max() == joined and (np.diff(data.artefact.values.astype(int)) >= 0).all()
    np.testing.assert_array_equal(label >= 0, data.fate.values.ravel() == wj.Outcome.STRIDE)


@pytest.mark.slow
def test_a_cycle_of_cells_may_belong_to_one_without_a_period(monkeypatch):
    """Beyond the cascade of doublings: walkers from both centres never come back to themselves."""
    monkeypatch.setattr("walker_jax.basins.attractor_search.PATIENCE", 2)
    monkeypatch.setattr("walker_jax.basins.attractor_search.ATTEMPTS", 1)
    monkeypatch.setattr("walker_jax.basins.methods.PATIENCE", 2)
    data = wj.basin(wj.SimplestWalker(0.0188), wj.Grid.sheared(**PAPER))
    assert data.period.values.tolist() == [0] and not data.artefact.any()
    assert data["cells"].values.tolist() == [(data.fate.values == 0).sum()] == [28]


# Piece by piece


STEEP = wj.SimplestWalker(0.0151)
COARSE = {"theta": (0, 0.4, 50), "sum": (-0.03, 0.02, 60)}


@cache
def computed_at_once(method):
    """Close to the doubling, where walkers are left at the end."""
    return wj.basin(STEEP, wj.Grid.sheared(**COARSE), method, strides=30)


@pytest.fixture
def small_pieces(monkeypatch):
    monkeypatch.setattr("walker_jax.basins.methods.PIECE", 600)


@pytest.mark.parametrize("method", ["cell-map", "direct"])
def test_piece_by_piece_it_is_the_same(tmp_path, small_pieces, method):
    grid, wanted = wj.Grid.sheared(**COARSE), computed_at_once(method)
    found = wj.basin(STEEP, grid, method, strides=30, out=tmp_path / "a.zarr")
    assert found.attrs.pop("request") and found.identical(wanted)
    again = wj.basin(STEEP, grid, method, strides=30, out=tmp_path / "a.zarr")
    assert again.drop_attrs(deep=False).identical(wanted.drop_attrs(deep=False))
    if method == "direct":
        assert ((wanted.fate == 0) & (wanted.strides == 30)).sum() > 10
    with pytest.raises(storage.StoreConflict, match="another result"):
        wj.basin(STEEP, grid, method, strides=30, tolerance=1e-9, out=tmp_path / "a.zarr")


def test_the_order_in_which_cells_are_computed_changes_nothing(monkeypatch):
    """That of accelerators, over all of a grid or a part of it."""
    grid = wj.Grid.sheared(**COARSE)
    blocks, mapper = (None, methods.Block(600, (20, 60))), Mapper(STEEP, [], Integrator(1e-12), 3)

    def compute():
        maps = [methods.cell_map(STEEP, grid, Integrator(1e-12), block) for block in blocks]
        labels = [methods.map_block(mapper, grid, block) for block in blocks]
        return [*maps, *labels[0], *labels[1], *(one.remaining for one in labels)]

    wanted = compute()
    order = lambda shape: compact_order(shape, 64)
    monkeypatch.setattr("walker_jax.basins.methods.order_of_cells", order)
    for found, values in zip(compute(), wanted, strict=True):
        np.testing.assert_array_equal(found, values)
    whole, cells = wanted[0], grid.size
    np.testing.assert_array_equal(wanted[1], whole[600:1800])
    assert 100 < np.unique(whole[whole < cells]).size and 20 < len(wanted[-2]) < cells


@pytest.mark.parametrize("shape", [(50, 60), (2, 2000), (3, 4, 1000), (1, 1, 5000), (7,), (900,)])
def test_pieces_are_all_cells_one_after_the_other(small_pieces, shape):
    block = methods.block_shape(shape)
    place = storage.Pieces(Path(), None, shape[: len(block)], block, None, (), ())
    grid = wj.Grid({str(i): (0, 1, n) for i, n in enumerate(shape)}, np.eye(len(shape)))
    parts = [methods.block_at(grid, place, i) for i in range(place.count)]
    assert [i for part in parts for i in range(grid.size)[part.cells]] == [*range(grid.size)]
    sizes = [math.prod(part.shape) for part in parts]
    assert max(sizes) < 2 * 600 and (len(parts) == 1 or max(sizes) >= 600)


@pytest.mark.parametrize("method", [pytest.param("cell-map", marks=pytest.mark.slow), "direct"])
def test_rows_that_are_long_are_cut(tmp_path, small_pieces, method):
    grid = wj.Grid.sheared(theta=(0.1, 0.3, 2), sum=(-0.03, 0.02, 1500))
    wanted = wj.basin(STEEP, grid, method, strides=30)
    found = wj.basin(STEEP, grid, method, strides=30, out=tmp_path / "a.zarr")
    assert found.drop_attrs(deep=False).identical(wanted.drop_attrs(deep=False))
    stored = xr.open_zarr(tmp_path / "a.zarr", chunks=None, consolidated=False)  # without dask
    assert stored["fate"].encoding["chunks"] == (1, 750)


@pytest.mark.parametrize("method", ["cell-map", "direct"])
def test_interrupted_at_any_write_it_goes_on(tmp_path, small_pieces, monkeypatch, method):
    grid, path = wj.Grid.sheared(**COARSE), tmp_path / "a.zarr"
    wanted = computed_at_once(method)
    piece, stops, runs = [], {0, 2, 3, 4, 6, 8}, 0
    kind = methods.CellMapping if method == "cell-map" else methods.DirectIteration
    compute = kind.piece

    def counted(self, notes, part):
        piece.append(part)
        return compute(self, notes, part)

    stop_writes(monkeypatch, stops, arrays=1)
    monkeypatch.setattr(kind, "piece", counted)
    while stops:
        with pytest.raises(KeyboardInterrupt):
            wj.basin(STEEP, grid, method, strides=30, out=path)
        runs += 1
        assert storage.load(path) is not None
    found = wj.basin(STEEP, grid, method, strides=30, out=path)
    assert found.drop_attrs(deep=False).identical(wanted.drop_attrs(deep=False))
    # of five pieces four were in flight when it stopped; no other is computed twice
    assert (runs, len(piece), len(set(piece))) == (6, 9, 5)


KILLED = """
import os
import signal
import sys
from pathlib import Path
import jax
from zarr.storage import LocalStore
import walker_jax as wj
from walker_jax.basins import methods
jax.config.update("jax_enable_x64", True)
methods.PIECE = 2**12
kind = methods.CellMapping if sys.argv[1] == "cell-map" else methods.DirectIteration
compute, put, left = kind.piece, LocalStore.set, int(sys.argv[3])
def told(self, notes, part):
    print("begun", part.first, flush=True)
    return compute(self, notes, part)
async def counted(self, key, value):
    global left
    left -= 1
    if left == 0:
        os.kill(os.getpid(), signal.SIGKILL)
    await put(self, key, value)
kind.piece, LocalStore.set = told, counted
grid = wj.Grid.sheared(theta=(0, 0.4, 400), sum=(-0.03, 0.02, 1000))
wj.basin(wj.SimplestWalker(0.0151), grid, sys.argv[1], out=Path(sys.argv[2]))
print("ended", flush=True)
"""


@pytest.mark.slow
@pytest.mark.parametrize("method", ["cell-map", "direct"])
def test_killed_at_twenty_moments_it_is_the_same_to_the_bit(tmp_path, method):
    """Killed, so that nothing is tidied up; no piece is computed twice but those in flight."""
    path, begun = tmp_path / "a.zarr", []
    # before so many files are written, none of them so many that twenty runs could come to the end
    for files in (*np.random.default_rng(0).integers(1, 12, 20).tolist(), 0):
        command = [sys.executable, "-c", KILLED, method, str(path), str(files)]
        run = subprocess.run(command, stdout=subprocess.PIPE, text=True)
        lines = run.stdout.splitlines()
        assert run.returncode == (-signal.SIGKILL if files else 0)
        assert ("ended" in lines) == (files == 0)
        begun += [line for line in lines if line.startswith("begun")]
    grid = wj.Grid.sheared(theta=(0, 0.4, 400), sum=(-0.03, 0.02, 1000))
    wanted = wj.basin(wj.SimplestWalker(0.0151), grid, method)
    assert (
        datasets.open_dataset(path).drop_attrs(deep=False).identical(wanted.drop_attrs(deep=False))
    )
    assert len(set(begun)) == 80
    assert len(begun) <= 80 + 20
    assert [place.name for place in tmp_path.iterdir()] == ["a.zarr"]

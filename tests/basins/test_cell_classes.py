"""What data sets say, by the functions that read them, against other ways to compute it."""

import numpy as np
import pytest
import xarray as xr

import walker_jax as wj
from walker_jax.basins.cell_classes import (
    along_axis,
    failing_cells,
    fixed_coordinates,
    large_basins,
    total_area,
    walking_cells,
)
from walker_jax.basins.schema import describe
from walker_jax.figures.text import NO_BREAK, SYMBOLS, basin_note
from walker_jax.stability.nearest_starts import circle
from walker_jax.systems.outcomes import OUTCOMES, Outcome

WALKER = wj.SimplestWalker(0.0125)  # with attractors of period one and three
GRID = wj.Grid.sheared(theta=(0.1, 0.3, 40), sum=(-0.02, 0.01, 30))


@pytest.fixture(scope="module")
def data():
    return wj.basin(WALKER, GRID, "direct")


def test_states_along_an_axis_are_where_the_grid_has_them():
    states = np.asarray(GRID.centres(np.arange(GRID.size))).reshape(*GRID.shape, 2)
    section = ["theta", "thetadot"]
    for name, expected in zip(
        GRID.names, np.meshgrid(*GRID.axes.values(), indexing="ij"), strict=True
    ):
        np.testing.assert_allclose(along_axis(states, section, name), expected, atol=1e-15)
    assert np.isnan(along_axis(states, section, "phidot")).all()
    np.testing.assert_array_equal(along_axis(states, ["x", "sum"], "sum"), states[..., 1])


def test_every_cell_is_in_one_class(data):
    large = large_basins(data, 3)
    walking = walking_cells(data, large)
    classes = [*walking.large.values(), walking.others, walking.artefacts, walking.unmatched]
    classes += failing_cells(data["fate"].values).values()
    np.testing.assert_array_equal(np.sum(classes, axis=0), 1)
    counts = [walking.large[number].sum() for number in large]
    assert counts == data["cells"].values[large].tolist()
    assert total_area(data) == pytest.approx((data["attractor"].values >= 0).sum() * GRID.cell_area)


def test_every_failure_has_its_cells():
    """A system's own failures too; of -1, which is not computed yet, there is no class."""
    fate = np.random.default_rng(0).integers(-1, OUTCOMES, (30, 40)).astype(np.int8)
    found = failing_cells(fate)
    assert sorted(found) == [*range(1, OUTCOMES)]
    for outcome, one in found.items():
        np.testing.assert_array_equal(one, fate == outcome)


def test_large_basins_have_a_tenth_of_the_cells_that_never_fall():
    """Of 100 cells, 5 of which match no attractor; half of the grid falls."""
    cells = {0: 9, 1: 10, 2: 40, 3: 23, 4: 13, -1: 5}  # 2 is an artefact
    attractor = np.repeat([*cells, -1], [*cells.values(), 100])
    fate = np.repeat([Outcome.STRIDE, Outcome.FORWARD], 100)
    order = np.random.default_rng(0).permutation(200)
    data = xr.Dataset(
        {
            "fate": (("theta", "sum"), fate[order].reshape(20, 10)),
            "attractor": (("theta", "sum"), attractor[order].reshape(20, 10)),
            "artefact": ("number", np.arange(5) == 2),
        }
    )
    assert large_basins(data, 9) == [3, 4, 1]
    assert large_basins(data, 2) == [3, 4]


def test_points_of_a_circle_are_equally_far_from_its_centre():
    centre = np.array([0.2, -0.2])
    points = circle(centre, 0.003, 50)
    np.testing.assert_allclose(np.linalg.norm(points - centre, axis=1), 0.003, rtol=1e-12)
    assert points.shape == (50, 2) and np.ptp(points[:, 0]) > 0.0059


def test_a_slice_tells_the_coordinates_that_it_holds_fixed():
    """Behind its axes and before them; a window that is only zoomed into is no slice."""
    walker, ends = wj.RoundFootWalker(0.01, foot_radius=0.3), {"thetadot": (-1, 0, 3)}
    point = {"theta": 0.25, "thetadot": 0.0, "phidot": 0.0}
    across = wj.Grid.through(point, **ends, phidot=(-0.5, 0.0, 4))
    plain = wj.Grid.plain(theta=(0, 1, 2), **ends, phidot=-0.125)
    whole = wj.Grid.plain(theta=(0, 1, 2), **ends, phidot=(-0.5, 0.0, 4)).zoom(
        np.array([0.2, -0.2, 0.1]), 2
    )
    for grid, fixed in ((across, {"theta": 0.25}), (plain, {"phidot": -0.125}), (whole, {})):
        assert fixed_coordinates(describe_fates(walker, grid)) == fixed
    note = basin_note(describe_fates(walker, across)).replace(NO_BREAK, " ")
    assert note.endswith(f"\nin the slice at {SYMBOLS['theta']} = 0.25")
    spatial = wj.SpatialWalker()
    point = dict.fromkeys(spatial.section, 0.5)
    grid = wj.Grid.through(point, theta=(0, 1, 2), phidot=(0, 1, 2))
    note = " ".join(basin_note(describe_fates(spatial, grid)).split())
    others = ("yaw", "phi", "yawdot", "leandot", "thetadot")
    assert note.endswith(", ".join(f"{SYMBOLS.get(name, name)} = 0.5" for name in others))


def describe_fates(walker, grid):
    """A basin's data set in which no walker converges to an attractor."""
    data = describe(walker, grid, {"method": "direct"})
    return data.assign(fate=(grid.names, np.zeros(grid.shape, np.int8)), area=0.0)

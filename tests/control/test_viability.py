"""The viability kernel against a published map, closed forms and plain searches."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr
from matplotlib.text import Text
from reference import DATA

import walker_jax as wj
from walker_jax import figures
from walker_jax.control.images import Arrivals, box_around
from walker_jax.controlled_maps import (
    ImageBoxes,
    Points,
    best_action,
    count_safe,
    find_capture,
    find_viable,
    unavoidable_failure,
)

PUBLISHED = dict(np.load(DATA / "slip_map.npz"))
ENERGY = 0.85 + 5.5**2 / (2 * 9.81)
RUNNER = wj.systems.SpringMassRunner(stiffness=8200 / (80 * 9.81), energy=ENERGY)


def test_no_action_leads_to_anything_of_value_zero():
    """Cells 0, 1 and 2 are worth 2, 1 and 0; beyond them nothing is worth anything."""
    image = np.array([[2, 1, 0], [2, 3, 4], [2, 1, 3], [4, 4, 4]], np.int32)
    action = best_action(Points(image), np.array([2, 1, 0, 0]))
    assert action.tolist() == [2, -1, 1, -1]


@pytest.mark.parametrize("failing", [[], [0], [0, 1, 2]])
def test_a_box_is_wider_if_part_of_its_cell_fails(failing):
    """The images of centre and corners are within 0.1 of each other, in a cell of the grid."""
    grid = wj.Grid.plain(x=(0, 9, 9), y=(0, 9, 9))
    place = np.array([[4.45, 4.45], [4.55, 4.45], [4.45, 4.55], [4.55, 4.55]])
    made = ~np.isin(np.arange(4), failing)
    there: Any = jnp.array([4.5, 4.5]), jnp.asarray(True), jnp.asarray(4 * 9 + 4)
    corners = jnp.where(made[:, None], place, jnp.nan), jnp.asarray(made)
    low, high, whole, some = box_around((grid, grid), Arrivals(*there), corners)
    reach = 1 if failing else 0
    assert low.tolist() == [4 - reach] * 2 and high.tolist() == [4 + reach] * 2
    assert bool(whole) == (not failing) and some


# A published map: a spring-mass runner that chooses its angle of attack


def test_a_published_map_has_the_published_kernel():
    failed, place, count = PUBLISHED["Q_F"], PUBLISHED["Q_map"], len(PUBLISHED["s_grid"])
    image = np.where(failed | (place == 0), count + 1, place - 1).astype(np.int32)
    points = Points(image)
    kernel = find_viable(points) < 0
    held = points.within(points.table(kernel), np.arange(count), slice(None))
    assert np.array_equal(held, PUBLISHED["Q_V"])
    assert held.mean() == pytest.approx(0.17481, abs=1e-6)
    share = count_safe(points, kernel) / image.shape[1]
    np.testing.assert_allclose(share, PUBLISHED["S_M"], rtol=0, atol=1e-15)


@pytest.mark.slow
def test_the_runner_has_the_failures_and_kernel_published():
    """Cells of the published map stand for their lower ends, those here for their centres: that
    moves the boundaries of safe actions by half a cell."""
    apex, angle = PUBLISHED["s_grid"] * ENERGY, np.pi / 2 - PUBLISHED["a_grid"]
    half = (apex[1] - apex[0]) / 2
    grid = wj.Grid.plain(apex=(apex[0] - half, apex[-1] + half, len(apex)))
    data = wj.viable(RUNNER, grid, {"angle": angle})
    published = PUBLISHED["Q_V"].any(axis=1)
    assert (data["viable"].values != published).sum() == 0
    share = data["safe_actions"].values / len(angle)
    assert np.abs(share - PUBLISHED["S_M"]).max() < 0.02
    assert data["safe_actions"].values.sum() / published.size / len(angle) == pytest.approx(
        0.17481, abs=0.004
    )
    assert (data["failure"].values[~published] == wj.Outcome.OUTSIDE).all()
    assert data.attrs["inner_area"] < data.attrs["area"] < data.attrs["outer_area"]


# Closed forms: a rimless wheel on level ground that pushes off


class PushedWheel(wj.System):
    """Spokes 0.6 rad apart, of length 1, and an impulse along the trailing one at each step."""

    push: float = 0.0

    section = ("rate",)

    def advance(self, x):
        passes = x[0] > LEAST
        outcome = jnp.where(passes, wj.Outcome.STRIDE, wj.Outcome.BACKWARD)
        return np.cos(0.6) * x + np.sin(0.6) * self.push, outcome, jnp.ones_like(x[0])


LEAST = np.sqrt(2 - 2 * np.cos(0.3))
"""The rate with which the wheel comes to rest upright."""


def test_kernel_and_capturable_sets_of_a_wheel_are_closed_forms():
    grid = wj.Grid.plain(rate=(0.0, 1.5, 150_000))
    rate, cell = grid.axes["rate"], grid.cell_area
    target = (rate >= 0.5) & (rate < 0.6)
    data = wj.viable(PushedWheel(), grid, {"push": (0.0, 0.2, 8)}, target=target)
    # With the whole push the wheel goes on from any rate above the least.
    assert data.attrs["area"] == pytest.approx(1.5 - LEAST, abs=cell)
    assert data.attrs["inner_area"] == pytest.approx(1.5 - LEAST, abs=4 * cell)
    assert data.attrs["outer_area"] == pytest.approx(1.5 - LEAST, abs=4 * cell)
    low, high = 0.5, 0.6
    for steps in range(1, 5):
        low = max(LEAST, (low - np.sin(0.6) * 0.2) / np.cos(0.6))
        high = min(1.5, high / np.cos(0.6))
        captured = (data["capture"].values >= 0) & (data["capture"].values <= steps)
        assert captured.sum() * cell == pytest.approx(high - low, abs=2 * cell)
    assert np.array_equal(data["capture"] >= 0, data["viable"])


def test_too_weak_pushes_leave_no_kernel_and_so_many_strides():
    """The wheel slows down with its largest push too, w -> c w + s p."""
    grid = wj.Grid.plain(rate=(0.0, 1.5, 3001))
    data = wj.viable(PushedWheel(), grid, {"push": [0.0, 0.05]}, bounds=False)
    assert not data["viable"].any() and "inner" not in data
    rate, made = grid.axes["rate"].copy(), np.zeros(3001, int)
    while (rate > LEAST).any():
        made += rate > LEAST
        rate = np.where(rate > LEAST, np.cos(0.6) * rate + np.sin(0.6) * 0.05, rate)
    # Cells round each stride up or down by half of one; the slowest are fewest.
    assert np.abs(data["lasting"].values - made).max() <= 1
    assert (data["lasting"].values != made).mean() < 0.01
    assert (data["failure"] == wj.Outcome.BACKWARD).all()


def saturate(x, gain):
    return jnp.clip(x + gain, 0, 1)


@pytest.mark.parametrize("gain", [-1.0, 1.0, 0.3])
@pytest.mark.parametrize("axes", [("x",), ("x", "y"), ("x", "y", "z")])
def test_bounds_hold_where_images_lie_on_the_edges_of_the_grid(gain, axes):
    """Both borders belong to the grid: what saturates at either of them stays."""
    system = wj.Map(saturate, axes, parameters={"gain": gain})
    grid = wj.Grid.plain(**dict.fromkeys(axes, (0, 1, 10)))
    data = wj.viable(system, grid, {"gain": [gain]})
    inner, kernel, outer = (data[name].values for name in ("inner", "viable", "outer"))
    assert not (inner & ~kernel).any() and not (kernel & ~outer).any()
    assert kernel.all()
    assert inner.all() or abs(gain) < 1  # a cell in which the map has its kink is not bounded well
    beyond = wj.Grid.plain(**dict.fromkeys(axes, (0, np.nextafter(1.0, 0), 10)))
    left = wj.viable(system, beyond, {"gain": [gain]})["viable"].values
    assert left.all() if gain < 0 else not left.any()  # a grid that ends just before 1


def test_the_systems_own_parameters_are_an_action():
    """So what converges by itself is viable, whatever the actions."""
    own = wj.PoweredWalker(0.004, push_off=0.01)
    data = wj.viable(own, GRID, {"push_off": [0.03, 0.04]}, bounds=False)
    assert data["push_off"].values.tolist() == [0.03, 0.04, 0.01]
    target = data["capture"].values == 0
    assert target.any() and not (target & ~data["viable"].values).any()
    assert not ((data["capture"].values >= 0) & ~data["viable"].values).any()


class Stalling(PushedWheel):
    """One that names how it fails."""

    failures = ("stalls",)

    def advance(self, x):
        state, outcome, time = super().advance(x)
        return state, jnp.where(outcome == 0, outcome, self.failure("stalls")), time

    def gait_region(self):
        return wj.Grid.plain(rate=(0.0, 1.5, 100))


def test_a_policy_has_what_its_system_has(tmp_path):
    grid = wj.Grid.plain(rate=(0.0, 1.5, 100))
    wheel = Stalling(push=0.11)
    data = wj.viable(wheel, grid, {"push": (0.0, 0.2, 5)})
    data.to_zarr(tmp_path / "kernel.zarr", consolidated=False)
    with xr.open_zarr(tmp_path / "kernel.zarr", consolidated=False) as kept:
        single = kept.load().assign_attrs(actions="push", section="rate")  # as NetCDF has them
    steered = wj.Policy(wheel, single)
    assert steered.failures == ("stalls",) and steered.label() == "SteeredStalling"
    gait = wj.find_gait(steered)
    np.testing.assert_allclose(gait.states, wj.find_gait(wheel).states, atol=1e-12)
    followed = wj.basin(steered, grid, "direct")
    assert followed.attrs["failures"] == "stalls"
    assert np.array_equal(followed["attractor"] >= 0, data["viable"])


# Walkers


GRID = wj.Grid.sheared(theta=(0.05, 0.45, 40), sum=(-0.05, 0.01, 48))
PUSHES = {"push_off": (0.0, 0.08, 9)}
WALKER = wj.PoweredWalker(0.004)


@pytest.fixture(scope="module")
def pushed():
    return wj.viable(WALKER, GRID, PUSHES)


@pytest.fixture(scope="module")
def basins(pushed):
    """Those of the passive walker and of the policy."""
    return [wj.basin(one, GRID, "direct") for one in (WALKER, wj.Policy(WALKER, pushed))]


def test_sets_are_within_each_other_cell_by_cell(pushed):
    inner, kernel, outer = (pushed[name].values for name in ("inner", "viable", "outer"))
    assert not (inner & ~kernel).any() and not (kernel & ~outer).any()
    assert 0 < inner.sum() < kernel.sum() < outer.sum()
    passive = wj.basin(WALKER, GRID)["attractor"].values >= 0
    assert np.array_equal(pushed["capture"].values == 0, passive)
    assert not ((pushed["capture"].values >= 0) & ~kernel).any()
    fixed = wj.basin(wj.PoweredWalker(0.004, push_off=0.02), GRID)["attractor"].values >= 0
    assert fixed.any() and not (fixed & ~kernel).any()  # 0.02 is one of the actions


@pytest.mark.slow
def test_bounds_close_in_on_the_area_with_the_size_of_cells():
    """The first power of it, as boundaries are lines: half as large cells have half the gap."""
    gaps = []
    for finer in (1, 2, 4):
        counts = np.array([40, 48]) * finer
        grid = wj.Grid.sheared(theta=(0.05, 0.45, counts[0]), sum=(-0.05, 0.01, counts[1]))
        data = wj.viable(WALKER, grid, {"push_off": (0.0, 0.08, 33)})
        assert data.attrs["inner_area"] <= data.attrs["area"] <= data.attrs["outer_area"]
        gaps.append(data.attrs["outer_area"] - data.attrs["inner_area"])
    assert 0.9 < np.log2(gaps[0] / gaps[2]) / 2 < 1.3


def test_areas_are_off_by_no_more_than_cells_on_every_grid():
    for count in (100, 210, 430, 870, 1750):
        grid = wj.Grid.plain(rate=(0.0, 1.5, count))
        about = wj.viable(PushedWheel(), grid, {"push": (0.0, 0.2, 8)}).attrs
        inner, area, outer = (
            (about[name] - (1.5 - LEAST)) / grid.cell_area
            for name in ("inner_area", "area", "outer_area")
        )
        assert -3 <= inner <= 0 <= outer <= 3 and -0.5 <= area <= 0.5


def test_actions_lead_where_they_should(pushed):
    """Followed by hand: by the action of each cell a walker comes one stride nearer to the target,
    on the cells' own terms."""
    capture, action = pushed["capture"].values, pushed["action"].values
    cells = np.flatnonzero(capture > 0)
    value = pushed["push_off"].values[action.ravel()[cells]]
    many = wj.PoweredWalker(0.004)
    for cell, push in zip(cells[::37], value[::37], strict=True):
        made = wj.stride(
            wj.PoweredWalker(many.slope, push_off=push), jnp.asarray(GRID.centre(int(cell)))
        )
        following = int(GRID.cell(made.state))
        assert made.outcome == wj.Outcome.STRIDE
        assert capture.ravel()[following] == capture.ravel()[cell] - 1
    acts = pushed["viable"].values & (capture != 0)
    assert np.array_equal(action >= 0, acts)


def test_the_policy_is_a_system_whose_basin_is_about_the_kernel(pushed, basins):
    passive, followed = (one["attractor"].values >= 0 for one in basins)
    kernel, inner = pushed["viable"].values, pushed["inner"].values
    assert followed.sum() > 2.5 * passive.sum() > 0
    assert not (followed & ~pushed["outer"].values).any()
    assert (followed & kernel).sum() > 0.85 * kernel.sum()
    assert (followed & inner).sum() > 0.9 * inner.sum()


@pytest.mark.slow
def test_the_policy_takes_actions_of_cells_and_means_between(pushed):
    steered = wj.Policy(WALKER, pushed)
    action = pushed["action"].values
    value = np.where(action >= 0, pushed["push_off"].values[action], 0.0)
    by = lambda push, x: wj.stride(wj.PoweredWalker(0.004, push_off=push), x).state
    acts = action >= 0
    (i, j), *_ = np.argwhere(acts & np.roll(acts, -1, axis=1) & (np.diff(value, append=0) != 0))
    one, other = (jnp.asarray(GRID.centre(int(i * 48 + k))) for k in (j, j + 1))
    np.testing.assert_allclose(wj.stride(steered, one).state, by(value[i, j], one), atol=1e-14)
    between = 0.75 * one + 0.25 * other
    mean = 0.75 * value[i, j] + 0.25 * value[i, j + 1]
    np.testing.assert_allclose(wj.stride(steered, between).state, by(mean, between), atol=1e-13)
    push = lambda x: wj.stride(steered, x).state
    along = jax.jvp(push, (between,), (other - one,))[1]
    apart = push(between + 1e-4 * (other - one)) - push(between - 1e-4 * (other - one))
    np.testing.assert_allclose(along, apart / 2e-4, atol=1e-7)
    alone = jnp.asarray(GRID.centre(int(np.flatnonzero(pushed["capture"].values == 0)[3])))
    plain = wj.stride(WALKER, alone).state
    np.testing.assert_allclose(wj.stride(steered, alone).state, plain, rtol=0, atol=1e-15)
    away = jnp.array([0.3, -0.9])
    assert wj.stride(steered, away).outcome == wj.stride(WALKER, away).outcome
    other = wj.PoweredWalker(0.0035)
    gait = wj.find_gait(other, [0.15, -0.155])
    flatter = wj.find_gait(wj.Policy(other, pushed), gait.states[0])
    np.testing.assert_allclose(flatter.states, gait.states, atol=1e-10)
    np.testing.assert_allclose(flatter.multipliers, gait.multipliers, atol=1e-8)


def test_two_parameters_at_once_and_a_target_of_ones_own(pushed):
    grid = wj.Grid.sheared(theta=(0.05, 0.45, 20), sum=(-0.1, 0.01, 22))
    target = np.zeros(grid.shape, bool)
    target[8:10, 12:18] = True
    data = wj.viable(
        wj.PoweredWalker(0.004, hip_stiffness=2.0),
        grid,
        {"hip_angle": (-0.4, 0.0, 3), "push_off": [0.0, 0.02]},
        target=target,
    )
    assert data.sizes["action_number"] == 6 and data.attrs["actions"] == "hip_angle, push_off"
    assert np.array_equal(data["hip_angle"], [-0.4, -0.4, -0.2, -0.2, 0, 0])
    assert np.array_equal(data["capture"].values == 0, target)
    assert data.attrs["target_area"] == pytest.approx(target.sum() * grid.cell_area)


def test_the_picture_shades_viable_cells_and_names_the_failures(pushed):
    ax = figures.viability(pushed)
    words = [text.get_text() for text in ax.findobj(Text)]
    assert {"falls backward", "target", "inner bound"} <= {*words}
    assert any(f"viable {pushed.attrs['area']:.4g}" in one.replace("\n", " ") for one in words)


def test_the_picture_of_captured_sets_has_areas_and_basins(pushed, basins):
    capture, (passive, followed) = pushed["capture"].values, basins
    ax = figures.capturability(pushed, {"passive": passive, "policy": followed})
    words = {text.get_text() for text in ax.findobj(Text)}
    area = lambda cells: f"{cells.sum() * GRID.cell_area:.3g}"
    assert f"target: {area(capture == 0)}" in words
    assert f"1 stride: {area((capture == 0) | (capture == 1))}" in words
    assert f"policy: {sum(followed.attrs['area']):.3g}" in words
    assert "bound to fail" in words
    (image,) = ax.get_images()
    shown = np.asarray(image.get_array()).swapaxes(0, 1)
    colours = [shown[capture == n][0] for n in range(3)]
    assert all((shown[capture == n] == colours[n]).all() for n in range(3))
    grey = [colour @ [0.3, 0.6, 0.1] for colour in colours]
    assert grey[0] + 40 < grey[1] < grey[2] - 25  # told apart without colour too
    assert len(ax.collections) == 2


# The algorithms, against plain searches over random maps


def plainly_viable(holds, n) -> np.ndarray:
    """Steps that each cell can make, by trying every action in every round."""
    alive, lasting = np.ones(n, bool), np.full(n, -1)
    step = -1
    while True:
        step += 1
        held = np.array([holds(cell, alive) for cell in range(n)])
        dead = alive & ~held
        if not dead.any():
            return lasting
        lasting[dead] = step
        alive &= held


def test_kernel_and_capture_basin_are_those_of_a_plain_search():
    rng = np.random.default_rng(3)
    for _ in range(20):
        n, m = 60, 3
        image = rng.integers(0, n, (n, m)).astype(np.int32)
        image[rng.random((n, m)) < 0.55] = n + rng.integers(1, 4)
        points = Points(image)
        holds = lambda cell, alive, image=image: any(
            one < len(alive) and alive[one] for one in image[cell]
        )
        lasting = plainly_viable(holds, n)
        assert np.array_equal(find_viable(points), lasting)
        target = rng.random(n) < 0.05
        steps = find_capture(points, target)
        action = best_action(points, np.where(steps < 0, 0, n + 1 - steps))
        distance = np.where(target, 0, n)
        for _ in range(n):
            reached = np.append(distance, n)[np.minimum(image, n)].min(axis=1) + 1
            distance = np.minimum(distance, reached)
        assert np.array_equal(steps, np.where(distance < n, distance, -1))
        some = steps > 0
        assert np.array_equal(steps[image[some, action[some]]], steps[some] - 1)
        failure = unavoidable_failure(points, lasting.astype(np.int32))
        assert np.array_equal(failure == 0, lasting < 0)


@pytest.mark.parametrize("counts", [(30,), (7, 9), (4, 3, 5)])
@pytest.mark.parametrize("every", [True, False])
def test_boxes_are_held_as_a_plain_count_says(counts, every):
    rng = np.random.default_rng(5)
    n, m, d = int(np.prod(counts)), 3, len(counts)
    ends = np.sort(rng.integers(0, np.array(counts), (2, n, m, d)), axis=0)
    valid = rng.random((n, m)) < 0.8
    boxes = ImageBoxes(ends[0], ends[1], valid, counts, every)
    chosen = rng.random(n) < (0.9 if every else 0.1)
    shaped = chosen.reshape(counts)
    held = np.empty((n, m), bool)
    for cell, action in np.ndindex(n, m):
        places = zip(*ends[:, cell, action], strict=True)
        inside = shaped[tuple(slice(low, high + 1) for low, high in places)]
        held[cell, action] = valid[cell, action] and (inside.all() if every else inside.any())
    table = boxes.table(chosen)
    assert np.array_equal(boxes.within(table, np.arange(n), slice(None)), held)
    one = rng.integers(0, m, n)
    assert np.array_equal(boxes.within(table, np.arange(n), one), held[np.arange(n), one])
    lasting = plainly_viable(
        lambda cell, alive: boxes.within(boxes.table(alive), np.array([cell]), slice(None)).any(),
        n,
    )
    assert np.array_equal(find_viable(boxes), lasting)

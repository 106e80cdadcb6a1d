"""The error of an area's derivative holds where the boundary is fractal, and where margins jump."""

import numpy as np
import pytest

import walker_jax as wj
from walker_jax.design.area_gradients import INDEPENDENT
from walker_jax.design.grid_lines import compare_lines

REGION = wj.Grid.sheared(theta=(0, np.pi / 4, 100), sum=(-1.1, 0.1, 400))
SIMPLEST = wj.Grid.sheared(theta=(0, np.pi / 4, 200), sum=(-0.12, 0.06, 200))
FRACTAL = wj.PoweredWalker(0.0, hip_stiffness=2.0, hip_angle=-0.3, push_off=0.1)


@pytest.mark.slow
def test_at_a_fractal_boundary_the_error_is_infinite():
    """The integral has the wrong sign there, or a third of the size."""
    names = "hip_angle", "slope", "hip_stiffness"
    found = wj.measure(FRACTAL, "area", names, grid=REGION, levels=0, check=10_000)
    assert found.fractal.all() and np.isinf(found.gradient_error).all() and not found.averaged.any()
    assert np.isfinite(found.gradient).all() and np.isfinite(found.value_error)
    found = wj.measure(
        FRACTAL, "area", names[:1], grid=REGION, levels=1, bands=(0.02,), check=20_000
    )
    assert found.fractal.all() and found.averaged.all()
    # by differences of areas refined three times, to 0.001
    assert abs(found.gradient[0] - 0.163) < 4 * found.gradient_error[0] < 0.04
    other = wj.PoweredWalker(0.01, 8.0, 1.0, -0.5, 0.05)
    found = wj.measure(other, "area", ("hip_angle",), grid=REGION, levels=0, check=10_000)
    assert found.fractal.all() and np.isinf(found.gradient_error).all()


@pytest.mark.parametrize(
    ("slope", "fractal"),
    [(0.003, False), pytest.param(0.006, False, marks=pytest.mark.slow), (0.013, True)],
)
def test_smooth_boundaries_are_told_from_fractal_ones(slope, fractal):
    """Those of the simplest walker, by the class of the next, whose program is compiled once."""
    found = wj.measure(
        wj.PoweredWalker(slope), "area", ["slope"], grid=SIMPLEST, levels=0, check=10_000
    )
    assert found.fractal.tolist() == [fractal] and np.isinf(found.gradient_error[0]) == fractal
    expected = {0.003: -0.0985, 0.006: -0.0410}  # by differences, to 0.0016
    if not fractal:
        assert abs(found.gradient[0] - expected[slope]) < 3 * found.gradient_error[0]


def test_where_margins_jump_the_error_holds():
    """A third of this smooth boundary are starts whose strike is missed, and which fall later on.

    Their margins are not zero there: taken for velocities, they give -0.84 and -1.0, to 0.05.
    """
    walker = wj.PoweredWalker(0.02, 4.0, 0.5, -0.4, 0.02)
    found = wj.measure(walker, "area", ("slope", "hip_angle"), grid=REGION, levels=0, check=10_000)
    assert not found.fractal.any() and 0.2 < found.lost / found.crossings < 0.5
    expected = np.array([1.50, 0.625])  # by differences of areas refined three times, to 0.01
    assert (np.abs(found.gradient - expected) < 2 * found.gradient_error).all()
    assert np.isfinite(found.gradient_error).all()


@pytest.mark.parametrize("shape", [(50, 400), (20, 30, 40)])
@pytest.mark.parametrize("axis", [0, 1])
def test_lines_tell_whether_crossings_are_independent(shape, axis):
    rng = np.random.default_rng(3)
    lines = np.stack(np.meshgrid(*(np.arange(n) + 0.5 for n in np.delete(shape, axis))), -1)
    lines = lines.reshape(-1, len(shape) - 1)
    places = np.insert(np.concatenate([lines, lines]), axis, 3.2, axis=1)
    random, alike = rng.normal(size=len(places)), np.ones(len(places))
    between, within = compare_lines(places, axis, shape, np.stack([random, alike], axis=1))
    assert between[1] == pytest.approx(0, abs=1e-9) and within[1] == len(places)
    assert between[0] / within[0] == pytest.approx(1, abs=5 / np.sqrt(len(places)))
    assert between[0] / within[0] > INDEPENDENT
    # a single line with a crossing differs from both of its neighbours, one at an end from one
    middle, end = (np.insert(np.full(len(shape) - 1, at), axis, 3.2)[None] for at in (7.5, 0.5))
    for place, half in ((middle, 1.0), (end, 0.5)):
        assert compare_lines(place, axis, shape, np.full((1, 1), 3.0))[0] == 9 * half

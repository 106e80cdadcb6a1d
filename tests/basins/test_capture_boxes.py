"""Capture boxes, and the search for attractors that refinement begins with."""

import numpy as np
import pytest

import walker_jax as wj
from walker_jax.basins import capture_boxes
from walker_jax.basins.attractor import match_attractor
from walker_jax.basins.attractor_search import mapper_of_scouts, scouts_among, survey
from walker_jax.basins.capture_boxes import with_capture_boxes
from walker_jax.basins.refinement import refine_cells
from walker_jax.integrators.integrator import Integrator

TWO_GAITS = wj.SimplestWalker(0.0125)
"""A gait of period one, and another of period three, whose basin is a quarter as large."""
GRID = wj.Grid.sheared(theta=(0.1, 0.3, 40), sum=(-0.03, 0.01, 40))
CENTRES = GRID.centres(np.arange(GRID.size))
INTEGRATOR = Integrator(1e-12)
SETTINGS = {"strides": 200, "check": 1000, "seed": 0, "tolerance": None, "by_centres": True}


@pytest.fixture(scope="module")
def whole():
    """The mapper to the attractors of a sample as large as the grid."""
    return survey(TWO_GAITS, CENTRES, INTEGRATOR, 200).mapper


def test_leaps_end_in_the_same_boxes_as_steps(whole, monkeypatch):
    by_leaps = with_capture_boxes(whole)
    monkeypatch.setattr(capture_boxes, "LEAP", 1)
    by_steps = with_capture_boxes(whole)
    assert [one.period for one in by_leaps.attractors] == [1, 3]
    for one, other in zip(by_leaps.attractors, by_steps.attractors, strict=True):
        assert one.capture_boxes is not None and other.capture_boxes is not None
        assert np.abs(np.linalg.inv(one.capture_boxes)).max() > 5e-4  # the smallest is 5e-6
        np.testing.assert_allclose(one.capture_boxes, other.capture_boxes, rtol=1e-12)


def test_boxes_that_are_known_stay(whole):
    once = with_capture_boxes(whole)
    again = with_capture_boxes(once)
    for one, other in zip(once.attractors, again.attractors, strict=True):
        assert one.capture_boxes is other.capture_boxes


@pytest.mark.parametrize(("scouts", "periods"), [(256, [1, 3]), (32, [1]), (3, [])])
def test_an_attractor_that_no_scout_finds_is_found_later(whole, monkeypatch, scouts, periods):
    monkeypatch.setattr("walker_jax.basins.attractor_search.SCOUTS", scouts)
    starts = CENTRES[scouts_among(GRID.size)]
    assert len(starts) == scouts
    scouted = mapper_of_scouts(TWO_GAITS, starts, INTEGRATOR, 200)
    found = refine_cells(TWO_GAITS, GRID, 1, **SETTINGS)
    assert [one.period for one in scouted.attractors] == periods
    attractors = found.mapper.attractors
    assert {one.period for one in attractors} == {1, 3} and len(attractors) == 2
    assert all(one.capture_boxes is not None for one in attractors)
    labels = whole(found.grid.centres(found.cells))
    ours = found.runs.attractor[found.runs.of_cells(found.cells)]
    alike = np.array([match_attractor(one.states[:1], whole.attractors)[0] for one in attractors])
    np.testing.assert_array_equal(np.where(ours < 0, -1, alike[ours]), labels.attractor)
    assert {*labels.attractor.tolist()} == {-1, 0, 1}
    late = labels.attractor == 1
    assert late.any() and found.made[late].max() < 30  # not 200, as before it was known

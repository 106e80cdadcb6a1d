"""The iteration of the stride map, and the mapper from starts to attractors."""

import jax
import numpy as np
import pytest

import walker_jax as wj
from walker_jax import Outcome
from walker_jax.basins.attractor import Attractor, all_motions, seen
from walker_jax.basins.attractor_search import label_and_find, lasting_motions, search
from walker_jax.basins.labels import CLOSE
from walker_jax.basins.mapper import Mapper
from walker_jax.basins.methods import attractors_of_cycles
from walker_jax.cellmaps import resolve
from walker_jax.integrators.integrator import Integrator
from walker_jax.systems.outcomes import OUTCOMES
from walker_jax.walking import iteration
from walker_jax.walking.iteration import Targets, iterate, orbits

WALKER = wj.SimplestWalker(0.004)
GAIT = np.array([[0.1533895648762, -0.1560801466757]])
REGION = wj.Grid.sheared(theta=(0.1, 0.2, 6), sum=(-0.01, 0.005, 8))


@pytest.fixture(scope="module")
def starts():
    x = REGION.centres(np.arange(REGION.size))
    return np.concatenate([GAIT, x, [[-0.1, -0.1], [np.nan, -0.2]]])


def walks_of(starts, count, walkers=WALKER):
    """Stride by stride: all states, and the outcome of the last stride of each walk."""
    states, outcome = [starts], np.zeros(len(starts), int)
    for _ in range(count):
        ends = wj.strides(walkers, states[-1])
        outcome = np.where(outcome == Outcome.STRIDE, ends.outcome, outcome)
        states.append(np.asarray(ends.state))
    return np.stack(states, axis=1), outcome


@pytest.mark.parametrize("count", [3, 30])
def test_rounds_change_nothing(starts, count, monkeypatch):
    """Against walks stride by stride, however the strides are divided into rounds."""
    states, outcome = walks_of(starts, count)
    assert {0, 1, 2, 5} <= set(outcome.tolist())
    assert len(starts) < iteration.MANY_WALKS
    for rounds, many in (((4, 16, 64), 1), ((4, 16, 64), 1000), ((1,), 1000), ((7, 2), 100)):
        monkeypatch.setattr(iteration, "ROUNDS", rounds)
        monkeypatch.setattr(iteration, "MANY_WALKS", many)
        end = iterate(WALKER, starts, count, Integrator(1e-12))
        np.testing.assert_array_equal(end.outcome, outcome)
        np.testing.assert_array_equal(end.strides, np.isfinite(states[:, 1:, 0]).sum(axis=1))
        walking = outcome == Outcome.STRIDE
        np.testing.assert_array_equal(end.state[walking], states[walking, -1])
        assert np.isnan(end.state[~walking]).all() and (end.target == -1).all()
    recorded, last = orbits(WALKER, starts, count, Integrator(1e-12))
    np.testing.assert_array_equal(recorded, states)
    np.testing.assert_array_equal(last, outcome)


def test_each_start_may_have_a_walker_of_its_own(starts):
    slopes = np.linspace(0.003, 0.015, len(starts))
    walkers = jax.vmap(wj.SimplestWalker)(slopes)
    states, outcome = walks_of(starts, 20, walkers)
    end = iterate(walkers, starts, 20, Integrator(1e-12))
    np.testing.assert_array_equal(end.outcome, outcome)
    walking = outcome == Outcome.STRIDE
    np.testing.assert_array_equal(end.state[walking], states[walking, -1])
    np.testing.assert_array_equal(orbits(walkers, starts, 20, Integrator(1e-12))[0], states)


@pytest.mark.parametrize("far", [0, 1, 40])
def test_a_walk_ends_at_the_target_that_it_reaches_first(starts, far):
    """Among others that none reaches, few enough for a kernel, or so many that the host looks."""
    states, _ = walks_of(starts, 40)
    near = GAIT + np.array([[0.0, 0.0], [4e-3, 0.0]])
    centres = np.concatenate([near, np.full((far, 2), 0.7)])
    end = iterate(
        WALKER,
        starts,
        40,
        Integrator(1e-12),
        Targets(centres, np.tile(np.eye(2) / 5e-3, (2 + far, 1, 1))),
    )
    away = np.abs(states[:, :, None] - near).max(axis=3)
    inside = (away < 5e-3).any(axis=2)
    reached = inside.any(axis=1)
    first = inside.argmax(axis=1)
    assert 5 < reached.sum() < len(starts) and (first[reached] > 0).any()
    np.testing.assert_array_equal(end.target >= 0, reached)
    np.testing.assert_array_equal(end.strides[reached], first[reached])
    rows = np.flatnonzero(reached)
    np.testing.assert_array_equal(end.state[rows], states[rows, first[rows]])
    nearest = away[rows, first[rows]].argmin(axis=1)
    np.testing.assert_array_equal(end.target[rows], nearest)
    assert set(nearest.tolist()) == {0, 1}


def test_the_mapper_labels_starts_by_their_attractors(starts):
    cycle = Attractor(GAIT)
    wandering = all_motions(np.array([[0.2, -0.3]]))
    labels = Mapper(WALKER, [wandering, cycle], Integrator(1e-12), 200)(starts)
    _, outcome = walks_of(starts, 200)
    np.testing.assert_array_equal(labels.converged, outcome == Outcome.STRIDE)
    assert set(labels.attractor.tolist()) == {-1, 1} and labels.strides[0] == 0
    np.testing.assert_array_equal(labels.fallen, outcome > 0)
    assert labels.total_strides == labels.strides.sum() + (outcome > 0).sum()
    assert len(labels.remaining) == 0


def test_walkers_that_remain_get_attractors_found_from_them(starts):
    mapper = Mapper(WALKER, [], Integrator(1e-12), 20)
    labels = mapper(starts)
    assert len(labels.remaining) > 5 and not labels.converged.any()
    labels, mapper, _ = label_and_find(mapper, starts)
    (found,) = mapper.attractors
    assert found.period == 1
    np.testing.assert_allclose(found.states, GAIT, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(labels.attractor, np.where(labels.fate == 0, 0, -1))


CHAOTIC = 0.01017
"""A slope with a stable gait of period one, and a motion without a period that passes close by."""


def test_a_motion_that_passes_close_to_a_gait_is_not_the_gait():
    walker = wj.SimplestWalker(CHAOTIC)
    gait = np.asarray(wj.find_gait(walker).states)
    mapper = Mapper(walker, [Attractor(gait)], Integrator(1e-12), 200)
    grid = wj.Grid.sheared(theta=(0.1, 0.35, 120), sum=(-0.04, 0.01, 120))
    labels = mapper.follow(grid.centres(np.arange(grid.size)))
    remaining = labels.state[labels.remaining]
    assert len(remaining) > 3
    # One that passes by, seen at all times of its way: close to the gait, and never on it.
    states = orbits(walker, remaining[:1], 2000, Integrator(1e-12))[0][0]
    near = states[np.abs(states - gait).max(axis=1) < CLOSE]
    assert len(near) > 100
    np.testing.assert_array_equal(mapper.approached(near[:64]), -1)


def test_a_slow_approach_is_one():
    """Just before the period doubling, and just after: walkers alternate for a long time."""
    for slope in (0.01508, 0.0151):
        walker = wj.SimplestWalker(slope)
        start = np.asarray(wj.find_gait(walker).states)[:1] + 1e-4
        (found,) = search(walker, start, Integrator(1e-12))
        assert found.period == (1 if slope < 0.01509 else 2)
        mapper = Mapper(walker, [found], Integrator(1e-12), 50)
        np.testing.assert_array_equal(mapper(found.states + 2e-4).attractor, 0)
        (motion,) = lasting_motions(walker, start, [], Integrator(1e-12))
        assert motion.period is None
        assert lasting_motions(walker, start, [found], Integrator(1e-12)) == []


def test_an_unstable_gait_that_repeats_attracts_nothing():
    walker = wj.SimplestWalker(0.0152)
    gait = wj.find_gait(walker)
    assert gait.found and not gait.stable
    assert search(walker, np.asarray(gait.states), Integrator(1e-12)) == []


def test_a_transient_is_no_attractor():
    """Above the crisis walkers take some hundred strides to fall, below it they go on."""
    grid = wj.Grid.sheared(theta=(0.15, 0.3, 36), sum=(-0.02, 0.005, 36))
    x = grid.centres(np.arange(grid.size))
    (chaos,) = search(wj.SimplestWalker(0.0189), x, Integrator(1e-12))
    assert chaos.period is None
    walker = wj.SimplestWalker(0.0191)
    assert search(walker, x, Integrator(1e-12)) == []
    labels, mapper, _ = label_and_find(Mapper(walker, [], Integrator(1e-12), 200), x)
    assert len(labels.remaining) > 0 and mapper.attractors == []


@pytest.mark.parametrize(
    ("slope", "periods"),
    [pytest.param(CHAOTIC, [1, 0], marks=pytest.mark.slow), (CHAOTIC + 7e-6, [1])],
)
def test_a_transient_that_ends_at_a_gait_is_no_attractor(slope, periods):
    """Above its crisis the motion without a period ends: walkers that leave it come to the gait."""
    walker = wj.SimplestWalker(slope)
    grid = wj.Grid.sheared(theta=(0.16, 0.31, 60), sum=(-0.015, 0.009, 60))
    data = wj.basin(walker, grid, "direct", strides=150)
    assert data.period.values.tolist() == periods
    left = np.flatnonzero((data.fate.values == 0) & (data.strides.values == 150))
    end = iterate(walker, grid.centres(left), 8000, Integrator(1e-12))
    at_gait = np.abs(end.state - data.states.values[0, 0]).max(axis=1) < 1e-6
    assert len(left) > 3 and (end.outcome == 0).all()
    assert at_gait.all() if len(periods) == 1 else not at_gait.any()
    np.testing.assert_array_equal(data.attractor.values.ravel()[left], len(periods) - 1)


def test_a_motion_without_a_period_is_listed_if_walkers_stay():
    wandering = all_motions(np.array([[0.2, -0.3]]))
    mapper = Mapper(WALKER, [Attractor(GAIT), wandering], Integrator(1e-12), 5)
    starts = REGION.centres(np.arange(REGION.size))
    few = mapper(starts)
    listed = seen(mapper.attractors, few.attractor)
    assert (few.attractor == 1).any() and len(listed) == 2
    many = mapper._replace(strides=300)(starts)
    listed = seen(mapper.attractors, many.attractor)
    assert (many.attractor == 0).any() and [one.period for one in listed] == [1]


def test_an_attractor_without_a_cycle_of_cells_is_not_listed():
    """Of a cycle of three cells, one centre leads to the gait: the cycle is an artefact."""
    labels = Mapper(WALKER, [Attractor(GAIT)], Integrator(1e-12), 300)(
        REGION.centres(np.arange(REGION.size))
    )
    cycle = [int(labels.converged.argmax()), *np.flatnonzero(labels.fallen)[:2].tolist()]
    image = np.full(REGION.size, REGION.size + Outcome.FORWARD)
    image[cycle] = np.roll(cycle, -1)
    ends = resolve(image, sinks=OUTCOMES)
    (artefact,), number, counts = attractors_of_cycles(WALKER, REGION, ends, Integrator(1e-12))
    assert counts.artefact.tolist() == [True] and counts.falling.tolist() == [2]
    assert artefact.period == 3 and number.tolist() == [0]

"""Sections with angles: it makes no difference where the circle is cut open."""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import walker_jax as wj
from walker_jax.basins.attracting_gaits import is_same_cycle
from walker_jax.basins.attractor import Attractor, match_attractor
from walker_jax.gaits.cycles import cycle_distance, has_shorter_period
from walker_jax.gaits.derivatives import gait_derivatives
from walker_jax.gaits.search import remove_duplicates
from walker_jax.systems.angles import difference, turn_to, turns_of, wrap
from walker_jax.walking.consistency import check_projection

TURN = 2 * np.pi


class Turned(wj.systems.ImpactOscillator):
    """An oscillator whose angle is measured from another origin, so that its cut lies elsewhere."""

    origin: Any = 0.0

    def lift(self, x):
        return super().lift(x.at[0].add(self.origin))

    def project(self, state):
        return jnp.stack([wrap(state.phase - self.origin), state.v])


PLAIN = wj.systems.ImpactOscillator()
GAIT = wj.find_gait(PLAIN, [3.0, -0.5])
ORIGIN = float(GAIT.states[0, 0]) - np.pi
CUT = Turned(origin=ORIGIN)  # its gait is on the cut


def on_circle(x, k, drift):
    """Advance an angle that is at rest where sin is -drift / k, and halve the other coordinate."""
    return jnp.stack([wrap(x[0] + k * jnp.sin(x[0]) + drift + 0.1 * x[1]), 0.4 * x[1]])


def circle(k=0.5, drift=0.0):
    region = {"angle": (-np.pi, np.pi, 20), "y": (-1, 1, 4)}
    named = {"parameters": {"k": k, "drift": drift}, "region": region, "angles": ("angle",)}
    return wj.Map(on_circle, ("angle", "y"), **named)


def test_differences_of_angles_are_half_a_turn_at_most():
    turns = turns_of(PLAIN)
    x, other = np.array([[3.1, 1.0], [0.5, -4.0]]), np.array([[-3.1, -3.0], [0.2, 4.0]])
    found = difference(x, other, turns)
    np.testing.assert_allclose(found, [[6.2 - TURN, 4.0], [0.3, -8.0]], rtol=0, atol=1e-15)
    np.testing.assert_allclose(turn_to(x, other, turns), other + found, rtol=0, atol=1e-15)
    assert turns_of(wj.SimplestWalker(0.004)) is None and difference(x, other, None)[1, 1] == -8
    assert np.isnan(difference(x * np.nan, other, turns)).all()


@pytest.mark.parametrize("beside", [-0.02, 0.02])
def test_a_gait_on_the_cut_is_found_from_both_sides(beside):
    x = np.array([float(wrap(jnp.asarray(np.pi + beside))), GAIT.states[0, 1] + 0.01])
    searches = partial(wj.find_gait, CUT), jax.jit(partial(wj.find_gait, CUT))
    for found in (search(x) for search in searches):
        assert found.found and found.stable
        away = difference(np.asarray(found.states), [[np.pi, GAIT.states[0, 1]]], turns_of(CUT))
        assert np.abs(away).max() < 1e-12 and np.abs(found.states[0, 0]) < np.pi + 1e-12
        np.testing.assert_allclose(found.multipliers, GAIT.multipliers, rtol=1e-10)
        np.testing.assert_allclose(found.step_times, GAIT.step_times, rtol=1e-12)


def test_searches_of_a_region_find_the_gait_on_the_cut_once():
    (found,) = wj.find_gaits(CUT)
    assert abs(abs(found.states[0, 0]) - np.pi) < 1e-12
    rest = wj.find_gaits(circle())
    at = sorted(abs(float(gait.states[0, 0])) for gait in rest)
    np.testing.assert_allclose(at, [0, np.pi], rtol=0, atol=1e-12)
    assert wj.find_gaits(circle(), 2) == []  # nor is it one of period two


def test_the_basin_of_a_gait_on_the_cut_is_that_of_another():
    """A grid over the whole circle has the same cells, in another order."""
    axes = {"v": (-2, 0, 10)}
    areas = []
    for system, low in ((PLAIN, -np.pi), (CUT, -np.pi - ORIGIN)):
        grid = wj.Grid.plain(angle=(low, low + TURN, 24), **axes)
        found = wj.basin(system, grid, "direct")
        assert found.period.values.tolist() == [1]
        areas.append(float(found.area[0]))
    assert areas[0] == pytest.approx(areas[1], rel=1e-12) and areas[0] > 5
    grid = wj.Grid.plain(angle=(-np.pi, np.pi, 40), y=(-1, 1, 10))
    found = wj.basin(circle(), grid, "direct")
    assert found.period.values.tolist() == [1]  # not one on either side
    assert float(found.area[0]) == pytest.approx(2 * TURN, rel=1e-12)


def test_derivatives_and_exponents_of_a_rest_on_the_cut():
    """sin(angle) = -drift / k there; the multipliers are 1 + k cos(angle) and 0.4."""
    rest = wj.find_gait(circle(), np.array([3.1, 0.1]))
    by_drift, by_k = (gait_derivatives(circle(), rest, name) for name in ("drift", "k"))
    np.testing.assert_allclose(by_drift.states, [[2, 0]], rtol=0, atol=1e-12)
    np.testing.assert_allclose(by_k.states, [[0, 0]], rtol=0, atol=1e-12)
    np.testing.assert_allclose(by_k.multipliers, [-1, 0], rtol=0, atol=1e-12)
    found = wj.lyapunov(circle(), np.array([3.0, 0.1]), walks=2)  # from both sides of the cut
    np.testing.assert_allclose(found.exponents, np.log([0.5, 0.4]), rtol=1e-12)


@pytest.mark.slow
def test_derivatives_of_a_gait_on_the_cut():
    there = wj.find_gait(CUT, [3.1, -0.5])
    found, expected = (
        gait_derivatives(system, gait, "stop") for system, gait in ((CUT, there), (PLAIN, GAIT))
    )
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-8, atol=1e-12)


def test_a_branch_goes_on_across_the_cut():
    """An angle does not jump there: it goes on beyond half a turn."""
    branches = [
        wj.continue_gait(system, "stop", (-0.03, 0.05), gait)
        for system, gait in ((PLAIN, GAIT), (CUT, wj.find_gait(CUT, [3.1, -0.5])))
    ]
    expected, found = branches
    assert found.ends == expected.ends == ("the end of the range",) * 2
    change = found.states[:, 0] - found.states[0, 0]
    np.testing.assert_allclose(change, expected.states[:, 0] - expected.states[0, 0], atol=1e-9)
    sides = np.sign(np.abs(found.states[:, 0, 0]) - np.pi)
    assert {-1, 1} <= {*sides.tolist()}


def test_a_branch_closes_after_a_full_turn():
    """The rests of drift + k sin(angle) = 0 lie on one closed curve, with folds at +-k."""
    system = circle()
    gait = wj.find_gait(system, [0.05, 0.0])
    branch = wj.continue_gait(system, "drift", (-1.0, 1.0), gait)
    assert branch.ends == ("the branch closes",) * 2
    drift = -0.5 * np.sin(branch.states[:, 0, 0])
    np.testing.assert_allclose(branch.values, drift, rtol=0, atol=1e-10)
    assert np.ptp(branch.states[:, 0, 0]) > 0.9 * TURN
    np.testing.assert_allclose(sorted(one.value for one in branch.folds), [-0.5, 0.5], atol=1e-9)


def test_attractors_on_the_cut_have_periods():
    found = wj.attractors(circle(), "k", np.array([0.3, 0.6]), np.full((2, 1, 2), 3.0), strides=200)
    assert found["period"].values.tolist() == [[1], [1]]


def test_cycles_are_compared_across_the_cut():
    turns, e = turns_of(PLAIN), 1e-9
    one = np.array([[np.pi - e, 1.0], [0.5, 2.0]])
    other = np.array([[0.5, 2.0], [-np.pi + e, 1.0]])
    assert cycle_distance(one, other) > 3 and cycle_distance(one, other, turns) < 3 * e
    twice = np.stack([one[0], other[1]])[None]
    assert not has_shorter_period(twice)[0] and has_shorter_period(twice, turns)[0]
    known = [Attractor(one)]
    assert match_attractor(other[1:], known, 1e-6).tolist() == [-1]
    assert match_attractor(other[1:], known, 1e-6, turns).tolist() == [0]
    gait = wj.Gait(one, np.zeros(2, complex), np.ones(2), *np.array([True, 0.0, True], object))
    assert is_same_cycle(gait, gait._replace(states=other), turns)
    rows = [np.stack(pair) for pair in zip(gait, gait._replace(states=other), strict=True)]
    rows = wj.Gait(*rows)._replace(found=np.array([True, True]))
    assert len(remove_duplicates(rows, turns).states) == 1
    assert len(remove_duplicates(rows).states) == 2


def test_an_angle_that_is_not_named_is_a_complaint():
    class Unnamed(wj.systems.BouncingBall):
        angles = ()

    assert check_projection(wj.systems.BouncingBall(), jnp.array([0.8, 3.1])) == []
    (complaint,) = check_projection(Unnamed(), jnp.array([0.8, 3.1]))
    assert complaint == "project takes full turns off angle, which angles does not name"


def test_newtons_method_does_not_see_the_seam():
    """Starts at both ends of the angle's range, and beside them, lead to one gait.

    The two gaits of velocity pi are at cos(angle) = pi (1 - e) / (a (1 + e)), as far from the seam
    on either side of it.
    """
    ball = wj.systems.BouncingBall(amplitude=0.5, restitution=0.8)
    angle = np.arccos(np.pi * 0.2 / (0.5 * 1.8))
    for start in (np.pi, -np.pi, np.pi - 1e-9, 1e-9 - np.pi, 3 * np.pi):
        found = wj.find_gait(ball, [start, 3.0])
        assert found.found
        np.testing.assert_allclose(found.states, [[-angle, np.pi]], rtol=1e-11)

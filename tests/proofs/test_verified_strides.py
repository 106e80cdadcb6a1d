"""Verified strides: random plain strides lie in them, and a bound left out is seen."""

from collections.abc import Callable
from functools import partial

import jax
import numpy as np
import pytest

import walker_jax as wj
from walker_jax.proofs import flows, strides
from walker_jax.proofs.enclosures import Enclosure, Space, exactly, monomials
from walker_jax.proofs.provable import check_provable, enclose_parameters
from walker_jax.proofs.strides import FALL, STRIDE, UNDECIDED, verify_stride

PLANE, LINES = Space(2, 2), Space(2, 1)
LONG_STEPS = 1e-7
"""Tolerance with which a stride has half as many steps; what is proved holds with any."""
GAIT = np.array([0.1533895648762378, -0.1560801466756806])
WALKERS = {
    "simplest": wj.SimplestWalker(0.004),
    "spring": wj.SpringWalker(0.004, 1.0),
    "powered": wj.PoweredWalker(0.0, push_off=0.03, hip_damping=0.01),
}


def verified(walker, centres, radius, space=PLANE, tangents=(), **options):
    sides = [[radius if i == j else None for j in range(2)] for i in range(2)]
    rest = [None] * (len(monomials(space)) - 3)
    box = lambda i: Enclosure([centres[:, i], *sides[i], *rest], 0.0, space)
    known = enclose_parameters(check_provable(walker), space)
    return verify_stride(known, (box(0), box(1)), tangents, **options)


def value(one: Enclosure, u: np.ndarray) -> np.ndarray:
    powers = [np.prod(u ** np.array(p), axis=1) for p in monomials(one.space)]
    with np.errstate(all="ignore"):  # of boxes that were given up
        return np.sum([t * p for t, p in zip(one.terms, powers, strict=True)], axis=0)


def errors(walker, centres, radius, seed, **options):
    """Verdicts, and by how much plain strides from random points of boxes are off the polynomials,
    as parts of their radii."""
    found = verified(walker, centres, radius, **options)
    u = np.random.default_rng(seed).uniform(-1, 1, centres.shape)
    plain = wj.strides(walker, centres + radius * u, tolerance=1e-14)
    proved = found.verdict == STRIDE
    assert np.all(np.asarray(plain.outcome)[proved] == wj.Outcome.STRIDE)
    assert not np.any(np.asarray(plain.outcome)[found.verdict == FALL] == wj.Outcome.STRIDE)
    off = [
        np.abs(value(one, u) - np.asarray(plain.state)[:, i])[proved] / one.radius[proved]
        for i, one in enumerate(found.state)
    ]
    return found.verdict, np.concatenate(off)


SLOW = [pytest.param(name, marks=pytest.mark.slow) for name in ("simplest", "spring")]


@pytest.mark.parametrize("name", ["powered", *SLOW])
def test_random_strides_lie_in_their_enclosures(name):
    walker = WALKERS[name]
    about = np.asarray(wj.find_gait(walker).states[0])
    rng = np.random.default_rng(1)
    centres = about + rng.normal(size=(300, 2)) * 1e-3
    verdict, off = errors(walker, centres, 3e-5, seed=2)
    assert np.mean(verdict == STRIDE) > 0.5
    assert off.max() <= 1 and off.max() > 0.05  # and the enclosures are close


@pytest.mark.slow
def test_starts_of_the_window_have_the_proved_fates():
    rng = np.random.default_rng(3)
    theta, sums = rng.uniform(0.02, 0.4, 1500), rng.uniform(-0.03, 0.01, 1500)
    centres = np.stack([theta, sums - theta], 1)
    verdict, off = errors(wj.SimplestWalker(0.004), centres, 1e-5, seed=4)
    counts = np.bincount(verdict, minlength=4)
    assert min(counts[STRIDE], counts[FALL]) > 300 and off.max() <= 1
    assert counts[UNDECIDED] < 30, counts


@pytest.mark.slow
def test_a_million_random_strides_lie_in_their_enclosures():
    rng = np.random.default_rng(5)
    for seed in range(50):
        centres = GAIT + rng.normal(size=(20_000, 2)) * 5e-3
        verdict, off = errors(wj.SimplestWalker(0.004), centres, 3e-6, seed=seed)
        assert off.max() <= 1 and np.mean(verdict == STRIDE) > 0.5


def test_a_remainder_of_the_series_left_out_is_seen(monkeypatch):
    """With long steps of a low order the remainder is what matters: without it starts are lost."""
    centres = GAIT + np.random.default_rng(6).normal(size=(40, 2)) * 1e-4
    coarse = {"order": 8, "tolerance": 1e-5}
    walker = wj.SimplestWalker(0.004)
    verdict, off = errors(walker, centres, 1e-8, seed=7, **coarse)
    assert np.all(verdict == STRIDE) and off.max() <= 1
    plain = flows.flow_at

    def without(step, time, **kind):
        none = flows.map_enclosures(lambda bound: 0.0 * bound, step.rest)
        return plain(step._replace(rest=none), time, **kind)

    monkeypatch.setattr(flows, "flow_at", without)
    for module in ("events", "strides"):
        monkeypatch.setattr(f"walker_jax.proofs.{module}.flow_at", without)
    _, off = errors(walker, centres, 1e-8, seed=7, **coarse)
    assert off.max() > 1


def test_the_jacobian_of_all_points_of_a_box_is_enclosed():
    walker, radius = wj.SimplestWalker(0.004), 1e-5
    ones = np.ones(20)
    tangents = tuple(
        tuple(exactly(one * ones, LINES) for one in direction) for direction in np.eye(2)
    )
    centres = GAIT + np.random.default_rng(8).normal(size=(20, 2)) * 1e-3
    found = verified(walker, centres, radius, LINES, tangents, tolerance=LONG_STEPS)
    assert np.all(found.verdict == STRIDE)
    corner = centres + radius
    jacobian = np.asarray(jacobians(walker, corner))
    for column, tangent in enumerate(found.tangents):
        for row, one in enumerate(tangent):
            box = one.range()
            assert np.all(np.abs(box.midpoint - jacobian[:, row, column]) <= box.radius + 1e-8)
            assert np.all(box.radius < 0.1)


def jacobians(walker, x):
    one = jax.jacfwd(lambda x: wj.stride(walker, x).state)
    return jax.vmap(one)(jax.numpy.asarray(x))


STARTS = np.array([GAIT, [0.15, -0.6], [0.8, -0.8]])
"""The gait, a start that falls, and one with theta above pi / 4 and all else as in a stride."""


def verified_starts() -> strides.VerifiedStride:
    return verified(wj.SimplestWalker(0.004), STARTS, 1e-6, LINES, tolerance=LONG_STEPS)


def record(monkeypatch, name: str, pick: Callable) -> list:
    """Record of each call of a function of `strides` what is picked of its arguments and result."""
    calls, whole = [], getattr(strides, name)

    def recorded(*args, **how):
        result = whole(*args, **how)
        calls.append(pick(args, result))
        return result

    monkeypatch.setattr(strides, name, recorded)
    return calls


def test_starts_stride_fall_or_are_not_feasible(monkeypatch):
    """Each step is watched up to where the next begins, and the last one until the strike."""
    watched = record(monkeypatch, "watch_step", lambda args, _: args[3])
    begun = record(monkeypatch, "flow_at", lambda args, _: args[1])
    latest = record(monkeypatch, "enclose_strike", lambda _, strike: strike.latest)
    found = verified_starts()
    assert found.verdict.tolist() == [STRIDE, FALL, UNDECIDED]
    for row, count in enumerate(found.steps[:2]):
        until = [one[row] for one in begun[: count - 1]]
        until.append((latest if row == 0 else begun)[count - 1][row])
        assert [one[row] for one in watched[:count]] == until


def test_a_step_that_is_not_proved_counts_for_nothing(monkeypatch):
    steps = verified_starts().steps
    take, watch, calls = strides.take_step, strides.watch_step, []

    def take_step(*args, proved, **how):
        calls.append(0)
        step = take(*args, **how)
        return step._replace(proved=step.proved & proved(len(calls)))

    last = lambda number: number < steps  # the one with the strike or the fall
    monkeypatch.setattr(strides, "take_step", partial(take_step, proved=last))
    assert verified_starts().verdict.tolist() == [UNDECIDED] * 3
    calls.clear()

    def watch_step(*args):
        found = watch(*args)
        return found._replace(no_strike=found.no_strike & (len(calls) > 1))

    monkeypatch.setattr(strides, "take_step", partial(take_step, proved=lambda number: number > 1))
    monkeypatch.setattr(strides, "watch_step", watch_step)
    assert verified_starts().verdict.tolist() == [STRIDE, FALL, UNDECIDED]


@pytest.mark.parametrize(
    ("part", "fact", "verdicts"),
    [
        ("take_step", {"proved": False}, [UNDECIDED, UNDECIDED]),
        ("watch_step", {"no_strike": False}, [UNDECIDED, UNDECIDED]),
        ("watch_step", {"clear": False}, [UNDECIDED, FALL]),
        ("watch_step", {"no_strike": True, "rising": True}, [STRIDE, UNDECIDED]),
        ("enclose_strike", {"proved": False}, [UNDECIDED, FALL]),
    ],
)
def test_a_verdict_rests_on_each_fact(monkeypatch, part, fact, verdicts):
    """On a proof of the step, of no strike before, of no fall, and of the strike itself."""
    prove = getattr(strides, part)
    flags = {name: np.full(len(STARTS), value) for name, value in fact.items()}
    monkeypatch.setattr(strides, part, lambda *args, **how: prove(*args, **how)._replace(**flags))
    monkeypatch.setattr(strides, "MOST_STEPS", 8)
    assert verified_starts().verdict.tolist() == [*verdicts, UNDECIDED]

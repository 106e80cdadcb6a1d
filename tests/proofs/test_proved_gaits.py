"""Proved gaits and period doublings, against the references."""

import numpy as np
import pytest
from reference import read_values

import walker_jax as wj
from walker_jax.checks import ComputationFailed, WrongUse
from walker_jax.proofs.enclosures import ball
from walker_jax.proofs.matrices import enclose_eigenvalues, is_contraction, krawczyk

VALUES = read_values("values")
GAITS = [one for one in VALUES["gaits"] if one["slope"] in (0.004, 0.009)]
DIGITS = 2e-12
"""Of the references, which have 13 digits, and 11 of multipliers."""


def check_gait(reference, proved):
    off = np.abs(proved.states[0] - reference["state"])
    assert np.all(off <= proved.radii[0] + DIGITS) and proved.radii.max() < 1e-12
    assert proved.unique_within > 2 * proved.radii.max()
    expected = np.array([complex(*pair) for pair in reference["multipliers"]])
    off = np.abs(np.sort_complex(proved.multipliers) - np.sort_complex(expected))
    assert np.all(off <= 1.5 * proved.multiplier_radius + 1e-10)
    assert proved.multiplier_radius < 1e-6
    assert proved.stable is bool(np.all(np.abs(expected) < 1))


def prove(reference):
    return wj.prove_gait(wj.SimplestWalker(reference["slope"]), reference["state"])


def test_a_gait_is_where_its_reference_is():
    (one,) = [one for one in GAITS if one["slope"] == 0.004 and one["kind"] == "long"]
    check_gait(one, prove(one))


@pytest.mark.slow
@pytest.mark.parametrize("reference", GAITS, ids=lambda one: f"{one['slope']} {one['kind']}")
def test_gaits_are_where_their_references_are(reference):
    check_gait(reference, prove(reference))


@pytest.mark.slow
@pytest.mark.parametrize(("slope", "period"), [(0.017, 2), (0.0181, 4)])
def test_gaits_of_longer_periods_are_proved(slope, period):
    walker, guess = wj.SimplestWalker(slope), None
    if period == 4:
        guess = wj.find_gait(wj.SimplestWalker(0.01795), period=4).states
        guess = wj.find_gait(wj.SimplestWalker(0.01805), guess, 4).states
    proved = wj.prove_gait(walker, guess, period)
    found = wj.find_gait(walker, proved.states, period)
    assert np.all(np.abs(proved.states - np.asarray(found.states)) <= proved.radii + 1e-12)
    assert proved.radii.max() < 1e-12 and proved.stable is True


@pytest.mark.slow
def test_the_first_period_doubling_is_proved():
    found = wj.prove_doubling(wj.SimplestWalker(0.004), 0.0145, 0.0155)
    reference = VALUES["period_doublings"][0]
    assert found.low < reference["slope"] < found.high and found.high - found.low < 3e-8
    assert abs(found.states[0, 0] - reference["theta"]) < found.radius


@pytest.mark.slow
def test_a_spring_and_a_push_have_proved_gaits():
    for walker in (wj.SpringWalker(0.004, 0.5), wj.PoweredWalker(0.0, push_off=0.03)):
        proved = wj.prove_gait(walker)
        assert proved.radii.max() < 1e-11


def test_krawczyk_proves_a_root_and_only_where_there_is_one():
    """x^2 = 2 near 1.4142, and no zero of x^2 + 1."""
    number = lambda value: ball(np.float64(value), 0.0)
    centre, radius = 1.4142, 1e-3
    slope = ball(np.float64(2 * centre), 2 * radius)
    zero = krawczyk(
        np.array([centre]), radius, [[number(centre) * number(centre) - 2.0]], [[slope]]
    )
    assert zero.proved
    (root,) = zero.within
    assert root.lower < np.sqrt(2) < root.upper and root.spread < 1e-6
    none = krawczyk(
        np.array([centre]), radius, [[number(centre) * number(centre) + 1.0]], [[slope]]
    )
    assert not none.proved


def test_eigenvalues_of_a_matrix_are_enclosed():
    rng = np.random.default_rng(1)
    for _ in range(200):
        m = rng.normal(size=(2, 2))
        box = [[ball(value, 1e-9) for value in row] for row in m]
        found, true = enclose_eigenvalues(box), np.linalg.eigvals(m)
        if found is None:
            assert abs(np.trace(m) ** 2 / 4 - np.linalg.det(m)) < 1e-6
            continue
        for a, b in found:
            middle = complex(a.midpoint, b.midpoint)
            assert min(abs(true - middle)) <= 1.5 * (a.spread + b.spread)
        stable = is_contraction(box)
        assert stable is None or stable == bool(np.all(np.abs(true) < 1))


def test_wrong_use_of_doublings_is_refused():
    walker = wj.SimplestWalker(0.004)
    with pytest.raises(WrongUse, match=r"low=0.02 must be below high=0.01"):
        wj.prove_doubling(walker, 0.02, 0.01)
    with pytest.raises(WrongUse, match="width must be above"):
        wj.prove_doubling(walker, 0.01, 0.02, width=0.0)
    with pytest.raises(ComputationFailed, match="no gait of period 1 doubles it"):
        wj.prove_doubling(walker, 0.004, 0.005)


def test_a_proof_that_fails_says_so(monkeypatch):
    """Where a stride near the cycle is not proved."""
    for module in ("gait_proofs", "doubling_proofs"):
        monkeypatch.setattr(f"walker_jax.proofs.{module}.enclose_cycle", lambda *_: None)
    with pytest.raises(ComputationFailed, match="no gait of period 1 is proved near"):
        wj.prove_gait(wj.SimplestWalker(0.004))
    with pytest.raises(ComputationFailed, match="no period doubling is proved"):
        wj.prove_doubling(wj.SimplestWalker(0.004), 0.0145, 0.0155)

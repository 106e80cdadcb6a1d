"""Bifurcations over two parameters, of maps known in closed form and of the simplest walker."""

import jax.numpy as jnp
import numpy as np
import pytest
from by_differences import differences
from free_bodies import Bodies
from reference import read_values

import walker_jax as wj

DOUBLINGS = read_values("systems")["period_doubling"]["values"]


def curve_of(f, coordinates, values, guess, kind, bounds):
    """The curve of the only bifurcation of a kind of a map over p, in p and q."""
    system = wj.Map(f, coordinates, parameters=dict(zip("pq", values, strict=True)))
    gait = wj.find_gait(system, guess=guess)
    low, high = bounds["p"]
    branch = wj.continue_gait(system, "p", (float(low), float(high)), gait)
    event = next(event for event in branch.events if event.kind == kind)
    return wj.continue_event(system, event, ("p", "q"), bounds)


def the_special(curve, kind):
    (found,) = [one for one in curve.special if one.kind == kind]
    assert abs(found.criterion) < 1e-9 and found.residual < 1e-12
    return found


@pytest.mark.parametrize(
    ("kind", "exact", "special", "at"),
    [
        ("fold", lambda b: -((1 - b) ** 2) / 4, "1:1 resonance", (-1, -1)),
        ("doubling", lambda b: 3 * (1 - b) ** 2 / 4, "1:2 resonance", (3, -1)),
    ],
)
def test_curves_of_the_map_of_henon(kind, exact, special, at):
    system = wj.systems.HenonMap(0.1, 0.3)
    branch = wj.continue_gait(system, "a", (-0.3, 1.0), wj.find_gait(system, [[0.7, 0.2]]))
    (event,) = [one for one in branch.events if one.kind == kind]
    curve = wj.continue_event(system, event, ("a", "b"), {"a": (-2, 4), "b": (-1.2, 0.6)})
    a, b = curve.values.T
    np.testing.assert_allclose(a, exact(b), rtol=0, atol=1e-13)
    assert b.max() == 0.6 and b.min() < -1.1 and curve.ends[0] == "the end of the range"
    found = the_special(curve, special)
    np.testing.assert_allclose(found.values, at, rtol=0, atol=1e-10)
    np.testing.assert_allclose(found.multipliers, [1, 1] if kind == "fold" else [-1, -1], atol=1e-6)
    assert curve.period == 1 and curve.parameters == ("a", "b")


def test_a_doubling_of_period_two_over_both_parameters_of_henon():
    """Its trace is -1 - b^2 where a = (1 - b)^2 + (1 + b)^2 / 4."""
    system = wj.systems.HenonMap(0.6, 0.3)
    gait = wj.find_gait(system, [[0.97, -0.09], [-0.3, 0.29]], period=2)
    (event,) = wj.continue_gait(system, "a", (0.5, 1.0), gait).doublings
    curve = wj.continue_event(system, event, ("a", "b"), {"a": (0, 4), "b": (-0.3, 0.6)})
    a, b = curve.values.T
    np.testing.assert_allclose(a, (1 - b) ** 2 + (1 + b) ** 2 / 4, rtol=0, atol=1e-12)
    assert curve.criticality == ["supercritical"] * len(a) and curve.period == 2


def test_a_cusp():
    f = lambda x, p, q: x + p + q * x - x**3 + 0.3 * x**2
    bounds = {"p": (-2, 2), "q": (-2, 2)}
    curve = curve_of(f, ("x",), (-1.0, 1.0), [[-1.5]], "fold", bounds)
    found = the_special(curve, "cusp")
    np.testing.assert_allclose(found.values, [0.001, -0.03], rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.states, [[0.1]], rtol=0, atol=1e-12)
    x = curve.states[:, 0, 0]
    np.testing.assert_allclose(curve.values[:, 1], 3 * x**2 - 0.6 * x, rtol=0, atol=1e-12)
    np.testing.assert_allclose(np.abs(curve.coefficients), np.abs(0.3 - 3 * x), atol=1e-12)


def test_a_generalised_flip():
    f = lambda x, p, q: -(1 + p) * x + q * x**3 + x**5
    bounds = {"p": (-0.5, 0.5), "q": (-2, 3)}
    curve = curve_of(f, ("x",), (-0.3, -1.0), [[0.0]], "doubling", bounds)
    found = the_special(curve, "generalised flip")
    np.testing.assert_allclose(found.values, 0, atol=1e-12)
    np.testing.assert_allclose(curve.coefficients, curve.values[:, 1], rtol=0, atol=1e-12)
    assert set(curve.criticality) == {"subcritical", "supercritical"}


def test_a_fold_flip():
    f = lambda x, p, q: jnp.stack(
        [x[0] + p - x[0] ** 2, -(1 + q) * x[1] + x[1] ** 3 + 0.1 * x[0] * x[1]]
    )
    bounds = {"p": (-0.5, 0.5), "q": (-1, 1)}
    curve = curve_of(f, ("x", "y"), (0.1, -0.5), [[0.3, 0.0]], "fold", bounds)
    found = the_special(curve, "fold-flip")
    np.testing.assert_allclose(found.values, 0, atol=1e-12)
    np.testing.assert_allclose(np.sort(np.real(found.multipliers)), [-1, 1], atol=1e-12)


def test_branch_points_persist_where_a_symmetry_keeps_them():
    f = lambda x, p, q: jnp.stack([x[0] + p * x[0] - q * x[0] ** 3, 0.5 * x[1] + x[0] ** 2 + q])
    bounds = {"p": (-1, 1), "q": (-2, 2)}
    curve = curve_of(f, ("x", "y"), (-0.5, 0.5), [[0.0, 1.0]], "branch point", bounds)
    p, q = curve.values.T
    np.testing.assert_allclose(p, 0, atol=1e-13)
    assert q.min() == -2 and q.max() == 2 and np.isnan(curve.coefficients).all()


def test_branches_that_no_longer_cross():
    f = lambda x, p, q: x + p * x - x**2 + q
    bounds = {"p": (-1, 1), "q": (-1, 1)}
    curve = curve_of(f, ("x",), (-0.5, 0.0), [[0.0]], "branch point", bounds)
    assert curve.ends == ("the branches no longer cross",) * 2 and len(curve.values) == 1


def resonant(x, p, q):
    """The delayed logistic map, and a term that vanishes at its fixed point x = y = 1 - 1/p."""
    return jnp.stack([p * x[0] * (1 - x[1]) + q * x[0] ** 2 * (x[0] - x[1]), x[0]])


def test_resonances_of_neimark_sacker_points():
    """With x = 1 - 1/p the trace is 1 + q x^2 and the determinant p x + q x^2."""
    bounds = {"p": (0.5, 8), "q": (-10, 10)}
    curve = curve_of(resonant, ("x", "y"), (1.7, 0.0), [[0.4, 0.4]], "neimark-sacker", bounds)
    p, q = curve.values.T
    x = 1 - 1 / p
    np.testing.assert_allclose(p * x + q * x**2, 1, rtol=0, atol=1e-12)
    assert curve.ends == ("a 1:2 resonance, where the pair becomes real", "the end of the range")
    np.testing.assert_allclose(curve.values[0], [5, -4.6875], rtol=0, atol=1e-10)
    for name, cosine in {"1:2 resonance": -1, "1:3 resonance": -0.5, "1:4 resonance": 0}.items():
        found = the_special(curve, name)
        p = 2 - 2 * cosine + 1  # as p x = 1 - q x^2 = 2 - trace
        np.testing.assert_allclose(found.values[0], p, rtol=0, atol=1e-10)
        np.testing.assert_allclose(np.real(found.multipliers), cosine, rtol=0, atol=1e-6)


def test_a_chenciner_point():
    """A rotation by 1 with growth 1 + p + q r^2 - r^4."""

    def f(x, p, q):
        r = x[0] ** 2 + x[1] ** 2
        c, s = np.cos(1), np.sin(1)
        return (1 + p + q * r - r**2) * jnp.stack([c * x[0] - s * x[1], s * x[0] + c * x[1]])

    bounds = {"p": (-0.5, 0.5), "q": (-1, 2)}
    curve = curve_of(f, ("x", "y"), (-0.3, -0.5), [[0.0, 0.0]], "neimark-sacker", bounds)
    found = the_special(curve, "Chenciner")
    np.testing.assert_allclose(found.values, 0, atol=1e-12)
    # z = (u + i v) / sqrt(2) along the unit eigenvector: |x|^2 = 2 |z|^2
    np.testing.assert_allclose(curve.coefficients, 2 * curve.values[:, 1], rtol=0, atol=1e-12)


@pytest.mark.slow
def test_doublings_over_the_stiffness_of_the_hip():
    walker = wj.SpringWalker(0.014, hip_stiffness=0.0)
    (doubling,) = wj.continue_gait(walker, "slope", (0.014, 0.016)).doublings
    for name, one in DOUBLINGS.items():
        bounds = {"slope": (0.01, 0.1), "hip_stiffness": (0.0, float(name))}
        curve = wj.continue_event(walker, doubling, bounds=bounds)
        assert curve.values[0, 1] == 0 and abs(curve.values[0, 0] - 0.015088437941117) < 1e-12
        assert curve.values[-1, 1] == one["k"]
        assert abs(curve.values[-1, 0] - one["slope_doubling"]) < 1e-12
        state = one["theta"], one["thetadot"]
        np.testing.assert_allclose(curve.states[-1, 0], state, rtol=0, atol=1e-11)
        np.testing.assert_allclose(curve.multipliers[-1], one["multipliers"], rtol=0, atol=1e-11)
        assert set(curve.criticality) == {"supercritical"}


@pytest.mark.slow
def test_codimension_two_of_round_feet():
    """Where the centre of mass is behind the leg; the multipliers also by an independent solution.

    The fold of period two ends in the generalised flip, as it must.
    """
    walker, names = wj.RoundFootWalker(0.012, com_offset=-0.015), ("slope", "com_offset")
    bounds = {"slope": (0.004, 0.024), "com_offset": (-0.04, 0.0)}
    branch = wj.continue_gait(walker, "com_offset", bounds["com_offset"])
    (doubling,) = branch.doublings
    curve = wj.continue_event(walker, doubling, names[::-1], bounds)
    flip, fold_flip = (the_special(curve, kind) for kind in ("generalised flip", "fold-flip"))
    assert set(curve.criticality) == {"subcritical", "supercritical"}
    np.testing.assert_allclose(flip.values, [-0.026835186984, 0.009857074822], rtol=0, atol=1e-10)
    at = fold_flip.values
    np.testing.assert_allclose(at, [-0.025251477871, 0.009121863907], rtol=0, atol=1e-10)
    np.testing.assert_allclose(np.sort(np.real(fold_flip.multipliers))[[0, 2]], [-1, 1], atol=1e-9)
    (fold,) = [one for one in branch.folds if one.value < -0.02]
    folds = wj.continue_event(walker, fold, names[::-1], bounds)
    np.testing.assert_allclose(the_special(folds, "fold-flip").values, at, rtol=0, atol=1e-10)
    for found, expected in ((fold_flip, 1.0), (flip, 0.928829)):
        offset, slope = found.values
        bodies, x = Bodies(wj.RoundFootWalker(slope, com_offset=offset)), found.states[0]
        along = lambda points, bodies=bodies: np.array([bodies.stride(one)[0] for one in points])
        np.testing.assert_allclose(along(x[None])[0], x, rtol=0, atol=1e-9)
        multipliers = np.sort(np.linalg.eigvals(differences(along, x, np.full(3, 1e-4))).real)
        np.testing.assert_allclose(multipliers[[0, 2]], [-1, expected], rtol=0, atol=1e-5)


def test_wrong_events_are_refused():
    system = wj.systems.HenonMap(0.1, 0.3)
    branch = wj.continue_gait(system, "a", (0.1, 1.0), wj.find_gait(system, [[0.7, 0.2]]))
    (doubling,) = branch.doublings
    bounds = {"a": (0, 1), "b": (0, 1)}
    for names in (("a", "a"), ("a",), "ab"):
        with pytest.raises(ValueError, match="parameters must be two different names"):
            wj.continue_event(system, doubling, names, bounds)
    for wrong in (None, {"a": (0, 1)}):
        with pytest.raises(ValueError, match="bounds must give the lowest and highest a and b"):
            wj.continue_event(system, doubling, ("a", "b"), wrong)
    with pytest.raises(ValueError, match=r"bounds must hold the event, at a 0\.3675 and b 0\.3"):
        wj.continue_event(system, doubling, ("a", "b"), bounds | {"b": (0.5, 1)})
    with pytest.raises(ValueError, match=r"event must be one of this system, at a 0\.3675"):
        wj.continue_event(
            system, doubling._replace(states=np.array([[5.0, 9.0]])), ("a", "b"), bounds
        )
    with pytest.raises(ValueError, match="event must be one on the section x, y"):
        wj.continue_event(system, doubling._replace(states=np.zeros((1, 3))), ("a", "b"), bounds)
    with pytest.raises(
        ValueError, match=r"event must be one of this system, at a 0\.3675 and b 0\.2"
    ):
        wj.continue_event(wj.systems.HenonMap(0.1, 0.2), doubling, ("a", "b"), bounds)


def test_a_curve_that_closes_is_followed_once():
    """Folds of x' = x + p^2 + q^2 - 1 - x^2, on the unit circle."""
    system = wj.Map(
        lambda x, p, q: x + p**2 + q**2 - 1 - x**2, ("x",), parameters={"p": 1.2, "q": 0.1}
    )
    branch = wj.continue_gait(system, "p", (0.5, 1.5), wj.find_gait(system, [[0.67]]))
    (fold,) = branch.folds
    bounds = {"p": (-2.0, 2.0), "q": (-2.0, 2.0)}
    curve = wj.continue_event(system, fold, ("p", "q"), bounds)
    assert curve.ends == ("the curve closes",) * 2
    np.testing.assert_allclose(np.hypot(*curve.values.T), 1, atol=1e-12)
    turned = np.unwrap(np.arctan2(*curve.values.T))
    assert 0.9 < abs(turned[-1] - turned[0]) / (2 * np.pi) < 1.1

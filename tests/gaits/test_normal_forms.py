"""Coefficients of normal forms, against the formulas of Kuznetsov's book written out."""

import jax.numpy as jnp
import numpy as np
import pytest
from maps import done_with
from matplotlib.legend import Legend

import walker_jax as wj
from walker_jax import figures
from walker_jax.gaits.continuation import Start, follow_branch
from walker_jax.gaits.events import add_normal_form
from walker_jax.gaits.gait_summary import summarise_bifurcations
from walker_jax.gaits.normal_forms import criticality, find_coefficient


def the_event(stride, states, bounds):
    start = Start(bounds[0], np.asarray(states, float))
    (found,) = done_with(stride, follow_branch(start, 1.0, bounds)).events
    assert np.isnan(found.coefficient) and found.criticality == ""
    return done_with(stride, add_normal_form(found))


@pytest.mark.parametrize("cubic", [-3.0, 2.0])
def test_a_doubling_of_a_line(cubic):
    """-(1 + p) x + b x^2 + c x^3 has the coefficient b^2 + c (Kuznetsov, equation 4.9)."""
    stride = lambda x, p: -(1 + p) * x + 1.5 * x**2 + cubic * x**3
    found = the_event(stride, [[0.0]], (-0.5, 0.5))
    assert found.coefficient == pytest.approx(1.5**2 + cubic, abs=1e-12)
    assert found.criticality == ("supercritical" if cubic > -2 else "subcritical")


def test_the_logistic_map_doubles_supercritically():
    """At r = 3 the coefficient is r^2: f'' = -2 r and f''' = 0."""
    found = the_event(lambda x, r: r * x * (1 - x), [[0.6]], (2.5, 3.2))
    assert found.value == pytest.approx(3, abs=1e-13)
    assert found.coefficient == pytest.approx(9, abs=1e-10)


def test_the_doubling_of_henon():
    """s = <p, C + 3 B(q, (I - A)^-1 B(q, q))> / 6 with B = (-2 a q_1 r_1, 0) and C = 0."""
    a, b = 3 * 0.7**2 / 4, 0.3
    stride = lambda x, a: jnp.stack([1 - a * x[0] ** 2 + x[1], b * x[0]])
    found = the_event(stride, [[1.4, 0.42]], (0.2, 0.5))
    x = 2 * (1 - b) / (4 * a)  # trace = -2 a x = b - 1
    matrix = np.array([[-2 * a * x, 1], [b, 0]])
    q, p = np.array([1, -b]), np.array([1, -1.0])
    np.testing.assert_allclose(matrix @ q, -q, atol=1e-12)
    np.testing.assert_allclose(p @ matrix, -p, atol=1e-12)
    q = q / np.linalg.norm(q)
    p = p / (p @ q)
    form = lambda u, v: np.array([-2 * a * u[0] * v[0], 0])
    bend = np.linalg.solve(np.eye(2) - matrix, form(q, q))
    assert found.coefficient == pytest.approx(p @ form(q, bend) / 2, rel=1e-10)


@pytest.mark.parametrize(("cubic", "word"), [(0.0, "supercritical"), (-20.0, "subcritical")])
def test_the_torus_of_the_delayed_logistic_map(cubic, word):
    """Supercritical (Kuznetsov, example 4.3); a cubic term, zero at the fixed point, changes it."""

    def stride(x, p):
        u = x[1] - (1 - 1 / p)
        return jnp.stack([p * x[0] * (1 - x[1]) + cubic * u**3, x[0]])

    found = the_event(stride, [[3 / 8] * 2], (1.6, 2.4))
    assert found.value == pytest.approx(2, abs=1e-12)
    matrix = np.array([[1.0, -1.0], [1.0, 0.0]])
    multiplier = np.exp(1j * np.pi / 3)
    q = np.array([multiplier, 1]) / np.sqrt(2)
    p = np.array([1, -1 / multiplier])
    np.testing.assert_allclose(p @ matrix, multiplier * p, atol=1e-12)
    p = p / (p @ q)
    form = lambda u, v: np.array([-2 * (u[0] * v[1] + u[1] * v[0]), 0])
    flat = np.linalg.solve(np.eye(2) - matrix, form(q, q.conj()))
    twice = np.linalg.solve(multiplier**2 * np.eye(2) - matrix, form(q, q))
    third = np.array([6 * cubic * q[1] ** 2 * q[1].conj(), 0])
    total = third + 2 * form(q, flat) + form(q.conj(), twice)
    exact = np.real(p @ total / multiplier) / 2
    assert found.coefficient == pytest.approx(exact, rel=1e-9)
    assert found.criticality == word


def test_a_cycle_has_the_criticality_of_any_of_its_states():
    """Of period two, of the logistic map at r = 1 + sqrt 6, in both orders."""
    stride = lambda x, r: r * x * (1 - x)
    r = 3.4
    states = (r + 1 + np.array([1, -1]) * np.sqrt((r - 3) * (r + 1))) / (2 * r)
    for order in (states, states[::-1]):
        found = the_event(stride, order[:, None], (r, 3.5))
        assert found.value == pytest.approx(1 + np.sqrt(6), abs=1e-12)
        x = found.states[:, 0]
        square = lambda x, r=found.value: np.polynomial.Polynomial([0, r, -r])(
            np.polynomial.Polynomial([0, r, -r])(x)
        )
        twice = square(np.polynomial.Polynomial([x[0], 1])).coef
        assert found.coefficient == pytest.approx(twice[2] ** 2 + twice[3], rel=1e-9)
        assert found.criticality == "supercritical"


def test_folds_and_branch_points_have_no_criticality():
    assert criticality("fold", 1.0) == criticality("branch point", np.nan) == ""
    assert criticality("doubling", 1e-12) == criticality("neimark-sacker", np.nan) == ""
    task = find_coefficient("branch point", np.zeros(1), np.zeros((1, 1)), np.eye(1))
    assert np.isnan(done_with(lambda x, p: x, task))


def test_criticality_is_in_answers_and_pictures():
    system = wj.Map(
        lambda x, p: -(1 + p) * x - x**3 + 0.2 * x**5,
        ("x",),
        parameters={"p": -0.3},
        region={"x": (-1.0, 1.0, 64)},
    )
    data = wj.bifurcation_diagram(
        system,
        "p",
        (-0.3, 0.2),
        period_max=1,
        strides=50,
        scan=8,
        exponents=20,
        normal_forms=True,
    )
    (one,) = summarise_bifurcations(data)["doublings"]
    assert one["criticality"] == "subcritical"
    np.testing.assert_allclose(data["event_coefficient"], [-1], rtol=1e-12)
    stable = data["sample_value"].values < -0.01
    rate = np.log(np.abs(1 + data["sample_value"].values[stable]))
    np.testing.assert_allclose(data["exponents"].values[stable, 0], rate, rtol=0, atol=1e-7)
    ax = figures.gait_branches(data)
    told = [text.get_text() for one in ax.findobj(Legend) for text in one.get_texts()]
    assert "subcritical doubling" in told and "period doubling" not in told
    assert len(figures.bifurcations(data).axes) >= 4
    older = data.drop_vars(["event_coefficient", "torus_coefficient", "exponents"])
    assert "criticality" not in summarise_bifurcations(older)["doublings"][0]
    assert len(figures.bifurcations(older).axes) >= 3
    with pytest.raises(ValueError, match="data must have exponents"):
        figures.lyapunov_exponents(older)

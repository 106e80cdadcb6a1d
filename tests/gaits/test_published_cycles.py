"""Bifurcations of cycles and equilibria known from MatCont or in closed form."""

from typing import Any

import numpy as np
import pytest
from reference import ROOT
from scipy.integrate import solve_ivp

import walker_jax as wj

SCRIPT = ROOT / "benchmarks" / "matcont.py"
EVENTS = {
    "NS": (-0.595750552627086, [-0.09487159, -0.14834729], -0.595750403989607, 8.86109929893307),
    "PD": (-0.614681676875110, [-0.07422893, -0.14129712], -0.614681653707090, 9.25684575645854),
}
"""nu and roughly x and z here, nu and the period in MatCont 7.6."""
CRITICAL = {"NS": lambda m: abs(m) - 1, "PD": lambda m: m + 1}


@pytest.fixture(scope="module")
def systems() -> dict[str, Any]:
    names: dict[str, Any] = {"__name__": "matcont"}
    exec(compile(SCRIPT.read_text(), str(SCRIPT), "exec"), names)
    return names


def multipliers_by_scipy(nu: float, x: float, z: float, period: float) -> np.ndarray:
    """Multipliers of the circuit's cycle, from the variational equations over one period."""
    beta, gamma, r, a3, b3 = 0.5, -0.6, 0.6, 0.32858, 0.93358

    def field(t, state):
        (x, y, z), columns = state[:3], state[3:].reshape(3, 3)
        over, slope = b3 * (y - x) ** 3, 3 * b3 * (y - x) ** 2
        rates = (
            (-(beta + nu) * x + beta * y - a3 * x**3 + over) / r,
            beta * x - (beta + gamma) * y - z - over,
            y + 0.001,
        )
        jacobian = np.array(
            [
                [(-(beta + nu) - 3 * a3 * x**2 - slope) / r, (beta + slope) / r, 0],
                [beta + slope, -(beta + gamma) - slope, -1],
                [0, 1, 0],
            ]
        )
        return np.concatenate([rates, (jacobian @ columns).ravel()])

    start = np.concatenate([[x, -0.001, z], np.eye(3).ravel()])
    found = solve_ivp(field, (0, period), start, "DOP853", rtol=1e-13, atol=1e-14).y[:, -1]
    np.testing.assert_allclose(found[:3], start[:3], rtol=0, atol=1e-11)
    return np.linalg.eigvals(found[3:].reshape(3, 3))


@pytest.mark.parametrize("name", EVENTS)
def test_cycles_of_a_circuit_are_critical_where_matcont_has_them(systems, name):
    """To its digits, and to more by the multipliers of another integrator.

    JaxCont's validation misses the doubling, and the multipliers of the Neimark-Sacker point.
    """
    nu, guess, published, period = EVENTS[name]
    assert abs(nu - published) < 2e-7
    cycle = wj.find_gait(systems["Circuit"](nu), guess)
    assert abs(cycle.step_times[0] - period) < 5e-6
    x, z = cycle.states[0]
    theirs = multipliers_by_scipy(nu, x, z, float(cycle.step_times[0]))
    for one in (*cycle.multipliers, 1):  # 1 along the flow
        assert np.min(np.abs(theirs - one)) < 1e-9
    assert np.min(np.abs(CRITICAL[name](theirs))) < 1e-9


def test_a_radial_cycle_has_its_closed_form(systems):
    for rho in (0.5, 1.0, 1.5):
        cycle = wj.find_gait(systems["Radial"](rho), [1.1 * rho**0.5])
        assert abs(cycle.states[0, 0] - rho**0.5) < 1e-14
        assert abs(cycle.step_times[0] - 2 * np.pi) < 1e-13
        assert abs(cycle.multipliers[0] - np.exp(-4 * np.pi * rho)) < 1e-13


@pytest.mark.slow
def test_continuation_finds_the_bifurcations(systems):
    cubic = systems["Cubic"]()
    branch = wj.continue_gait(cubic, "p", (-1.0, 1.0), wj.find_gait(cubic, [-2.1]))
    assert np.allclose(sorted(one.value for one in branch.folds), [-2 / 3, 2 / 3], atol=1e-13)
    for name, parameter, value in (("VanDerPol", "mu", 0.0), ("AdaptiveControl", "alpha", 1.0)):
        system = systems[name]()
        rest = wj.find_gait(system, np.zeros(len(system.section)))
        (hopf,) = wj.continue_gait(
            system, parameter, (value - 0.5, value + 0.5), rest
        ).neimark_sackers
        assert abs(hopf.value - value) < 1e-13
        assert abs(abs(np.angle(hopf.multipliers[0])) - 1) < 1e-13  # the frequency
    circuit = systems["Circuit"]()
    branch = wj.continue_gait(
        circuit, "nu", (-0.62, -0.58), wj.find_gait(circuit, [-0.08, -0.1434])
    )
    kinds = {"NS": branch.neimark_sackers, "PD": branch.doublings}
    for name, events in kinds.items():
        assert min(abs(one.value - EVENTS[name][0]) for one in events) < 1e-12
    of_matcont = -0.584492842421877
    assert min(abs(one.value - of_matcont) for one in branch.folds) < 1e-11

"""Are bifurcations of equilibria and cycles where MatCont, or a closed form, has them?

The cases are those by which JaxCont validates itself. `published` has MatCont 7.6's values in the
last case, as JaxCont prints them, and closed forms in the others. Equilibria are followed as fixed
points of the map after a time of 1, so that a fold has a multiplier of 1, and a Hopf point is a
Neimark-Sacker point.

The answer: all are found, to rounding where there is a closed form. Of the circuit JaxCont 0.4 does
not find the period doubling, and its multipliers at the Neimark-Sacker point are off, as its own
page says. MatCont's values differ from those here by 1e-7 and less: its multiplier at the doubling
is -0.99999, here it is -1 to 1e-14 (`Bifurcation.residual`), which
tests/gaits/test_published_cycles.py checks by another integrator.

This package has neither Hopf's normal form (the Lyapunov coefficients of MC-EQ-002 and 003), nor
codimension-two points of equilibria (MC-C2-001), nor phase response curves (MC-PRC-001), nor cycles
by collocation, nor connecting orbits.

                                                      here             published   differ
    MC-EQ-001   fold, p                   0.66666666666667      0.66666666666667    0e+00
    MC-EQ-001   fold, p                  -0.66666666666667     -0.66666666666667    0e+00
    MC-EQ-002   Hopf, mu              -5.0323499005624e-17                     0    5e-17
                frequency                                1                     1    0e+00
    MC-EQ-003   Hopf, alpha                              1                     1    2e-16
                frequency                                1                     1    2e-16
    MC-LC-001   period, rho 0.5            6.2831853071796       6.2831853071796    2e-14
                radius                    0.70710678118655      0.70710678118655    1e-15
                multiplier              0.0018674427317203     0.001867442731708    1e-14
    MC-LC-001   period, rho 1.5            6.2831853071796       6.2831853071796    0e+00
                radius                     1.2247448713916       1.2247448713916    0e+00
                multiplier             6.5124121360995e-09   6.5124121360799e-09    2e-20
    MC-LC-002   LPC, nu                  -0.58449284241639     -0.58449284242188    5e-12
                period                     8.4118548958443       8.4118662142581    1e-05
    MC-LC-002   NS, nu                   -0.59575055262709     -0.59575040398961    1e-07
                period                     8.8611027421906       8.8610992989331    3e-06
    MC-LC-002   PD, nu                   -0.61468167687511     -0.61468165370709    2e-08
                period                     9.2568462110863       9.2568457564585    5e-07
    72 s in all
"""

import time
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import walker_jax as wj


class Flow(wj.HybridSystem):
    """An equilibrium of a flow is a fixed point after a time of 1, with multipliers exp(l)."""

    def lift(self, x):
        return x, 0 * x[0]

    def project(self, state):
        return state[0]

    def modes(self):
        field = lambda state: (self.field(state[0]), 1 + 0 * state[1])
        return {"flow": wj.Mode(field, (wj.Guard(lambda state: state[1] - 1, wj.SECTION),))}

    def field(self, x):
        raise NotImplementedError


class Cubic(Flow):
    """MC-EQ-001: folds at p = 2/3 and -2/3."""

    p: Any = -1.0
    section = ("x",)

    def field(self, x):
        return self.p + x - x**3 / 3


class VanDerPol(Flow):
    """MC-EQ-002: a Hopf point at mu = 0 of frequency 1."""

    mu: Any = -0.5
    section = "x", "y"

    def field(self, x):
        return jnp.stack([x[1], self.mu * (1 - x[0] ** 2) * x[1] - x[0]])


class AdaptiveControl(Flow):
    """MC-EQ-003: a Hopf point at alpha = 1 of frequency 1."""

    alpha: Any = 0.5
    section = "x", "y", "z"

    def field(self, x):
        return jnp.stack([x[1], x[2], -self.alpha * x[2] - x[1] - x[0] + x[0] ** 2])


class Radial(wj.HybridSystem):
    """MC-LC-001: a cycle of radius sqrt(rho), period 2 pi and multiplier exp(-4 pi rho)."""

    rho: Any = 0.5
    section = ("x",)

    def lift(self, x):
        return jnp.stack([x[0], 0 * x[0]])

    def project(self, state):
        return state[:1]

    def modes(self):
        def field(state):
            x, y = state
            grows = self.rho - x**2 - y**2
            return jnp.stack([grows * x - y, grows * y + x])

        return {"turn": wj.Mode(field, (wj.Guard(lambda state: state[1], wj.SECTION),))}


class Circuit(wj.HybridSystem):
    """MC-LC-002, MatCont's torBPC: an electronic circuit, whenever z is least."""

    nu: Any = -0.605
    section = "x", "z"

    def lift(self, x):
        return jnp.stack([x[0], -0.001 + 0 * x[0], x[1]])

    def project(self, state):
        return state[::2]

    def modes(self):
        beta, gamma, r, a3, b3 = 0.5, -0.6, 0.6, 0.32858, 0.93358

        def field(state):
            x, y, z = state
            over = b3 * (y - x) ** 3
            charge = (-(beta + self.nu) * x + beta * y - a3 * x**3 + over) / r
            return jnp.stack([charge, beta * x - (beta + gamma) * y - z - over, y + 0.001])

        return {"cycle": wj.Mode(field, (wj.Guard(lambda state: state[1] + 0.001, wj.SECTION),))}


def line(name: str, quantity: str, found: Any, published: float):
    print(f"{name:12}{quantity:20}{found:22.14g}{published:22.14g}{abs(found - published):9.0e}")


def main():
    jax.config.update("jax_enable_x64", True)
    begin = time.perf_counter()
    print(f"{'':32}{'here':>22}{'published':>22}{'differ':>9}")
    cubic = wj.continue_gait(Cubic(), "p", (-1.0, 1.0), wj.find_gait(Cubic(), [-2.1]))
    for fold, value in zip(sorted(cubic.folds, key=lambda one: -one.value), (2, -2), strict=True):
        line("MC-EQ-001", "fold, p", fold.value, value / 3)
    systems = {
        "MC-EQ-002": (VanDerPol(), "mu", 0.0),
        "MC-EQ-003": (AdaptiveControl(), "alpha", 1.0),
    }
    for name, (system, parameter, value) in systems.items():
        rest = wj.find_gait(system, np.zeros(len(system.section)))
        (hopf,) = wj.continue_gait(
            system, parameter, (-0.5 + value, 0.5 + value), rest
        ).neimark_sackers
        line(name, f"Hopf, {parameter}", hopf.value, value)
        line("", "frequency", abs(np.angle(hopf.multipliers[0])), 1)
    for rho in (0.5, 1.5):
        cycle = wj.find_gait(Radial(rho), [1.1 * rho**0.5])
        line("MC-LC-001", f"period, rho {rho}", cycle.step_times[0], 2 * np.pi)
        line("", "radius", cycle.states[0, 0], rho**0.5)
        line("", "multiplier", cycle.multipliers[0].real, np.exp(-4 * np.pi * rho))
    cycle = wj.find_gait(Circuit(), [-0.08, -0.1434])
    branch = wj.continue_gait(Circuit(), "nu", (-0.62, -0.58), cycle)
    of_matcont = {
        "LPC": (branch.folds, -0.584492842421877, 8.41186621425809),
        "NS": (branch.neimark_sackers, -0.595750403989607, 8.86109929893307),
        "PD": (branch.doublings, -0.61468165370709, 9.25684575645854),
    }
    for name, (events, value, period) in of_matcont.items():
        event = min(events, key=lambda one: abs(one.value - value))
        cycle = wj.stride(Circuit(event.value), event.states[0])
        line("MC-LC-002", f"{name}, nu", event.value, value)
        line("", "period", cycle.time, period)
    print(f"{time.perf_counter() - begin:.0f} s in all")


if __name__ == "__main__":
    main()

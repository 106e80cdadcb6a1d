"""Equations of motion as a balance of power, solved by series without a formula for accelerations.

The series of a solution grows order by order, as in `taylor`, from a balance that is linear in the
unknown coefficient.
"""

import abc
import math

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import PyTree

from walker_jax.integrators.expansion import compose, with_fast_sincos
from walker_jax.integrators.series import (
    Series,
    keeping_results,
    recording,
    scale,
    series_log,
)


class PowerBalance(eqx.Module):
    """Equations of motion as a balance of power; a state holds coordinates first, then rates."""

    @abc.abstractmethod
    def series(self, state: PyTree, order: int) -> PyTree[list]:
        """Return the Taylor coefficients of the solution."""

    @abc.abstractmethod
    def balance(
        self, state: list[Series], start: list
    ) -> tuple[list[Series], list[Series], list[Series]]:
        """Return the series of the balance, and lists of all series that precede it and form it.

        The preceding series depend on the unknown coefficient through their own of one order more.
        """


class VirtualPower(PowerBalance):
    """Equations of motion as a balance of virtual power, without a formula for accelerations.

    With x = F(q), the equations are p(q, q', x'') = 0, where p is linear in x'' = F(q(t))''. The
    series of F(q(t)) follows from that of q(t), so neither derivatives of F nor solutions of linear
    equations are expanded. A state holds the coordinates q first, then their rates.
    """

    @abc.abstractmethod
    def transfer(self, q: list) -> list:
        """Return x = F(q), from scalars q to scalars x."""

    @abc.abstractmethod
    def virtual_power(self, q: list, qdot: list, acceleration: list) -> list:
        """Return p(q, q', x''): one scalar for each of q."""

    @abc.abstractmethod
    def factorise(self, q: list) -> PyTree:
        """Return the matrix -dp/dx'' dF/dq, which multiplies q'' in -p, in a form for `solve`."""

    @abc.abstractmethod
    def solve(self, factors: PyTree, right: list) -> list:
        """The solution of linear equations with the matrix of `factorise`."""

    @eqx.filter_jit  # traced once for all calls
    def __call__(self, state: PyTree) -> PyTree:
        """The time derivative of a state."""
        leaves, structure = jax.tree.flatten(state)
        q, rates = leaves[: len(leaves) // 2], leaves[len(leaves) // 2 :]
        velocity = lambda q: jax.jvp(self.transfer, (q,), (rates,))[1]
        convective = jax.jvp(velocity, (q,), (rates,))[1]
        accelerations = self.solve(self.factorise(q), self.virtual_power(q, rates, convective))
        return jax.tree.unflatten(structure, rates + accelerations)

    def series(self, state: PyTree, order: int) -> PyTree[list]:
        """Taylor coefficients of the solution.

        The k-th coefficient of p contains q_{k+2} only through the top coefficient of F(q(t)), with
        the derivative of F at t = 0 as its factor. So p is first computed with q_{k+2} = 0; then
        q_{k+2} is the solution of a linear equation whose right-hand side is that p.
        """
        with keeping_results():
            return self.grow(state, order)

    def grow(self, state: PyTree, order: int) -> PyTree[list]:
        leaves, structure = jax.tree.flatten(state)
        start, rates = leaves[: len(leaves) // 2], leaves[len(leaves) // 2 :]
        factors = with_fast_sincos(self.factorise)(start)
        # unknown coefficients are zero
        q = [Series(lambda k: None, pair) for pair in zip(start, rates, strict=True)]
        qdot = [derivative(series) for series in q]
        p, of_transfer, of_power = self.balance([*q, *qdot], leaves)
        for k in range(order):
            missing = [jnp.zeros_like(start[0]) if c is None else c for c in (s[k] for s in p)]
            for series in of_power:
                del series.coefficients[k:]
            for series in (*of_transfer, *q):
                del series.coefficients[k + 2 :]
            for series, value in zip(q, self.solve(factors, missing), strict=True):
                series.coefficients.append(value * (1 / ((k + 1) * (k + 2))))
        return jax.tree.unflatten(
            structure, [coefficients_up_to(series, order) for series in (*q, *qdot)]
        )

    def balance(
        self, state: list[Series], start: list
    ) -> tuple[list[Series], list[Series], list[Series]]:
        """Return the series of p along q(t), a list of all series of F, and one of p's others."""
        half = len(state) // 2
        q, qdot = state[:half], state[half:]
        with recording(series_log) as of_transfer:
            x = compose(self.transfer, q, start[:half])
        with recording(series_log) as of_power:
            acceleration = [derivative(series, times=2) for series in x]
            like = [jnp.zeros_like(start[0])] * len(x)
            p = compose(
                lambda args: self.virtual_power(*args),
                (q, qdot, acceleration),
                (start[:half], start[half:], like),
            )
        return p, of_transfer, of_power


class ConstrainedPower(PowerBalance):
    """Equations of motion for independent rates u; all rates are q' = T(q) u.

    With momenta m = P(q) u the equations are p(q, u, m, m') = 0, one for each of u, where p is
    linear in m'. A state holds the coordinates q first, then u.
    """

    @property
    @abc.abstractmethod
    def independent(self) -> tuple[int, ...]:
        """Indices of the coordinates with the independent rates u."""

    @abc.abstractmethod
    def rates(self, q: list, u: list) -> list:
        """Return T(q) u: one scalar for each of q."""

    @abc.abstractmethod
    def momentum(self, q: list, u: list) -> list:
        """Return P(q) u as scalars m, including any that p needs without their rates."""

    @abc.abstractmethod
    def power(self, q: list, u: list, momentum: list, momentum_rates: list) -> list:
        """Return p: one scalar for each of u."""

    @abc.abstractmethod
    def factorise(self, q: list) -> PyTree:
        """Return the matrix -dp/dm' P, which multiplies u' in -p, in a form for `solve`."""

    @abc.abstractmethod
    def solve(self, factors: PyTree, right: list) -> list:
        """The solution of linear equations with the matrix of `factorise`."""

    def halves(self, leaves: list) -> tuple[list, list]:
        """Split leaves into coordinates and independent rates."""
        count = len(leaves) - len(self.independent)
        return leaves[:count], leaves[count:]

    @eqx.filter_jit  # traced once for all calls
    def __call__(self, state: PyTree) -> PyTree:
        """The time derivative of a state."""
        leaves, structure = jax.tree.flatten(state)
        q, u = self.halves(leaves)
        qdot = self.rates(q, u)
        momentum, convective = jax.jvp(lambda q: self.momentum(q, u), (q,), (qdot,))
        udot = self.solve(self.factorise(q), self.power(q, u, momentum, convective))
        return jax.tree.unflatten(structure, qdot + udot)

    def series(self, state: PyTree, order: int) -> PyTree[list]:
        """Taylor coefficients of the solution.

        The k-th coefficient of p contains u_{k+1} only through the top coefficient of the momenta,
        linearly, with P at t = 0 as its factor. So p is first computed with u_{k+1} = 0, and
        u_{k+1} solves a linear equation whose right-hand side is that p.
        """
        with keeping_results():
            return self.grow(state, order)

    def grow(self, state: PyTree, order: int) -> PyTree[list]:
        leaves, structure = jax.tree.flatten(state)
        at, start = self.halves(leaves)
        factors = with_fast_sincos(self.factorise)(at)
        # unknown coefficients are zero
        u = [Series(lambda k: None, [value]) for value in start]
        qdot: list[Series] = []

        def coordinate(i):
            return Series(lambda k: at[i] if k == 0 else scale(qdot[i][k - 1], 1 / k))

        q = [coordinate(i) for i in range(len(at))]
        qdot += compose(lambda both: self.rates(*both), (q, u), (at, start))
        p, of_momentum, of_power = self.balance([*q, *u], leaves)
        for k in range(order):
            missing = [jnp.zeros_like(leaves[0]) if c is None else c for c in (s[k] for s in p)]
            for series in of_power:
                del series.coefficients[k:]
            for series in (*of_momentum, *u):
                del series.coefficients[k + 1 :]
            for series, value in zip(u, self.solve(factors, missing), strict=True):
                series.coefficients.append(value * (1 / (k + 1)))
        return jax.tree.unflatten(
            structure, [coefficients_up_to(series, order) for series in (*q, *u)]
        )

    def balance(self, state, start):
        both, at = self.halves(state), self.halves(start)
        with recording(series_log) as of_momentum:
            momentum = compose(lambda both: self.momentum(*both), both, at)
        with recording(series_log) as of_power:
            changes = [derivative(series) for series in momentum]
            like = [jnp.zeros_like(start[0])] * len(momentum)
            known = *both, momentum, changes
            p = compose(lambda args: self.power(*args), known, (*at, like, like))
        return p, of_momentum, of_power


def derivative(series: Series, times: int = 1) -> Series:
    """Return the time derivative of a series, of order `times`."""

    def rule(k):
        coefficient = scale(series[k + times], math.perm(k + times, times))
        return jnp.zeros_like(series[0]) if coefficient is None and k == 0 else coefficient

    return Series(rule)


def coefficients_up_to(series: Series, order: int) -> list:
    """Return the coefficients of a series up to an order, as arrays."""
    zero = jnp.zeros_like(series[0])
    return [zero if series[k] is None else series[k] for k in range(order + 1)]

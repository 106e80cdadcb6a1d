"""Equations of motion as a balance of power, solved by series without a formula for accelerations.

The series of a solution grows order by order, as in `taylor`, from a balance that is linear in the
unknown coefficient.
"""

import abc
import math
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import PyTree

from walker_jax.integrators.expansion import compose, with_fast_sincos
from walker_jax.integrators.series import (
    Series,
    coefficients_up_to,
    keeping_results,
    recording,
    scale,
    series_log,
)


class PowerBalance(eqx.Module):
    """Equations of motion as a balance of power p; a state holds coordinates first, then rates.

    The balance is linear in some derivatives of the unknowns: accelerations, or rates of momenta.
    """

    degree: ClassVar[int]
    """Order of the derivatives of the unknowns that the balance determines."""

    @abc.abstractmethod
    def factorise(self, q: list) -> PyTree:
        """Return the matrix that multiplies these derivatives in -p, in a form for `solve`."""

    @abc.abstractmethod
    def solve(self, factors: PyTree, right: list) -> list:
        """The solution of linear equations with the matrix of `factorise`."""

    def series(self, state: PyTree, order: int) -> PyTree[list]:
        """Return the Taylor coefficients of the solution.

        The k-th coefficient of p contains an unknown's coefficient of order k + degree only through
        the top coefficient of the series that precede p, linearly, with the derivative at t = 0 as
        its factor. So p is first computed with zeros for these; then they are the solution of a
        linear equation whose right-hand side is that p.
        """
        leaves, structure = jax.tree.flatten(state)
        with keeping_results():
            factors = with_fast_sincos(self.factorise)(self.split_state(leaves)[0])
            motion, unknown = self.expand(*self.split_state(leaves))
            p, preceding, forming = self.balance(motion, leaves)
            for k in range(order):
                missing = [jnp.zeros_like(leaves[0]) if c is None else c for c in (s[k] for s in p)]
                for one in forming:
                    del one.coefficients[k:]
                for one in (*preceding, *unknown):
                    del one.coefficients[k + self.degree :]
                factor = 1 / math.perm(k + self.degree, self.degree)
                for one, value in zip(unknown, self.solve(factors, missing), strict=True):
                    one.coefficients.append(value * factor)
            return jax.tree.unflatten(structure, [coefficients_up_to(one, order) for one in motion])

    def split_state(self, leaves: list) -> tuple[list, list]:
        """Split leaves into coordinates and rates."""
        return leaves[: len(leaves) // 2], leaves[len(leaves) // 2 :]

    @abc.abstractmethod
    def expand(self, q: list, rates: list) -> tuple[list[Series], list[Series]]:
        """Return the series of a state's numbers, and those of the unknowns.

        Unknown coefficients are zero.
        """

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
    equations are expanded. A state holds the coordinates q first, then their rates. The matrix of
    `factorise` is -dp/dx'' dF/dq, which multiplies q''; the preceding series are those of F.
    """

    degree: ClassVar = 2

    @abc.abstractmethod
    def transfer(self, q: list) -> list:
        """Return x = F(q), from scalars q to scalars x."""

    @abc.abstractmethod
    def virtual_power(self, q: list, qdot: list, acceleration: list) -> list:
        """Return p(q, q', x''): one scalar for each of q."""

    @eqx.filter_jit  # traced once for all calls
    def __call__(self, state: PyTree) -> PyTree:
        """The time derivative of a state."""
        leaves, structure = jax.tree.flatten(state)
        q, rates = self.split_state(leaves)
        velocity = lambda q: jax.jvp(self.transfer, (q,), (rates,))[1]
        convective = jax.jvp(velocity, (q,), (rates,))[1]
        accelerations = self.solve(self.factorise(q), self.virtual_power(q, rates, convective))
        return jax.tree.unflatten(structure, rates + accelerations)

    def expand(self, q, rates):
        unknown = [Series(lambda k: None, pair) for pair in zip(q, rates, strict=True)]
        return [*unknown, *map(derivative, unknown)], unknown

    def balance(self, state, start):
        (q, qdot), (at, rates) = self.split_state(state), self.split_state(start)
        with recording(series_log) as of_transfer:
            x = compose(self.transfer, q, at)
        with recording(series_log) as of_power:
            acceleration = [derivative(series, times=2) for series in x]
            like = [jnp.zeros_like(start[0])] * len(x)
            known = q, qdot, acceleration
            p = compose(lambda args: self.virtual_power(*args), known, (at, rates, like))
        return p, of_transfer, of_power


class ConstrainedPower(PowerBalance):
    """Equations of motion for independent rates u; all rates are q' = T(q) u.

    With momenta m = P(q) u the equations are p(q, u, m, m') = 0, one for each of u, where p is
    linear in m'. A state holds the coordinates q first, then u. The matrix of `factorise` is
    -dp/dm' P, which multiplies u'; the preceding series are those of the momenta.
    """

    degree: ClassVar = 1

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

    def split_state(self, leaves: list) -> tuple[list, list]:
        """Split leaves into coordinates and independent rates."""
        count = len(leaves) - len(self.independent)
        return leaves[:count], leaves[count:]

    @eqx.filter_jit  # traced once for all calls
    def __call__(self, state: PyTree) -> PyTree:
        """The time derivative of a state."""
        leaves, structure = jax.tree.flatten(state)
        q, u = self.split_state(leaves)
        qdot = self.rates(q, u)
        momentum, convective = jax.jvp(lambda q: self.momentum(q, u), (q,), (qdot,))
        udot = self.solve(self.factorise(q), self.power(q, u, momentum, convective))
        return jax.tree.unflatten(structure, qdot + udot)

    def expand(self, q, rates):
        u = [Series(lambda k: None, [value]) for value in rates]
        qdot: list[Series] = []

        def coordinate(i):
            return Series(lambda k: q[i] if k == 0 else scale(qdot[i][k - 1], 1 / k))

        moving = [coordinate(i) for i in range(len(q))]
        qdot += compose(lambda both: self.rates(*both), (moving, u), (q, rates))
        return [*moving, *u], u

    def balance(self, state, start):
        both, at = self.split_state(state), self.split_state(start)
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

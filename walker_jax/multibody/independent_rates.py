"""Motion under constraints on rates, by as many independent rates as the constraints leave.

Some of the rates qdot, u, are independent; A(q) qdot = 0 gives the others, so qdot = T(q) u. By
Jourdain's principle, the power of forces and inertia vanishes for every entry of u,

    T^T (F,q^T [f - M xddot] + Q) = 0,    xdot = F,q T u.

A state (q, u) obeys the constraints for any numbers, so no error of an integration can break them.
"""

import abc

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from walker_jax.integrators.power_balance import ConstrainedPower
from walker_jax.kernels.scalars import unroll
from walker_jax.multibody.constraints import rate_matrix
from walker_jax.multibody.linear import block, factorise, solve_factored
from walker_jax.multibody.system import (
    Coordinates,
    System,
    mass_matrix,
    times_masses,
    velocity,
)


class ConstrainedMotion(ConstrainedPower):
    """Equations of motion of a system under constraints on rates, for `integrators`.

    A state is any PyTree of scalars: first the coordinates q, then the rates of those that
    `independent` names, in its order.
    """

    @abc.abstractmethod
    def system(self) -> System:
        """Masses, x = F(q) and forces."""

    @abc.abstractmethod
    def constraints(self, q: Coordinates, qdot: Coordinates) -> Float[Array, " a"]:
        """a, linear in qdot."""

    @property
    @abc.abstractmethod
    def independent(self) -> tuple[int, ...]:
        """Indices of the coordinates whose rates are independent; all others follow from a = 0."""

    def allowed_rates(self, q: Coordinates) -> Float[Array, "q u"]:
        """Return T(q): column i has all rates at unit rate of the i-th independent coordinate.

        NaN where the dependent rates are not determined.
        """
        A = rate_matrix(self.constraints, q, q)
        dependent = [i for i in range(len(q)) if i not in self.independent]
        own = jnp.stack([A[:, i] for i in dependent], axis=1)
        # own is square: own^-1 = own^T (own own^T)^-1, and own own^T needs no pivoting.
        factors = factorise(block(own @ own.T, range(len(own))))
        columns = []
        for i in self.independent:
            one = -own.T @ jnp.stack(solve_factored(factors, list(A[:, i])))
            entries = dict(zip(dependent, one, strict=True))
            unit = {j: np.asarray(float(i == j), q.dtype) for j in self.independent}
            columns.append(jnp.stack([(entries | unit)[j] for j in range(len(q))]))
        return jnp.stack(columns, axis=1)

    def rates(self, q, u):
        flat = lambda self, q, u: list(self.allowed_rates(jnp.stack(q)) @ jnp.stack(u))
        return unroll(flat)(self, q, u)

    def momentum(self, q, u):
        """M xdot."""

        def flat(self, q, u):
            q, system = jnp.stack(q), self.system()
            xdot = velocity(system.transfer, q, self.allowed_rates(q) @ jnp.stack(u))
            return list(times_masses(system, xdot))

        return unroll(flat)(self, q, u)

    def power(self, q, u, momentum, momentum_rates):
        def flat(self, q, u, momentum_rates):
            q, system = jnp.stack(q), self.system()
            allowed = self.allowed_rates(q)
            _, transposed = jax.vjp(unroll(system.transfer), q)
            (power,) = transposed(system.forces.astype(q.dtype) - jnp.stack(momentum_rates))
            if system.generalised_forces is not None:
                power = power + system.generalised_forces(q, allowed @ jnp.stack(u))
            return list(allowed.T @ power)

        return unroll(flat)(self, q, u, momentum_rates)

    def factorise(self, q):
        def flat(self, q):
            q = jnp.stack(q)
            allowed = self.allowed_rates(q)
            matrix = allowed.T @ mass_matrix(self.system(), q) @ allowed
            return factorise(block(matrix, range(len(matrix))))

        return unroll(flat)(self, q)

    def solve(self, factors, right):
        return solve_factored(factors, right)

"""Walks and gaits under `jax.shard_map` are those without it; what devices share sums derivatives.

A mesh of one device asks of a program what a mesh of several does: that values vary along its axes
as loops and derivatives need.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.sharding import PartitionSpec

import walker_jax as wj

STARTS = jnp.array([[0.2, -0.2], [0.21, -0.21], [0.19, -0.2]])
OVER = PartitionSpec("cells")
walker_at = lambda slope: wj.SimplestWalker(slope)


WALKS = [
    lambda slope, x: wj.walk(walker_at(slope), x, 2),
    lambda slope, x: wj.walk(walker_at(slope), x, 2, ground=[0.0, 0.001]),
]
GAITS = [
    lambda slope, x: wj.find_gait(walker_at(slope), x),
    lambda slope, x: jax.jacfwd(lambda x: wj.find_gait(walker_at(slope), x, 2).residual)(x),
    lambda slope, x: wj.find_gait(wj.systems.HenonMap(1.0, 10 * slope), x),
]


@pytest.mark.parametrize(
    ("function", "shared"),
    [
        *((one, shared) for one in WALKS for shared in (True, False)),
        *((one, bool(i % 2)) for i, one in enumerate(GAITS)),
        *(pytest.param(one, not i % 2, marks=pytest.mark.slow) for i, one in enumerate(GAITS)),
    ],
)
def test_cells_are_those_without_a_mesh(function, shared):
    mesh = jax.sharding.Mesh(np.array(jax.devices()[:1]), ("cells",))
    slope = jnp.asarray(0.009) if shared else jnp.array([0.009, 0.0091, 0.0092])
    many = jax.vmap(function, (None if shared else 0, 0))
    specs = (PartitionSpec() if shared else OVER, OVER)
    sharded = jax.shard_map(many, mesh=mesh, in_specs=specs, out_specs=OVER)
    found, expected = (jax.tree.leaves(jax.jit(f)(slope, STARTS)) for f in (sharded, many))
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-11, atol=1e-13)
    assert np.isfinite(np.asarray(found[0])[0]).all()


def test_derivatives_by_a_shared_parameter_are_sums():
    mesh = jax.sharding.Mesh(np.array(jax.devices()[:1]), ("cells",))
    gait = lambda slope, x: wj.find_gait(walker_at(slope), x).states[0, 0]
    total = lambda slope, xs: jax.vmap(gait, (None, 0))(slope, xs).sum()
    inside = jax.shard_map(
        jax.grad(total), mesh=mesh, in_specs=(PartitionSpec(), OVER), out_specs=PartitionSpec()
    )
    found, expected = (jax.jit(f)(0.009, STARTS) for f in (inside, jax.grad(total)))
    long = jnp.cbrt(0.009)  # theta is about 0.97095 of the cube root of the slope
    np.testing.assert_allclose(found, expected, rtol=1e-9)
    assert abs(found / (3 * 0.970951 * long / (3 * 0.009)) - 1) < 0.05

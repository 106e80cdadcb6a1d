"""Does it pay to polish a policy by gradients through strides?

The policy is the one of least effort for the simplest walker with push-off; its table has a value
for each cell. Adam (optax) improves the table by derivatives of the margins of four strides from
each cell, starting from a point in the cell that is drawn anew for each step. The margin is that of
the stride that fails, or else by how much a stride passes the top; the mean of
log(1 + exp(-margin / 0.003)) is minimised. The script prints the area of the policy's basin,
followed directly, before and after on two grids, and the seconds beside those of the kernel.

The result of 120 steps: 0.00690 becomes 0.00738 on 160 x 180 cells, and 0.00783 becomes 0.00826 on
320 x 360. Halving the cells gains more than that, in a seventh of the time: 8 s instead of 60.
"""

import time

import jax
import jax.numpy as jnp
import numpy as np
import optax

import walker_jax as wj
from walker_jax.control.actions import Actions
from walker_jax.control.policies import interpolate_actions, least_effort_actions
from walker_jax.control.steered import steer

SLOPE, LARGEST = 0.004, 0.1
STRIDES, SCALE, RATE, STEPS, STARTS = 4, 0.003, 2e-4, 120, 1500


def main():
    jax.config.update("jax_enable_x64", True)
    for nx, ny in ((160, 180), (320, 360)):
        walker = wj.PoweredWalker(SLOPE)
        grid = wj.Grid.sheared(theta=(0.0, 0.8, nx), sum=(-0.4, 0.05, ny))
        begun = time.perf_counter()
        data = wj.viable(walker, grid, {"push_off": (0.0, LARGEST, 17)}, bounds=False)
        action = least_effort_actions(
            walker, data, Actions(("push_off",), data["push_off"].values[:, None], 0)
        )
        found = time.perf_counter() - begun
        pushes = np.where(action >= 0, data["push_off"].values[action], 0.0).ravel()
        begun = time.perf_counter()
        polished = polish(grid, action >= 0, pushes)
        words = f"{nx} x {ny}: kernel {data.attrs['area']:.5f} in {found:.1f} s, policy "
        words += f"{area(walker, grid, action >= 0, pushes):.5f}, polished "
        words += f"{area(walker, grid, action >= 0, polished):.5f} in "
        print(f"{words}{time.perf_counter() - begun:.0f} s", flush=True)


def numbered(acts):
    """An action of its own for each cell that acts."""
    return np.where(acts, np.arange(acts.size).reshape(acts.shape), -1)


def area(walker, grid, acts, pushes) -> float:
    choose = interpolate_actions(grid, numbered(acts), pushes[:, None])
    return sum(wj.basin(steer(walker, ("push_off",), choose), grid, "direct").attrs["area"])


def polish(grid, acts, pushes):
    """The pushes of cells, by gradient steps."""
    cells, rng = np.flatnonzero(acts), np.random.default_rng(0)
    spacing = grid.shear @ np.diag(grid.spacing)

    def loss(pushes, x):
        worst, going = jnp.inf, jnp.asarray(True)
        for _ in range(STRIDES):
            choose = interpolate_actions(grid, numbered(acts), pushes[:, None])
            (push,) = choose(x, jnp.zeros(1))
            found = wj.margins(wj.PoweredWalker(SLOPE, push_off=push), x)
            failed = found.stride.outcome != wj.Outcome.STRIDE
            margin = jnp.where(failed, found.failed, found.backward)
            worst = jnp.minimum(worst, jnp.where(going & jnp.isfinite(margin), margin, jnp.inf))
            going = going & ~failed
            x = jnp.where(going, found.stride.state, x)
        known = jnp.isfinite(worst)
        return jnp.where(known, jax.nn.softplus(-jnp.where(known, worst, 0) / SCALE), 0)

    mean = lambda pushes, xs: jax.vmap(loss, (None, 0))(pushes, xs).mean()
    slope_of, optimiser = jax.jit(jax.grad(mean)), optax.adam(RATE)
    pushes = jnp.asarray(pushes)
    with jax.numpy_dtype_promotion("standard"):
        state = optimiser.init(pushes)
    for _ in range(STEPS):
        chosen = rng.choice(cells, min(STARTS, len(cells)), replace=False)
        xs = grid.centres(chosen) + rng.uniform(-0.5, 0.5, (len(chosen), 2)) @ spacing.T
        slope = jnp.nan_to_num(slope_of(pushes, jnp.asarray(xs)))
        with jax.numpy_dtype_promotion("standard"):
            update, state = optimiser.update(slope, state)
            pushes = jnp.clip(jnp.asarray(optax.apply_updates(pushes, update)), 0, LARGEST)
    return np.asarray(pushes)


if __name__ == "__main__":
    main()

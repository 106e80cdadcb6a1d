"""How long does an ensemble of short flows take, beside diffrax, heyoka and a loop by hand?

The problem is that of GPUODEBenchmarks: Lorenz's equations with sigma = 10, beta = 8/3, rho uniform
from 0 to 21 over 8,388,608 trajectories, from (1, 0, 0), t from 0 to 1.

"""

import argparse
import os
from functools import partial
from typing import Any, NamedTuple

os.environ.setdefault("WALKER_JAX_CACHE_DIR", "")  # so that `first` compiles

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from by_numba import write_loop
from jax import lax
from ratios import compare, optional, versions

import walker_jax as wj
from walker_jax.kernels import kernel

SIGMA, BETA = 10.0, 8 / 3
ALL = 8_388_608
STEP = 0.001


class State(NamedTuple):
    x: Any
    y: Any
    z: Any
    time: Any


class Lorenz(wj.HybridSystem):
    """Lorenz's equations, after a time of 1."""

    rho: Any

    section = "x", "y", "z"

    def lift(self, x):
        return State(x[0], x[1], x[2], 0 * x[0])

    def project(self, state):
        return jnp.stack([state.x, state.y, state.z])

    def modes(self):
        def field(s):
            y = s.x * (self.rho - s.z) - s.y
            return State(SIGMA * (s.y - s.x), y, s.x * s.y - BETA * s.z, 1 + 0 * s.time)

        return {"flow": wj.Mode(field, (wj.Guard(lambda s: s.time - 1, wj.SECTION),))}


def by_stride(rho, tolerance=1e-8):
    start = jnp.array([1.0, 0.0, 0.0], rho.dtype)
    return wj.stride(Lorenz(rho), start, tolerance=tolerance).state


def solve(rho, adaptive: bool):
    """By diffrax, as the published program does."""

    def field(t, s, args):
        x, y, z = s
        return SIGMA * (y - x), x * (rho - z) - y, x * y - BETA * z

    number = partial(jnp.asarray, dtype=rho.dtype)
    tolerances = diffrax.PIDController(rtol=1e-8, atol=1e-8)
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(field),
        diffrax.Tsit5(),
        t0=number(0.0),
        t1=number(1.0),
        dt0=number(STEP),
        y0=(number(1.0), number(0.0), number(0.0)),
        stepsize_controller=tolerances if adaptive else diffrax.ConstantStepSize(),
        max_steps=None,
        adjoint=diffrax.ForwardMode(),
        throw=False,
    )
    assert solution.ys is not None
    return jnp.stack([one[-1] for one in solution.ys])


def by_numba(adaptive: bool):
    field = {
        "x": f"{SIGMA} * ([y] - [x])",
        "y": "[x] * (p - [z]) - [y]",
        "z": f"[x] * [y] - {BETA} * [z]",
    }
    loop, tolerance = write_loop(field, diffrax.Tsit5()), 1e-8 * adaptive

    def run(rho):
        starts = np.tile([1.0, 0.0, 0.0], (len(rho), 1))
        states = np.empty((len(rho), 1, 3))
        return loop(starts, rho, np.ones(1), STEP, tolerance, 1e-8, states)[:, 0]

    return run


def by_heyoka(heyoka, tolerance: float = 1e-8, width: int = 16):
    x, y, z = heyoka.make_vars("x", "y", "z")
    rho = heyoka.par[0]
    field = [(x, SIGMA * (y - x)), (y, x * (rho - z) - y), (z, x * y - BETA * z)]
    integrator = heyoka.taylor_adaptive_batch(field, np.zeros((3, width)), tol=tolerance)

    def run(values):
        batches = values[: len(values) // width * width].reshape(-1, width)
        states = np.empty((len(batches), 3, width))
        for batch, state in zip(batches, states, strict=True):
            integrator.set_time(0.0)
            integrator.state[:] = np.array([[1.0], [0.0], [0.0]])
            integrator.pars[0] = batch
            integrator.propagate_until(1.0)
            state[:] = integrator.state
        return np.transpose(states, (0, 2, 1)).reshape(-1, 3)

    return run


def ways_with(adaptive: bool, rho: np.ndarray, some: np.ndarray) -> dict:
    """Return each way to follow the trajectories, and its values of rho; slow ways get `some`."""
    on_cpu = jax.default_backend() == "cpu"
    one = partial(solve, adaptive=adaptive)
    quick, plain = jax.jit(jax.vmap(kernel(one))), jax.jit(jax.vmap(one))
    batches = jax.jit(lambda values: lax.map(one, values, batch_size=1000))
    slow, given = (batches, some) if on_cpu else (plain, rho)
    ways = {"strides, 1e-8": (jax.jit(jax.vmap(by_stride)), rho)} if adaptive else {}
    ways |= {
        "diffrax in a kernel": (quick, rho),
        "diffrax in a kernel, float32": (quick, rho.astype(np.float32)),
        "diffrax": (slow, given),
        "diffrax, float32": (slow, given.astype(np.float32)),
    }
    if on_cpu and optional("numba"):
        ways["Numba, by hand"] = by_numba(adaptive), rho
    if on_cpu and adaptive and (heyoka := optional("heyoka")):
        ways["heyoka, 1e-8, batches of 16"] = by_heyoka(heyoka), rho
    return ways


def main():
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--trajectories", type=int, default=65_536)
    args = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    rho = np.linspace(0.0, 21.0, args.trajectories)
    stride = max(1, len(rho) // 4096)
    exact = np.asarray(jax.jit(jax.vmap(partial(by_stride, tolerance=1e-15)))(rho[::stride]))

    def error(states) -> str:
        states = np.asarray(states, float)
        states = states if len(states) == len(exact) else states[::stride]
        return f"{np.abs(states - exact).max():10.0e}"

    print(f"{versions('diffrax', 'numba', 'heyoka')}; {len(rho)} trajectories; error at the end")
    for adaptive in (True, False):
        print("\nadaptive steps" if adaptive else "\n1,000 steps")
        ways = ways_with(adaptive, rho, rho[::stride])
        runs = {name: partial(run, values) for name, (run, values) in ways.items()}
        each = {name: len(values) for name, (_, values) in ways.items()}
        compare(runs, each, args.repeats, "us", error)


if __name__ == "__main__":
    main()

"""How long does an ensemble of short flows take, beside diffrax, heyoka and a loop by hand?

The problem is that of GPUODEBenchmarks: Lorenz's equations with sigma = 10, beta = 8/3, rho uniform
from 0 to 21 over 8,388,608 trajectories, from (1, 0, 0), t from 0 to 1; adaptive steps of Tsit5
with tolerances of 1e-8, and 1,000 steps. Theirs are in float32, on a GPU. `us each` is the
processor time of one trajectory on one core, and the last number the largest error at the end.
Strides and kernels run on a GPU where JAX has one: then give `--trajectories 8388608`.

The answer: in a kernel diffrax takes a seventh of its time with adaptive steps, a 14th in float32,
and a 16th to a 30th with 1,000 steps, a fifth or an eighth of the time of a loop by Numba. All
8,388,608 are 3.3 s of one core by strides, 7 s by diffrax with adaptive steps in float32, and 25 s
with 1,000 steps.

Published, for all on an NVIDIA V100 in float32, adaptive and 1,000 steps: MPGOS 0.049 and 0.094 s,
DiffEqGPU 0.069 and 0.145 s, diffrax 2.61 and 10.0 s. Julia on a processor takes 12 us each with
adaptive steps, at coarser tolerances, and 139 us with 1,000 steps, by threads of an unnamed number.

    2 cores; jax 0.10.2, diffrax 0.7.2, numba 0.68.1, heyoka 7.13.2; 65536 trajectories

    adaptive steps
                                          us each       times as long   first
    strides, 1e-8                          0.3944             1 (1-1)   3.2 s     7e-08
    diffrax in a kernel                     1.197    3.03 (3.01-3.09)   4.1 s     2e-08
    diffrax in a kernel, float32           0.8272    2.09 (2.09-2.14)   3.1 s     2e-05
    diffrax                                 8.752    22.3 (20.6-25.5)  26.0 s     2e-08
    diffrax, float32                        11.55    29.9 (27.7-32.3)  28.0 s     1e-05
    Numba, by hand                          6.161    15.6 (15.6-15.9)  14.3 s     3e-08
    heyoka, 1e-8, batches of 16             1.324     3.36 (3.2-3.64)   0.4 s     5e-10

    1,000 steps
                                          us each       times as long   first
    diffrax in a kernel                     5.172             1 (1-1)   9.2 s     4e-12
    diffrax in a kernel, float32            2.921 0.565 (0.563-0.569)   5.5 s     4e-05
    diffrax                                 82.67      16 (15.2-17.8)  23.6 s     4e-12
    diffrax, float32                         89.3    17.3 (16.3-18.7)  19.4 s     3e-05
    Numba, by hand                          41.91     8.1 (8.04-8.12)  39.6 s     5e-12

The machine was busy with other work. No GPU has run this script.
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
    ways: dict[str, Any] = (
        {"strides, 1e-8": (jax.jit(jax.vmap(by_stride)), rho)} if adaptive else {}
    )
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

    print(f"{versions('diffrax', 'numba', 'heyoka')}; {len(rho)} trajectories")
    for adaptive in (True, False):
        print("\nadaptive steps" if adaptive else "\n1,000 steps")
        ways = ways_with(adaptive, rho, rho[::stride])
        runs = {name: partial(run, values) for name, (run, values) in ways.items()}
        each = {name: len(values) for name, (_, values) in ways.items()}
        compare(runs, each, args.repeats, "us", error)


if __name__ == "__main__":
    main()

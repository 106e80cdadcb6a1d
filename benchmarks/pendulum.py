"""How long does a basin stability by long flows take, beside diffrax, Numba, heyoka and pybasin?

The problem is pybasin's (version 0.2, its page of solvers): theta'' = T - alpha theta' - K
sin(theta), with alpha = 0.1, T = 0.5, K = 1, from starts drawn uniformly, theta within half a turn
of arcsin(T / K), theta' within 10; t from 0 to 1000, relative tolerance 1e-8, absolute 1e-6. A
pendulum rotates for ever if its largest theta' at times from 950 on exceeds their mean by 0.01, and
rests otherwise. Here the states at 51 times are returned. `ms each` is the processor time of one
start on one core, `error` the median of the errors at t = 1000, then come wrong fates. Other
packages are optional. Where JAX has a GPU, `strides` and kernels run there, on as many `--starts`
as are given.

The answer: strides by Taylor series take an eighth of the time of Dormand and Prince's method, in a
kernel or by Numba, with a tenth of its error, a quarter of heyoka's and a 36th of pybasin's. All
that is left to gain in a kernel of diffrax are its sines, which the C library computes one by one.
A start takes 0.12 ms of one core, 0.22 ms at the package's own tolerance.

Published, for 100,000 starts: Julia's DP5 12.4 s, torchdiffeq 36 s, diffrax 64 s and MATLAB 102 s
on a processor of 24 cores (Intel Core Ultra 9 275HX; at more times), diffrax 11.6 s and DiffEqGPU
(float32, tolerance 1e-6) 0.74 s on a laptop's GPU (RTX 5070 Ti). Julia's time is 3 ms of one core
for each start, 24 times as long as strides here: of another core.

    2 cores; jax 0.10.2, diffrax 0.7.2, numba 0.68.1, heyoka 7.13.2, pybasin 0.2.0; 1000 starts
    rotating: 0.8230; error and wrong fates at the end of a line
                                          ms each       times as long   first
    strides, 1e-8                          0.1224             1 (1-1)   2.3 s     2e-04     0
    strides, 1e-12, their own              0.2242    1.82 (1.82-1.95)   2.9 s     7e-09     0
    diffrax, Dopri5, in a kernel           0.9038    7.36 (7.33-7.62)  16.4 s     2e-03     0
    diffrax, Dopri5                         1.366      11.2 (11-11.5)  18.6 s     2e-03     0
    Numba, Dopri5 by hand                  0.9562    7.81 (7.75-8.05)  20.7 s     2e-03     0
    heyoka, 1e-8, batches of 8             0.4565     3.76 (3.7-3.76)   2.3 s     4e-04     0
    pybasin, JaxSolver                      4.471    36.5 (35.6-37.8)  32.0 s     2e-03     0

The command was `--starts 1000 --repeats 3`, on a machine that was busy with other work.
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

ALPHA, TORQUE, STIFFNESS = 0.1, 0.5, 1.0
SETTLED, END = 950.0, 1000.0
RELATIVE, ABSOLUTE = 1e-8, 1e-6


class State(NamedTuple):
    angle: Any
    rate: Any
    time: Any


class Pendulum(wj.HybridSystem):
    """The pendulum after each `duration`, its angle within half a turn."""

    duration: Any

    section = "angle", "rate"
    angles = ("angle",)

    def lift(self, x):
        return State(x[0], x[1], 0 * x[0])

    def project(self, state):
        return jnp.stack([jnp.mod(state.angle + jnp.pi, 2 * jnp.pi) - jnp.pi, state.rate])

    def modes(self):
        def field(y):
            pull = TORQUE - ALPHA * y.rate - STIFFNESS * jnp.sin(y.angle)
            return State(y.rate, pull, 1 + 0 * y.time)

        over = wj.Guard(lambda y: y.time - self.duration, wj.SECTION)
        return {"flow": wj.Mode(field, (over,))}


def draw_starts(count: int) -> np.ndarray:
    rng, middle = np.random.default_rng(0), np.arcsin(TORQUE / STIFFNESS)
    angle = rng.uniform(-np.pi + middle, np.pi + middle, count)
    return np.stack([angle, rng.uniform(-10, 10, count)], axis=1)


def by_strides(tolerance: float):
    """19 strides of a duration of 50, and 50 of a duration of 1."""

    def one(x):
        settled = wj.walk(Pendulum(50.0), x, 19, tolerance=tolerance).states[-1]
        return wj.walk(Pendulum(1.0), settled, 50, tolerance=tolerance).states

    return jax.jit(jax.vmap(one))


def solve(x):
    """By diffrax, as pybasin does: theta and theta' at 51 times."""
    field = lambda t, y, args: (y[1], TORQUE - ALPHA * y[1] - STIFFNESS * jnp.sin(y[0]))
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(field),
        diffrax.Dopri5(),
        t0=0.0,
        t1=END,
        dt0=0.1,
        y0=(x[0], x[1]),
        stepsize_controller=diffrax.PIDController(rtol=RELATIVE, atol=ABSOLUTE),
        saveat=diffrax.SaveAt(ts=jnp.linspace(SETTLED, END, 51)),
        max_steps=None,
        adjoint=diffrax.ForwardMode(),
        throw=False,
    )
    assert solution.ys is not None
    return jnp.stack(solution.ys, axis=1)


def by_numba():
    """Dormand and Prince's method as a loop by hand."""
    pull = f"{TORQUE} - {ALPHA} * [rate] - {STIFFNESS} * math.sin([angle])"
    loop = write_loop({"angle": "[rate]", "rate": pull}, diffrax.Dopri5())
    times = np.linspace(SETTLED, END, 51)

    def run(starts):
        states = np.empty((len(starts), len(times), 2))
        return loop(starts, starts[:, 0], times, 0.1, RELATIVE, ABSOLUTE, states)

    return run


def by_heyoka(heyoka, tolerance: float, width: int = 8):
    """Taylor series too, in batches, one thread of heyoka's for each core."""
    angle, rate = heyoka.make_vars("angle", "rate")
    pull = TORQUE - ALPHA * rate - STIFFNESS * heyoka.sin(angle)
    integrator = heyoka.taylor_adaptive_batch(
        [(angle, rate), (rate, pull)], np.zeros((2, width)), tol=tolerance
    )
    times = np.concatenate([[0.0], np.linspace(SETTLED, END, 51)])

    def run(starts):
        batches = starts[: len(starts) // width * width].reshape(-1, width, 2)

        def begin(integrator, i):
            integrator.set_time(0.0)
            integrator.state[:] = batches[i].T
            return integrator

        found = heyoka.ensemble_propagate_grid_batch(integrator, times, len(batches), begin)
        return np.concatenate([np.transpose(one[-1][1:], (2, 0, 1)) for one in found])

    return run


def by_pybasin(pybasin_solvers, torch):
    """pybasin's own default solver, which calls diffrax."""

    class Ode(pybasin_solvers.JaxODESystem):
        def ode(self, t, y, args=None):
            return jnp.array([y[1], TORQUE - ALPHA * y[1] - STIFFNESS * jnp.sin(y[0])])

        def get_str(self):
            return "pendulum"

    solver = pybasin_solvers.JaxSolver(
        t_span=(0, END), t_steps=51, t_eval=(SETTLED, END), device="cpu",
        rtol=RELATIVE, atol=ABSOLUTE, cache_dir=None,
    )  # fmt: skip
    return lambda starts: (
        solver.integrate(Ode({}), torch.from_numpy(starts))[1].numpy().swapaxes(0, 1)
    )


def rotates(states) -> np.ndarray:
    rates = np.asarray(states)[..., 1]
    return rates.max(1) - rates.mean(1) > 0.01


def difference(states, exact) -> float:
    """Median over starts of the error at the end, the angle modulo a turn."""
    error = np.abs(np.asarray(states)[:, -1] - exact[: len(states), -1])
    error[:, 0] = np.abs(np.mod(error[:, 0] + np.pi, 2 * np.pi) - np.pi)
    return float(np.median(error.max(1)))


def main():
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--starts", type=int, default=2000)
    args = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    starts = draw_starts(args.starts)
    ways: dict[str, Any] = {
        "strides, 1e-8": by_strides(1e-8),
        "strides, 1e-12, their own": by_strides(1e-12),
        "diffrax, Dopri5, in a kernel": jax.jit(jax.vmap(kernel(solve))),
        "diffrax, Dopri5": jax.jit(lambda xs: lax.map(solve, xs, batch_size=1000)),
    }
    if optional("numba"):
        ways["Numba, Dopri5 by hand"] = by_numba()
    if heyoka := optional("heyoka"):
        ways["heyoka, 1e-8, batches of 8"] = by_heyoka(heyoka, 1e-8)
    if (solvers := optional("pybasin.solvers")) and (torch := optional("torch")):
        ways["pybasin, JaxSolver"] = by_pybasin(solvers, torch)
    exact = np.asarray(by_strides(1e-15)(starts))

    def notes(states) -> str:
        wrong = np.sum(rotates(states) != rotates(exact)[: len(states)])
        return f"{difference(states, exact):10.0e}{wrong:6}"

    print(f"{versions('diffrax', 'numba', 'heyoka', 'pybasin')}; {len(starts)} starts")
    print(f"rotating: {np.mean(rotates(exact)):.4f}; error and wrong fates at the end of a line")
    runs = {name: partial(run, starts) for name, run in ways.items()}
    compare(runs, dict.fromkeys(ways, len(starts)), args.repeats, "ms", notes)


if __name__ == "__main__":
    main()

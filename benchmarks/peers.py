"""How fast are events and resets, beside diffrax, heyoka, jaxonomy and SciPy?

Balls with linear drag leave the ground at speeds from 0.5 to 2, and bounce ten times with a
restitution of 0.9: the time of the tenth bounce, by tolerances of 1e-10. `us each` is the processor
time of one ball on one core, the last number the largest error. heyoka's balls are followed one by
one, as its event calls no Python and only stops the integrator; from a height of exactly 0 it
misses the event. Peers are optional: jaxonomy 3.4 asks for jax 0.9, but runs with 0.10.

The answer: strides take a 16th of heyoka's time, a hundredth of jaxonomy's under `vmap`, and a
3000th of SciPy's, with less error than any. In a kernel diffrax takes 1.3 times as long as strides,
and a fifth of its own time without one. These flights are short: where solves need many steps, or
different numbers of them, a kernel gains more (benchmarks/kernels.py).

    2 cores; jax 0.10.2, diffrax 0.7.2, heyoka 7.13.2, jaxonomy 3.4.1; 20000 balls, with errors
                                          us each       times as long   first
    strides, 1e-10                          1.734             1 (1-1)   2.5 s     1e-14
    diffrax in a kernel, Tsit5 1e-10        2.306    1.33 (1.27-1.35)  99.0 s     2e-09
    diffrax, Tsit5 1e-10                    12.96    7.27 (7.08-8.03)  93.8 s     2e-09
    SciPy, DOP853 1e-10                      5707 3260 (3140-3320)      2.2 s     5e-09
    heyoka, 1e-10, one by one               28.09    15.9 (15.5-18.6)   0.3 s     2e-13
    jaxonomy, 1e-10, by vmap                193.7       110 (104-114)  38.8 s     7e-09

The machine was very busy with other work, which `first` shows.
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
import optimistix
from jax import lax
from ratios import compare, optional, versions
from scipy.integrate import solve_ivp

import walker_jax as wj
from walker_jax.kernels import kernel

DRAG, RESTITUTION, BOUNCES = 0.1, 0.9, 10
NEWTON = optimistix.Newton(rtol=1e-12, atol=1e-12)


class Flight(NamedTuple):
    height: Any
    speed: Any


class Ball(wj.HybridSystem):
    """A ball with drag, each time it leaves the ground."""

    section = ("speed",)

    def lift(self, x):
        return Flight(0 * x[0], x[0])

    def project(self, state):
        return state.speed[None]

    def modes(self):
        field = lambda y: Flight(y.speed, -1 - DRAG * y.speed)
        bounce = lambda y: Flight(0 * y.height, -RESTITUTION * y.speed)
        lands = wj.Guard(lambda y: -y.height, wj.SECTION, reset=bounce)
        return {"flight": wj.Mode(field, (lands,))}


def by_strides(tolerance: float):
    one = lambda speed: jnp.sum(wj.walk(Ball(), speed[None], BOUNCES, tolerance=tolerance).times)
    return jax.jit(jax.vmap(one))


def by_diffrax(speed, tolerance: float):
    field = lambda t, y, args: (y[1], -1 - DRAG * y[1])
    lands = diffrax.Event(lambda t, y, args, **_: y[0], NEWTON, direction=False)

    def fly(_, state):
        speed, time = state
        solution = diffrax.diffeqsolve(
            diffrax.ODETerm(field),
            diffrax.Tsit5(),
            t0=0.0,
            t1=100.0,
            dt0=0.01,
            y0=(0.0, speed),
            stepsize_controller=diffrax.PIDController(rtol=tolerance, atol=tolerance),
            event=lands,
            max_steps=10_000,
            adjoint=diffrax.ForwardMode(),
            throw=False,
        )
        assert solution.ys is not None and solution.ts is not None
        return -RESTITUTION * solution.ys[1][-1], time + solution.ts[-1]

    return lax.fori_loop(0, BOUNCES, fly, (speed, 0.0))[1]


def by_heyoka(heyoka, tolerance: float):
    """One ball after the other; the event stops the integrator."""
    height, speed = heyoka.make_vars("height", "speed")
    pull = -1 - DRAG * speed
    integrator = heyoka.taylor_adaptive(
        [(height, speed), (speed, pull)],
        np.zeros(2),
        tol=tolerance,
        t_events=[heyoka.t_event(height, direction=heyoka.event_direction.negative)],
    )

    def run(speeds):
        times = np.empty(len(speeds))
        for i, speed in enumerate(speeds):
            integrator.time = 0.0
            integrator.reset_cooldowns()
            integrator.state[:] = 1e-15, speed  # from 0 it misses the event
            for _ in range(BOUNCES):
                integrator.propagate_until(1e3)
                integrator.state[:] = 1e-15, -RESTITUTION * integrator.state[1]
            times[i] = integrator.time
        return times

    return run


def by_scipy(speeds, tolerance: float):
    field = lambda t, y: (y[1], -1 - DRAG * y[1])
    lands = lambda t, y: y[0]
    lands.__dict__.update(terminal=True, direction=-1)
    options: dict[str, Any] = dict(events=lands, rtol=tolerance, atol=tolerance)
    times = np.zeros(len(speeds))
    for i, start in enumerate(speeds):
        speed = start
        for _ in range(BOUNCES):
            found = solve_ivp(field, (0, 100), (0.0, speed), "DOP853", **options)
            speed, times[i] = -RESTITUTION * found.y[1, -1], times[i] + found.t[-1]
    return times


def by_jaxonomy(jaxonomy, tolerance: float):
    """Balls side by side, each simulated until a little after its last bounce."""

    class Bouncing(jaxonomy.LeafSystem):
        def __init__(self):
            super().__init__(name="ball")
            start = jnp.array([0.0, 1.0, 0.0, 0.0])  # height, speed, bounces, time of the last
            self.declare_continuous_state(default_value=start, ode=self.rates)
            self.declare_continuous_state_output(name="state")
            self.declare_zero_crossing(
                guard=lambda time, state, *inputs, **parameters: state.continuous_state[0],
                reset_map=self.bounce,
                direction="positive_then_non_positive",
            )

        def rates(self, time, state, *inputs, **parameters):
            speed = state.continuous_state[1]
            return jnp.array([speed, -1 - DRAG * speed, 0.0, 0.0])

        def bounce(self, time, state, *inputs, **parameters):
            _, speed, count, last = state.continuous_state
            counted = jnp.where(count < BOUNCES, time, last)
            return state.with_continuous_state(
                jnp.array([0.0, -RESTITUTION * speed, count + 1, counted])
            )

    system = Bouncing()
    options = jaxonomy.SimulatorOptions(
        rtol=tolerance, atol=tolerance, max_major_steps=100, math_backend="jax"
    )

    def one(speed):
        context = system.create_context()
        context = context.with_continuous_state(jnp.array([0.0, speed, 0.0, 0.0]))
        end = jaxonomy.simulate(system, context, (0.0, 14.0 * speed), options=options)
        return end.context.continuous_state[3]

    return jax.jit(jax.vmap(one))


def main():
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--balls", type=int, default=20_000)
    args = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    speeds = np.linspace(0.5, 2.0, args.balls)
    some, few = speeds[:: args.balls // 500], speeds[:: args.balls // 20]
    one = partial(by_diffrax, tolerance=1e-10)
    ways: dict[str, Any] = {
        "strides, 1e-10": (by_strides(1e-10), speeds),
        "diffrax in a kernel, Tsit5 1e-10": (jax.jit(jax.vmap(kernel(one))), speeds),
        "diffrax, Tsit5 1e-10": (jax.jit(jax.vmap(one)), speeds[::10]),
        "SciPy, DOP853 1e-10": (partial(by_scipy, tolerance=1e-10), few),
    }
    if heyoka := optional("heyoka"):
        ways["heyoka, 1e-10, one by one"] = by_heyoka(heyoka, 1e-10), some
    if jaxonomy := optional("jaxonomy"):
        ways["jaxonomy, 1e-10, by vmap"] = by_jaxonomy(jaxonomy, 1e-10), some
    exact = {len(some): some for _, some in ways.values()}
    exact = {n: np.asarray(by_strides(1e-15)(values)) for n, values in exact.items()}
    error = lambda times: f"{np.abs(np.asarray(times) - exact[len(times)]).max():10.0e}"
    print(f"{versions('diffrax', 'heyoka', 'jaxonomy')}; {len(speeds)} balls, with errors")
    runs = {name: partial(run, values) for name, (run, values) in ways.items()}
    compare(
        runs, {name: len(values) for name, (_, values) in ways.items()}, args.repeats, "us", error
    )


if __name__ == "__main__":
    main()

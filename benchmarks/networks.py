"""How fast are strides with a network as the torque of the hip, and their gradients?

The simplest walker's swing leg is turned by a multilayer perceptron of tanh, within the stride, of
angles and rates, or from stride to stride, of the section's coordinates. Its weights are
parameters. Gradients are those of the end of ten strides with respect to all weights, summed over
the starts. Each row has, for each way, the seconds of a processor (not of a clock) from nothing to
the first strides, and strides per such second once compiled; then the same of gradients. Ways are

- walker_jax;
- `diffrax.diffeqsolve` by hand, with Dopri8, an `Event` with a root finder, and
  `RecursiveCheckpointAdjoint`, at the tolerance at which its heel strikes are those of walker_jax
  to 6e-11;
- walker_jax with `WALKER_JAX_KERNELS=off`, so by XLA alone.

Every way runs in a process of its own with an empty cache, and with all starts at once: 50,000 for
strides, and 1,000 for gradients. Slower ways have fewer (`SMALLER`); rates hardly depend on that.
Starts are near the gait. The last column is the largest difference of diffrax's gradient from
walker_jax's, by the same walks, relative to the largest derivative. Last comes a population of
networks of 2 x 16, all at once and one after the other.

On a machine of two cores, which many others used too, walker_jax made 2.1 times the strides of
diffrax or more, and 2.8 times the gradients or more; a gradient cost 3.4 to 5.7 strides, and later
4.2 at 2 x 16 to 5.2 at 2 x 64, by the shortest of 40 repetitions of 32 walks. From 256 starts 0.004
from the gait diffrax missed heel strikes within three strides, and its gradient was off by 40. A
population of 256 networks made 38,748 strides a second, in a later run on a busier machine, and
networks one after the other 37,527.

                                             walker_jax                               diffrax
    1 x 8   within   1.9 s  189122/s    9.2 s  47406/s |   3.9 s   30452/s   16.0 s   4583/s | 4e-09
    2 x 16  within   2.3 s   60039/s   14.9 s  11272/s |   3.6 s   22376/s   15.0 s   2266/s | 4e-09
    2 x 32  within   2.4 s   29168/s   13.4 s   5151/s |   3.4 s   13813/s   13.3 s   1823/s | 4e-09
    1 x 8   once     1.2 s  957075/s    3.5 s 283185/s |   3.0 s   38794/s   12.6 s   4511/s | 4e-09
    2 x 16  once     1.2 s  948875/s    4.1 s 224763/s |   3.6 s   39897/s   15.2 s   6549/s | 4e-09

    python benchmarks/networks.py [--only 2x16 2x16-once population] [--starts N] [--ways WAYS]
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from typing import Any, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix

import walker_jax as wj
from walker_jax.hybrid.modes import SECTION, Guard, Mode

jax.config.update("jax_enable_x64", True)
SLOPE, GAIN = 0.009, 0.0002
REPEATS = 2
TOLERANCE = 1e-12
"""Of diffrax; that of walker_jax is its default, of the same size."""
AHEAD = -0.3
"""The angle between the legs from which on a swing leg is ahead, and its foot comes down."""
WAYS = ("walker_jax", "diffrax", "XLA")
IN_A_ROW = 10
"""Strides of a walk that is differentiated."""
FEWER = 50
"""So many times fewer walks are differentiated than strides made."""
SMALLER = {"walker_jax": 1, "diffrax": 25, "XLA": 100}
"""So many times fewer strides are made and differentiated by slower ways."""
COMPARED = 40
"""Walks whose gradients are compared."""
LEAST_STARTS = COMPARED * FEWER * SMALLER["diffrax"]
"""Starts from which `diffeqsolve` too differentiates as many walks."""
NETWORKS, ALONE = 256, 8
"""Networks of a population, and of those that walk one by one beside it."""


class State(NamedTuple):
    theta: Any
    phi: Any
    thetadot: Any
    phidot: Any
    torque: Any


def network(width: int, layers: int, within: bool, key: Any = None) -> eqx.nn.MLP:
    """Return a perceptron with drawn weights, whose torques leave every walker walking."""
    key = jax.random.key(width) if key is None else key
    inputs = 4 if within else 2
    return eqx.nn.MLP(inputs, "scalar", width, layers, activation=jnp.tanh, key=key)


def rates(policy, within: bool, y: State) -> State:
    angle = y.theta - SLOPE
    torque = GAIN * policy(jnp.stack(y[:4])) if within else y.torque
    fall = jnp.sin(angle)
    swing = jnp.sin(y.phi) * (y.thetadot**2 - jnp.cos(angle)) + fall + torque
    return State(y.thetadot, y.phidot, fall, swing, jnp.zeros_like(angle))


def begin(policy, within: bool, x) -> State:
    held = jnp.zeros_like(x[0]) if within else GAIN * policy(x)
    return State(x[0], 2 * x[0], x[1], (1 - jnp.cos(2 * x[0])) * x[1], held)


def after(y: State):
    """Return the section's coordinates after heel strike."""
    return jnp.stack([-y.theta, jnp.cos(2 * y.theta) * y.thetadot])


class NetworkWalker(wj.HybridSystem):
    """The simplest walker with a network as the torque of its hip."""

    policy: Any
    within: bool = eqx.field(static=True)
    section = ("theta", "thetadot")

    def modes(self):
        reset = lambda y: self.lift(after(y))
        ahead = lambda y: AHEAD - y.phi
        strikes = Guard(lambda y: y.phi - 2 * y.theta, SECTION, (ahead,), reset=reset)
        stops = Guard(lambda y: y.thetadot, "BACKWARD", at_once=True)
        falls = Guard(lambda y: -np.pi / 2 - y.theta, "FORWARD")
        field = lambda y: rates(self.policy, self.within, y)
        return {"swing": Mode(field, (stops, falls, strikes))}

    def lift(self, x):
        return begin(self.policy, self.within, x)

    def project(self, state):
        return jnp.stack([state.theta, state.thetadot])


def by_package(policy, within: bool, x, adjoint: Any = None):
    return wj.stride(NetworkWalker(policy, within), x).state


def by_hand(policy, within: bool, x, adjoint: Any = None):
    """Make a stride by `diffeqsolve`, as one would write it."""
    contact = lambda t, y, args, **_: jnp.where(y.phi < AHEAD, y.phi - 2 * y.theta, -1.0)
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(lambda t, y, policy: rates(policy, within, y)),
        diffrax.Dopri8(),
        0.0,
        10.0,
        0.1,
        begin(policy, within, x),
        args=policy,
        stepsize_controller=diffrax.PIDController(rtol=TOLERANCE, atol=TOLERANCE),
        event=diffrax.Event(contact, optimistix.Newton(1e-12, 1e-12), direction=True),
        adjoint=adjoint or diffrax.ForwardMode(),
        max_steps=256,
        throw=False,
    )
    return after(jax.tree.map(lambda y: y[-1], solution.ys))


def functions(way: str, within: bool):
    """Return the functions of a policy and starts: strides, and the gradient of several."""
    step = by_hand if way == "diffrax" else by_package
    checkpoints = diffrax.RecursiveCheckpointAdjoint()

    def ends(policy, xs):
        following = lambda x, _: (step(policy, within, x, checkpoints), None)
        walk = lambda x: jax.lax.scan(following, x, length=IN_A_ROW)[0]
        return jnp.sum(jax.vmap(walk)(xs))

    strides = lambda policy, xs: jax.vmap(lambda x: step(policy, within, x))(xs)
    return map(eqx.filter_jit, (strides, eqx.filter_grad(ends)))


def near_the_gait(starts: int) -> np.ndarray:
    """Return starts of walks that do not fall; fewer are the first ones of more."""
    return np.random.default_rng(0).uniform(0.199, 0.201, (starts, 2)) * [1, -1]


def measure(way: str, width: int, layers: int, within: bool, starts: int, file: str) -> None:
    """Print seconds until the first results, and numbers per second; save the gradient."""
    policy = network(width, layers, within)
    xs = near_the_gait(starts)
    found, strides = [], 1
    forward, gradient = functions(way, within)
    for compute in (forward, gradient):
        times, given = [], jnp.asarray(xs)
        for _ in range(REPEATS + 1):
            start = time.process_time()
            found = jax.block_until_ready(compute(policy, given))
            times.append(time.process_time() - start)
        print(times[0] - min(times[1:]), strides * len(xs) / min(times[1:]))
        xs, strides = xs[: starts // FEWER], IN_A_ROW
    if len(xs) > COMPARED:
        found = gradient(policy, jnp.asarray(xs[:COMPARED]))
    np.save(file, np.concatenate([np.ravel(leaf) for leaf in jax.tree.leaves(found)]))


def report(width: int, layers: int, within: bool, starts: int, ways: list[str]) -> None:
    cells, gradients = [], []
    for way in ways:
        with tempfile.TemporaryDirectory() as folder:
            settings = {"WALKER_JAX_CACHE_DIR": folder, "JAX_ENABLE_COMPILATION_CACHE": "0"}
            if way == "XLA":
                settings["WALKER_JAX_KERNELS"] = "off"
            file = f"{folder}/gradient.npy"
            given = [way, width, layers, int(within), starts // SMALLER[way], file]
            done = subprocess.run(
                [sys.executable, __file__, "--one", *map(str, given)],
                env=os.environ | settings,
                capture_output=True,
                text=True,
                check=True,
            )
            gradients.append(np.load(file))
        compiling, rate, longer, slower = map(float, done.stdout.split())
        cells.append(f"{compiling:6.1f} s {rate:7.0f}/s {longer:6.1f} s {slower:6.0f}/s")
    where = "within" if within else "once"
    known = dict(zip(ways, gradients, strict=True))
    own, other = (known.get(way, np.array([np.nan])) for way in WAYS[:2])
    wrong = np.max(np.abs(other - own)) / np.max(np.abs(own))
    print(f"    {layers} x {width:<3} {where:6}" + " |".join(cells) + f" | {wrong:.0e}", flush=True)


def report_population(width: int, layers: int, starts: int) -> None:
    """Print strides per second of many networks at once, and of some one after the other."""
    keys, xs = jax.random.split(jax.random.key(0), NETWORKS), jnp.asarray(near_the_gait(starts))
    make = lambda key: NetworkWalker(network(width, layers, True, key), True)
    walkers, policies = eqx.filter_vmap(make)(keys), list(map(make, keys[:ALONE]))
    one = jax.jit(jax.vmap(wj.stride, (None, 0)))
    every = jax.jit(jax.vmap(jax.vmap(wj.stride, (None, 0)), (0, None)))
    together, alone = lambda: every(walkers, xs), lambda: [one(each, xs) for each in policies]
    for compute, count in ((together, NETWORKS), (alone, ALONE)):
        jax.block_until_ready(compute())
        times = []
        for _ in range(REPEATS):
            start = time.process_time()
            jax.block_until_ready(compute())
            times.append(time.process_time() - start)
        print(f"{count:5} networks {count * starts / min(times):8.0f}/s", flush=True)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--one"]:
        way, *numbers, file = sys.argv[2:]
        width, layers, within, starts = map(int, numbers)
        measure(way, width, layers, bool(within), starts, file)
        sys.exit()
    rows = {
        f"{layers}x{width}{'' if within else '-once'}": (width, layers, within)
        for within in (True, False)
        for layers in (1, 2)
        for width in (8, 16, 32, 64)
    }
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--only", nargs="+", choices=[*rows, "population"], help="rows")
    parser.add_argument("--starts", type=int, default=LEAST_STARTS)
    parser.add_argument("--ways", nargs="+", choices=WAYS, default=WAYS)
    given = parser.parse_args()
    if given.starts < LEAST_STARTS:
        parser.error(f"--starts must be at least {LEAST_STARTS}, not {given.starts}")
    print(" " * 17 + "".join(f"{way:>38}" for way in given.ways))
    for row in given.only or [*rows, "population"]:
        if row == "population":
            report_population(16, 2, given.starts // FEWER)
        else:
            report(*rows[row], given.starts, given.ways)

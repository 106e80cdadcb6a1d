"""How fast are strides with a network as the torque of the hip?

The simplest walker's swing leg is turned by a multilayer perceptron of tanh, within the stride, of
angles and rates, or from stride to stride, of the section's coordinates. Its weights are constants.
Each row has the seconds of a processor (not of a clock) from nothing to the first stride, and the
strides per such second once compiled, by

- walker_jax;
- walker_jax with `WALKER_JAX_KERNELS=off`, so by XLA alone;
- `diffrax.diffeqsolve` by hand, within the stride, with Dopri8 and its event, at the tolerances at
  which its heel strikes are those of walker_jax to 4e-11.

Every variant runs in a process of its own with an empty cache, and with all starts at once. Starts
are near the gait, so all make a stride.

On a machine of two cores, which others used too:

                                     walker_jax                     XLA                 diffrax
    1 x 8   within the stride    2.0 s    111909/s     12.4 s     17376/s      3.5 s     28646/s
    1 x 16  within the stride    1.9 s     86662/s     12.2 s     12066/s      3.6 s     31300/s
    1 x 32  within the stride    1.7 s     53803/s     11.9 s      8493/s      3.5 s     25402/s
    1 x 64  within the stride    1.9 s     28408/s     11.8 s      4782/s      3.4 s     14883/s
    2 x 8   within the stride    1.7 s     44897/s     11.3 s      9898/s      2.8 s     26167/s
    2 x 16  within the stride    1.7 s     51591/s     11.4 s      7568/s      2.7 s     20818/s
    2 x 32  within the stride    1.7 s     24334/s     10.4 s      4582/s      3.0 s      7386/s
    2 x 64  within the stride    1.9 s     10915/s     11.1 s      1978/s      3.0 s      5034/s
    1 x 8   once a stride       1.0 s    400680/s      7.1 s     46726/s      2.6 s     35432/s
    1 x 16  once a stride       1.0 s    420936/s      7.0 s     48366/s      2.6 s     40229/s
    1 x 32  once a stride       1.0 s    383998/s      7.3 s     41137/s      2.7 s     38864/s
    1 x 64  once a stride       1.0 s    370265/s      6.8 s     37446/s      2.7 s     35484/s
    2 x 8   once a stride       1.0 s    311321/s      8.0 s     47892/s      3.2 s     32750/s
    2 x 16  once a stride       1.1 s    297016/s      7.5 s     36806/s      3.1 s     39421/s
    2 x 32  once a stride       1.1 s    389047/s      7.7 s     38163/s      3.3 s     41851/s
    2 x 64  once a stride       1.2 s    316720/s      8.2 s     32965/s      3.2 s     35845/s

    python benchmarks/networks.py [WIDTHS [STARTS]]
"""

import itertools
import os
import subprocess
import sys
import tempfile
import time
from typing import Any, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import optimistix

import walker_jax as wj
from walker_jax.hybrid.modes import SECTION, Guard, Mode

jax.config.update("jax_enable_x64", True)
SLOPE, REPEATS = 0.009, 2
AHEAD = -0.3
"""The angle between the legs from which on a swing leg is ahead, and its foot comes down."""
WAYS = ("walker_jax", "XLA", "diffrax")


class State(NamedTuple):
    theta: Any
    phi: Any
    thetadot: Any
    phidot: Any
    torque: Any


def network(width: int, layers: int, inputs: int):
    """Return a perceptron with drawn weights, from inputs to a small torque."""
    rng = np.random.default_rng(width)
    sizes = [inputs, *[width] * layers]
    hidden = [
        (jnp.asarray(rng.normal(size=(b, a)) / np.sqrt(a)), jnp.asarray(rng.normal(size=b) / 10))
        for a, b in itertools.pairwise(sizes)
    ]
    last = jnp.asarray(rng.normal(size=width) * 0.02 / np.sqrt(width))

    def torque(x):
        for weights, bias in hidden:
            x = jnp.tanh(weights @ x + bias)
        return last @ x

    return torque


def field_of(torque, within: bool):
    def field(y: State) -> State:
        angle = y.theta - SLOPE
        turned = torque(jnp.stack(y[:4])) if within else y.torque
        fall = jnp.sin(angle)
        swing = jnp.sin(y.phi) * (y.thetadot**2 - jnp.cos(angle)) + fall + turned
        return State(y.thetadot, y.phidot, fall, swing, jnp.zeros_like(angle))

    return field


def begin(torque, within: bool, x) -> State:
    held = jnp.zeros_like(x[0]) if within else torque(x)
    return State(x[0], 2 * x[0], x[1], (1 - jnp.cos(2 * x[0])) * x[1], held)


def after(y: State):
    """Return the section's coordinates after heel strike."""
    return jnp.stack([-y.theta, jnp.cos(2 * y.theta) * y.thetadot])


def walker(torque, within: bool) -> wj.HybridSystem:
    """Return the walker, with the network in the closure of its methods."""

    class NetworkWalker(wj.HybridSystem):
        section = ("theta", "thetadot")

        def modes(self):
            reset = lambda y: begin(torque, within, after(y))
            ahead = lambda y: AHEAD - y.phi
            strikes = Guard(lambda y: y.phi - 2 * y.theta, SECTION, (ahead,), reset=reset)
            stops = Guard(lambda y: y.thetadot, "BACKWARD", at_once=True)
            falls = Guard(lambda y: -np.pi / 2 - y.theta, "FORWARD")
            return {"swing": Mode(field_of(torque, within), (stops, falls, strikes))}

        def lift(self, x):
            return begin(torque, within, x)

        def project(self, state):
            return jnp.stack([state.theta, state.thetadot])

    return NetworkWalker()


def by_hand(torque, within: bool):
    """Return the stride by `diffeqsolve`, as one would write it."""
    field = field_of(torque, within)
    contact = lambda t, y, args, **_: jnp.where(y.phi < AHEAD, y.phi - 2 * y.theta, -1.0)
    event = diffrax.Event(contact, optimistix.Newton(1e-12, 1e-12), direction=True)

    def stride(x):
        solution = diffrax.diffeqsolve(
            diffrax.ODETerm(lambda t, y, args: field(y)),
            diffrax.Dopri8(),
            0.0,
            10.0,
            0.1,
            begin(torque, within, x),
            stepsize_controller=diffrax.PIDController(rtol=1e-12, atol=1e-12),
            event=event,
            adjoint=diffrax.ForwardMode(),
            throw=False,
        )
        return after(jax.tree.map(lambda y: y[-1], solution.ys))

    return jax.jit(jax.vmap(stride))


def measure(way: str, width: int, layers: int, within: bool, starts: int) -> None:
    """Print seconds until the first strides, strides per second, and their mean."""
    torque = network(width, layers, 4 if within else 2)
    rng = np.random.default_rng(0)
    xs = np.stack([rng.uniform(0.198, 0.202, starts), -rng.uniform(0.202, 0.206, starts)], 1)
    if way == "diffrax":
        run = by_hand(torque, within)
    else:
        system = walker(torque, within)
        run = lambda xs: wj.strides(system, xs).state
    times = []
    for _ in range(REPEATS + 1):
        start = time.process_time()
        result = jax.block_until_ready(run(xs))
        times.append(time.process_time() - start)
    seconds = min(times[1:])
    mean = np.nanmean(np.asarray(result), 0)
    print(times[0] - seconds, starts / seconds, *mean, np.isfinite(result[:, 0]).mean())


def report(width: int, layers: int, within: bool, starts: int) -> None:
    cells, means = [], []
    for way in WAYS:
        with tempfile.TemporaryDirectory() as folder:
            settings = {"WALKER_JAX_CACHE_DIR": folder, "JAX_ENABLE_COMPILATION_CACHE": "0"}
            if way == "XLA":
                settings["WALKER_JAX_KERNELS"] = "off"
            given = [way, width, layers, int(within), starts if way != "XLA" else starts // 4]
            done = subprocess.run(
                [sys.executable, __file__, "--one", *map(str, given)],
                env=os.environ | settings,
                capture_output=True,
                text=True,
                check=True,
            )
        compiling, rate, *mean, _ = map(float, done.stdout.split())
        cells.append(f"{compiling:9.1f} s {rate:9.0f}/s")
        means.append(mean)
    where = "within the stride" if within else "once a stride"
    print(f"    {layers} x {width:<3} {where:18}" + "".join(cells), flush=True)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--one"]:
        way, *numbers = sys.argv[2:]
        width, layers, within, starts = map(int, numbers)
        measure(way, width, layers, bool(within), starts)
    else:
        widths = [int(x) for x in sys.argv[1].split(",")] if len(sys.argv) > 1 else [8, 16, 32, 64]
        starts = int(sys.argv[2]) if len(sys.argv) > 2 else 2048
        print(" " * 23 + "".join(f"{way:>24}" for way in WAYS))
        for within in (True, False):
            for layers in (1, 2):
                for width in widths:
                    report(width, layers, within, starts)

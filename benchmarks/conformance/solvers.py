"""Three solvers for the runs of the conformance set, each as its users would write it.

A solver is a function from a system and a run to an `Answer`.
"""

from typing import Any, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix
from formulas import FUNCTIONS, Formulas, Kind
from scipy.integrate import solve_ivp

import walker_jax as wj

jax.config.update("jax_enable_x64", True)
NUMPY = Kind(float, {one: getattr(np, one) for one in FUNCTIONS} | {"pi": np.pi, "max": max})
JAX = Kind(float, {one: getattr(jnp, one) for one in FUNCTIONS} | {"pi": np.pi, "max": jnp.maximum})
MOST_EVENTS = 60
"""A run that is longer has gone wrong."""
SKIP = 1e-9
"""Time by which a solver goes on where an event was not admitted."""


class Answer(NamedTuple):
    """A run: its events, its end, and the derivatives of that."""

    events: list[tuple[str, str, float]]
    """Mode, where it led, and time."""
    end: dict[str, float]
    by: dict[str, dict[str, float]]
    """Derivatives of the end by the start and a parameter."""


def walker_jax(system: dict[str, Any], run: dict[str, Any]) -> Answer:
    """A `HybridSystem` whose section is the end of the run; derivatives by `jax.jacfwd`."""
    formulas = Formulas(system, JAX)
    names, start = formulas.variables, np.array([*formulas.start(run).values()])
    as_arrays = lambda found, y: {name: found[name] + 0 * y["t"] for name in names}

    class Machine(wj.HybridSystem):
        values: dict[str, Any]
        section = tuple(names)

        def lift(self, x: Any) -> Any:
            return dict(zip(names, x, strict=True))

        def project(self, state: Any) -> Any:
            return jnp.stack([state[name] for name in names])

        def modes(self) -> dict[str, wj.Mode]:
            def guard(mode: str, one: dict[str, Any]) -> wj.Guard:
                value = lambda formula: (
                    lambda y: formulas.evaluate(mode, [formula], y, self.values)[0]
                )
                goes_on = one["leads_to"] in system["modes"]
                return wj.Guard(
                    value(one["rises"]),
                    one["leads_to"] if goes_on else wj.SECTION,
                    tuple(value(admits) for admits in one.get("admits", [])),
                    reset=lambda y: as_arrays(formulas.reset(mode, one, y, self.values), y),
                )

            return {
                mode: wj.Mode(
                    lambda y, mode=mode: as_arrays(formulas.field(mode, y, self.values), y),
                    tuple(guard(mode, one) for one in formulas.guards(mode, run)),
                )
                for mode in sorted(system["modes"], key=lambda mode: mode != run["mode"])
            }

    p = formulas.parameters(run)
    told = wj.explain(Machine(p), start)
    times = np.cumsum([one.time for one in told.modes])
    events = []
    for one, time in zip(told.modes, times, strict=True):
        led_to = one.led_to.removesuffix(" at once")
        if one.rises:  # which names the end of the run, too
            led_to = formulas.guards(one.name, run)[one.rises[-1].guard]["leads_to"]
        events.append((one.name, led_to, float(time)))
    end = lambda z: wj.stride(Machine(p | {run["by"]: z[-1]}), z[:-1]).state
    z = jnp.array([*start, p[run["by"]]])
    return as_answer(names, run, events, end(z), jax.jacfwd(end)(z))


def as_answer(names: list[str], run: Any, events: Any, end: Any, slopes: Any) -> Answer:
    """Return the answer of an end and of its derivatives, of which those by the time are left."""
    named = lambda values: dict(zip(names, map(float, values), strict=True))
    by = dict(zip([*names, run["by"]], np.asarray(slopes).T, strict=True))
    return Answer(events, named(end), {name: named(one) for name, one in by.items() if name != "t"})


def scipy(system: dict[str, Any], run: dict[str, Any]) -> Answer:
    """`solve_ivp` with DOP853 at 1e-13, mode by mode; derivatives are differences of runs."""
    formulas = Formulas(system, NUMPY)
    names = formulas.variables
    state = lambda y: dict(zip(names, map(float, y), strict=True))

    def follow_mode(mode: str, y: Any, p: Any) -> tuple[int, np.ndarray, float]:
        """The guard that ended the mode, the state there, and the value of the guard."""
        guards = formulas.guards(mode, run)
        value = lambda formula, y: formulas.evaluate(mode, [formula], state(y), p)[0]
        rates = lambda _, y: [*formulas.field(mode, state(y), p).values()]

        def event(guard: dict[str, Any]) -> Any:
            def counts(_: float, y: Any) -> float:
                admitted = all(value(one, y) > 0 for one in guard.get("admits", []))
                return value(guard["rises"], y) if admitted else -1.0

            counts.terminal = True  # pyright: ignore[reportFunctionMemberAccess] (where SciPy reads it)
            counts.direction = 1  # pyright: ignore[reportFunctionMemberAccess] (as above)
            return counts

        events: Any = [*map(event, guards)]
        made = solve_ivp(rates, (0, 100), y, "DOP853", events=events, rtol=1e-13, atol=1e-13)
        which = next((i for i, one in enumerate(made.t_events or []) if one.size), -1)
        return which, made.y[:, -1], value(guards[which]["rises"], made.y[:, -1])

    def follow(start: Any, p: Any) -> tuple[list[tuple[str, str, float]], np.ndarray]:
        y, mode, events = np.array(start), run["mode"], []
        while len(events) < MOST_EVENTS:
            which, y, value = follow_mode(mode, y, p)
            guard = formulas.guards(mode, run)[which]
            if which >= 0 and abs(value) > 1e-6:  # it was admitted later
                y = y + SKIP * np.array([*formulas.field(mode, state(y), p).values()])
                continue
            events.append((mode, guard["leads_to"] if which >= 0 else "", y[0]))
            if events[-1][1] not in system["modes"]:
                break
            y = np.array([*formulas.reset(mode, guard, state(y), p).values()])
            mode = guard["leads_to"]
        return events, y

    start, p = [*formulas.start(run).values()], formulas.parameters(run)
    events, end = follow(start, p)

    def moved(i: int, step: float) -> np.ndarray:
        if i == len(names):
            return follow(start, p | {run["by"]: p[run["by"]] + step})[1]
        return follow([one + step * (i == k) for k, one in enumerate(start)], p)[1]

    h = 1e-6
    slopes = [(moved(i, h) - moved(i, -h)) / (2 * h) for i in range(len(names) + 1)]
    return as_answer(names, run, events, end, np.array(slopes).T)


def by_diffrax(system: dict[str, Any], run: dict[str, Any]) -> Answer:
    """`diffeqsolve` with Dopri8 at 1e-12 and an `Event`, mode by mode; derivatives by `jacfwd`."""
    formulas = Formulas(system, JAX)
    names = formulas.variables
    state = lambda y: dict(zip(names, y, strict=True))
    stacked = lambda s: jnp.stack([jnp.asarray(one, float) for one in s.values()])

    def piece(mode: str) -> Any:
        guards = formulas.guards(mode, run)
        value = lambda formula, y, p: formulas.evaluate(mode, [formula], state(y), p)[0]

        def event(guard: dict[str, Any]) -> Any:
            def counts(t: Any, y: Any, args: Any, **_: Any) -> Any:
                admits = [value(one, y, args) > 0 for one in guard.get("admits", [])]
                return jnp.where(jnp.array(admits).all(), value(guard["rises"], y, args), -1.0)

            return counts

        @eqx.filter_jit
        def solve(y: Any, p: Any) -> Any:
            made: Any = diffrax.diffeqsolve(
                diffrax.ODETerm(lambda t, y, p: stacked(formulas.field(mode, state(y), p))),
                *(diffrax.Dopri8(), 0.0, 100.0, None, y, p),
                stepsize_controller=diffrax.PIDController(rtol=1e-12, atol=1e-12),
                event=diffrax.Event(
                    [*map(event, guards)], optimistix.Newton(1e-13, 1e-13), direction=True
                ),
                adjoint=diffrax.ForwardMode(),
                max_steps=100_000,
                throw=False,
            )
            return made.ys[-1], jnp.stack(made.event_mask)

        return solve

    pieces = {mode: piece(mode) for mode in system["modes"]}

    def follow(z: Any, way: list[tuple[str, int]] | None) -> Any:
        """The end of a run; the way is noted at first, and known when it is differentiated."""
        y, p, mode, events = z[:-1], own | {run["by"]: z[-1]}, run["mode"], []
        while len(events) < MOST_EVENTS:
            y, mask = pieces[mode](y, p)
            which = way[len(events)][1] if way else int(jnp.argmax(mask)) if mask.any() else -1
            guards = formulas.guards(mode, run)
            if way is None and which >= 0:
                rises = formulas.evaluate(mode, [guards[which]["rises"]], state(y), p)[0]
                which = len(guards) if abs(rises) > 1e-6 else which  # it was admitted later
            events.append((mode, which, y[0]))
            if which == len(guards):
                y = y + SKIP * stacked(formulas.field(mode, state(y), p))
                continue
            if which < 0 or guards[which]["leads_to"] not in system["modes"]:
                break
            y = stacked(formulas.reset(mode, guards[which], state(y), p))
            mode = guards[which]["leads_to"]
        return events, y

    own = formulas.parameters(run)
    z = jnp.array([*formulas.start(run).values(), own[run["by"]]])
    events, end = follow(z, None)
    slopes = jax.jacfwd(lambda z: follow(z, [one[:2] for one in events])[1])(z)
    found = []
    for mode, which, time in events:
        leads_to = [one["leads_to"] for one in formulas.guards(mode, run)]
        if which < len(leads_to):
            found.append((mode, leads_to[which] if which >= 0 else "", float(time)))
    return as_answer(names, run, found, end, slopes)


SOLVERS = {"walker_jax": walker_jax, "SciPy": scipy, "diffrax": by_diffrax}

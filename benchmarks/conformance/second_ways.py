"""The same runs a second way: motions in closed form where there is one, else by extrapolation.

A motion is a function from a state of a mode to the state after a time, in mpmath. Guards are
sampled along it, and their rises refined by secants on the motion itself. Derivatives are
differences of whole runs, with the events in the same order. Nothing here is shared with
`taylor_series` but the formulas.
"""

from collections.abc import Callable
from functools import cache, partial
from itertools import pairwise
from typing import Any

from formulas import FUNCTIONS, Formulas, Kind, Numbers
from mpmath import mp, mpf

mp.dps = 55
NUMBERS = Kind(mpf, {name: getattr(mp, name, max) for name in FUNCTIONS} | {"pi": mp.pi})
Motion = Callable[[str, Numbers, Any], Numbers]
ZERO = mpf(10) ** -30
SAMPLES = {
    "buck_converter": 2e-5,
    "stiff_ground": 5e-5,
    "kneed_walker": 1 / 32,
    "rocking_block": 1 / 32,
}
"""Times between samples of the guards where they are not `USUAL`."""
USUAL = 1 / 8
DIFFERENCE = mpf(10) ** -15
"""Step of the differences."""


# Motions


def affine(formulas: Formulas, p: Numbers) -> Motion:
    """Return the motion of fields that are affine, by exponentials of matrices."""

    @cache
    def matrix(mode: str) -> Any:
        names = formulas.variables
        at = lambda **one: [*formulas.field(mode, dict.fromkeys(names, mpf(0)) | one, p).values()]
        constant = at()
        columns = [
            [a - b for a, b in zip(at(**{name: mpf(1)}), constant, strict=True)] for name in names
        ]
        return mp.matrix([*columns, constant]).T

    @cache
    def exponential(mode: str, time: Any) -> Any:
        rates = matrix(mode)
        square = mp.zeros(rates.cols)
        square[: rates.rows, :] = rates
        return mp.expm(square * time)

    def motion(mode: str, state: Numbers, time: Any) -> Numbers:
        end = exponential(mode, time) * mp.matrix([*state.values(), 1])
        return dict(zip(state, end, strict=False))

    return motion


def drag(formulas: Formulas, p: Numbers) -> Motion:
    """v is a tangent of the time on the way up, and a hyperbolic one on the way down."""
    rate, most = mp.sqrt(p["gravity"] * p["drag"]), mp.sqrt(p["gravity"] / p["drag"])

    def motion(mode: str, s: Numbers, time: Any) -> Numbers:
        up = mode == "rise"
        angle = (mp.atan if up else mp.atanh)(s["v"] / most)
        after = angle - rate * time
        tangent, size = (mp.tan, mp.cos) if up else (mp.tanh, mp.cosh)
        way = mp.log(size(after) / size(angle)) / p["drag"]
        return {"t": s["t"] + time, "x": s["x"] + (way if up else -way), "v": most * tangent(after)}

    return motion


def forced(formulas: Formulas, p: Numbers) -> Motion:
    """x is that of the steady state and a damped oscillation."""
    w, z, i = p["frequency"], p["damping"], mp.mpc(0, 1)
    gain = 1 / (1 - w**2 + 2 * i * z * w)
    root = -z + i * mp.sqrt(1 - z**2)

    def motion(mode: str, s: Numbers, time: Any) -> Numbers:
        steady = lambda t: gain * mp.exp(i * w * t)
        x, v = s["x"] - mp.re(steady(s["t"])), s["v"] - mp.re(i * w * steady(s["t"]))
        free = mp.mpc(x, (mp.re(root) * x - v) / mp.im(root)) * mp.exp(root * time)
        now = steady(s["t"] + time)
        return {"t": s["t"] + time, "x": mp.re(now + free), "v": mp.re(i * w * now + root * free)}

    return motion


def swing(angle: Any, rate: Any, time: Any) -> tuple[Any, Any]:
    """Return angle and rate of a pendulum after a time, angle'' = -sin(angle)."""
    energy = (rate**2 / 2 + 1 - mp.cos(angle)) / 2  # 1 where it just stands upright
    if energy < 1:  # sin(angle / 2) = k sn
        k = mp.sqrt(energy)
        began = mp.ellipf(mp.asin(mp.sin(angle / 2) / k), energy)
        began = 2 * mp.ellipk(energy) - began if rate < 0 else began
        sn, cn = (mp.ellipfun(name, began + time, m=energy) for name in ("sn", "cn"))
        return 2 * mp.asin(k * sn), 2 * k * cn
    k = mp.sqrt(energy) * (1 if rate > 0 else -1)  # angle / 2 = am
    at = mp.ellipf(angle / 2, 1 / energy) + k * time
    sn, cn, dn = (mp.ellipfun(name, at, m=1 / energy) for name in ("sn", "cn", "dn"))
    return 2 * mp.atan2(sn, cn), 2 * k * dn


def hanging(formulas: Formulas, p: Numbers) -> Motion:
    def motion(mode: str, s: Numbers, time: Any) -> Numbers:
        angle, rate = swing(s["angle"], s["rate"], time)
        return {"t": s["t"] + time, "angle": angle, "rate": rate}

    return motion


def upright(formulas: Formulas, p: Numbers) -> Motion:
    """A pendulum upside down, whose angle from hanging is its own plus or minus pi."""

    def motion(mode: str, s: Numbers, time: Any) -> Numbers:
        stays = s["rate"] ** 2 / 2 + mp.cos(s["angle"]) < 1
        side = (s["angle"] if stays else -s["rate"]) > 0  # from which side it comes
        turn = -mp.pi if side else mp.pi
        angle, rate = swing(s["angle"] + turn, s["rate"], time)
        return {"t": s["t"] + time, "angle": angle - turn, "rate": rate}

    return motion


def hertz(formulas: Formulas, p: Numbers) -> Motion:
    """Flights are parabolas; a contact returns the speed, after a time that is an integral."""
    gravity, k = p["gravity"], p["stiffness"]

    @cache
    def contact(v: Any) -> Any:
        energy = lambda depth: v**2 + 2 * gravity * depth - 4 * k * depth ** mpf("2.5") / 5
        about = (5 * v**2 / (4 * k)) ** mpf("0.4")
        deepest = mp.findroot(energy, (about, about * mpf("1.001")))
        # depth = deepest w^2 with w = 1 - u^2, so that neither end of the integral is singular
        force, weight = 4 * k * deepest ** mpf("2.5") / 5, 2 * gravity * deepest

        def integrand(u: Any) -> Any:
            w = 1 - u**2
            return w / mp.sqrt(force * (1 + w + w**2 + w**3 + w**4) - weight * (1 + w))

        return 8 * deepest * mp.quad(integrand, [0, 1])

    def motion(mode: str, s: Numbers, time: Any) -> Numbers:
        fall = {"t": s["t"] + time, "x": s["x"], "v": s["v"] - gravity * time}
        if mode == "flight":
            return fall | {"x": s["x"] + s["v"] * time - gravity * time**2 / 2}
        left = -contact(s["v"]) if s["v"] < 0 else s["x"]  # only the end is known, so x is the
        return {"t": s["t"] + time, "x": left + time, "v": abs(s["v"])}  # time past it

    return motion


STAGES = [2 * k for k in range(1, 21)]
PIECE = 1 / 4
"""Longest step of the extrapolation."""


def extrapolated(formulas: Formulas, p: Numbers) -> Motion:
    """The modified midpoint rule by ever more steps, extrapolated (Gragg 1965)."""

    def midpoint(mode: str, state: Numbers, time: Any, steps: int) -> list[Any]:
        h = time / steps
        rates = lambda y: formulas.field(mode, dict(zip(state, y, strict=True)), p).values()
        move = lambda y, h, f: [a + h * b for a, b in zip(y, f, strict=True)]
        before = [*state.values()]
        now = move(before, h, rates(before))
        for _ in range(steps - 1):
            before, now = now, move(before, 2 * h, rates(now))
        ahead = move(before, 2 * h, rates(now))
        return [(a + 2 * b + c) / 4 for a, b, c in zip(before, now, ahead, strict=True)]

    def step(mode: str, state: Numbers, time: Any) -> Numbers | None:
        row: list[list[Any]] = []
        for j, steps in enumerate(STAGES):
            new = [midpoint(mode, state, time, steps)]
            for k in range(j):
                ratio = (mpf(steps) / STAGES[j - k - 1]) ** 2 - 1
                new.append([a + (a - b) / ratio for a, b in zip(new[k], row[k], strict=True)])
            if j and max(abs(a - b) for a, b in zip(new[-1], row[-1], strict=True)) < 1e-44:
                return dict(zip(state, new[-1], strict=True))
            if j == 12 and max(abs(a - b) for a, b in zip(new[-1], row[-1], strict=True)) > 1e-25:
                return None  # nor will it converge
            row = new
        return None

    def motion(mode: str, state: Numbers, time: Any) -> Numbers:
        pieces = max(1, int(mp.ceil(abs(time) / PIECE)))
        for _ in range(pieces):
            made = step(mode, state, time / pieces)
            if made is None:
                half = time / pieces / 2
                made = motion(mode, motion(mode, state, half), half)
            state = made
        return state

    return motion


# Runs


MOTIONS: dict[str, Callable[[Formulas, Numbers], Motion]] = {
    **dict.fromkeys(
        [
            "ball",
            "ball_on_table",
            "buck_converter",
            "corner",
            "layer",
            "relay",
            "rocking_block",
            "stick_slip",
            "stiff_ground",
            "switched_oscillator",
            "thermostat",
            "two_balls",
            "two_tanks",
        ],
        affine,
    ),
    "ball_with_drag": drag,
    "hopper": hertz,
    "impact_oscillator": forced,
    "pendulum_with_stop": hanging,
    "rimless_wheel": upright,
}
"""Closed forms; systems that have none are extrapolated."""


def turning_point(value: Callable[[Any], Any], end: Any, sign: int) -> Any:
    """Return where in (0, end) a value times a sign is greatest, by golden sections."""
    ratio, a, b = (mp.sqrt(5) - 1) / 2, mpf(0), mpf(end)
    while b - a > 1e-16 * end:
        c, d = b - ratio * (b - a), a + ratio * (b - a)
        a, b = (a, d) if sign * value(c) > sign * value(d) else (c, b)
    return (a + b) / 2


def rises(value: Callable[[Any], Any], end: Any) -> list[Any]:
    """Return where in [0, end) a value rises through zero, or from it at 0."""
    first, last, begin = value(mpf(0)), value(mpf(end)), mpf(0)
    found = []
    if abs(first) < ZERO:  # what it begins to do
        begin = end * mpf("1e-6")
        first = value(begin)
        found = [mpf(0)] if first > 0 else []
    places = [begin, mpf(end)]
    for sign in (1, -1):
        bend = sign * (2 * value(mpf(end) / 2) - first - last)
        if first * last > 0 and bend > abs(last - first) / 4 and -sign * first > 0:
            middle = turning_point(value, end, sign)
            if sign * value(middle) > 0:
                places = [begin, middle, mpf(end)]
    for a, b in pairwise(places):
        if value(a) < -ZERO and value(b) >= 0:
            found.append(mp.findroot(value, (a, b), solver="illinois", tol=1e-80, maxsteps=200))
    return found


class Runs:
    """Runs of a system, from any start and with any parameters."""

    def __init__(self, system: dict[str, Any], name: str, run: dict[str, Any]):
        self.formulas, self.run = Formulas(system, NUMBERS), run
        self.motion_of = MOTIONS.get(name, extrapolated)
        self.sample = mpf(SAMPLES.get(name, USUAL))

    def value(self, mode: str, guard: dict[str, Any], motion: Any, p: Numbers) -> Any:
        """Return the value of a guard along a motion, as a function of the time."""

        def value(time: Any) -> Any:
            return self.formulas.evaluate(mode, [guard["rises"]], motion(time), p)[0]

        return value

    def next_event(self, motion: Motion, mode: str, state: Numbers, p: Numbers) -> tuple[Any, int]:
        """Return the duration of a mode and the guard that ends it, by samples of all guards."""
        passed, here = mpf(0), state
        while True:
            found: list[tuple[Any, int]] = []
            ahead = cache(partial(motion, mode, here))
            for i, guard in enumerate(self.formulas.guards(mode, self.run)):
                for x in rises(self.value(mode, guard, ahead, p), self.sample):
                    there = ahead(x)
                    admits = self.formulas.evaluate(mode, guard.get("admits", []), there, p)
                    if all(one > 0 for one in admits):
                        found.append((x, i))
            if found:
                time, which = min(found)
                return passed + time, which
            passed, here = passed + self.sample, ahead(self.sample)

    def follow(self, start: Numbers, p: Numbers, way: list[Any] | None = None) -> Any:
        """Return the events as (mode, guard, time, duration), and the end; along a known way."""
        motion, events = self.motion_of(self.formulas, p), []
        state, mode = start, self.run["mode"]
        while True:
            if way:
                _, which, _, duration = way[len(events)]
            else:
                duration, which = self.next_event(motion, mode, state, p)
            guard = self.formulas.guards(mode, self.run)[which]
            there = motion(mode, state, duration)
            if way:  # which is that of another run, close by
                value = self.value(mode, guard, partial(motion, mode, there), p)
                x = mp.findroot(value, (mpf(0), mpf(10) ** -14 * self.sample), tol=1e-80)
                there, duration = motion(mode, there, x), duration + x
            events.append((mode, which, there["t"], duration))
            if guard["leads_to"] not in self.formulas.system["modes"]:
                return events, there
            state = self.formulas.reset(mode, guard, there, p)
            mode = guard["leads_to"]

    def derivatives(self, way: list[Any]) -> dict[str, Numbers]:
        """Return the derivatives of the end by each variable of the start and the parameter."""
        start, p = self.formulas.start(self.run), self.formulas.parameters(self.run)
        found = {}
        for name in [*self.formulas.system["variables"], self.run["by"]]:
            ends = {}
            for k in (-2, -1, 1, 2):
                moved = {name: ({} | p | start)[name] + k * DIFFERENCE}
                ends[k] = self.follow(
                    start | {n: x for n, x in moved.items() if n in start},
                    p | {n: x for n, x in moved.items() if n in p},
                    way,
                )[1]
            found[name] = {
                one: (8 * (ends[1][one] - ends[-1][one]) - (ends[2][one] - ends[-2][one]))
                / (12 * DIFFERENCE)
                for one in start
            }
        return found

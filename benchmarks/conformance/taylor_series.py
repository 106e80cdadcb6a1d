"""Runs of a system by Taylor series with more than forty digits, in arithmetic of python-flint.

Numbers carry their derivatives by the start and a parameter, so a step is a step of the variational
equations too. A guard is a polynomial along a step; intervals that certainly hold no rise are
discarded until the first rise is alone in one. At an event derivatives are those on its surface,
from which the reset leads on; the time is a variable like others, which each mode counts from the
event that began it.
"""

from collections.abc import Iterator
from typing import Any

from flint import arb, arb_poly, arb_series, ctx
from formulas import FUNCTIONS, Formulas, Kind, Numbers

ORDER = 44
TOLERANCE = 1e-46
"""Last term of a step's series, relative to the variable."""
TINY = arb(10) ** -29
"""A guard below this is zero."""
LONGEST = 1.0
ctx.dps = 60


class Jet:
    """A number, or a series of the time, and its derivatives."""

    def __init__(self, value: Any, by: tuple[Any, ...]):
        self.value, self.by = value, by

    def chain(self, value: Any, slope: Any) -> "Jet":
        return Jet(value, tuple(slope * one for one in self.by))

    def __add__(self, other: Any) -> "Jet":
        if not isinstance(other, Jet):
            return Jet(self.value + other, self.by)
        pairs = zip(self.by, other.by, strict=True)
        return Jet(self.value + other.value, tuple(a + b for a, b in pairs))

    def __mul__(self, other: Any) -> "Jet":
        if not isinstance(other, Jet):
            return self.chain(self.value * other, other)
        pairs = zip(self.by, other.by, strict=True)
        by = tuple(a * other.value + self.value * b for a, b in pairs)
        return Jet(self.value * other.value, by)

    def __neg__(self) -> "Jet":
        return self * -1

    def __sub__(self, other: Any) -> "Jet":
        return self + -other

    def __rsub__(self, other: Any) -> "Jet":
        return -self + other

    def __truediv__(self, other: Any) -> "Jet":
        if not isinstance(other, Jet):
            return self * (1 / arb(other))
        inverse = 1 / other.value
        return self * other.chain(inverse, -(inverse * inverse))

    def __rtruediv__(self, other: Any) -> "Jet":
        inverse = 1 / self.value
        return self.chain(inverse, -(inverse * inverse)) * other

    def __pow__(self, power: int) -> "Jet":
        product = self
        for _ in range(power - 1):
            product = product * self
        return product

    __radd__, __rmul__ = __add__, __mul__

    def sin(self) -> "Jet":
        return self.chain(self.value.sin(), self.value.cos())

    def cos(self) -> "Jet":
        return self.chain(self.value.cos(), -self.value.sin())

    def exp(self) -> "Jet":
        return self.chain(self.value.exp(), self.value.exp())

    def sqrt(self) -> "Jet":
        root = self.value.sqrt()
        return self.chain(root, 1 / (root * 2))


def apply(name: str) -> Any:
    return lambda x: getattr(x if isinstance(x, Jet | arb) else arb(x), name)()


SERIES = Kind(arb, {one: apply(one) for one in FUNCTIONS} | {"pi": arb.pi()})


def rises(coefficients: list[Any], length: Any) -> Iterator[Any]:
    """Yield where in [0, length) a polynomial rises through zero, or from zero at the start."""
    zeros = next((k for k, one in enumerate(coefficients) if abs(one) > TINY), None)
    if zeros is None:
        return
    if zeros and coefficients[zeros] > 0:
        yield arb(0)
    p = arb_poly(coefficients[zeros:])
    slope = p.derivative()
    left = [(arb(0), length)]
    while left:
        a, b = left.pop()
        middle, half = (a + b) / 2, (b - a) / 2
        around, shifted = arb(0, half), p(arb_poly([middle, 1]))
        if abs(shifted(around)) > 0:
            continue
        rate = shifted.derivative()(around)
        if rate < 0 or (rate > 0 and (p(a) > TINY or p(b) < TINY)):  # at b: the next one's
            continue
        if rate > 0:
            yield root(p, slope, middle)
        elif half < 1e-28:
            raise ArithmeticError(f"a guard only touches zero, {middle} after a step began")
        else:
            left += [(middle, b), (a, middle)]


def root(p: Any, slope: Any, x: Any) -> Any:
    """Return the zero of a polynomial near x, by Newton's iteration."""
    for _ in range(100):
        step = p(x) / slope(x)
        x = (x - step).mid()
        if abs(step) < 1e-48 * (1 + abs(x)):
            return x
    raise ArithmeticError(f"Newton's iteration has not ended at {x}")


def coefficient(number: Any, k: int) -> Any:
    """Return a coefficient of a series; of a constant the first one is its value."""
    if isinstance(number, arb_series):
        return number[k]
    return arb(number) if k == 0 else arb(0)


def expand(formulas: Formulas, mode: str, state: Numbers, p: Numbers) -> dict[str, list[list[Any]]]:
    """Return the coefficients of each variable along the motion, and those of its derivatives."""
    found = {name: [[one.value], *([d] for d in one.by)] for name, one in state.items()}
    for k in range(ORDER):
        ctx.cap = k + 1
        rates = formulas.field(mode, as_series(found, k + 1), p)
        for name, lists in found.items():
            rate = rates[name]
            parts = (rate.value, *rate.by) if isinstance(rate, Jet) else (rate,)
            for i, one in enumerate(lists):
                one.append(coefficient(parts[i], k) / (k + 1) if i < len(parts) else arb(0))
    return found


def as_series(found: dict[str, list[list[Any]]], length: int) -> Numbers:
    """Return the variables as series of the time, with as many coefficients."""
    series = {name: [arb_series(one, length) for one in lists] for name, lists in found.items()}
    return {name: Jet(value, tuple(by)) for name, (value, *by) in series.items()}


def at(found: dict[str, list[list[Any]]], time: Any) -> Numbers:
    """Return the state at a time of a step, and its derivatives."""
    ends = {name: [arb_poly(one)(time).mid() for one in lists] for name, lists in found.items()}
    return {name: Jet(value, tuple(by)) for name, (value, *by) in ends.items()}


def step_length(found: dict[str, list[list[Any]]]) -> Any:
    lengths = [LONGEST]
    for one in (one for lists in found.values() for one in lists):
        for k in (ORDER - 1, ORDER):
            last = abs(float(one[k]))
            if last:
                lengths.append((TOLERANCE * max(abs(float(one[0])), 1.0) / last) ** (1 / k))
    return arb(min(lengths))


def follow_step(
    formulas: Formulas, mode: str, guards: list[dict[str, Any]], state: Numbers, p: Numbers
) -> tuple[Numbers, int | None]:
    """Return the state at the end of a step, and the guard that has ended the mode there."""
    found = expand(formulas, mode, state, p)
    length = step_length(found)
    ctx.cap = ORDER + 1
    series = as_series(found, ORDER + 1)
    first: tuple[Any, int | None] = length, None
    for i, guard in enumerate(guards):
        (value,) = formulas.evaluate(mode, [guard["rises"]], series, p)
        for time in rises([coefficient(value.value, k) for k in range(ORDER + 1)], length):
            if not time < first[0]:
                break
            there = formulas.evaluate(mode, guard.get("admits", []), at(found, time), p)
            if all(one.value > 0 for one in there):
                first = time, i
                break
    return at(found, first[0]), first[1]


def on_surface(
    formulas: Formulas, mode: str, guard: dict[str, Any], state: Numbers, p: Numbers
) -> Numbers:
    """Return the state with derivatives on the surface where a guard is zero."""
    rates = formulas.field(mode, state, p)
    plain = {name: one.value if isinstance(one, Jet) else arb(one) for name, one in rates.items()}
    along = {name: Jet(one.value, (plain[name],)) for name, one in state.items()}
    constant = {name: Jet(one.value, (arb(0),)) for name, one in p.items()}
    (value,) = formulas.evaluate(mode, [guard["rises"]], state, p)
    (rate,) = formulas.evaluate(mode, [guard["rises"]], along, constant)
    times = [-(one / rate.by[0]) for one in value.by]
    return {
        name: Jet(one.value, tuple(d + plain[name] * t for d, t in zip(one.by, times, strict=True)))
        for name, one in state.items()
    }


def solve(system: dict[str, Any], run: dict[str, Any]) -> Any:
    """Return the events of a run as (mode, guard, time), and its end with all derivatives.

    Derivatives are by the start, in the order of the variables, and by the run's parameter.
    """
    formulas = Formulas(system | system.get("regular form", {}), SERIES)
    by = [*system["variables"], run["by"]]
    seed = lambda name: tuple(arb(int(one == name)) for one in by)
    extra = {"start": dict.fromkeys(formulas.system["variables"], "0") | run["start"]}
    state = {name: Jet(one, seed(name)) for name, one in formulas.start(extra).items()}
    p = {name: Jet(one, seed(name)) for name, one in formulas.parameters(run).items()}
    mode, events = run["mode"], []
    while True:
        guards = formulas.guards(mode, run)
        state, which = follow_step(formulas, mode, guards, state, p)
        if which is None:
            continue
        guard = guards[which]
        state = on_surface(formulas, mode, guard, state, p)
        events.append((mode, which, state["t"].value))
        if guard["leads_to"] not in system["modes"]:
            return events, {name: state[name] for name in ("t", *system["variables"])}
        after = formulas.reset(mode, guard, state, p)
        zero = tuple(arb(0) for _ in by)
        state = {
            k: one if isinstance(one, Jet) else Jet(arb(one), zero) for k, one in after.items()
        }
        mode = guard["leads_to"]

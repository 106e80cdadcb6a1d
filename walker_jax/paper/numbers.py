"""The paper's numbers, compared with those computed here."""

from decimal import Decimal
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import xarray as xr
from scipy.optimize import brentq, minimize_scalar

from walker_jax.gaits.search import find_gait, find_gaits
from walker_jax.paper.calculations import EXAMPLE_SLOPE
from walker_jax.systems.outcomes import Outcome
from walker_jax.walkers.model import State
from walker_jax.walkers.point_foot import PointFootWalker
from walker_jax.walkers.simplest import SimplestWalker
from walker_jax.walking.iteration import strides

TABLE_1 = (
    ("0.2000", "-0.2165", "-0.01645"),
    ("0.1788", "-0.1917", "-0.01290"),
    ("0.1756", "-0.1841", "-0.00850"),
    ("0.1878", "-0.1888", "-0.00100"),
    ("0.1586", "-0.1599", "-0.00134"),
    ("0.1459", "-0.1488", "-0.00295"),
    ("0.1492", "-0.1526", "-0.00337"),
    ("0.1539", "-0.1569", "-0.00302"),
    ("0.1558", "-0.1583", "-0.00256"),
)
FIXED_POINT = ("0.1534", "-0.1561", "-0.00269")


class Number(NamedTuple):
    """A number in the paper, and the one computed here."""

    where: str
    what: str
    printed: str
    ours: str
    agrees: bool
    """Whether both agree at the printed digits."""
    why: str
    """The reason for a difference, or how to read the number."""


def compare_numbers(data: dict[str, xr.Dataset]) -> list[Number]:
    """Compare every number of the paper's text and table with ours."""
    walker = SimplestWalker(EXAMPLE_SLOPE)
    gait = find_gait(walker)
    theta, thetadot = map(float, gait.states[0])
    states = data["walk"]["states"].values
    names = "θ", "θ̇", "θ + θ̇"
    found = [
        compare_printed("Fig. 2", f"{name} of the cyclic motion", text, value)
        for name, text, value in zip(names, FIXED_POINT, (theta, thetadot), strict=False)
    ]
    for step, row in enumerate(TABLE_1, 1):
        values = *states[step - 1], states[step - 1].sum()
        found += [
            compare_printed("Table 1", f"step {step}, {name}", text, float(value))
            for name, text, value in zip(names, row, values, strict=True)
        ]
    found += [
        compare_printed("Table 1", f"fixed point, {name}", text, value)
        for name, text, value in zip(
            names, FIXED_POINT, (theta, thetadot, theta + thetadot), strict=True
        )
    ]
    return [
        *found,
        *numbers_of_section_3(),
        *numbers_of_section_4(data, walker),
        *numbers_of_section_5(data, walker),
    ]


def numbers_of_section_3() -> list[Number]:
    """Compare the impact, for a walker whose feet have almost no mass, by the general method."""
    theta, rate = -0.25, -0.3
    walker = PointFootWalker(EXAMPLE_SLOPE, 1e-9)
    strike = State(*map(jnp.asarray, (theta, 2 * theta, rate, 0.1)))
    (u, v), after = walker.impact(strike)
    along, above = walker.impulse(strike)
    s, c = np.sin(2 * theta) * rate, np.cos(2 * theta)
    sine, cosine = np.sin(theta), np.cos(theta)
    slip = (
        "One component of (19) has the wrong sign: the impulse is directed along the swing leg, as "
        "the text says. The sign here is that of the ground's impulse on the walker, upward."
    )
    formulas = (
        ("(18)", "u̇⁺, to -sin θ cos 2θ sin 2θ θ̇⁻", u, -sine * c * s, ""),
        ("(18)", "v̇⁺, to cos θ cos 2θ sin 2θ θ̇⁻", v, cosine * c * s, ""),
        ("(18)", "θ̇⁺, to cos²2θ θ̇⁻", after.thetadot, c**2 * rate, ""),
        ("(18)", "φ̇⁺, to cos 2θ (cos 2θ - 1) θ̇⁻", after.phidot, c * (c - 1) * rate, ""),
        ("(19)", "ρ_x, to -sin θ sin 2θ θ̇⁻", along, -sine * s, slip),
        ("(19)", "ρ_y, to cos θ sin 2θ θ̇⁻", above, cosine * s, ""),
        ("3.2", "size of the impulse, to sin 2θ θ̇⁻", np.hypot(along, above), np.abs(s), ""),
        ("3.2", "speed of the stance foot, to cos 2θ sin 2θ θ̇⁻", np.hypot(u, v), np.abs(c * s), ""),
    )
    return [
        compare_printed(where, what, "1", float(ours) / float(printed), 6, why)
        for where, what, ours, printed, why in formulas
    ]


def numbers_of_section_4(data: dict[str, xr.Dataset], walker: SimplestWalker) -> list[Number]:
    """Compare the step-to-step behaviour."""
    at = lambda *values: State(*map(jnp.asarray, values))
    force: Any = lambda rate: float(walker.contact_force(at(EXAMPLE_SLOPE, 0.0, rate, 0.0))[1])
    fastest: Any = brentq(force, -2.0, -0.1)

    def rate_after_strike(angle: float) -> float:
        """Return the rate of the stance leg after heel strike at an angle."""
        _, after = walker.impact(at(angle, 2 * angle, -1.0, 0.0))
        return float(walker.exchange_legs(after).thetadot)

    turning: Any = rate_after_strike
    widest: Any = brentq(turning, -1.2, -0.4)
    edge = backward_edge(walker, np.array([0.1, 0.2, 0.3]))
    inclination = float(np.degrees(np.arctan((edge[2] - edge[0]) / 0.2)))
    folds = data["gaits"]["event_fold"].values
    doubling = float(data["gaits"]["event_value"].values[~folds].min())
    count = len(find_gaits(walker, 1, progress=False))
    froude = "Froude number at which the contact force vanishes, leg upright"
    slower = "The long and the short gait, and slower ones whose leg swings to and fro once more."
    return [
        compare_printed(
            "4.1", "θ from which a heel strike turns the walker back, π/4", "0.7854", -widest
        ),
        compare_printed("4.1", froude, "1", fastest**2, 3),
        compare_printed(
            "4.1", "θ + θ̇ on the boundary to B, at θ = 0.2: γ", "0.004", float(edge[1]) + 0.2
        ),
        compare_printed("5.1", "inclination of that boundary, degrees", "-45", inclination),
        compare_printed("4.2", "slope up to which the gait is stable", "0.015", doubling),
        compare_printed("5.2", "the same, after Garcia and others (1998)", "0.0151", doubling),
        Number(
            where="4",
            what="cyclic solutions of period one",
            printed="one or two",
            ours=str(count),
            agrees=count in (1, 2),
            why="" if count in (1, 2) else slower,
        ),
    ]


def numbers_of_section_5(data: dict[str, xr.Dataset], walker: SimplestWalker) -> list[Number]:
    """Compare the results."""
    fate = Outcome(int(strides(walker, np.array([[0.2, -0.23]])).outcome[0])).name
    walks = data["line"]["attractor"].values >= 0
    crossings = int((np.diff(walks.astype(int), prepend=0) > 0).sum())
    at = data["surviving_cells"]["slope"].values
    empty = data["surviving_cells"]["cells"].values == 0
    gone = np.where(empty.any(axis=1), at[empty.argmax(axis=1)], np.inf)
    below, above = map(float, data["gaits"]["lost"].values)
    radius = lambda slope: float(np.abs(find_gait(SimplestWalker(slope)).multipliers[0]))
    best: Any = minimize_scalar(radius, bounds=(0.008, 0.015), method="bounded")
    coarse = min((0.008, 0.010, 0.012, 0.014, 0.016), key=radius)
    areas = data["areas"]["mapped_area"].values
    largest = float(data["areas"]["slope"].values[areas.argmax()])
    vanished = "slope at which the basin has vanished"
    return [
        Number("5.1", "fate of (0.2, -0.23)", "F", fate[0], agrees=fate == "FORWARD", why=""),
        Number(
            where="5.1",
            what="crossings of the basin along θ = 0.2",
            printed="at least 4",
            ours=str(crossings),
            agrees=crossings >= 4,
            why="",
        ),
        compare_printed(
            *("5.2", f"{vanished}, on the paper's grid", "0.022", float(gone[0])),
            why="The first slope, in steps of 0.001, at which no cell converges to an attractor. "
            f"It depends on where cells lie: from {gone.min():.3f} to {gone.max():.3f} on "
            f"{len(gone)} grids, this one and others shifted by parts of a cell. From 0.0205 on "
            "only a few are left, each with an unstable gait that seems to stand still in it.",
        ),
        Number(
            where="5.2",
            what=f"{vanished}, followed directly",
            printed="0.022",
            ours=f"{np.floor(below * 1e5) / 1e5:.5f} to {np.ceil(above * 1e5) / 1e5:.5f}",
            agrees=bool(below <= 0.022 <= above),
            why="No cells. Between these slopes the chaotic attractor at the end of the gait's "
            "period doublings is lost, and walkers fall after some hundred strides.",
        ),
        compare_printed(
            *("5.2", "slope of the most stable gait", "0.012", float(best.x)),
            why="Two complex multipliers meet on the real axis there; their modulus shrinks up to "
            "that slope, and that of the larger one grows steeply beyond it. Of slopes that are "
            f"0.002 apart, {coarse:g} has the most stable gait.",
        ),
        Number(
            where="5.2",
            what="is the basin largest there?",
            printed="no",
            ours="no" if largest < 0.011 else "yes",
            agrees=largest < 0.011,
            why=f"It is largest at the smallest slope measured, {largest:g}.",
        ),
    ]


def backward_edge(walker: SimplestWalker, theta: np.ndarray) -> np.ndarray:
    """Find the rate where walkers begin to fall backward in the first stride, at each angle."""
    slow, fast = np.full(len(theta), -1e-6), -2 * theta
    for _ in range(50):
        middle = (slow + fast) / 2
        ends = strides(walker, np.stack([theta, middle], axis=1))
        falls = np.asarray(ends.outcome) == Outcome.BACKWARD
        slow, fast = np.where(falls, middle, slow), np.where(falls, fast, middle)
    return (slow + fast) / 2


def compare_printed(
    where: str, what: str, printed: str, ours: float, digits: int | None = None, why: str = ""
) -> Number:
    """Compare a number, printed to some digits, with ours, which is written with three more."""
    places = -int(Decimal(printed).as_tuple().exponent)
    agrees = bool(abs(ours - float(printed)) <= 0.5 * 10.0**-places * (1 + 1e-9))
    digits = places + 3 if digits is None else digits
    return Number(where, what, printed, f"{ours:.{digits}f}", agrees, why)

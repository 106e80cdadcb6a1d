"""Outcomes of strides, and the results of strides and walks."""

import enum
from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Inexact, Int

from walker_jax.checks import is_traced
from walker_jax.integrators.roots import Scalar
from walker_jax.systems.html_tables import html_table, list_numbers


class Outcome(enum.IntEnum):
    """How a stride ends: a number, with words for it; for a failure also the word for its margin.

    Four outcomes are for all systems. The others are failures with the same name in the walkers and
    in other machines with legs; a system names its own in `System.failures`.
    """

    _value_: int
    words: str
    margin: str

    def __new__(cls, value: int, words: str = "", margin: str = ""):
        one = int.__new__(cls, value)
        one._value_, one.words, one.margin = value, words, margin
        return one

    STRIDE = 0, "walks"
    """Heel strike: the next stride begins."""
    FORWARD = 1, "falls forward", "forward"
    """The stance leg reaches theta = -pi/2 without a heel strike."""
    BACKWARD = 2, "falls backward", "backward"
    """The stance leg stops before a heel strike, or the heel strike turns the next one back."""
    RUNNING = 3, "runs", "running"
    """The contact force is tensile at the start, or during a stride that reaches heel strike."""
    STOPPED = 4, "stops on both feet", "stopping"
    """At heel strike the trailing foot does not lift: both feet stay down."""
    OUTSIDE = 5, "not a feasible start", "outside"
    """The start is not feasible."""
    UNDECIDED = 6, "undecided"
    """The integration gave no answer."""
    LEFT_GRID = 7, "leaves the grid"
    """Cell mapping only: the stride ended outside the grid."""
    BENT_KNEE = 8, "lands on a bent knee", "landing"
    """The swing foot comes down in front of the stance foot while the knee is bent."""
    BUCKLED = 9, "buckles", "buckling"
    """The stance knee would have had to resist bending, in a stride that reaches heel strike; only
    if that is checked."""
    SCUFFED = 10, "scuffs", "scuffing"
    """The bent leg's foot, or the swing disc of a walker in space, was below the ground, in a
    stride that reaches heel strike. For the bent leg, only if that is checked."""
    SIDEWAYS = 11, "falls sideways", "sideways"
    """A walker in space has fallen to a side."""

    @classmethod
    def _missing_(cls, value):
        """Make the outcome of a failure that a system names itself, such as OWN_1."""
        if not isinstance(value, int | np.integer) or not OWN <= value < OUTCOMES:
            return None
        own = int.__new__(cls, value)
        own._name_, own._value_ = f"OWN_{value - OWN + 1}", int(value)
        own.words = own.margin = ""
        return own


OWN = 12
"""Number of the first failure that a system names itself in `System.failures`; others follow."""
OUTCOMES = 32
"""The numbers of outcomes are below this one, so a system may name 20 failures."""


def failures_of(data: Any) -> tuple[str, ...]:
    """Return the names of a system's own failures from the attributes of its data set."""
    return names_in(data, "failures")


def join_names(names: Iterable[str]) -> str:
    """Return names as one attribute of a data set; NetCDF 3 holds no list of words."""
    return ", ".join(names)


def names_in(data: Any, attribute: str) -> tuple[str, ...]:
    """Return the names in an attribute of a data set; none if it has no such attribute.

    Older data sets have a list of names instead of one string.
    """
    names = data.attrs.get(attribute, ())
    return tuple(names.split(", ") if isinstance(names, str) else names)


def name_of_outcome(outcome: int, failures: Sequence[str] = ()) -> str:
    """Return the name of an outcome, for a system with these failures of its own."""
    own = int(outcome) - OWN
    return failures[own] if 0 <= own < len(failures) else Outcome(int(outcome)).name


def names_of_outcomes(failures: Sequence[str] = ()) -> dict[Outcome, str]:
    """Return the names of all outcomes, for a system with these failures of its own."""
    own = [Outcome(OWN + i) for i in range(len(failures))]
    return {one: name_of_outcome(one, failures) for one in (*Outcome, *own)}


def outcome_in_words(name: str) -> str:
    """Describe an outcome in words, given its name; a system's own failure is its name."""
    known = Outcome.__members__.get(name)
    return name.replace("_", " ") if known is None else known.words


def stride_table(stride: "Stride") -> str | None:
    """Return how a stride ended, and where; of many, how many ended in which way."""
    if is_traced(stride):
        return None
    outcomes, words = np.asarray(stride.outcome), lambda code: outcome_in_words(Outcome(code).name)
    if outcomes.ndim:
        found = Counter(outcomes.ravel().tolist()).most_common()
        rows = [(words(code), count) for code, count in found]
        return html_table(f"{outcomes.size} strides", ("outcome", "strides"), rows)
    rows = [("outcome", words(outcomes.item()))]
    if outcomes == Outcome.STRIDE:
        rows += [("state", list_numbers(stride.state)), ("time", list_numbers(stride.time))]
    return html_table("Stride", ("", ""), rows)


def walk_table(walk: "Walk") -> str | None:
    """Return the strides of a walk, up to its failure; None for several walks."""
    if is_traced(walk) or np.ndim(walk.outcomes) != 1:
        return None
    rows, strides = [], zip(walk.states, walk.times, np.asarray(walk.outcomes), strict=False)
    for k, (start, time, outcome) in enumerate(strides):
        word = outcome_in_words(Outcome(outcome).name)
        rows += [(k, list_numbers(start), list_numbers(time), word)]
        if outcome != Outcome.STRIDE:
            break
    return html_table("Walk", ("stride", "start", "time", "outcome"), rows)


class Stride(NamedTuple):
    """The result of a stride."""

    state: Float[Array, "*cells section"]
    """Start of the next stride, on the section; NaN unless the outcome is `STRIDE`."""
    outcome: Int[Array, "*cells"]
    """`Outcome` as int8."""
    time: Float[Array, "*cells"]
    """Duration, in the unit of time; NaN unless the outcome is `STRIDE`."""
    _repr_html_ = stride_table


class Walk(NamedTuple):
    """The result of a number of strides. Nothing follows a failure: later states are NaN."""

    states: Float[Array, "strides+1 coordinates"]
    """Start of each stride, and of the one after the last; full states on rough ground."""
    outcomes: Int[Array, " strides"]
    """`Outcome` of each stride; that of the failure from there on."""
    times: Float[Array, " strides"]
    """Duration of each stride, in the unit of time."""
    _repr_html_ = walk_table


def nan_unless(known: Bool[Array, ""], values: Inexact[Array, "..."]) -> Inexact[Array, "..."]:
    """Multiply values by 1 or by NaN, so that their derivatives become NaN too."""
    return values * jnp.where(known, 1, jnp.nan).astype(values.dtype)


def make_stride(
    state: Float[Array, " coordinates"], outcome: Int[Array, ""], time: Scalar
) -> Stride:
    """Make a `Stride`; results and their derivatives are NaN unless the outcome is `STRIDE`."""
    success = outcome == Outcome.STRIDE
    return Stride(nan_unless(success, state), outcome, nan_unless(success, time))

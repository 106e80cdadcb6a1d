"""The limits of a design problem: how far measures of the gait are from them."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from walker_jax.design.measures import differentiate_measures
from walker_jax.design.problem import BINDING_SLACK, Problem
from walker_jax.gaits.cycles import Gait

MAX_NEWTON_STEPS = 20
"""Most Newton steps to a place that keeps the limits; each roughly squares the error."""
MAX_VIOLATION = 1e-9
"""Largest relative violation of a limit: the error left by the last Newton step."""


class Slack(NamedTuple):
    """Relative slack of a limit, negative if the limit is violated, and its gradient by place."""

    name: str
    value: float
    gradient: Float[np.ndarray, " parameters"]


class Limits:
    """The limits of a problem, evaluated at places, with a cache of the results."""

    def __init__(
        self, problem: Problem, gait_of: Callable[[Float[np.ndarray, " parameters"]], Gait]
    ):
        self.problem, self.gait_of = problem, gait_of
        self.known: dict[bytes, list[Slack]] = {}

    def slacks(self, place: Float[np.ndarray, " parameters"]) -> list[Slack]:
        """Return the slacks of all limits at a place; NaN if there is no gait."""
        problem, values = self.problem, self.problem.values(place)
        if not problem.limits:
            return []
        if values.tobytes() in self.known:
            return self.known[values.tobytes()]
        walker, gait = problem.walker_at(values), self.gait_of(values)
        how = tuple(problem.limits), problem.functions, problem.tolerance
        measures = differentiate_measures(walker, problem.names, gait, *how)
        found = []
        for name, ends in problem.limits.items():
            for limit, side in zip(ends, (1, -1), strict=True):
                if np.isfinite(limit):
                    scale = side / (abs(limit) or 1.0)
                    value, gradient, *_ = measures[name]
                    gradient = gradient * problem.scale
                    found.append(Slack(name, scale * (value - limit), scale * gradient))
        self.known[values.tobytes()] = found
        return found

    def nearest_allowed(
        self, place: Float[np.ndarray, " parameters"]
    ) -> Float[np.ndarray, " parameters"] | None:
        """Return the place, or one near it that keeps all limits; None if none is found."""
        violating = None
        for _ in range(MAX_NEWTON_STEPS):
            if self.problem.refusal(self.problem.values(place)):
                return None
            found = self.slacks(place)
            broken = [one for one in found if not one.value >= -MAX_VIOLATION]
            if not broken:
                smallest = min((one.value for one in found), default=0.0)
                if violating is None or smallest < BINDING_SLACK:
                    return place
                return self.crossing(place, violating)  # the Newton step was too long
            violating, worst = place, min(broken, key=lambda one: one.value)
            lowest, highest = self.problem.ends
            at_bound = (place == lowest) & (worst.gradient < 0)
            at_bound |= (place == highest) & (worst.gradient > 0)
            gradient = np.where(at_bound, 0.0, worst.gradient)
            if not (np.isfinite(worst.value) and np.sum(gradient**2) > 0):
                return None
            place = self.problem.within(place - worst.value * gradient / np.sum(gradient**2))
        return None

    def crossing(
        self,
        within: Float[np.ndarray, " parameters"],
        violating: Float[np.ndarray, " parameters"],
    ) -> Float[np.ndarray, " parameters"]:
        """Find where a limit binds, between a place that keeps it and one that violates it."""

        def smallest_slack(share: float) -> float:
            slack = min(one.value for one in self.slacks(within + share * (violating - within)))
            return slack if np.isfinite(slack) else -1.0

        from scipy.optimize import brentq

        share: Any = brentq(smallest_slack, 0.0, 1.0, xtol=1e-13)
        return within + share * (violating - within)

    def feasible_direction(
        self,
        place: Float[np.ndarray, " parameters"],
        direction: Float[np.ndarray, " parameters"],
    ) -> Float[np.ndarray, " parameters"]:
        """Project a direction so that it crosses neither bounds nor binding limits."""
        binding = [one.gradient for one in self.slacks(place) if one.value < BINDING_SLACK]
        for _ in range(1 + len(place) if binding or not self.problem.free.all() else 0):
            lowest, highest = self.problem.ends
            leaves = ((place == lowest) & (direction < 0)) | ((place == highest) & (direction > 0))
            direction = np.where(leaves, 0.0, direction)
            for gradient in (np.where(leaves, 0.0, one) for one in binding):
                if direction @ gradient < 0:
                    direction = direction - (direction @ gradient) / np.sum(gradient**2) * gradient
        return direction

    def binding(self, place: Float[np.ndarray, " parameters"]) -> set[str]:
        """Return the measures whose limits bind at a place."""
        return {one.name for one in self.slacks(place) if one.value < BINDING_SLACK}

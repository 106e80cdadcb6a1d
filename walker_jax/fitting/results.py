"""The result of a fit: parameters with errors, the fitted system, residuals, and a data set."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import jax
import numpy as np
import xarray as xr
from jax.flatten_util import ravel_pytree
from jaxtyping import Float
from scipy.stats import norm

from walker_jax.checks import check_confidence
from walker_jax.fitting.bounds import Bounds, from_free, moving, to_free
from walker_jax.fitting.resampling import resample
from walker_jax.fitting.residuals import Data, Problem, predicted
from walker_jax.fitting.solving import Solved
from walker_jax.fitting.uncertainty import (
    Direction,
    covariance_and_directions,
    information,
    unknown_among,
)
from walker_jax.systems.html_tables import html_table
from walker_jax.systems.hybrid_system import HybridSystem
from walker_jax.walkers.parameters import describe_source, with_values


@dataclass(frozen=True)
class Fit:
    """Fitted parameters with their errors."""

    parameters: dict[str, float]
    errors: dict[str, float]
    """Standard deviations, from the Jacobian; infinite where the recordings tell nothing."""
    covariance: Float[np.ndarray, "parameters parameters"]
    system: HybridSystem | tuple[HybridSystem, ...]
    """With the fitted parameters."""
    directions: tuple[Direction, ...]
    """Combinations of parameters with independent errors, relative to their values, worst first."""
    draws: Float[np.ndarray, "draws parameters"]
    """Parameters fitted to resampled steps; none without a bootstrap."""
    converged: bool
    data: xr.Dataset
    """Recorded and fitted samples, residuals, starts, and durations of steps."""
    bounds: Bounds = field(repr=False)
    problem: Problem | None = field(default=None, repr=False)
    """Constants of the residuals, and first guesses; None of a fit that `fit` did not make."""

    @property
    def unknown(self) -> tuple[str, ...]:
        """Combinations of parameters that the recordings do not tell apart, in words."""
        return tuple(map(str, unknown_among(self.directions)))

    @property
    def correlation(self) -> Float[np.ndarray, "parameters parameters"]:
        """Correlations of the errors of the parameters."""
        errors = np.sqrt(np.diag(self.covariance))
        with np.errstate(invalid="ignore"):
            return self.covariance / np.outer(errors, errors)

    def intervals(self, confidence: float = 0.95) -> dict[str, tuple[float, float]]:
        """Return intervals of confidence: of the bootstrap if there is one, else normal ones."""
        check_confidence(confidence)
        tails = (1 - confidence) / 2, (1 + confidence) / 2
        if len(self.draws):
            ends = np.nanquantile(self.draws, tails, axis=0).T
        else:
            middle, errors = np.array([*self.parameters.values()]), [*self.errors.values()]
            ends = middle[:, None] + np.outer(errors, norm.ppf(tails))
        return {
            name: (float(a), float(b)) for name, (a, b) in zip(self.parameters, ends, strict=True)
        }

    def with_parameters(self, values: Any) -> Any:
        """Return the fitted system, or both, with other values of the fitted parameters."""
        put = lambda one: with_values(one, zip(self.parameters, values, strict=True))
        return tuple(map(put, self.system)) if isinstance(self.system, tuple) else put(self.system)

    def sample(self, count: int, seed: int = 0) -> Float[np.ndarray, "draws parameters"]:
        """Draw parameters from the normal distribution of their errors, kept within bounds.

        It is normal in the variables without bounds that the search uses. Parameters without
        information stay as they are.
        """
        middle = np.array([*self.parameters.values()])
        free = to_free(middle, self.bounds)
        rates, _ = moving(free, self.bounds)
        covariance = np.where(np.isfinite(self.covariance), self.covariance, 0)
        spread = root_of(covariance / np.outer(rates, rates))
        noise = np.random.default_rng(seed).normal(size=(count, len(middle)))
        return np.asarray(jax.vmap(from_free, (0, None))(free + noise @ spread.T, self.bounds))

    def table(self) -> list[tuple[str, ...]]:
        """Return a row for each parameter: value, error, and interval of 95 %."""
        ends = self.intervals()
        shown = lambda *values: tuple(f"{value:.6g}" for value in values)
        return [(n, *shown(v, self.errors[n], *ends[n])) for n, v in self.parameters.items()]

    def __repr__(self) -> str:
        rows = [f"{n} = {v} ± {e} ({a} to {b})" for n, v, e, a, b in self.table()]
        rows += [f"not told apart: {one}" for one in self.unknown]
        return "\n".join(rows + ([] if self.converged else ["the search did not converge"]))

    def _repr_html_(self) -> str:
        return html_table("fit", ("parameter", "value", "error", "from", "to"), self.table())


def root_of(covariance: Float[np.ndarray, "n n"]) -> Float[np.ndarray, "n n"]:
    """Return a root S of a covariance, S S^T, also where it is singular."""
    values, vectors = np.linalg.eigh(covariance)
    return vectors * np.sqrt(np.maximum(values, 0))


def fit_of(problem: Problem, solved: Solved, data: Data, bootstrap: int, seed: int) -> Fit:
    """Return the result of a search, whose noise is that of `data`."""
    names, values = problem.layout.names, np.asarray(solved.motion.values)
    rates, away = moving(solved.unknowns.free, data.bounds)
    # At a bound recordings tell nothing: without the bound the search would go on.
    root = information(np.asarray(solved.jacobian), len(names)) * np.where(away, 1 / rates, 0)
    sizes = np.where(values == 0, 1, np.abs(values))
    covariance, directions = covariance_and_directions(root, names, sizes)
    errors = np.sqrt(np.diag(covariance)).tolist()
    put = lambda one: with_values(one, zip(names, values, strict=True))
    fitted = tuple(map(put, problem.systems))
    draws = resample(problem, solved, data, bootstrap, seed)
    named = dict(zip(names, values.tolist(), strict=True))
    found = data_of(fitted[0], problem, data, solved, covariance, directions)
    return Fit(
        named,
        dict(zip(names, errors, strict=True)),
        covariance,
        fitted[0] if len(fitted) == 1 else fitted,
        directions,
        draws,
        bool(solved.converged) and bool(np.all(solved.motion.walks)),
        found,
        data.bounds,
        problem,
    )


def data_of(
    system: HybridSystem,
    problem: Problem,
    data: Data,
    solved: Solved,
    covariance: Float[np.ndarray, "n n"],
    directions: Sequence[Direction],
) -> xr.Dataset:
    """Return recorded and fitted numbers as a data set."""
    layout, steps = problem.layout, data.steps
    motion, fitted = predicted(layout, solved.unknowns, data)
    gaps = np.where(steps.known, 0.0, np.nan)
    per_sample = "step", "sample", "column"
    real = steps.known.any(axis=-1)
    unknowns = ravel_pytree(solved.unknowns)[0].size
    return xr.Dataset(
        {
            "time": (per_sample[:2], np.where(real, steps.times, np.nan)),
            "recorded": (per_sample, steps.values + gaps),
            "fitted": (per_sample, np.asarray(fitted) + gaps),
            "residual": (
                per_sample,
                (steps.values - np.asarray(fitted)) / np.asarray(data.noise) + gaps,
            ),
            "begin": ("step", np.asarray(motion.begins)),
            "end": ("step", np.asarray(motion.ends)),
            "recorded_end": ("step", steps.ends),
            "recording": ("step", steps.recording),
            "run": ("step", steps.run),
            "stance": ("step", steps.stance),
            "walks": ("step", np.asarray(motion.walks)),
            "starts": (("step", "coordinate"), np.asarray(motion.starts)),
            "value": ("parameter", np.asarray(motion.values)),
            "covariance": (("parameter", "other"), covariance),
            "noise": ("column", np.asarray(data.noise)),
        },
        {
            # objects, which Zarr stores as text of any length
            "column": np.array(problem.columns, object),
            "coordinate": np.array(system.section, object),
            "parameter": np.array(layout.names, object),
        },
        {
            **describe_source(system),
            "strike_noise": float(data.strike_noise),
            "sum_of_squares": float(solved.cost),
            "degrees_of_freedom": steps.count - unknowns,
            "shooting": "single" if layout.single else "multiple",
            "loss": layout.loss,
            "converged": int(solved.converged),
            "unknown": "; ".join(map(str, unknown_among(directions))),
        },
    )

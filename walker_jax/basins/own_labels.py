"""Labels of a user's own: a function of the end of a walk, or clusters of features of its orbit."""

import importlib.util
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from walker_jax.basins.attractor import Attractor, all_motions
from walker_jax.checks import WrongUse, check_whole, short
from walker_jax.fingerprints import code_fingerprint
from walker_jax.integrators.integrator import Integrator
from walker_jax.systems.system import System
from walker_jax.walking.iteration import orbits

DIGITS = 6
"""Digits of features, in their ranges, that count, so that walks still converging to one point
are not split. A range that is smaller than the size of a feature by as much tells none apart."""


class Clusters(NamedTuple):
    """A label of walks for `basin`: the cluster, by HDBSCAN, that features of its orbit are in.

    Walks with similar features converge to one attractor. (Campello, Moulavi and Sander 2013;
    Stender and Hoffmann 2022, of basins.) Features are scaled to their ranges. Clusters are
    numbered in the order of the cells that are first in each; -1 is noise.
    """

    features: Callable[[Float[Array, "states section"]], Float[Array, " features"]]
    """A JAX function of the states of a walk, after it has made the strides of `basin`."""
    strides: int = 100
    """Number of these strides, one less than of states."""
    smallest: int = 10
    """Fewest walks in a cluster."""


OwnLabel = Callable[[Float[Array, " section"]], Int[Array, ""]] | Clusters


def check_label(label: Any) -> dict[str, Any]:
    """Return what identifies a user's label in a data set; raise `WrongUse` for no label."""
    name = getattr(label, "__name__", type(label).__name__)
    parts: tuple = (label,)
    if isinstance(label, Clusters):
        check_whole("label strides", label.strides)
        check_whole("label smallest", label.smallest, 2)
        if importlib.util.find_spec("sklearn") is None:
            raise WrongUse("Clusters take scikit-learn: pip install 'walker_jax[cluster]'")
        parts, name = (*label,), f"{name} {label.strides} {label.smallest}"
        label = label.features
    if not callable(label):
        raise WrongUse(f"label must be a function, or Clusters of one, not {short(label)}")
    return {"label": name, "label_code": code_fingerprint(object, parts)}


def label_ends(
    label: OwnLabel, walker: System, x: Float[np.ndarray, "n section"], integrator: Integrator
) -> tuple[list[Attractor], Int[np.ndarray, " n"]]:
    """Return the labels of walks from their last states, and an attractor for each label."""
    if isinstance(label, Clusters):
        number = clusters_of(label, walker, x, integrator)
    else:
        number = np.asarray(jax.vmap(label)(jnp.asarray(x)))
        if number.shape != (len(x),) or number.dtype.kind not in "biu" or (number < -1).any():
            raise WrongUse(
                "label must return a whole number from 0 on for each state, or -1 for none, not "
                f"{short(number)}"
            )
    first = [np.flatnonzero(number == i)[:1] for i in range(number.max(initial=-1) + 1)]
    states = [x[one] if len(one) else np.full_like(x[:1], np.nan) for one in first]
    return [all_motions(one) for one in states], number


def clusters_of(
    label: Clusters, walker: System, x: Float[np.ndarray, "n section"], integrator: Integrator
) -> Int[np.ndarray, " n"]:
    """Return the cluster of each walk; -1 for noise, and for a walk that fails."""
    from sklearn.cluster import HDBSCAN  # pyright: ignore[reportMissingImports] (an extra)

    walks, _ = orbits(walker, x, label.strides, integrator)
    features = np.asarray(jax.vmap(label.features)(jnp.asarray(walks)))
    if features.shape[:1] != (len(x),) or features.ndim != 2:
        raise WrongUse(f"label must have features in one row for a walk, not {short(features)}")
    number, known = np.full(len(x), -1), np.isfinite(features).all(axis=1)
    if known.sum() < label.smallest:
        return number
    features = features[known]
    span = np.ptp(features, axis=0)
    span[span <= 10.0**-DIGITS * np.abs(features).max(axis=0)] = np.inf
    about: Any = dict(min_cluster_size=label.smallest, allow_single_cluster=True, copy=True)
    model = HDBSCAN(**about)  # its stubs take words for `copy` alone
    found = model.fit_predict(((features - features.min(axis=0)) / span).round(DIGITS))
    clusters, first = np.unique(found[found >= 0], return_index=True)
    order = np.full(len(clusters) + 1, -1)
    order[clusters[np.argsort(first)]] = np.arange(len(clusters))
    number[known] = order[found]
    return number

"""First guesses of where steps start, from their samples; checks that these are steps at all."""

from collections.abc import Sequence
from functools import partial
from itertools import combinations
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from walker_jax.checks import WrongUse
from walker_jax.fitting.steps import Steps
from walker_jax.systems.hybrid_system import HybridSystem
from walker_jax.walking.stride import modes_from

SHARE = 0.25
"""Share of a step's duration, from its start, over which a quadratic gives value and rate."""
FEWEST = 4
"""Samples that a quadratic is fitted to, at least; a step with fewer has a straight line."""
TURNS = 5
"""Turns of Gauss's and Newton's method from columns and rates to a point of the section, which is
nearly linear in them."""
MISMATCH = 0.3
"""Columns are taken for swapped if they are off the section by this share of their size, and
swapped by a quarter of that."""


def names_of_state(system: HybridSystem) -> tuple[str, ...]:
    """Return the names of the coordinates of the state in which steps begin."""
    names = system.names_of_state()
    if names is None:
        raise WrongUse(f"system must have states with names, NamedTuples, unlike {system.label()}")
    return names


def values_at_start(steps: Steps) -> Float[np.ndarray, "2 steps columns"]:
    """Return each column's value and rate at the start of each step, by least squares."""
    shares = (steps.times - steps.begins[:, None]) / (steps.ends - steps.begins)[:, None]
    near = steps.known & (shares <= SHARE)[..., None]
    first = steps.known & (steps.known.cumsum(axis=1) <= FEWEST)
    used = np.where(near.sum(axis=1, keepdims=True) >= FEWEST, near, first)
    powers = np.where(used, shares[..., None], 0)[..., None] ** np.arange(3) * used[..., None]
    powers[..., 2] *= used.sum(axis=1, keepdims=True) >= FEWEST
    products = np.einsum("stkp,stkq->skpq", powers, powers)
    moments = np.einsum("stkp,stk->skp", powers, np.where(used, steps.values, 0))
    inverse = np.linalg.pinv(products, rcond=1e-12, hermitian=True)
    value, rate, _ = np.moveaxis(np.einsum("skpq,skq->skp", inverse, moments), -1, 0)
    return np.stack([value, rate / (steps.ends - steps.begins)[:, None]])


def first_starts(
    system: HybridSystem, of_state: Sequence[str], places: tuple[int, ...], steps: Steps
) -> Float[np.ndarray, "steps section"]:
    """Guess starts on the section: columns and their rates are nearest to the recorded ones.

    `of_state` names the coordinates of a state, and `places` are those that were recorded.
    """
    values, rates = values_at_start(steps)
    columns = [of_state[place] for place in places]
    check_columns(system, of_state, columns, values)
    aims = np.concatenate([values, rates], axis=1)
    starts, ranks = map(np.asarray, points_of_section(places, system, jnp.asarray(aims)))
    if ranks.max() < len(system.section):
        raise WrongUse(
            f"columns must tell a point of the section, {', '.join(system.section)}, unlike "
            f"{', '.join(columns)} and their rates: add some, or give starts to walker_jax.fit",
            of="columns",
        )
    return starts


@partial(jax.jit, static_argnums=0)
def points_of_section(
    places: tuple[int, ...], system: HybridSystem, aims: Float[Array, "steps columns"]
) -> tuple[Any, Any]:
    """Return starts whose columns and rates are nearest to aims, and the ranks of their slopes."""

    def seen(x):
        """Return the columns and their rates at the start x."""
        start = system.launch(x)
        rates = next(iter(modes_from(system, x).values())).rates(start)
        numbers = (jnp.stack(jax.tree.leaves(one)) for one in (start, rates))
        return jnp.concatenate([one[jnp.asarray(places)] for one in numbers])

    def find(aim):
        x = jnp.zeros(len(system.section))
        for _ in range(TURNS):
            x = x - jnp.linalg.lstsq(jax.jacfwd(seen)(x), seen(x) - aim)[0]
        return x, jnp.linalg.matrix_rank(jax.jacfwd(seen)(x))

    return jax.vmap(find)(aims)


def check_columns(
    system: HybridSystem,
    of_state: Sequence[str],
    columns: Sequence[str],
    values: Float[np.ndarray, "steps columns"],
) -> None:
    """Raise `WrongUse` where two columns, swapped, are on the section and as named are not."""
    section = system.section
    if not {name for name in section if not name.endswith("dot")} <= {*columns}:
        return
    lift = jax.vmap(lambda x: jnp.stack(jax.tree.leaves(system.launch(x))))

    def off(order: Sequence[str]) -> float:
        known = dict(zip(order, values.T, strict=True))
        x = np.stack([known.get(name, np.zeros(len(values))) for name in section], axis=1)
        state = dict(zip(of_state, np.asarray(lift(jnp.asarray(x))).T, strict=True))
        places = [name for name in order if not name.endswith("dot")]
        apart = [state[name] - known[name] for name in places]
        size = [known[name] for name in places]
        return float(np.nanmedian(np.abs(apart)) / np.nanmedian(np.abs(size)))

    now = off(columns)
    places = [name for name in columns if not name.endswith("dot")]
    for a, b in combinations(places, 2):
        swapped = [b if name == a else a if name == b else name for name in columns]
        if now > MISMATCH and off(swapped) < now / 4:
            raise WrongUse(
                f"columns {a} and {b} must be swapped: as they are, no step begins on the section "
                f"of {system.label()}",
                of="columns",
            )


def check_feasible(
    system: HybridSystem, starts: Float[np.ndarray, "steps section"], walks: Any
) -> None:
    """Raise `WrongUse` if no first guess makes a step."""
    if not np.any(walks):
        middle = ", ".join(f"{value:.3g}" for value in np.median(starts, axis=0))
        raise WrongUse(
            f"recordings must begin steps of {system.label()}: none walks from its recorded start, "
            f"such as ({middle}); check signs and units, or give starts to walker_jax.fit",
            of="recordings",
        )

"""Somebody else's simulation of strides, such as a loop of MuJoCo with a trained policy, as a map.

Nothing is known of it but the strides it makes: outcomes and states come from sampling, derivatives
from differences. Whatever is said of its basin is as true as the samples are many.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from walker_jax.checks import WrongUse, check_number, short, warn_once
from walker_jax.grids import Grid
from walker_jax.systems.maps import check_names, freeze, region_of
from walker_jax.systems.outcomes import Outcome
from walker_jax.systems.system import System, code_field

Strides = Callable[[Float[np.ndarray, "n section"]], tuple[Any, Any]]
"""From starts to the next states, and whether each stride was made."""


class BlackBox(System):
    """A function of strides that JAX cannot see, as a system: every stride takes the time 1.

    ```python
    def strides(starts):  # NumPy arrays of shape (n, 2)
        ...  # a loop of a simulator
        return states, made

    wj.BlackBox(strides, ("angle", "rate"), step=1e-4)
    ```

    Basins, basin stability, least disturbances and edge states call it with many starts at once;
    `find_gait` has its Jacobian by central differences. A stride that is not made is `FORWARD`.
    Nothing here is exact: an isolated pocket of falls that no sample meets stays unseen, and a
    simulation of contacts has errors of its own. Sampled results say how many starts they rest on.

    **Arguments:**

    - `strides`: a function of NumPy arrays of starts, (n, section), to the next states and to n
      truth values. It must depend on the starts alone.
    - `coordinates`: names of the section's coordinates.
    - `step`: change of a coordinate for differences, well above the noise of the simulation.
    - `region`: axes of a grid whose cells are the starts of searches for gaits, as of `Map`.
    """

    strides: Strides = code_field()
    section: tuple[str, ...] = code_field()  # pyright: ignore[reportIncompatibleVariableOverride] (of each box)
    step: float = code_field()
    region: tuple | None = code_field()

    def __init__(
        self,
        strides: Strides,
        coordinates: Sequence[str],
        *,
        step: float | int = 1e-4,
        region: Mapping[str, Any] | None = None,
    ):
        if not callable(strides):
            raise WrongUse(f"strides must be a function, not {short(strides)}")
        check_names("coordinates", coordinates)
        check_number("step", step)
        if not 0 < step < np.inf:
            raise WrongUse(f"step must be positive and finite, not {step}")
        self.strides, self.section, self.step = strides, tuple(coordinates), float(step)
        warn_once(
            f"{short(self.label())} is a black box: all results are sampled, derivatives are "
            "differences, and a pocket of falls between samples stays unseen"
        )
        self.region = None if region is None else freeze(region_of(self.section, region))

    def label(self):
        return getattr(self.strides, "__name__", type(self).__name__)

    def advance(self, x):
        state, made = call(self, x)
        outcome = jnp.where(made, Outcome.STRIDE, Outcome.FORWARD)
        return state, outcome, jnp.ones((), x.dtype)

    def gait_region(self):
        return super().gait_region() if self.region is None else Grid.plain(**dict(self.region))


def call(
    box: BlackBox, x: Float[Array, " section"]
) -> tuple[Float[Array, " section"], Bool[Array, ""]]:
    """Return the next state, and whether there is one; many starts are one call."""

    @jax.custom_jvp
    def stride(x):
        kinds = jax.ShapeDtypeStruct(x.shape, x.dtype), jax.ShapeDtypeStruct((), bool)
        return jax.pure_callback(lambda x: answer(box, x), kinds, x, vmap_method="expand_dims")

    @stride.defjvp
    def difference(primals, tangents):
        (x,), (tangent,) = primals, tangents
        size = jnp.maximum(jnp.abs(tangent).max(), jnp.finfo(x.dtype).tiny)
        h = box.step / size
        state, made = stride(x)
        ends = [stride(x + sign * h * tangent)[0] for sign in (1, -1)]
        change = (ends[0] - ends[1]) / (2 * h)
        return (state, made), (change, np.zeros((), jax.dtypes.float0))

    return stride(x)


def answer(box: BlackBox, x: Any) -> tuple[np.ndarray, np.ndarray]:
    """Call the function with starts along one axis, and check what it returns."""
    starts = np.asarray(x).reshape(-1, np.shape(x)[-1])
    states, made = (np.asarray(one) for one in box.strides(starts))
    if states.shape != starts.shape or made.shape != starts.shape[:1]:
        raise WrongUse(
            f"strides must return states of shape {starts.shape} and {len(starts)} truth values, "
            f"not {states.shape} and {made.shape}"
        )
    states = np.where(made[:, None], states, np.nan).astype(starts.dtype)
    return states.reshape(np.shape(x)), made.astype(bool).reshape(np.shape(x)[:-1])

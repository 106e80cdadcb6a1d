"""Feedback from stride to stride: parameters that depend on the state at heel strike."""

from collections.abc import Mapping, Sequence
from functools import cache, partial
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from walker_jax.checks import WrongUse, check_kind, short
from walker_jax.systems.system import fields_of
from walker_jax.walkers.model import Walker
from walker_jax.walkers.parameters import Parameter, check_parameter, parameters, with_parameter


class FeedbackWalker(Walker):
    """The common base of the walkers that `Feedback` makes."""

    controlled: eqx.AbstractClassVar[tuple[str, ...]]
    """Names of the parameters that are set at each heel strike."""
    limited: eqx.AbstractClassVar[tuple[str, ...]]
    """Names of the controlled parameters whose bounds are parameters of the walker too."""
    kind: eqx.AbstractClassVar[type[Walker]]
    """The walker without feedback."""

    def during_stride(self, x):
        """p = p* + K (x - x*), within its bounds."""
        walker, values = self, fields_of(self)
        away = [x[i] - values[f"reference_{name}"] for i, name in enumerate(self.section)]
        described = {one.name: one for one in parameters(self.kind)}
        for name in self.controlled:
            gains = [values[f"{name}_per_{coordinate}"] for coordinate in self.section]
            value = values[name] + sum(gain * d for gain, d in zip(gains, away, strict=True))
            one = described.get(name)
            low, high = (one.low, one.high) if one else (-np.inf, np.inf)
            if name in self.limited:
                low, high = values[f"least_{name}"], values[f"largest_{name}"]
            walker = with_parameter(walker, name, jnp.clip(value, low, high))
        return walker

    def __reduce__(self):
        return partial(remake, self.kind, self.controlled, self.limited, fields_of(self)), ()


def Feedback(
    walker: Walker,
    gait: Any,
    gains: Mapping[str, Sequence[Any] | Float[ArrayLike, " section"]],
    bounds: Mapping[str, tuple[Any, Any]] | None = None,
) -> Walker:
    """Make a walker whose parameters are set anew at each heel strike, by linear feedback.

    During the stride from x on the section, a parameter p is p* + K (x - x*), where p* is its value
    in `walker` and x* the state of the gait. So the gait stays a gait, whatever the gains. From a
    full state, x takes the section's coordinates. A parameter stays within its bounds. If p* is at
    a bound, as a push-off of 0 is, the stride function has a kink at the gait; derivatives and
    multipliers there are means of both sides.

    The result is a walker like any other. Its parameters are those of `walker`; x* as
    `reference_theta` and so on; and the gains as `push_off_per_theta` and so on. All can be
    differentiated, optimised and swept over.

    ```python
    powered = wj.PoweredWalker(0.0, hip_stiffness=2.0, push_off=0.1)
    walker = wj.Feedback(powered, wj.find_gait(powered), {"push_off": (0.5, 0.0)})
    wj.find_gait(walker).multipliers
    ```

    **Arguments:**

    - `walker`: any walker without feedback.
    - `gait`: a gait of period one (`find_gait`), or its state, of shape (section,).
    - `gains`: the row of K for each parameter by name, of shape (section,).
    - `bounds`: the least and the largest value of some of these parameters, within the parameter's
      own bounds, which hold by default. They are parameters too, `least_push_off` and
      `largest_push_off`. A parameter with an open range needs explicit bounds, such as a mass,
      which must exceed 0.

    Raises `ValueError` for parameters that the walker does not have, for values that are not finite
    numbers of that shape, for bounds beyond those of a parameter or missing ones, and for a walker
    that already has feedback.
    """
    check_kind("walker", walker, Walker)
    if type(walker).during_stride is not Walker.during_stride:
        raise WrongUse(f"walker must be one without feedback, not a {type(walker).__name__}")
    check_kind("gains", gains, Mapping)
    bounds = {} if bounds is None else bounds
    check_kind("bounds", bounds, Mapping)
    if not gains:
        raise WrongUse("gains must name one parameter of the walker or more, not {}")
    section = type(walker).section
    state = read_reference(gait, section)
    values = fields_of(walker)
    values |= {f"reference_{name}": state[i] for i, name in enumerate(section)}
    for name, row in gains.items():
        check_parameter(walker, name)
        if name not in values:
            raise WrongUse(f"gains must name single numbers of the walker, not the array of {name}")
        check_bounded(walker, name, bounds)
        row = read_row("gains", name, row, len(section))
        values |= {f"{name}_per_{one}": row[i] for i, one in enumerate(section)}
    for name, pair in bounds.items():
        if name not in gains:
            raise WrongUse(f"bounds must be of parameters with gains, not of {short(name)}")
        low, high = read_row("bounds", name, pair, 2)
        traced = isinstance(low, Tracer) or isinstance(high, Tracer)
        if not traced and not float(low) <= float(high):
            raise WrongUse(f"bounds of {name} must ascend, not be {float(low)}, {float(high)}")
        values |= {f"least_{name}": low, f"largest_{name}": high}
    return remake(type(walker), tuple(gains), tuple(bounds), values)


def check_bounded(walker: Walker, name: str, bounds: Mapping[str, Any]) -> None:
    """Raise `WrongUse` if feedback could set a parameter to a bound that it must not reach."""
    one = next(one for one in parameters(walker) if one.name == name)
    is_open = (one.low > -np.inf and not one.closed) or one.high < np.inf
    if is_open and name not in bounds:
        raise WrongUse(f"bounds must have {name}, which must be {one.bounds()}")


def remake(
    kind: type[Walker], controlled: tuple[str, ...], limited: tuple[str, ...], values: dict
) -> Walker:
    """Make the walker with feedback, with these parameters."""
    return feedback_class(kind, controlled, limited)(**values)


def read_reference(gait: Any, section: tuple[str, ...]) -> Float[Array, " section"]:
    """Return the state of a gait of period one, checked."""
    state = read_array("gait", getattr(gait, "states", gait))
    if state.ndim == 2 and len(state) == 1:
        state = state[0]
    if state.shape != (len(section),):
        raise WrongUse(
            f"gait must be of period one, or its state of shape ({len(section)},), not one of "
            f"shape {state.shape}"
        )
    if not isinstance(state, Tracer) and not np.isfinite(np.asarray(state)).all():
        raise WrongUse(
            f"gait must be one that was found, not {np.asarray(state).tolist()}: give find_gait "
            "another guess"
        )
    return state


def read_row(what: str, name: str, row: Any, size: int) -> Float[Array, " n"]:
    """Return gains or bounds of a parameter, checked."""
    values = read_array(f"{what} of {name}", row)
    if values.shape != (size,):
        raise WrongUse(f"{what} of {name} must be {size} numbers, not {short(row)}")
    return values


def read_array(what: str, given: Any) -> Float[Array, "..."]:
    """Return real numbers as an array; raise `WrongUse` for others."""
    try:
        return jnp.asarray(given, float)
    except (TypeError, ValueError, OverflowError):
        raise WrongUse(f"{what} must be real numbers, not {short(given)}") from None


@cache
def feedback_class(
    kind: type[Walker], controlled: tuple[str, ...], limited: tuple[str, ...]
) -> type[Walker]:
    """Make the class of walkers of a kind with feedback on some parameters."""
    known = {one.name: one for one in parameters(kind)}
    units = {name: one.unit for name, one in known.items()}
    added = [
        Parameter(f"reference_{name}", f"{name} of the gait that feedback keeps", "", 0.0)
        for name in kind.section
    ]
    for name in controlled:
        added += [
            Parameter(f"{name}_per_{one}", f"gain of {name} on {one}", units.get(name, ""), 0.0)
            for one in kind.section
        ]
    added = [one._replace(low=-np.inf, high=np.inf) for one in added]
    for name in limited:
        own = known.get(name, Parameter(name, "", "", 0.0, -np.inf, np.inf))
        added += [
            own._replace(name=f"{end}_{name}", meaning=f"{end} {name} that feedback sets")
            for end in ("least", "largest")
        ]
    fields = {one.name: eqx.field(converter=one.convert, default=one.default) for one in added}
    names = {"controlled": controlled, "limited": limited, "kind": kind}
    namespace = {
        "__annotations__": dict.fromkeys(fields, Any),
        "__module__": __name__,
        "__doc__": f"A `{kind.__name__}` with feedback on {', '.join(controlled)}.",
        **fields,
        **names,
    }
    metaclass: Any = type(kind)
    return metaclass(f"Feedback{kind.__name__}", (FeedbackWalker, kind), namespace)

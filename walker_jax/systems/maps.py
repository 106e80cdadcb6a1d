"""Maps as systems: a function of a point and of parameters."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from walker_jax.checks import WrongUse, check_kind, short
from walker_jax.grids import Grid
from walker_jax.systems.outcomes import Outcome
from walker_jax.systems.parameter import Parameter
from walker_jax.systems.system import System, code_field
from walker_jax.systems.trees import make_static


class Map(System):
    """A map x -> f(x, **parameters) as a system: every stride takes the time 1.

    ```python
    def henon(x, a, b):
        return jnp.stack([1 - a * x[0] ** 2 + x[1], b * x[0]])

    wj.Map(henon, ("x", "y"), parameters={"a": 1.4, "b": 0.3})
    ```

    **Arguments:**

    - `f`: a pure JAX function of a point, of shape (coordinates,), and of the parameters by name.
    - `coordinates`: names of the coordinates.
    - `parameters`: numbers by name, for derivatives, continuation and sweeps; or arrays, or trees
      of arrays such as networks.
    - `feasible`: a function (x, **parameters) that tells whether a stride may begin at a point; by
      default at any finite one. If it returns a real number, points where it is positive are
      feasible, and it is the `margin` of a stride, which gives areas of basins their derivatives.
    - `angles`: names of those coordinates that are angles, which `f` returns within one turn.
    - `region`: axes of a grid, `{"x": (low, high, count), ...}`, whose cells are the starts of
      searches for periodic points.

    Raises `ValueError` for names that are not distinct identifiers, and for an `f` or `feasible`
    that is not a function.
    """

    f: Callable = code_field()
    section: tuple[str, ...] = code_field()  # pyright: ignore[reportIncompatibleVariableOverride] (of each map)
    parameters: dict[str, Any]  # pyright: ignore[reportGeneralTypeIssues] (no default; __init__ is our own)
    angles: tuple[str, ...] = code_field()  # pyright: ignore[reportIncompatibleVariableOverride] (of each map)
    within: Callable | None = code_field()
    region: tuple | None = code_field()

    def __init__(
        self,
        f: Callable[..., Any],
        coordinates: Sequence[str],
        *,
        parameters: Mapping[str, Any] | None = None,
        feasible: Callable[..., Any] | None = None,
        angles: tuple[str, ...] | list[str] = (),
        region: Mapping[str, Any] | None = None,
    ):
        if not callable(f):
            raise WrongUse(f"f must be a function, not {short(f)}")
        if feasible is not None and not callable(feasible):
            raise WrongUse(f"feasible must be a function, not {short(feasible)}")
        check_kind("parameters", {} if parameters is None else parameters, Mapping)
        check_names("coordinates", coordinates)
        check_names("parameters", (*coordinates, *(parameters or {})))
        for name in parameters or {}:
            if hasattr(Map, name) or name in Map.__dataclass_fields__:
                raise WrongUse(f"parameters must have other names than a map's own {name}")
        self.f, self.section, self.within = f, tuple(coordinates), feasible
        self.parameters = {
            name: as_parameter(name, value) for name, value in (parameters or {}).items()
        }
        self.angles = tuple(angles) if isinstance(angles, list) else angles
        self.region = None if region is None else freeze(region_of(self.section, region))

    def __getattr__(self, name: str) -> Any:
        """Return a parameter by its name."""
        found = vars(self).get("parameters", {})
        if name in found:
            return found[name]
        label = self.label() if "f" in vars(self) else type(self).__name__  # while it is unpickled
        raise AttributeError(f"{label} has no parameter {name!r}")

    def label(self):
        return getattr(self.f, "__name__", type(self).__name__)

    def advance(self, x):
        return self.f(x, **self.parameters), Outcome.STRIDE, 1.0

    def feasible(self, x):
        if self.within is None:
            return super().feasible(x)
        value = self.within(x, **self.parameters)
        return super().feasible(x) & (value if is_logical(value) else value > 0)

    def margin(self, x):
        value = None if self.within is None else self.within(x, **self.parameters)
        return None if value is None or is_logical(value) else value

    def gait_region(self):
        return super().gait_region() if self.region is None else Grid.plain(**dict(self.region))


def as_parameter(name: str, value: Any) -> Any:
    """Return a parameter of a map, checked: a number or an array of reals, or a tree of them."""
    shape = () if isinstance(value, str) else np.shape(value) if eqx.is_array_like(value) else None
    exact = shape and not jnp.issubdtype(jnp.result_type(value), jnp.floating)
    if shape is None or exact:  # a tree or a function, or places in a table
        return make_static(value, name)
    return Parameter(name, "", "", low=-np.inf, shape=shape).convert(value)


def is_logical(value: Any) -> bool:
    return jnp.result_type(value) == jnp.dtype(bool)


def check_names(name: str, values: Sequence[str]) -> None:
    """Refuse values that are not distinct names."""
    proper = not isinstance(values, str) and all(
        isinstance(one, str) and one.isidentifier() for one in values
    )
    if not proper or not values or len({*values}) < len(values):
        raise WrongUse(f"{name} must be different names, such as ('x', 'y'), not {short(values)}")


def freeze(grid: Grid) -> tuple:
    """Return the axes of a grid as a value that can be compared."""
    ends = zip(grid.names, grid.lower, grid.upper, grid.shape, strict=True)
    return tuple((name, (float(low), float(high), n)) for name, low, high, n in ends)


def region_of(section: tuple[str, ...], region: Mapping[str, Any]) -> Grid:
    """Return a grid of these axes over all coordinates of a section."""
    check_kind("region", region, Mapping)
    if tuple(region) != section:
        raise WrongUse(f"region must have the axes {', '.join(section)}, not {short([*region])}")
    return Grid.plain(**region)

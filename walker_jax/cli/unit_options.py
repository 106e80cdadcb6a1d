"""The option `--units`, for answers in SI."""

from collections.abc import Iterable
from typing import Any, NamedTuple

import walker_jax as wj
from walker_jax.cli.options import Group, named
from walker_jax.refusals import WrongUse


class InUnits(Group, theme="Units"):
    """The sizes of the walker's units, for an answer in SI."""

    units: dict[str, Any] = named(
        "The walker's length in m, mass in kg, and gravity (default: 9.81 m/s²): answers in SI.",
        "VALUE",
    )

    @property
    def chosen(self) -> "wj.Units | None":
        """The units; None to keep those of the walker."""
        if not self.units:
            return None
        for name in self.units:
            if name not in wj.Units._fields:
                raise WrongUse(f"--units must be of {', '.join(wj.Units._fields)}, not of {name}")
        for name in ("length", "mass"):
            if name not in self.units:
                raise WrongUse(f"--units {name}=VALUE is required too")
        for name, value in self.units.items():
            if value <= 0:
                raise WrongUse(f"--units {name}={value:g} must be above 0")
        return wj.Units(**self.units)

    def of(self, walker: "wj.System") -> "Sizes":
        """Return the sizes of a walker's units; refuse other systems, whose units are unknown."""
        if self.units and not isinstance(walker, wj.Walker):
            raise WrongUse(f"--units is for walkers, not for {walker.label()}: leave it out")
        return Sizes(self.chosen)


class Sizes(NamedTuple):
    """Conversions of an answer to SI; without units it stays as it is."""

    units: "wj.Units | None"

    def states(self, states: Any, names: Iterable[str]) -> Any:
        """Return states of these coordinates."""
        from walker_jax.walkers.units import units_of_section

        if self.units is None:
            return states
        return states * [self.units.size(one) for one in units_of_section(names)]

    def times(self, times: Any) -> Any:
        """Return times."""
        from walker_jax.walkers.units import TIME

        return times if self.units is None else times * self.units.size(TIME)

    def unit(self, name: str) -> str:
        """Return the unit to print after a coordinate, or a time."""
        if self.units is None:
            return ""
        return " s" if name == "time" else " rad/s" if name.endswith("dot") else " rad"

    @property
    def said(self) -> list[str]:
        """The line before a table that says its units, if they are not the walker's."""
        return [] if self.units is None else ["Angles in rad, rates in rad/s, times in s."]

    @property
    def named(self) -> dict[str, Any]:
        """The units, for JSON."""
        if self.units is None:
            return {}
        return {"units": {"angle": "rad", "rate": "rad/s", "time": "s"} | self.units._asdict()}

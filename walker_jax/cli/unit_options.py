"""The option `--units`, for answers in SI."""

from collections.abc import Iterable
from typing import Any

import walker_jax as wj
from walker_jax.cli import library as lib
from walker_jax.cli.options import Group, named
from walker_jax.refusals import WrongUse


class InUnits(Group, theme="Units"):
    """The sizes of the walker's units, for an answer in SI; without them it stays as it is."""

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

    def check(self, system: "wj.System") -> None:
        """Refuse wrong units, and systems other than walkers, whose units are unknown."""
        if self.chosen and not isinstance(system, wj.Walker):
            raise WrongUse(f"--units is for walkers, not for {system.label()}: leave it out")

    def states(self, states: Any, names: Iterable[str]) -> Any:
        """Return states of these coordinates in the units."""
        units = self.chosen
        return states * [*map(units.size, lib.units_of_section(names))] if units else states

    def times(self, times: Any) -> Any:
        """Return times in the units."""
        return times * self.chosen.size(lib.TIME) if self.chosen else times

    def unit(self, name: str) -> str:
        """Return the unit to print after a coordinate, or a time."""
        if not self.units:
            return ""
        return " s" if name == "time" else " rad/s" if name.endswith("dot") else " rad"

    @property
    def named(self) -> dict[str, Any]:
        """The units, for JSON."""
        si = {"angle": "rad", "rate": "rad/s", "time": "s"}
        return {"units": si | self.chosen._asdict()} if self.chosen else {}

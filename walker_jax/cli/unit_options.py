"""The option `--units`, for answers in SI."""

from typing import Any

import walker_jax as wj
from walker_jax.cli.options import named
from walker_jax.refusals import WrongUse

UNITS: Any = named(
    "The walker's length in m, mass in kg, and gravity (default: 9.81 m/s²): answers in SI.",
    "VALUE",
    theme="Units",
)


def chosen_units(given: dict[str, float], system: "wj.System | None" = None) -> "wj.Units":
    """Return the units of an answer: those that are given, or those of a walker, which are all 1.

    Units of other systems than walkers are unknown.
    """
    if not given:
        return wj.Units(1.0, 1.0, 1.0)
    for name in given:
        if name not in wj.Units._fields:
            raise WrongUse(f"--units must be of {', '.join(wj.Units._fields)}, not of {name}")
    for name in ("length", "mass"):
        if name not in given:
            raise WrongUse(f"--units {name}=VALUE is required too")
    if system is not None and not isinstance(system, wj.Walker):
        raise WrongUse(f"--units is for walkers, not for {system.label()}: leave it out")
    made = wj.Units(**given)
    made.size("l")  # refuses a size that is not above zero, before any work
    return made


def units_named(given: dict[str, float]) -> dict[str, Any]:
    """Return the units that are given, for JSON."""
    si = {"angle": "rad", "rate": "rad/s", "time": "s"}
    return {"units": si | chosen_units(given)._asdict()} if given else {}

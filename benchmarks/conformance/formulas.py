"""Systems of the conformance set, whose formulas are evaluated for numbers of any kind.

A system is a file of `systems/`. A formula is an expression of Python with + - * / **, whole
numbers, the functions of a `Kind`, `pi`, the time `t`, variables, parameters, and the shorthands of
`let`. Every number of a file stands for the float64 number nearest to it.
"""

import json
from collections.abc import Callable, Iterable
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

FOLDER = Path(__file__).resolve().parent / "systems"
FUNCTIONS = ("sin", "cos", "tan", "exp", "log", "sqrt", "max")
Numbers = dict[str, Any]


class Kind(NamedTuple):
    """Numbers of one kind, such as those of NumPy, JAX, mpmath or flint."""

    number: Callable[[float], Any]
    functions: dict[str, Any]
    """Those of `FUNCTIONS`, and pi, by name."""


@cache
def compiled(formula: str) -> Any:
    return compile(formula, formula, "eval")


def names() -> list[str]:
    """Return the names of all systems."""
    return sorted(path.stem for path in FOLDER.glob("*.json"))


def read(name: str) -> dict[str, Any]:
    """Return the file of a system."""
    return json.loads((FOLDER / f"{name}.json").read_text())


class Formulas:
    """The formulas of a system, for numbers of one kind. States and parameters are by name."""

    def __init__(self, system: dict[str, Any], kind: Kind):
        self.system, self.kind = system, kind
        self.variables = ["t", *system["variables"]]

    def parameters(self, run: dict[str, Any]) -> Numbers:
        """Return the parameters of a run."""
        own = self.system["parameters"] | run.get("parameters", {})
        return {name: self.kind.number(float(text)) for name, text in own.items()}

    def start(self, run: dict[str, Any]) -> Numbers:
        """Return the state in which a run starts, at the time 0."""
        state = {"t": "0"} | run["start"]
        return {name: self.kind.number(float(state[name])) for name in self.variables}

    def guards(self, mode: str, run: dict[str, Any]) -> list[dict[str, Any]]:
        """Return the guards of a mode; the last one is the end of the run, if that is a time."""
        over = [{"rises": f"t - {run['until']}", "leads_to": "end"}] if "until" in run else []
        return self.system["modes"][mode]["guards"] + over

    def evaluate(self, mode: str, formulas: Iterable[str], state: Numbers, p: Numbers) -> list[Any]:
        """Return the values of formulas in a state of a mode."""
        known = self.kind.functions | p | state
        for shorthands in self.system.get("let", {}), self.system["modes"][mode].get("let", {}):
            for name, formula in shorthands.items():
                known[name] = eval(compiled(formula), {"__builtins__": {}}, known)
        return [eval(compiled(one), {"__builtins__": {}}, known) for one in formulas]

    def field(self, mode: str, state: Numbers, p: Numbers) -> Numbers:
        """Return the rates of all variables."""
        rates = {"t": "1"} | self.system["modes"][mode]["field"]
        found = self.evaluate(mode, (rates.get(name, "0") for name in self.variables), state, p)
        return dict(zip(self.variables, found, strict=True))

    def reset(self, mode: str, guard: dict[str, Any], state: Numbers, p: Numbers) -> Numbers:
        """Return the state after a guard has risen; a variable that is not reset stays."""
        new = guard.get("reset", {})
        found = self.evaluate(mode, new.values(), state, p)
        return state | dict(zip(new, found, strict=True))

"""Runge-Kutta methods as loops for Numba, written number by number from their coefficients."""

from typing import Any

import diffrax

LOOP = """
import math

from numba import njit, prange


@njit(parallel=True, error_model="numpy")
def solve(starts, parameters, times, length, relative, absolute, states):
    for i in prange(len(starts)):
        {start}
        p, t, h = parameters[i], 0.0, length
        {rates_0}
        for j in range(len(times)):
            end = times[j]
            while t < end:
                s = min(h, end - t) if end - t > 1.000001 * h else end - t
                {stages}
                {error}
                size = math.sqrt(({size}) / {count})
                if size <= 1 or relative == 0:
                    t = end if s == end - t else t + s
                    {accept}
                if relative > 0:
                    factor = min(max(0.9 * max(size, 1e-10) ** (-1 / {order}), 0.2), 10.0)
                    h = s * factor if size > 1 or s == h else max(h, s * factor)
            {write}
    return states
"""


def write_loop(field: dict[str, str], solver: diffrax.AbstractERK) -> Any:
    """Return a function (starts, parameters, times, length, relative, absolute, states) -> states.

    `field` has the rate of each variable by its name, as an expression of the variables and of `p`.
    With a relative tolerance of zero all steps have the `length`. States are written to `states`.
    Steps end at the times. The method is one whose last stage begins the next step.
    """
    tableau: Any = solver.tableau
    names, lines = list(field), {}
    last = len(tableau.b_sol) - 1

    def rates(stage: int, values: dict[str, str]) -> list[str]:
        """Return lines that compute the rates of a stage, by the values of the variables there."""
        given = [f"{name}_ = {values[name]}" for name in names]
        expressions = {name: field[name] for name in names}
        for name in names:
            expressions = {k: e.replace(f"[{name}]", f"{name}_") for k, e in expressions.items()}
        return given + [f"{name}{stage} = {expressions[name]}" for name in names]

    def weighted(name: str, weights) -> str:
        terms = [f"{float(w)!r} * {name}{k}" for k, w in enumerate(weights) if w != 0]
        return " + ".join(terms)

    stages: list[str] = []
    for k, weights in enumerate(tableau.a_lower, start=1):
        stages += rates(k, {name: f"{name} + s * ({weighted(name, weights)})" for name in names})
    lines["start"] = [f"{name} = starts[i, {k}]" for k, name in enumerate(names)]
    lines["rates_0"] = rates(0, {name: name for name in names})
    lines["stages"] = stages
    scale = "absolute + relative * max(abs({0}), abs({0}_))"  # {0}_: of the last stage
    lines["error"] = [
        f"e_{name} = s * ({weighted(name, tableau.b_error)}) / ({scale.format(name)})"
        for name in names
    ]
    lines["accept"] = [f"{name}, {name}0 = {name}_, {name}{last}" for name in names]
    lines["write"] = [f"states[i, j, {k}] = {name}" for k, name in enumerate(names)]
    source = LOOP
    for key, value in lines.items():
        (line,) = [one for one in LOOP.split("\n") if f"{{{key}}}" in one]
        indent = "\n" + line[: line.index("{")]
        source = source.replace(f"{{{key}}}", indent.join(value))
    size = " + ".join(f"e_{name} ** 2" for name in names)
    source = source.replace("{size}", size).replace("{count}", str(len(names)))
    source = source.replace("{order}", str(solver.order(None)))
    found: dict[str, Any] = {}
    exec(source, found)
    return found["solve"]

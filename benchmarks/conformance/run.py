"""How many digits of the conformance set does each solver get right, and which events does it miss?

    python benchmarks/conformance/run.py                        # all; half an hour, most of it
                                                                # to compile for diffrax
    python benchmarks/conformance/run.py --only ball --solvers SciPy

A row is a run. Digits are of the worst time, state or derivative, relative to the number or to 1,
whichever is larger; `3 missed`: of its events three, from the first wrong one on, are not found.
The last column is how much the run amplifies an error of its start: so many digits nobody has in
float64.
"""

import argparse
import math
from collections.abc import Iterable
from typing import Any

from formulas import names, read


def digits(pairs: Iterable[tuple[float, float]]) -> float:
    """Return the least number of right digits among pairs of found and right numbers."""
    errors = [abs(found - right) / max(1.0, abs(right)) for found, right in pairs]
    worst = max((1.0 if math.isnan(one) else one for one in errors), default=0.0)
    return min(16.0, max(0.0, -math.log10(max(worst, 1e-17))))


def compare(answer: Any, run: dict[str, Any]) -> tuple[int, float, float, float]:
    """Return the events after the first wrong one, and digits of times, states, derivatives."""
    right = [(one["mode"], one["leads_to"]) for one in run["events"]]
    same = [a[:2] == b for a, b in zip(answer.events, right, strict=False)]
    missed = len(right) - [*same, False].index(False)
    times = [(a[2], float(b["time"])) for a, b in zip(answer.events, run["events"], strict=False)]
    states = [(answer.end[name], float(one)) for name, one in run["end"].items()]
    slopes = [
        (answer.by[name][one], float(slope))
        for name, row in run["derivatives"].items()
        for one, slope in row.items()
    ]
    return missed, digits(times), digits(states), digits(slopes)


def row(name: str, run: dict[str, Any], solvers: dict[str, Any]) -> list[str]:
    """Return a row of the table: the run, four numbers for each solver, the amplification."""
    cells = []
    for solve in solvers.values():
        try:
            missed, *right = compare(solve(read(name), run), run)
        except Exception as error:  # whatever a solver raises is its answer
            cells.append(f"fails: {type(error).__name__}")
            continue
        cells.append(f"{missed} missed" if missed else " ".join(f"{one:.0f}" for one in right))
    slopes = [abs(float(one)) for line in run["derivatives"].values() for one in line.values()]
    return [f"{name}: {run['name']}", str(len(run["events"])), *cells, f"{max(slopes):.0e}"]


def main() -> None:
    from solvers import SOLVERS

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", nargs="*", default=names(), help="names of systems")
    parser.add_argument("--solvers", nargs="*", default=[*SOLVERS], help=", ".join(SOLVERS))
    arguments = parser.parse_args()
    solvers = {name: SOLVERS[name] for name in arguments.solvers}
    print("|", " | ".join(["run", "events", *solvers, "amplifies"]), "|")
    print("|---|---:|" + "---|" * len(solvers) + "---:|")
    for name in arguments.only:
        for run in read(name)["runs"]:
            print("|", " | ".join(row(name, run, solvers)), "|", flush=True)


if __name__ == "__main__":
    main()

"""Compute the numbers of the conformance set in two ways, and write them where they agree.

    python benchmarks/conformance/make.py              # all; an hour
    python benchmarks/conformance/make.py ball layer   # some

It needs python-flint and mpmath, of the extra [dev].
"""

import json
import sys
from typing import Any

from formulas import FOLDER, names, read
from mpmath import mp, mpf
from second_ways import MOTIONS, Runs
from taylor_series import solve

DIGITS = 20
"""Digits that are written."""
AGREE = mpf(10) ** -22
"""Largest difference of the two ways, relative to the number or to 1."""


def exact(number: Any) -> Any:
    """Return a number of flint as one of mpmath."""
    return mpf(number.str(mp.dps, radius=False))


def written(number: Any) -> str:
    return str(mp.nstr(number, DIGITS)) if abs(number) > 1e-45 else "0"


def compute(name: str, system: dict[str, Any], run: dict[str, Any]) -> dict[str, Any]:
    """Return a run with its numbers; raise `ArithmeticError` where the two ways differ."""
    events, state = solve(system, run)
    runs = Runs(system, name, run)
    other, end = runs.follow(runs.formulas.start(run), runs.formulas.parameters(run))
    slopes = runs.derivatives(other)
    if [one[:2] for one in events] != [one[:2] for one in other]:
        raise ArithmeticError(f"{name}, {run['name']}: {events} are not {other}")
    by = [*system["variables"], run["by"]]
    pairs = [(exact(a[2]), b[2]) for a, b in zip(events, other, strict=True)]
    pairs += [(exact(state[one].value), end[one]) for one in end]
    pairs += [(exact(state[one].by[i]), slopes[b][one]) for i, b in enumerate(by) for one in end]
    apart = max(abs(a - b) / max(1, abs(b)) for a, b in pairs)
    if apart > AGREE:
        raise ArithmeticError(f"{name}, {run['name']}: the two ways differ by {mp.nstr(apart, 3)}")
    print(f"{name}, {run['name']}: {len(events)} events, agree to {mp.nstr(apart, 2)}", flush=True)
    leads_to = [runs.formulas.guards(mode, run)[i]["leads_to"] for mode, i, _ in events]
    told = {"name", "mode", "parameters", "start", "until", "by"}
    return {key: value for key, value in run.items() if key in told} | {
        "events": [
            {"mode": one[0], "guard": one[1], "leads_to": to, "time": written(exact(one[2]))}
            for one, to in zip(events, leads_to, strict=True)
        ],
        "end": {one: written(exact(state[one].value)) for one in end},
        "derivatives": {
            b: {one: written(exact(state[one].by[i])) for one in end} for i, b in enumerate(by)
        },
        "second way": "closed form" if name in MOTIONS else "extrapolation",
        "the two ways differ by": mp.nstr(apart, 2),
    }


def main() -> None:
    for name in sys.argv[1:] or names():
        system = read(name)
        system["runs"] = [compute(name, system, run) for run in system["runs"]]
        (FOLDER / f"{name}.json").write_text(json.dumps(system, indent=1) + "\n")


if __name__ == "__main__":
    main()

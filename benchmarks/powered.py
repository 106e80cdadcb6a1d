"""Are gaits and sensitivity norms of powered walkers those of an independent integration?

The reference uses scipy alone (tests/helpers/powered_reference.py): Runge-Kutta of order 8, places
and velocities in the plane, differences of fourth order. docs/accuracy-basins.md has the table.
"""

import importlib
import sys
from pathlib import Path
from typing import Any

import jax
import numpy as np

import walker_jax as wj

sys.path.append(str(Path(__file__).parent.parent / "tests" / "helpers"))
reference: Any = importlib.import_module("powered_reference")  # a module of the tests

WALKERS = (
    (0.009, 0.0, 0.0, 0.0, 0.0),
    (0.009, 1.0, 0.0, 0.0, 0.0),
    (0.009, 0.5, 0.1, -0.2, 0.01),
    (0.0, 0.0, 0.0, 0.0, 0.05),
    (-0.01, 4.0, 1.0, -0.5, 0.1),
)


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    names = "slope | stiffness | damping | slack angle | push-off | theta | thetadot"
    print(f"| {names} | largest difference | norm | relative difference |")
    print("|" + " ---: |" * 10)
    for values in WALKERS:
        walker = wj.PoweredWalker(*values)
        gait = wj.find_gait(walker)
        theta, thetadot = gait.states[0]
        apart = np.abs(reference.find_gait(values, gait.states[0]) - gait.states[0]).max()
        norm = float(wj.gait_sensitivity(walker, gait).norm)
        other = reference.sensitivity_norm(values, gait.states[0])
        row = [f"{value:g}" for value in values]
        row += [f"{theta:.12f}", f"{thetadot:.12f}", f"{apart:.1e}"]
        row += [f"{norm:.8g}", f"{abs(other / norm - 1):.1e}"]
        print(f"| {' | '.join(row)} |", flush=True)


if __name__ == "__main__":
    main()

"""How long do the commands take, compared with another checkout, in one run?

Each command runs with this checkout and with the other in turn, each in a folder of its own: first
with an empty cache of machine code, then with a full one. On a shared machine compare processor
times. `--commands` selects commands.

    python benchmarks/answers.py OTHER_CHECKOUT --commands bifurcation robustness
"""

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

COMMANDS = {
    "bifurcation": "bifurcation",
    "robustness": "robustness --slope 0.009",
    "area": "optimise --over slope --bound slope=0.001:0.02",
    "disturbance": "optimise --over slope --bound slope=0.001:0.014 --objective least-disturbance",
    "spring": "optimise --walker spring --over hip-stiffness --bound hip-stiffness=0:9",
    "reproduce": "reproduce --quick",
}


def measure(checkout: Path, command: str, cache: Path) -> tuple[float, float]:
    """Seconds of processor time and of wall-clock time that a command takes."""
    with tempfile.TemporaryDirectory() as folder:
        environment = os.environ | {"PYTHONPATH": str(checkout), "WALKER_JAX_CACHE_DIR": str(cache)}
        environment.pop("JAX_COMPILATION_CACHE_DIR", None)
        words = [sys.executable, "-m", "walker_jax", *command.split(), "--json", "--out", "answer"]
        used = lambda: sum(resource.getrusage(resource.RUSAGE_CHILDREN)[:2])
        before, begun = used(), time.perf_counter()
        subprocess.run(words, cwd=folder, env=environment, check=True, stdout=subprocess.DEVNULL)
        return used() - before, time.perf_counter() - begun


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("other", type=Path)
    parser.add_argument("--commands", nargs="+", choices=COMMANDS, default=[*COMMANDS])
    given = parser.parse_args()
    here = Path(__file__).resolve().parent.parent
    print("processor time and wall-clock time in s, of the other checkout and of this one")
    with tempfile.TemporaryDirectory() as folder:
        for name in given.commands:
            for state in ("cold", "cached"):
                rows = [
                    measure(checkout.resolve(), COMMANDS[name], Path(folder) / str(i))
                    for i, checkout in enumerate((given.other, here))
                ]
                (old, old_wall), (new, new_wall) = rows
                print(
                    f"{name:12} {state:7} {old:7.1f} {old_wall:7.1f}   {new:7.1f} {new_wall:7.1f}"
                    f"   {old / new:.2f} times as long",
                    flush=True,
                )


if __name__ == "__main__":
    main()

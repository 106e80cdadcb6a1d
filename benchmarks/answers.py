"""How long does an answer take, compared with another checkout, in one run?

Each command, and each question in Python, is asked of this checkout and of another, one after the
other, in processes and folders of their own: first with an empty cache of programs ("cold"), then
with it ("cached"); in Python a second time in the same process too ("warm"). Processor time
compares best on a machine that others use too. `--only` chooses among them. A question that the
other checkout does not know is nan; one that fails in this checkout ends the comparison.

    python benchmarks/answers.py OTHER_CHECKOUT --only import basin kneed
"""

import argparse
import compileall
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

THIS = Path(__file__).resolve().parent.parent
COMMANDS = {
    "help": "basin --help",
    "basin": "basin",
    "bifurcation": "bifurcation",
    "robustness": "robustness --slope 0.009",
    "area": "optimise --over slope --bound slope=0.001:0.02",
    "disturbance": "optimise --over slope --bound slope=0.001:0.014 --objective least-disturbance",
    "spring": "optimise --walker spring --over hip-stiffness --bound hip-stiffness=0:9",
    "reproduce": "reproduce --quick",
}
GAITS = {
    "simplest": "wj.SimplestWalker(0.009)",
    "spring walker": "wj.SpringWalker(0.009, 0.3)",
    "point feet": "wj.PointFootWalker(0.009)",
    "round feet": "wj.RoundFootWalker(0.009)",
    "upper body": "wj.UpperBodyWalker(0.009)",
    "powered": "wj.PoweredWalker(0.009, hip_stiffness=0.3)",
    "kneed": "wj.KneedWalker(0.05)",
    "in space": "wj.SpatialWalker()",
    "torque": "Torque(0.009)",
    "brake": "Braked(0.009)",
}
"""Walkers of which a gait is sought; the last two are of classes of the user's own."""
PROGRAMS = {
    "import": "wj.stride",
    **{name: f"wj.find_gait({walker})" for name, walker in GAITS.items()},
    "branch": 'wj.continue_gait(wj.SimplestWalker(0.009), "slope", (0.001, 0.016))',
    "boundary": """wj.boundary_dimension(
        wj.SimplestWalker(0.009),
        wj.Grid.sheared(theta=(0, 0.785, 200), sum=(-0.12, 0.06, 200)))""",
    "shock": "wj.least_disturbance(wj.SimplestWalker(0.009))",
    "Hessian": """jax.jit(jax.hessian(lambda x: wj.stride(wj.SimplestWalker(0.009), x).state))(
        jnp.array([0.2, -0.2]))""",
    "multiplier": """jax.grad(lambda slope: jnp.abs(
        wj.find_gait(wj.SimplestWalker(slope), jnp.array([0.2, -0.2])).multipliers[0]))(0.009)""",
    "four parameters": """wj.optimise(
        wj.PoweredWalker(0.009, 0.3), {"slope": (0.004, 0.012), "hip_stiffness": (0.0, 4.0),
        "hip_damping": (0.0, 0.1), "hip_angle": (-0.2, 0.2)}, "area")""",
}
PROGRAM = """
import resource, time
import jax, jax.numpy as jnp
jax.config.update("jax_enable_x64", True)
import walker_jax as wj

class Torque(wj.SimplestWalker):
    def vector_field(self, state):
        free = super().vector_field(state)
        return free._replace(phidot=free.phidot - 0.1 * state.phi)

class Released(wj.Phase):  # a brake, until the stance leg is upright
    begin = end = lambda self, state: state
    event = lambda self, state: -state.theta
    contact_force = lambda self, state: self.walker.contact_force(state)

    def vector_field(self, state):
        free = self.walker.vector_field(state)
        return free._replace(phidot=free.phidot - 0.05 * state.phidot)

class Braked(wj.SimplestWalker):
    def phases(self):
        return (Released(self),)

def ask():
    return {question}

def used():
    return sum(resource.getrusage(resource.RUSAGE_SELF)[:2])

ask()
before, begun = used(), time.perf_counter()
ask()
print(used() - before, time.perf_counter() - begun)
"""


def measure(checkout: Path, name: str, cache: Path) -> list[tuple[float, float]]:
    """Seconds of processor and of wall-clock time of an answer; in Python, of a second one too."""
    command = ["-m", "walker_jax", *COMMANDS[name].split()] if name in COMMANDS else None
    if command and "--help" not in command:
        command += ["--out", "answer"]
    program = ["-c", PROGRAM.replace("{question}", PROGRAMS.get(name, ""))]
    with tempfile.TemporaryDirectory() as folder:
        environment = os.environ | {"PYTHONPATH": str(checkout), "WALKER_JAX_CACHE_DIR": str(cache)}
        environment.pop("JAX_COMPILATION_CACHE_DIR", None)
        used = lambda: sum(resource.getrusage(resource.RUSAGE_CHILDREN)[:2])
        before, begun = used(), time.perf_counter()
        ended = subprocess.run(
            [sys.executable, *(command or program)],
            cwd=folder,
            env=environment,
            capture_output=True,
            text=True,
        )
        whole = used() - before, time.perf_counter() - begun
    if ended.returncode and checkout == THIS:
        raise RuntimeError(f"this checkout fails at {name}:\n{ended.stderr}")
    if ended.returncode:  # the other checkout may not know the question
        return [(float("nan"), float("nan"))] * (1 if command else 2)
    if command:
        return [whole]
    cpu, wall = map(float, ended.stdout.split()[-2:])
    return [(whole[0] - cpu, whole[1] - wall), (cpu, wall)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("other", type=Path)
    known = [*COMMANDS, *PROGRAMS]
    parser.add_argument("--only", nargs="+", choices=known, default=known)
    given = parser.parse_args()
    checkouts = given.other.resolve(), THIS
    for checkout in checkouts:  # as pip does; where bytecode is off, each process would compile all
        compileall.compile_dir(checkout / "walker_jax", quiet=1)
    print("seconds of processor and of wall-clock time, of the other checkout and of this one")
    with tempfile.TemporaryDirectory() as folder:
        for name in given.only:
            for state in ("cold", "cached"):
                both = [
                    measure(checkout, name, Path(folder) / str(i) / name)
                    for i, checkout in enumerate(checkouts)
                ]
                for kind, old, new in zip((state, "warm"), *both, strict=False):
                    if kind == "warm" and state == "cold":
                        continue
                    print(
                        f"{name:16} {kind:7} {old[0]:7.2f} {old[1]:7.2f}   {new[0]:7.2f}"
                        f" {new[1]:7.2f}   {old[0] / new[0]:.2f} times as long",
                        flush=True,
                    )


if __name__ == "__main__":
    main()

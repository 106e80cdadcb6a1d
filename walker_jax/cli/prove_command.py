"""`walker-jax prove`."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import walker_jax as wj
from walker_jax.basins.windows import grid_along
from walker_jax.cli.answers import Output, request_for
from walker_jax.cli.conclusions import conclude_proof
from walker_jax.cli.groups import option
from walker_jax.cli.section import Window
from walker_jax.cli.walker_options import takes_walker
from walker_jax.proofs.basin_proofs import summarise_proof
from walker_jax.systems.system import System
from walker_jax.walkers.parameters import describe_in_words


@dataclass(frozen=True)
class Disc:
    theme = "Theorem"
    radius: float | None = option(
        None, "Radius of a disc about the gait, in (theta, thetadot), instead of a window."
    )
    levels: int = option(12, "Halve undecided cells this many times.", min=0)


@takes_walker()
def prove(
    walker: System,
    disc: Disc,
    window: Window,
    output: Output = Output(Path("proof.zarr")),
) -> None:
    """Prove that all starts near a gait walk for ever, or which of a window do.

    Arithmetic with rigorous bounds carries cells of starts from stride to stride, until all of a
    cell is in a trap about the gait, or has fallen. The page proofs.md says what the theorems are,
    and what must be trusted. For the walkers simplest, spring and powered. A window bounds the area
    of its starts that walk for ever; --levels 4 is then enough for a picture. What is interrupted
    is resumed by the same command.
    """
    axes = window.axes(walker) if disc.radius is None else {}
    request = request_for("prove", walker, radius=disc.radius, axes=axes, levels=disc.levels)

    def compute():
        region = grid_along(axes) if disc.radius is None else disc.radius
        how = {"levels": disc.levels, "progress": True, **output.place(request)}
        return wj.prove_basin(walker, region, **how)

    data = output.produce(request, compute, "proof", kept=True)
    answer = {"walker": request["walker"]} | summarise_proof(data)
    output.tell(answer, proof_in_words(walker, answer))


def proof_in_words(walker: System, answer: dict) -> Iterator[str]:
    """Write the theorem, or the bounds that are proved."""
    cells = answer["cells"]
    yield f"Proof, {describe_in_words(walker)}"
    if answer["radius"] and answer["all_walk"]:
        yield f"  theorem: every start within {answer['radius']:.9g} of the gait walks for ever"
    else:
        if answer["radius"]:
            yield "  not proved of the whole disc: try a smaller one, or more --levels"
        low, high = answer["area_lower"], answer["area_upper"]
        yield f"  starts that walk for ever have an area between {low:.8g} and {high:.8g}"
    yield f"  cells that walk {cells['walk']}, fall {cells['fall']}, are open {cells['open']}"
    size, strides = answer["trap"]["size"], answer["verified_strides"]
    yield f"  {strides} verified strides; trap of size {size:.4g}"
    yield f"  {conclude_proof(proved=not cells['open'] or answer['all_walk'])}"

"""`walker-jax prove`."""

from typing import Any

import walker_jax as wj
from walker_jax.cli import library as lib
from walker_jax.cli.answers import Output, request_for
from walker_jax.cli.commands import command
from walker_jax.cli.options import option
from walker_jax.cli.section import axes_option, grid_of, window_on


@command(
    examples=(
        "prove --radius 0.00223",
        "prove --slope 0.009 --radius 0.00223",
        "prove --theta 0.1 0.2 20 --sum -0.02 0.01 30 --levels 4",
    ),
    time="Half a minute for the first example, most of it to compile.",
    out="proof.zarr",
)
def prove(
    walker: "wj.Walker",
    output: Output,
    axes: dict[str, Any] = axes_option("Window"),
    region: float | None = option(
        None,
        "Radius of a disc about the gait, in (theta, thetadot), instead of a window.",
        "--radius",
        excludes=["axes"],
        above=0,
    ),
    levels: int = option(12, "Halve undecided cells this many times.", least=0),
):
    """Prove that all starts near a gait walk for ever, or which of a window do.

    Arithmetic with rigorous bounds carries cells of starts from stride to stride, until all of a
    cell is in a trap about the gait, or has fallen. The page proofs.md says what the theorems are,
    and what must be trusted. For the walkers simplest, spring and powered. A window bounds the area
    of its starts that walk for ever; --levels 4 is then enough for a picture. What is interrupted
    is resumed by the same command.
    """
    lib.check_provable(walker)
    axes = window_on(walker, axes) if region is None else {}
    request = request_for("prove", walker, radius=region, axes=axes, levels=levels)

    def compute():
        where = grid_of(walker, axes) if region is None else region
        how: Any = {"levels": levels, **output.place(request)}
        return wj.prove_basin(walker, where, **how)

    data = output.produce(request, compute, "proof", kept=True)
    answer = lib.summarise_proof(data)
    yield {"walker": request["walker"]} | answer
    yield f"Proof, {lib.describe_in_words(walker)}"
    if answer["radius"] and answer["all_walk"]:
        yield f"  theorem: every start within {answer['radius']:.9g} of the gait walks for ever"
    else:
        if answer["radius"]:
            yield "  not proved of the whole disc: try a smaller one, or more --levels"
        low, high = answer["area_lower"], answer["area_upper"]
        yield f"  starts that walk for ever have an area between {low:.8g} and {high:.8g}"
    cells = answer["cells"]
    yield f"  cells that walk {cells['walk']}, fall {cells['fall']}, are open {cells['open']}"
    size, strides = answer["trap"]["size"], answer["verified_strides"]
    yield f"  {strides} verified strides; trap of size {size:.4g}"
    yield "  proofs.md says what a proof rests on; more --levels decide more of the open cells."
    yield output.places()

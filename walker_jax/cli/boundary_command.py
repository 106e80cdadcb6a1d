"""`walker-jax boundary`."""

from collections.abc import Iterator
from typing import Any

import walker_jax as wj
from walker_jax.cli import library as lib
from walker_jax.cli.answers import Output, in_words, points_listed, request_for
from walker_jax.cli.commands import command
from walker_jax.cli.options import option
from walker_jax.cli.section import axes_option, grid_of, window_on


@command(
    examples=("boundary", "boundary --slope 0.009 --out steep.zarr"),
    time="Half a minute.",
    out="boundary.zarr",
)
def boundary(
    walker: "wj.System",
    output: Output,
    axes: dict[str, Any] = axes_option("Window"),
    strides: int = option(500, "Strides at most."),
):
    """Measure the boundary between walking and falling: its entropy, its saddles, Wada.

    A region is a set of starts that fall alike, or that converge to one attractor. The basin
    entropy is given for all boxes of 5 x 5 cells, and for those on the boundary. Its growth from
    boxes of 2 to 3 and to 5 cells shows whether the dimension of the boundary exceeds that of a
    line. For each region follows the share of its boundary that is not on the boundary of another
    region: zero if the boundary is Wada, but also if boundaries are merely close. The edge states,
    such as a saddle, are the states to which the boundary leads. The picture has the stable
    manifolds of the saddles. The default window is that of the command basin.
    """
    axes = window_on(walker, axes)
    request = request_for("boundary", walker, axes=axes, strides=strides)
    compute = lambda: wj.boundary(walker, grid_of(walker, axes), strides=strides, progress=True)
    answer = lib.summarise_boundary(output.produce(request, compute, "boundary"))
    yield {"walker": request["walker"]} | answer
    yield from boundary_in_words(walker, answer)
    yield output.places()


def boundary_in_words(walker: "wj.System", answer: dict) -> Iterator[str]:
    """Write the answer of `boundary`."""
    yield f"Boundary between fates and attractors, {lib.describe_in_words(walker)}"
    yield f"  basin entropy {answer['basin_entropy']:.5f} (0: one fate or attractor in each box)"
    entropy = answer["boundary_entropy"]
    if entropy["value"] is not None:
        yield f"  on the boundary {entropy['value']:.4f} +- {entropy['error']:.4f}"
        if entropy["excess"] is not None:
            fractal = "fractal" if entropy["fractal"] else "no sign of a fractal"
            excess = f"{entropy['excess']:.3f} +- {entropy['excess_error']:.3f}"
            yield f"  its dimension exceeds that of a smooth one by {excess} or more: {fractal}"
        yield f"  boxes on the boundary with three regions or more: {entropy['crowded']:.2%}"
    if answer["wada"]:
        shares = ", ".join(f"{one['share']:.1%} at {one['spacing']}" for one in answer["wada"])
        yield f"  largest part of a boundary that touches only two regions: {shares} cells"
        yield "    it tends to nothing on finer grids if the boundary is Wada's"
    yield from (f"  {edge_in_words(walker, one)}" for one in answer["edges"])
    if entropy["value"] is None:
        yield "  No boundary was found in this window: wider axes may hold one."
    else:
        yield "  walker-jax basin --zoom 1e4 shows it near; a finer grid tests more strictly."


def edge_in_words(walker: "wj.System", edge: dict) -> str:
    """Write an edge state in words."""
    regions, between = (
        " / ".join(in_words(one, walker) for one in edge[pair]) for pair in ("regions", "between")
    )
    third = "" if edge["between"] == edge["regions"] else f" (between {between})"
    if edge["kind"] != "saddle":
        return f"{regions}{third}: {edge['kind'] or 'no cycle found'}"
    multipliers = ", ".join(
        f"{complex(*pair):.6g}" if pair[1] else f"{pair[0]:.6g}" for pair in edge["multipliers"]
    )
    saddle = f"saddle of period {edge['period']} at {points_listed(edge['states'])}"
    return f"{regions}{third}: {saddle}, multipliers {multipliers}"

"""`walker-jax boundary`."""

from pathlib import Path
from typing import Annotated, Any

import typer

import walker_jax as wj
from walker_jax import storage
from walker_jax.basins.windows import fill_around_gait, grid_along, outline
from walker_jax.cli.answers import draw, find_earlier, listed, print_json, request_for
from walker_jax.cli.options import (
    PHIDOT_HELP,
    Axes,
    Json,
    Out,
    Overwrite,
    PictureOfData,
    WindowSum,
    WindowTheta,
    check_drawable,
    check_finite,
    check_phidot,
    check_ranges,
    window_from,
)
from walker_jax.cli.walker_options import takes_walker
from walker_jax.execution.progress import bar
from walker_jax.stability.boundaries import summarise_boundary
from walker_jax.systems.system import System
from walker_jax.walkers.model import Walker
from walker_jax.walkers.parameters import describe_in_words, describe_walker


@takes_walker(systems=True)
def boundary(
    walker: System,
    theta: WindowTheta = None,
    sum_: WindowSum = None,
    at_phidot: Annotated[
        float | None,
        typer.Option(help=f"{PHIDOT_HELP}: a slice there (default: at the gait)."),
    ] = None,
    axis: Axes = None,
    strides: Annotated[int, typer.Option(min=1, help="Strides at most.")] = 500,
    out: Out = Path("boundary.zarr"),
    figure: PictureOfData = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Measure the boundary between walking and falling: its entropy, its saddles, Wada.

    The measures are the basin entropy, over all boxes of 5 x 5 cells and over those on the boundary
    (above log 2, and in boxes of 3 x 3 cells too, it is fractal where its smooth pieces are wide
    beside the boxes); the share of a region's boundary that another region's lacks (none if it is
    Wada, but also if the boundaries are merely close); and the edge states, such as a saddle, to
    which the boundary leads. The picture has the stable manifolds of the saddles. The default
    window is that of the command basin.
    """
    from walker_jax import figures

    sliced = isinstance(walker, Walker) and "phidot" in walker.section
    if at_phidot is not None:
        check_finite(**{"at-phidot": at_phidot})
    check_phidot(walker, at_phidot)
    axes: dict[str, Any] = {"theta": theta, "sum": sum_}
    axes |= {"phidot": at_phidot} if sliced else {}
    axes = window_from(walker, axis, axes)
    if axis:
        check_ranges(axes, 2)
    check_drawable(outline(axes))
    asked = {name: list(axis) if isinstance(axis, tuple) else axis for name, axis in axes.items()}
    request = request_for(
        "boundary", walker, walker=describe_walker(walker), axes=asked, strides=strides
    )
    figure, data = find_earlier(out, figure, request, overwrite=overwrite)
    if data is None:
        with bar("boundary", True):
            grid = grid_along(fill_around_gait(walker, axes))
            data = wj.boundary(walker, grid, strides=strides, progress=True)
        data = storage.save(data, out, request)
    draw(figures.boundary(data), figure, request)
    answer = summarise_boundary(data)
    if as_json:
        print_json({"walker": request["walker"]} | answer)
        return
    print(f"Boundary between fates, {describe_in_words(walker)}")
    entropy = answer["boundary_entropy"]
    fractal = "fractal by the log 2 test" if entropy["fractal"] else "log 2 test not passed"
    print(f"  basin entropy {answer['basin_entropy']:.5f}")
    if entropy["value"] is not None:
        print(f"  of the boundary {entropy['value']:.4f} +- {entropy['error']:.4f}, {fractal}")
        print(f"  boxes on the boundary with three fates or more: {entropy['crowded']:.2%}")
    if answer["wada"]:
        shares = ", ".join(f"{one['share']:.1%} at {one['spacing']}" for one in answer["wada"])
        print(f"  boundaries that another region lacks, by spacing in cells: {shares}")
    for one in answer["edges"]:
        print(f"  {edge_in_words(one)}")
    print(f"  data set {out}, picture {figure}")


def edge_in_words(edge: dict) -> str:
    """An edge state in words."""
    regions, between = " / ".join(edge["regions"]), " / ".join(edge["between"])
    third = "" if edge["between"] == edge["regions"] else f" (between {between})"
    if edge["kind"] != "saddle":
        return f"{regions}{third}: {edge['kind'] or 'no cycle found'}"
    states = ", ".join(f"({listed(state)})" for state in edge["states"][:4])
    more = ", ..." if len(edge["states"]) > 4 else ""
    multipliers = ", ".join(
        f"{complex(*pair):.6g}" if pair[1] else f"{pair[0]:.6g}" for pair in edge["multipliers"]
    )
    period = f"saddle of period {edge['period']}"
    return f"{regions}{third}: {period} at {states}{more}, multipliers {multipliers}"

"""The modes of a hybrid system as a graph, with its guards as arrows."""

from matplotlib.axes import Axes
from matplotlib.patches import FancyArrowPatch
from matplotlib.text import Text

from walker_jax.figures.layout import DrawnAxes, axes_for, figure_of, write_beside
from walker_jax.figures.style import BASINS, INK, TITLE
from walker_jax.hybrid.graphs import in_order
from walker_jax.hybrid.modes import SECTION
from walker_jax.systems.hybrid_system import HybridSystem, failures_by_name, modes_of
from walker_jax.walking.explanation import Explanation

BOX = {"boxstyle": "round,pad=0.5", "fc": "#f2f2f2", "ec": INK}
PASSED, UNDER = BASINS[0], "#606060"
"""Colours of the way of a stride, and of the failures under a mode."""


def modes(system: HybridSystem, found: Explanation | None = None) -> DrawnAxes:
    """Draw the modes of a system, and the guards that lead from one to another or to the section.

    Modes stand in columns, in the order in which a stride may pass them; the failures to which a
    mode may lead are listed below it. Guards that lead back are drawn below the modes. The figure
    is of 2.2 inches for each column by 3 inches.

    **Arguments:**

    - `system`: any hybrid system.
    - `found`: a stride of it, from `walker_jax.explain`, whose way is drawn thick.
    """
    graph, failures = modes_of(system), failures_by_name(system)
    places = places_of(graph)
    columns = 1 + max(column for column, _ in places.values())
    rows = max(row for _, row in places.values())
    ax = axes_for(None, {}, 2.2 * columns, 3.0 + 0.8 * rows)
    ax.set(xlim=(-0.5, columns - 0.5), ylim=(-0.8, rows + 0.6))
    ax.axis("off")
    ax.set_title(f"Modes of {system.label()}", **TITLE)
    boxes = {name: ax.text(*place, name, ha="center", va="center", bbox=BOX, color=INK)
             for name, place in places.items()}  # fmt: skip
    figure_of(ax).draw_without_rendering()  # for the sizes of the boxes
    for name, mode in graph.items():
        ends = sorted({guard.leads_to for guard in mode.guards} & failures.keys())
        conditions = sorted({one.leads_to for one in mode.conditions} - {*ends})
        below = "\n".join(one.lower().replace("_", " ") for one in (*ends, *conditions))
        write_beside(ax, below, places[name], (0, -18), ha="center", va="top", color=UNDER)
    made = () if found is None else found.modes
    way = {(mode.name, mode.led_to.removesuffix(" at once")) for mode in made}
    for name, to in sorted(edges_of(graph)):
        draw_edge(ax, boxes[name], boxes[to], passed=(name, to) in way)
    return ax


def edges_of(graph: dict) -> set[tuple[str, str]]:
    """Return the pairs of names that a guard connects, failures excepted."""
    ends = {(name, one.leads_to) for name, mode in graph.items() for one in mode.guards}
    return {(name, to) for name, to in ends if to in graph or to == SECTION}


def places_of(graph: dict) -> dict[str, tuple[int, int]]:
    """Return the column and the row of each mode and of the section.

    A column is that after the last mode that leads ahead to it; rows are counted upwards.
    """
    columns: dict[str, int] = {}
    places: dict[str, tuple[int, int]] = {}
    for name in in_order(graph):
        before = (columns[one] for one, to in edges_of(graph) if to == name and one in columns)
        columns[name] = 1 + max(before, default=-1)
    columns[SECTION] = 1 + max(columns.values())
    for name, column in columns.items():
        places[name] = column, sum(at == column for at, _ in places.values())
    return places


def draw_edge(ax: Axes, start: Text, end: Text, *, passed: bool) -> None:
    """Draw an arrow from a mode's box to another one, bent where others stand in between."""
    place, onto = start.get_position(), end.get_position()
    ahead, straight = onto[0] - place[0], onto[1] == place[1]
    bend = 0.0 if ahead == 1 or not straight else -0.35 if ahead > 0 else -0.5
    ax.add_patch(
        FancyArrowPatch(
            place, onto, patchA=start.get_bbox_patch(), patchB=end.get_bbox_patch(),
            connectionstyle=f"arc3,rad={bend}", arrowstyle="-|>", mutation_scale=14,
            color=PASSED if passed else INK, lw=2.4 if passed else 0.8, zorder=0,
        )
    )  # fmt: skip

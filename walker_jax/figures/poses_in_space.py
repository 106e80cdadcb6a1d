"""Poses of walkers in space, by parallel projection: legs, discs, axle, shadows and the slope.

Places are along the slope, to the left and normal to it, as in a motion.
"""

import numpy as np
import xarray as xr
from jaxtyping import Float
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgb
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon

from walker_jax.figures.poses import GROUND, SOIL, SWING
from walker_jax.figures.style import INK

TURNED, ABOVE = np.radians(35), np.radians(20)
"""View of the walk: angle turned from its right side to its front, and elevation."""
WHITE = 0.45
"""Share of white in the face of a disc; its edge has the colour itself."""
SHADOW = "#c9c9c9"
"""Colour of shadows, which fall straight onto the slope."""
CORNERS = 60
"""Corners of the polygon that represents a disc."""
FAR = 2
"""Reach of the ground around the walker, in legs."""


def project(places: Float[np.ndarray, "n 3"], slope: float) -> Float[np.ndarray, "n 3"]:
    """Return places on the page, and how near they are to the eye."""
    c, s = np.cos(slope), np.sin(slope)
    level = places @ np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]])
    c, s, up, flat = np.cos(TURNED), np.sin(TURNED), np.sin(ABOVE), np.cos(ABOVE)
    axes = [[c, s, 0.0], [-up * s, up * c, flat], [flat * s, -flat * c, up]]
    return level @ np.array(axes).T


def draw_in_space(
    ax: Axes, pose: xr.Dataset
) -> tuple[list[Artist], Float[np.ndarray, " 2"], float]:
    """Draw one frame; return the artists, the place below the walker, and the height shown."""
    slope, radius, length = (
        float(pose.attrs[f"walker_{name}"]) for name in ("slope", "disc_radius", "leg_length")
    )
    place = {name: pose[name].values for name in ("stance", "swing", "stance_hip", "swing_hip")}
    flat = lambda points: project(points, slope)[:, :2]
    near = lambda points: float(project(points, slope)[:, 2].mean())
    below = (place["stance"] + place["swing"]) / 2 * [1, 1, 0]
    axle, turn = pose["axle"].values, np.linspace(0, 2 * np.pi, CORNERS)[:, None]
    first = np.cross(axle, [0.0, 0.0, 1.0])
    first /= np.linalg.norm(first)
    edge = radius * (np.cos(turn) * first + np.sin(turn) * np.cross(axle, first))
    legs = ("stance", INK), ("swing", SWING)
    rods = [(np.stack([place[one], place[f"{one}_hip"]]), colour) for one, colour in legs]
    rods.append((np.stack([place["stance_hip"], place["swing_hip"]]), GROUND))
    discs = [(place[one] + edge, colour) for one, colour in legs]
    shadows: list[Artist] = []
    parts: dict[Artist, float] = {}  # with how near they are to the eye
    for points, colour in rods:
        shadow = flat(points * [1, 1, 0])
        shadows.append(Line2D(*shadow.T, color=SHADOW, lw=3, zorder=2))
        line = Line2D(*flat(points).T, color=colour, lw=4, solid_capstyle="round")
        parts[line] = near(points)
    for points, colour in discs:
        shadow = flat(points * [1, 1, 0])
        shadows.append(Polygon(shadow, fc=SHADOW, ec=SHADOW, lw=2, zorder=2))
        face = *(WHITE + (1 - WHITE) * np.array(to_rgb(colour))), 0.92
        parts[Polygon(flat(points), fc=face, ec=colour, lw=1.6)] = near(points)
    for order, part in enumerate(sorted(parts, key=parts.__getitem__), start=3):
        part.set_zorder(order)
    drawn = [ax.add_artist(one) for one in (*slope_around(below, slope, length), *shadows, *parts)]
    return drawn, flat(below[None])[0], 1.25 * length


def slope_around(below: Float[np.ndarray, " 3"], slope: float, length: float) -> list[Artist]:
    """Return the slope around a place, with lines at every half of a leg."""
    middle = below / length
    at = np.arange(np.ceil(2 * (middle[0] - FAR)), 2 * (middle[0] + FAR)) / 2
    side = np.array([-1.0, -0.5, 0.0, 0.5, 1.0]) + round(2 * middle[1]) / 2
    corners = [(at[0], side[0]), (at[-1], side[0]), (at[-1], side[-1]), (at[0], side[-1])]
    flat = lambda points: project(length * np.array([[*p, 0.0] for p in points]), slope)[:, :2]
    lines = [flat([(x, side[0]), (x, side[-1])]) for x in at]
    lines += [flat([(at[0], y), (at[-1], y)]) for y in side]
    ground = Polygon(flat(corners), fc=SOIL, ec="none", zorder=0)
    return [ground, LineCollection(lines, colors="#d5d5d5", lw=0.8, zorder=1)]

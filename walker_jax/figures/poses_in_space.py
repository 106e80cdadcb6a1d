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
LIGHT = np.array([0.35, -0.75, 0.55]) / np.linalg.norm([0.35, -0.75, 0.55])
"""Direction to the light that shades discs; shadows fall straight onto the slope."""
DARKEST = 0.4
"""Share of its colour that a disc keeps where the light grazes it."""
SHADOW = "#c9c9c9"
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
    axle = pose["axle"].values
    flat = lambda points: project(points, slope)[:, :2]
    below = (place["stance"] + place["swing"]) / 2 * [1, 1, 0]
    drawn: list[Artist] = draw_slope(ax, below, slope, length)

    def disc(centre):
        """Return the edge of a disc, normal to the axle."""
        first = np.cross(axle, [0.0, 0.0, 1.0])
        first /= np.linalg.norm(first)
        turn = np.linspace(0, 2 * np.pi, CORNERS)[:, None]
        return centre + radius * (np.cos(turn) * first + np.sin(turn) * np.cross(axle, first))

    bars = [("stance", "stance_hip", INK), ("swing", "swing_hip", SWING)]
    rods = [(place[foot], place[hip], colour) for foot, hip, colour in bars]
    rods.append((place["stance_hip"], place["swing_hip"], GROUND))
    for start, end, _ in rods:
        (line,) = ax.plot(*flat(np.stack([start, end]) * [1, 1, 0]).T, color=SHADOW, lw=3, zorder=2)
        drawn.append(line)
    for foot, _, _ in bars:
        shadow = Polygon(flat(disc(place[foot]) * [1, 1, 0]), fc=SHADOW, ec=SHADOW, lw=2, zorder=2)
        drawn.append(ax.add_patch(shadow))

    parts: list[tuple[float, Artist]] = []
    for start, end, colour in rods:
        both = project(np.stack([start, end]), slope)
        line = Line2D(*both[:, :2].T, color=colour, lw=4, solid_capstyle="round")
        parts.append((both[:, 2].mean(), line))
    share = DARKEST + (1 - DARKEST) * abs(float(axle @ LIGHT))
    for foot, _, colour in bars:
        shade = 1 - share * (1 - np.array(to_rgb(colour)))
        shade = np.clip(shade * 0.6 + 0.4 * share, 0, 1)
        face = Polygon(flat(disc(place[foot])), fc=(*shade, 0.92), ec=colour, lw=1.6)
        near = project(place[foot][None], slope)[0, 2]
        parts.append((near + 1e-3 * length * np.sign(near), face))
    for order, (_, part) in enumerate(sorted(parts, key=lambda one: one[0])):
        part.set_zorder(3 + order)
        drawn.append(ax.add_artist(part))
    return drawn, flat(below[None])[0], 1.25 * length


def draw_slope(
    ax: Axes, below: Float[np.ndarray, " 3"], slope: float, length: float
) -> list[Artist]:
    """Draw the slope around a place, with lines at every half of a leg."""
    middle = below / length
    at = np.arange(np.ceil(2 * (middle[0] - FAR)), 2 * (middle[0] + FAR)) / 2
    side = np.array([-1.0, -0.5, 0.0, 0.5, 1.0]) + round(2 * middle[1]) / 2
    corners = [(at[0], side[0]), (at[-1], side[0]), (at[-1], side[-1]), (at[0], side[-1])]
    flat = lambda points: project(length * np.array([[*p, 0.0] for p in points]), slope)[:, :2]
    lines = [flat([(x, side[0]), (x, side[-1])]) for x in at]
    lines += [flat([(at[0], y), (at[-1], y)]) for y in side]
    ground = Polygon(flat(corners), fc=SOIL, ec="none", zorder=0)
    return [
        ax.add_patch(ground),
        ax.add_collection(LineCollection(lines, colors="#d5d5d5", lw=0.8, zorder=1)),
    ]

"""Pictures of walkers in motion: poses on the slope, leg angles, the way over a basin, films.

As in `figures`: each takes results, computes nothing, and draws on `ax` or on a figure of its own.
Walkers walk to the right, and slopes go down to the right, by their own angle.
"""

import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Float
from matplotlib.animation import FFMpegWriter
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Arc, Polygon
from PIL import Image

from walker_jax.checks import WrongUse
from walker_jax.figures import (
    BASINS,
    BELOW,
    FAILURES,
    INK,
    WORDS,
    along,
    basin,
    counted,
    ends,
    notable_attractors,
    painted,
    place_legend,
    regions_of,
    show,
    title,
    write_title,
)
from walker_jax.progress import tracked
from walker_jax.stride import Outcome

SWING = BASINS[1]
"""Colour of the swing leg; the stance leg is in ink."""
GROUND, SOIL = "#6b6b6b", "#ececec"
SHARES = (0, 0.2, 0.4, 0.6, 0.8, 1)
"""Of a stride, at which its poses are drawn."""
FILMS = (".gif", ".mp4")
FRAMES_PER_SECOND = 20
DOTS, COLOURS, PALETTE = 80, 256, Image.Quantize.FASTOCTREE
"""Of a GIF: dots per inch, colours at most, and how these are chosen."""
PATH = "#f2b632"
"""Colour of the way over a basin, seen on dark and on pale ground."""


def step(data: xr.Dataset) -> Figure:
    """One stride, in six poses from heel strike to heel strike.

    Figure 1 of Schwab and Wisse (2001), which names what the model consists of.

    **Arguments:**

    - `data`: what `walker_jax.motion` returns. Its first stride is drawn.

    **Returns** a figure of 9 by 6.4 inches.
    """
    own = data.isel(frame=data["stride"].values == 0)
    figure = Figure(figsize=(9, 6.4), layout="constrained")
    panels = figure.subplots(2, 3, sharex=True, sharey=True).flat
    last, size = own.sizes["frame"] - 1, leg_of(data)
    strides = data["outcome"].values[0] == Outcome.STRIDE
    ending = "just before heel strike" if strides else FAILURES[Outcome(int(data["outcome"][0]))][2]
    for k, (ax, share) in enumerate(zip(panels, SHARES, strict=True)):
        pose = own.isel(frame=round(share * last))
        draw_ground(ax, data)
        draw_pose(ax, pose)
        if k == 1:
            name_parts(ax, pose)
        when = f"time {float(pose['time']):.2f}"
        note = {0: "just after heel strike", len(SHARES) - 1: ending}.get(k, "")
        ax.set_title(when, loc="left", fontsize=10, fontweight="bold")
        ax.set_title(note, loc="right", fontsize=WORDS)
        ax.set(xlim=(-0.62 * size, 0.62 * size), ylim=(-0.16 * size, 1.22 * size), aspect="equal")
        ax.set_axis_off()
    legs = [
        Line2D([], [], color=INK, lw=3, label="stance leg"),
        Line2D([], [], color=SWING, lw=3, label="swing leg"),
    ]
    figure.legend(handles=legs, loc="outside lower left", ncols=2, frameon=False, fontsize=WORDS)
    words = f"{title(data)}: one stride, times in √(l/g)"
    figure.suptitle(words, x=0.01, ha="left", fontsize=12, fontweight="bold")
    return figure


def draw_ground(ax: Axes, data: xr.Dataset) -> None:
    """The slope, as far as can be seen, with a mark at every half of a leg."""
    slope, size = float(data.attrs["walker_slope"]), leg_of(data)
    far = np.ceil(2 + np.abs(data["hip"].values[:, 0]).max() / size)
    away = size * np.array([[-far, 0.0], [far, 0.0], [far, -far], [-far, -far]])
    ax.add_patch(Polygon(turned(away, slope), fc=SOIL, ec="none", zorder=0))
    ax.plot(*turned(away[:2], slope).T, color=GROUND, lw=1.2, zorder=1)
    marks = [[[at, 0.0], [at, -0.05 * size]] for at in np.arange(-far, far, 0.5) * size]
    marks = [turned(np.array(mark), slope) for mark in marks]
    ax.add_collection(LineCollection(marks, colors=GROUND, lw=1, zorder=1))


def leg_of(data: xr.Dataset) -> float:
    """From the hip to the sole."""
    return data.attrs["leg_length"] + data.attrs["foot_radius"]


def draw_pose(ax: Axes, pose: xr.Dataset) -> list[Line2D]:
    """Hip, legs and feet of one frame. Returns the lines."""
    slope, radius = (float(pose.attrs[name]) for name in ("walker_slope", "foot_radius"))
    hip = pose["hip"].values
    lines: list[Line2D] = []
    angles = {"stance": float(pose["theta"]), "swing": float(pose["theta"] - pose["phi"])}
    for name, colour, order in (("stance", INK, 3), ("swing", SWING, 4)):
        end = pose[name].values
        leg = turned(np.stack([hip, end]), slope)
        lines += ax.plot(*leg.T, color=colour, lw=3, solid_capstyle="round", zorder=order)
        if radius:
            way = angles[name] + np.linspace(-0.6, 0.6, 40)
            arc = end + radius * np.stack([np.sin(way), -np.cos(way)], axis=1)
            lines += ax.plot(*turned(arc, slope).T, color=colour, lw=3, zorder=order)
            sole = np.stack(
                [end, end + radius * np.array([np.sin(angles[name]), -np.cos(angles[name])])]
            )
            lines += ax.plot(*turned(sole, slope).T, color=colour, lw=3, zorder=order)
        else:
            lines += ax.plot(*leg[1:].T, "o", color=colour, mec="white", ms=6, zorder=order + 2)
    at = turned(hip[None], slope)
    return [*lines, *ax.plot(*at.T, "o", color=INK, mec="white", mew=1.2, ms=14, zorder=7)]


def turned(places: Float[np.ndarray, "n 2"], slope: float) -> Float[np.ndarray, "n 2"]:
    """Places along the slope and normal to it, as they are seen, the horizontal level."""
    c, s = np.cos(slope), np.sin(slope)
    return places @ np.array([[c, -s], [s, c]])


def name_parts(ax: Axes, pose: xr.Dataset) -> None:
    """The names of what the model consists of, beside one of its poses."""
    slope = float(pose.attrs["walker_slope"])
    foot, hip = (turned(pose[name].values[None], slope)[0] for name in ("stance", "hip"))
    theta, phi = float(pose["theta"]), float(pose["phi"])
    leg = leg_of(pose)
    up = turned(np.array([[0.0, 0.9 * leg]]), slope)[0]
    ax.plot(*np.stack([foot, foot + up]).T, color=GROUND, lw=0.8, ls=(0, (5, 4)), zorder=2)
    upright, down = 90 - np.degrees(slope), 270 - np.degrees(slope)
    hanging = down + np.degrees(theta - phi)
    for middle, size, begin, end, text, away in (
        (foot, 0.72, upright, upright + np.degrees(theta), r"$\theta$", (13, -3)),
        (hip, 0.5, hanging, down + np.degrees(theta), r"$\phi$", (2, -10)),
    ):
        wide = 2 * size * leg
        ax.add_patch(Arc(middle, wide, wide, theta1=begin, theta2=end, lw=1, zorder=8))
        way = np.radians((begin + end) / 2)
        at = middle + size * leg * np.array([np.cos(way), np.sin(way)])
        centred: dict[str, Any] = {"ha": "center", "va": "center", "fontsize": 12}
        ax.annotate(text, at, away, textcoords="offset points", **centred)
    words = (
        (hip, (13, 6), "hip, mass $M$"),
        (foot, (9, -13), "foot, mass $m$"),
        ((foot + hip) / 2, (10, 0), "leg, length $l$"),
    )
    for place, shift, text in words:
        ax.annotate(text, place, shift, textcoords="offset points", va="center", fontsize=WORDS)
    ax.annotate(f"slope $\\gamma$ = {slope:g}", (-0.6 * leg, -0.13 * leg), fontsize=WORDS)
    head, tail = (0.5 * leg, 0.45 * leg), (0.5 * leg, 0.75 * leg)
    ax.annotate("$g$", head, tail, ha="center", fontsize=12, arrowprops={"arrowstyle": "->"})


def leg_angles(data: xr.Dataset, ax: Axes | None = None) -> Axes:
    """Angles of both legs from the normal of the slope, over time.

    Figure 6 of Schwab and Wisse (2001). Legs exchange roles at heel strikes, the thin lines.

    **Arguments:**

    - `data`: what `walker_jax.motion` returns.
    - `ax`: where to draw; by default, on a new figure of 9 by 4.2 inches.

    **Returns** the axes.
    """
    if ax is None:
        ax = Figure(figsize=(9, 4.2), layout="constrained").add_subplot()
    stride, time = data["stride"].values, data["time"].values
    theta = data["theta"].values
    ax.axhline(0, color=GROUND, lw=0.6, zorder=1)
    for number in np.unique(stride).tolist():
        own = stride == number
        if number:
            ax.axvline(time[own][0], color=GROUND, lw=0.6, zorder=1)
        ax.plot(time[own], theta[own], color=INK, lw=1.8)
        ax.plot(time[own], (theta - data["phi"].values)[own], color=SWING, lw=1.8, ls=(0, (1, 1.2)))
    if time[-1] > time[0]:
        ax.set_xlim(time[0], time[-1])
    ax.set_xlabel("time (√(l/g))", fontsize=11)
    ax.set_ylabel("angle from the normal of the slope (rad)", fontsize=11)
    made = int((data["outcome"].values == Outcome.STRIDE).sum())
    write_title(ax, f"{title(data)}: leg angles", f"{counted(made, 'stride')}{failure(data)}")
    legs = [
        Line2D([], [], color=INK, lw=1.8, label="stance leg"),
        Line2D([], [], color=SWING, lw=1.8, ls=(0, (1, 1.2)), label="swing leg"),
    ]
    place_legend(ax, legs, BELOW, columns=2)
    return ax


def failure(data: xr.Dataset) -> str:
    """How a walk ends, if it fails."""
    last = Outcome(int(data["outcome"].values[-1]))
    return "" if last == Outcome.STRIDE else f", then {FAILURES[last][2]}"


def steps_over_basin(data: xr.Dataset, walk: xr.Dataset) -> Figure:
    """A basin of attraction, and the starts of the strides of a walk over it, joined in order.

    Figure 5 of Schwab and Wisse (2001), with an enlargement around the last half of them.

    **Arguments:**

    - `data`: what `walker_jax.basin` returns, over two dimensions.
    - `walk`: what `walker_jax.motion` returns, of the same walker.

    **Returns** a figure of 12 by 5.4 inches. Raises `ValueError` as `figures.basin`.
    """
    figure = Figure(figsize=(12, 5.4), layout="constrained")
    whole, close = figure.subplots(1, 2)
    basin(data, whole)
    x, y = way_over(data, walk["states"].rename(start="phase"))
    half = len(x) // 2
    window = [(values.min(), values.max()) for values in (x[half:], y[half:])]
    window = [(low - 0.3 * (high - low), high + 0.3 * (high - low)) for low, high in window]
    regions = regions_of(data, notable_attractors(data))
    names = map(str, data["fate"].dims)
    (left, right), (low, high) = (ends(data[name].values) for name in names)
    show(close, painted(regions, data["fate"].shape), (left, right, low, high))
    for ax, first, last in ((whole, 0, half), (close, half, len(x))):
        ax.plot(x, y, "-", color=PATH, lw=1.2, zorder=5)
        ax.plot(x, y, "o", color=PATH, mec=INK, mew=0.8, ms=6, zorder=6)
        for k in range(first, last):
            write_number(ax, k + 1, (x[k], y[k]))
    for number in notable_attractors(data):
        cycle = data["states"].sel(number=number)
        dots = way_over(data, cycle)
        close.plot(*dots, "o", color=INK, mec="white", mew=1.2, ms=7.5, zorder=5)
    close.set(xlim=window[0], ylim=window[1])
    close.set_xlabel(whole.get_xlabel(), fontsize=11)
    write_title(close, "Enlarged", f"starts {half + 1} to {len(x)}, and the attractor")
    return figure


def write_number(ax: Axes, number: int, place: tuple[float, float]) -> None:
    """A number beside a dot."""
    frame = {"boxstyle": "circle,pad=0.15", "fc": "white", "ec": INK, "lw": 0.5}
    ax.annotate(
        f"{number}", place, (8, 7), textcoords="offset points", fontsize=9, bbox=frame, zorder=7
    )


def way_over(
    data: xr.Dataset, states: xr.DataArray
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """States along the axes of a basin."""
    states = states.assign_coords(coordinate=data.attrs["section"])
    x, y = (along(states, str(axis)) for axis in data["fate"].dims)
    return x, y


def film(
    walk: xr.Dataset,
    path: Path,
    data: xr.Dataset | None = None,
    *,
    signature: str = "",
    progress: bool = False,
) -> None:
    """A film of a walk: the walker on its slope, and beside it its way over the basin.

    **Arguments:**

    - `walk`: what `walker_jax.motion` returns. Each of its frames is shown for 1/20 s.
    - `path`: where it goes, .gif or .mp4, which takes the program ffmpeg.
    - `data`: what `walker_jax.basin` returns, over two dimensions; without it there is the walker
      alone.
    - `signature`: kept in the file.
    - `progress`: whether to show it on a terminal.

    Raises `ValueError` for another ending, and for .mp4 where there is no ffmpeg. The file is
    whole, or what it was before.
    """
    check_film(path)
    figure = Figure(figsize=(10.4, 4.8) if data is not None else (5, 4.8), layout="constrained")
    axes = figure.subplots(1, 1 if data is None else 2, squeeze=False)[0]
    draw_ground(axes[0], walk)
    way, moving = None, [axes[0]]
    if data is not None:
        basin(data, axes[1]).set_title("", loc="left")
        way = way_over(data, walk["states"].rename(start="phase"))
        (line,) = axes[1].plot([], [], "o-", color=PATH, mec=INK, mew=0.8, ms=5, lw=1, zorder=6)
        (now,) = axes[1].plot([], [], "o", color=PATH, mec=INK, mew=1.4, ms=10, zorder=7)
        moving += [line, now]
    words = title(walk, 45 if data is None else 90)
    figure.suptitle(words, x=0.01, ha="left", fontsize=12, fontweight="bold")
    axes[0].set_axis_off()
    axes[0].set_aspect("equal")
    heading = axes[0].set_title("", loc="left", fontsize=11, fontweight="bold")
    figure.draw_without_rendering()
    figure.set_layout_engine("none")  # or panels shake

    frames = tracked(range(walk.sizes["frame"]), "film", progress)
    slope, stride = float(walk.attrs["walker_slope"]), walk["stride"].values
    tall = 1.2 * leg_of(walk)
    with saved(figure, path, signature, moving) as grab:
        for k in frames:
            pose, number = walk.isel(frame=k), int(stride[k])
            lines = draw_pose(axes[0], pose)
            x, y = turned(pose["hip"].values[None] * [[1, 0]], slope)[0]
            axes[0].set(xlim=(x - 0.75 * tall, x + 0.75 * tall), ylim=(y - 0.25 * tall, y + tall))
            heading.set_text(f"stride {number + 1}, time {float(pose['time']):.1f}")
            if way is not None:
                line.set_data(way[0][: number + 1], way[1][: number + 1])
                now.set_data(way[0][number : number + 1], way[1][number : number + 1])
            grab()
            for one in lines:
                one.remove()


def check_film(path: Path) -> None:
    """Refuse what no film can be written to."""
    if path.suffix not in FILMS:
        raise WrongUse(f"a film must end in one of {', '.join(FILMS)}, not {path}")
    if path.suffix == ".mp4" and not FFMpegWriter.isAvailable():
        raise WrongUse(f"{path} takes the program ffmpeg, which is not there: try .gif")


@contextmanager
def saved(
    figure: Figure, path: Path, signature: str, moving: list[Artist]
) -> Iterator[Callable[[], object]]:
    """What adds a figure as it is to a film, which is at its place in the end."""
    with tempfile.TemporaryDirectory(prefix=f".{path.stem}.", dir=path.absolute().parent) as folder:
        draft = Path(folder) / path.name
        if path.suffix == ".mp4":
            writer = FFMpegWriter(fps=FRAMES_PER_SECOND, metadata={"title": signature})
            with writer.saving(figure, str(draft), dpi=100):
                yield writer.grab_frame
        else:
            images: list[Image.Image] = []
            figure.set_dpi(DOTS)
            canvas = FigureCanvasAgg(figure)
            for one in moving:
                one.set_animated(True)
            canvas.draw()
            still = canvas.copy_from_bbox(figure.bbox)

            def grab() -> None:
                """What does not move is drawn once."""
                canvas.restore_region(still)
                for one in moving:
                    figure.draw_artist(one)
                colours = np.asarray(canvas.buffer_rgba())[..., :3]
                images.append(Image.fromarray(colours).quantize(COLOURS, PALETTE))

            yield grab
            images[0].save(
                draft,
                save_all=True,
                append_images=images[1:],
                duration=1000 // FRAMES_PER_SECOND,
                loop=0,
                comment=signature.encode(),
            )
        os.replace(draft, path)

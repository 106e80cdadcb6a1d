"""Films of walkers."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.animation import FFMpegWriter
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from PIL import Image

from walker_jax.checks import WrongPlace, WrongUse
from walker_jax.execution.progress import track
from walker_jax.figures.basin_maps import basin
from walker_jax.figures.layout import figure_legend, figure_title, name_axes, new_panels
from walker_jax.figures.poses import draw_ground, draw_pose, leg_size, to_level
from walker_jax.figures.poses_in_space import draw_in_space
from walker_jax.figures.regions import cell_edges, paint_one_basin, patch_of, place_states
from walker_jax.figures.style import INK, TITLE
from walker_jax.figures.text import walker_title
from walker_jax.figures.walk_plots import TRAJECTORY
from walker_jax.storage import atomic_file, check_writable
from walker_jax.storage.schema import check_dataset

FILMS = (".gif", ".mp4")
FRAMES_PER_SECOND = 20
"""Browsers play GIFs hardly any faster."""
SLOWED = 4
"""Factor by which a stride is slowed."""
DOTS, COLOURS, PALETTE = 80, 256, Image.Quantize.FASTOCTREE
"""Settings of a GIF: dots per inch, the most colours that it can have, and how Pillow chooses
them."""


def film(
    walk: xr.Dataset,
    path: Path,
    data: xr.Dataset | None = None,
    *,
    slow: int | None = None,
    signature: str = "",
    progress: bool = True,
) -> None:
    """Make a film of a walk: the walker on its slope, and beside it its trajectory in the basin.

    **Arguments:**

    - `walk`: what `walker_jax.motion` returns. Each of its frames is shown for 1/20 s. A walk in
      space is shown in parallel projection, from its right, ahead and above.
    - `path`: of the file, .gif, or .mp4, which needs the program ffmpeg.
    - `data`: what `walker_jax.basin` returns, over two dimensions; without it the film shows the
      walker alone.
    - `slow`: number of a stride, from 0, that is shown four times as slowly.
    - `signature`: text that is kept in the file.
    - `progress`: whether to show progress on a terminal, after a second.

    Raises `ValueError` for another ending, for .mp4 without ffmpeg, and for other data sets. An
    interruption leaves the file as it was.
    """
    check_film(path)
    in_space = "axle" in walk
    if in_space and data is not None:
        raise WrongUse("data must be left out for a walk in space")
    check_dataset(walk, "walk in space" if in_space else "walk")
    draw, lines, starts = draw_in_space if in_space else draw_on_slope, [], np.zeros((0, 2))
    wide, panels = (5.4, 1) if data is None else (10.4, 2)
    figure, (stage, *beside) = new_panels(wide, 4.8, 1, panels)
    if not in_space:
        draw_ground(stage, walk)
    if data is not None:
        starts = place_states(data, walk["states"].values)
        lines = trajectory_lines(basin(data, beside[0], title=False))
    figure_title(figure, walker_title(walk))
    stage.set_axis_off()
    stage.set(xlim=(0, 1.5), ylim=(0, 1.3), aspect="equal")  # for the layout
    heading = stage.set_title("stride 1, time 0.0", size="medium", **TITLE)
    fix_layout(figure)
    with film_writer(figure, path, signature, [stage, *lines]) as grab:
        for k in track(range(walk.sizes["frame"]), "film", progress):
            pose = walk.isel(frame=k)
            number = int(pose["stride"])
            drawn, (x, y), tall = draw(stage, pose)
            stage.set(xlim=(x - 0.75 * tall, x + 0.75 * tall), ylim=(y - 0.3 * tall, y + tall))
            words = f"stride {number + 1}, time {float(pose['time']):.1f}"
            heading.set_text(words + ", slowed" * (number == slow))
            for line, first in zip(lines, (0, number), strict=False):
                line.set_data(*starts[first : number + 1].T)
            for _ in range(SLOWED if number == slow else 1):
                grab()
            for one in drawn:
                one.remove()


def trajectory_lines(ax: Axes) -> list[Line2D]:
    """Return the lines of a trajectory and of its present start, without data yet."""
    look: Any = {"color": TRAJECTORY, "mec": INK}
    (line,) = ax.plot([], [], "o-", mew=0.8, ms=5, lw=1, zorder=6, **look)
    (now,) = ax.plot([], [], "o", mew=1.4, ms=10, zorder=7, **look)
    return [line, now]


def draw_on_slope(ax: Axes, pose: xr.Dataset) -> tuple[list[Line2D], tuple[float, float], float]:
    """Draw one frame; return its lines, the place below the hip, and the height shown."""
    x, y = to_level(pose["hip"].values * [1, 0], float(pose.attrs["walker_slope"]))
    if "footholds" in pose:
        last = pose.sizes["foothold"] - 1
        y += float(pose["footholds"][min(int(pose["stride"]), last), 1])
    return draw_pose(ax, pose), (x, y), 1.2 * leg_size(pose)


def fix_layout(figure: Figure) -> None:
    """Lay a figure out, once for all frames, as panels would shake otherwise."""
    figure.draw_without_rendering()
    figure.set_layout_engine("none")


def zoom_film(data: xr.Dataset, path: Path, *, signature: str = "", progress: bool = True) -> None:
    """Make a film of ever narrower windows around a point of a boundary.

    Colours are as in `basin`.

    **Arguments:**

    - `data`: what `walker_jax.zoom` returns, over two dimensions. Each frame is shown for 1/20 s.
    - `path`, `signature`, `progress`: as in `film`.

    Raises `ValueError` as `film` does.
    """
    check_film(path)
    check_dataset(data, "zoom")
    if data["fate"].ndim != 3:
        raise WrongUse(f"data must have a fate over two axes, not {dict(data['fate'].sizes)}")
    regions, images = paint_one_basin(data, data["fate"].values, data["attractor"].values >= 0)
    images = images.swapaxes(1, 2)
    figure, (ax,) = new_panels(6.4, 6.6, 1, 1)
    shown = ax.imshow(images[0], origin="lower", aspect="auto", interpolation="nearest")
    ax.set(xticks=[], yticks=[])
    x, y = map(str, data["fate"].dims[1:])
    name_axes(ax, x, y)
    figure_title(figure, walker_title(data))
    figure_legend([ax], map(patch_of, regions))
    heading = ax.set_title("window 0.000e+00 wide, 0.000e+00 high", loc="left", fontsize="medium")
    fix_layout(figure)
    sizes = [float(cell_edges(data[name].values)[1]) * 2 for name in (x, y)]
    with film_writer(figure, path, signature, [shown, heading]) as grab:
        for k in track(range(data.sizes["frame"]), "film", progress):
            wide, high = (size / float(data["factor"][k]) for size in sizes)
            heading.set_text(f"window {wide:.1e} wide, {high:.1e} high")
            shown.set_data(images[k])
            grab()


def check_film(path: Path) -> None:
    """Raise `WrongPlace` for a path to which no film can be written."""
    if path.suffix not in FILMS:
        raise WrongPlace(f"{path} must end in one of {', '.join(FILMS)}")
    if path.suffix == ".mp4" and not FFMpegWriter.isAvailable():
        raise WrongPlace(f"{path} takes the program ffmpeg, which is not installed: try .gif")
    check_writable(path)


@contextmanager
def film_writer(
    figure: Figure, path: Path, signature: str, moving: list[Artist]
) -> Iterator[Callable[[], object]]:
    """Yield a function that adds the figure to a film, which is put in its place at the end.

    In a GIF, only the `moving` artists are drawn anew for each frame.
    """
    with atomic_file(path) as draft:
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
                """Draw the moving artists on the still background, and add the frame."""
                canvas.restore_region(still)
                for one in moving:
                    figure.draw_artist(one)
                colours = np.asarray(canvas.buffer_rgba())[..., :3]
                images.append(Image.fromarray(colours).quantize(COLOURS, PALETTE))

            yield grab
            kept: Any = {"duration": 1000 // FRAMES_PER_SECOND, "comment": signature.encode()}
            images[0].save(draft, save_all=True, append_images=images[1:], loop=0, **kept)

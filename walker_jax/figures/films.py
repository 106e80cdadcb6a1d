"""Films of walkers."""

import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import xarray as xr
from matplotlib.animation import FFMpegWriter
from matplotlib.artist import Artist
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from walker_jax.checks import WrongUse
from walker_jax.execution.progress import track
from walker_jax.figures.basin_maps import basin
from walker_jax.figures.poses import PATH, draw_ground, draw_pose, leg_of, turned, way_over
from walker_jax.figures.style import INK, title

FILMS = (".gif", ".mp4")
FRAMES_PER_SECOND = 20
DOTS, COLOURS, PALETTE = 80, 256, Image.Quantize.FASTOCTREE
"""Of a GIF: dots per inch, colours at most, and how these are chosen."""


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

    frames = track(range(walk.sizes["frame"]), "film", progress)
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

"""The paper of Schwab and Wisse (2001), figure by figure and number by number.

*Basin of attraction of the simplest walking model*, ASME DETC2001/VIB-21363. Each part is computed
anew and kept as a data set, from which pictures and numbers follow. Where a number depends on the
paper's own cells, it is computed on the paper's grid, and exactly as well.
"""

import json
import shutil
from importlib.metadata import version
from pathlib import Path

import xarray as xr

from walker_jax import storage
from walker_jax.execution.progress import bar
from walker_jax.execution.threads import side_by_side
from walker_jax.paper import report
from walker_jax.paper.calculations import CALCULATIONS, FULL, QUICK
from walker_jax.paper.numbers import Number, compare_numbers
from walker_jax.paper.pictures import FIGURES, PaperFigure


def reproduce(
    out: Path, *, quick: bool = False, overwrite: bool = False, progress: bool = True
) -> list[Number]:
    """Compute all of the paper's figures and numbers, and write a report of them.

    **Arguments:**

    - `out`: the folder of the report: `report.html`, a page with everything in it; the figures, as
      PNG and SVG; `numbers.json`; and in `data` the data sets. Data sets of an earlier, possibly
      interrupted run with the same request are used again.
    - `quick`: whether to use fewer cells, slopes and strides, and omit exact areas.
    - `overwrite`: whether to remove the files of another run.
    - `progress`: whether to show progress on a terminal, after a second.

    **Returns** the numbers. Raises `ValueError` where the folder holds something else.
    """
    size = QUICK if quick else FULL
    request = {"command": "reproduce", "size": size._asdict(), "version": version("walker-jax")}
    places = {name: out / "data" / f"{name}.zarr" for name in CALCULATIONS}
    check_place(out, places, request, overwrite=overwrite)
    if overwrite:  # all at once, so that an interrupted run can be resumed
        for path in files_of(out):
            path.unlink(missing_ok=True)
        for path in places.values():
            shutil.rmtree(path, ignore_errors=True)
    (out / "data").mkdir(parents=True, exist_ok=True)

    def compute(name: str) -> xr.Dataset:
        """Compute a data set, unless an earlier run has left it."""
        own = request | {"part": places[name].stem}
        found = storage.find(places[name], own)
        if found is None:
            with bar(name, progress):
                found = storage.save(CALCULATIONS[name](size), places[name], own)
        return found

    begun = lambda: any(path.exists() for path in places.values())
    with storage.resumable(out, begun, overwrite=overwrite):
        with bar("calculations", progress, len(CALCULATIONS)) as update:
            data: dict[str, xr.Dataset] = {}
            for name, found in zip(CALCULATIONS, side_by_side(compute, CALCULATIONS), strict=True):
                data[name] = found
                update(len(data))
        with bar("numbers and figures", progress):
            numbers = compare_numbers(data)
            title, images = storage.signature(request), []
            for one in FIGURES:
                figure = one.draw(data)
                for path in picture_paths(out, one):
                    figure.savefig(path, dpi=150, metadata={"Title": title})
                images.append(picture_paths(out, one)[0].read_bytes())
        kept = {"signature": title, "numbers": [number._asdict() for number in numbers]}
        storage.write_text(out / "numbers.json", json.dumps(kept, indent=1))
        storage.write_text(out / "report.html", render_report(numbers, images, title, quick=quick))
    return numbers


def check_place(out: Path, places: dict[str, Path], request: dict, *, overwrite: bool) -> None:
    """Raise `WrongUse` where other files would be lost, or nothing can be written."""
    storage.check_writable(out)
    if not out.exists():
        return
    if not out.is_dir():
        raise storage.StoreConflict(
            f"{out} exists and is not a folder", storage.ANOTHER_PLACE.format("out"), of="out"
        )
    storage.check_writable(out / "data")
    if (out / "data").exists():
        for path in places.values():
            storage.find(path, request | {"part": path.stem}, overwrite=overwrite)
    for path in files_of(out):
        storage.check_picture(path, request, overwrite=overwrite, argument="out")


def files_of(out: Path) -> list[Path]:
    """Return the files of a report beside its data sets."""
    figures = [path for one in FIGURES for path in picture_paths(out, one)]
    return [*figures, out / "numbers.json", out / "report.html"]


def picture_paths(out: Path, figure: PaperFigure) -> tuple[Path, Path]:
    """Return the paths of a figure, as PNG and as SVG."""
    return out / f"figure-{figure.number}.png", out / f"figure-{figure.number}.svg"


def render_report(
    numbers: list[Number], images: list[bytes], signature: str, *, quick: bool
) -> str:
    """Return the page of the report."""
    differ = [number for number in numbers if not number.agrees]
    rows = lambda chosen: [
        (one.where, one.what, one.printed, one.ours, "✓" if one.agrees else "differs", one.why)
        for one in chosen
    ]
    head = ("section", "number", "printed", "ours", "", "why")
    size = "with fewer cells and slopes than in full" if quick else "in full"
    intro = (
        f"{len(numbers)} numbers of the paper's text and table are compared, at the digits that "
        f"are printed: {len(numbers) - len(differ)} agree, {len(differ)} differ, each for the "
        "reason beside it. Computed "
        f"{size} by walker_jax {version('walker-jax')}. Lengths are in units of the leg, times in "
        "√(l/g), angles in rad."
    )
    blocks = [report.table("Numbers that differ", head, rows(differ))]
    blocks += [
        report.picture(f"Figure {one.number}. {one.title}", image, one.text)
        for one, image in zip(FIGURES, images, strict=True)
    ]
    blocks.append(report.table("All numbers", head, rows(numbers)))
    title = "Basin of attraction of the simplest walking model"
    subtitle = "A. L. Schwab and M. Wisse, ASME DETC2001/VIB-21363 (2001), reproduced"
    return report.page(title, subtitle, intro, blocks, signature)

"""What commands print, draw and save."""

import json
import math
import sys
import time
from collections.abc import Iterable
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from walker_jax import storage
from walker_jax.checks import WrongPlace
from walker_jax.systems.system import System, code_of
from walker_jax.walkers.fingerprints import code_fingerprint

if TYPE_CHECKING:
    import xarray


PICTURES = (".png", ".svg", ".pdf")
"""Formats that carry a title, which tells whether a picture is of the same request."""


def request_for(command: str, system: System, /, **asked: Any) -> dict[str, Any]:
    """All that the answer of a command about a system depends on."""
    code = code_fingerprint(type(system), code_of(system))
    asked |= {"code": code} if code else {}
    return {"command": command, **asked, "version": version("walker-jax")}


def picture_path(out: Path, figure: Path | None) -> Path:
    """Where the picture of a data set goes; both places are checked."""
    if not out.name:
        raise WrongPlace(f"--out {out} is not the name of a data set: give one, such as a.zarr")
    figure = figure or out.with_suffix(".png")
    check_suffix(figure)
    if out.absolute() in (figure.absolute(), *figure.absolute().parents):
        raise WrongPlace(f"--figure {figure} must be another place than --out {out}")
    return figure


def find_earlier(
    out: Path, figure: Path | None, request: dict, *, overwrite: bool
) -> "tuple[Path, xarray.Dataset | None]":
    """Where the picture goes, and the data set that the same command has completed at `out`.

    Refuses a place where something else stands.
    """
    figure = picture_path(out, figure)
    found = storage.find(out, request, overwrite=overwrite)  # first: it says what differs
    earlier = request if found is None else storage.request_in(found.attrs)
    storage.check_picture(figure, request, earlier, overwrite=overwrite)
    if earlier["version"] != request["version"]:
        print(f"{out} was computed by version {earlier['version']}", file=sys.stderr)
    return figure, found


def check_suffix(figure: Path) -> None:
    """Refuse a name of a picture that is not of one of the `PICTURES`."""
    if figure.suffix not in PICTURES:
        raise WrongPlace(f"--figure {figure} must end in one of {', '.join(PICTURES)}")


def draw(axes, path: Path, request: dict) -> None:
    """Save the picture to which axes belong, signed with the request."""
    picture = axes.get_figure(root=True)
    with storage.atomic_file(path) as draft:
        picture.savefig(draft, dpi=150, metadata={"Title": storage.signature(request)})


class Stopwatch:
    """Wall-clock time, and how much of it JAX spent on tracing and compiling."""

    def __init__(self):
        self.compiling: list[tuple[float, float]] = []
        self.start = time.perf_counter()
        jax.monitoring.register_event_duration_secs_listener(self.record)

    def record(self, event: str, duration_secs: float, **kwargs: str | int) -> None:
        if "/compile" in event or "compilation_cache" in event:
            now = time.perf_counter()
            self.compiling.append((max(now - duration_secs, self.start), now))

    def seconds(self) -> dict[str, float]:
        """Seconds so far; compilations in several threads at once count once."""
        total, end = 0.0, self.start
        for begin, finish in sorted(self.compiling):
            total += max(0.0, finish - max(begin, end))
            end = max(end, finish)
        return {"compile": total, "run": time.perf_counter() - self.start - total}


def print_json(answer: dict) -> None:
    """Print an answer as JSON."""
    print(json.dumps(jsonable(answer), allow_nan=False))


def jsonable(value: Any) -> Any:
    """The same value in the types of JSON: null for NaN and infinities."""
    if isinstance(value, dict):
        return {key: jsonable(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return jsonable(value.tolist())
    if isinstance(value, list | tuple):
        return [jsonable(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value


def listed(numbers: Iterable[Any], form: str = ".6f") -> str:
    """Numbers with commas between them."""
    return ", ".join(f"{number:{form}}" for number in numbers)

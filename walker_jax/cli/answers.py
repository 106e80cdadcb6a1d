"""The answers of commands: printed, drawn and saved."""

import json
import math
import sys
import time
from collections.abc import Callable, Container, Iterable, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from walker_jax import storage
from walker_jax.checks import WrongPlace
from walker_jax.cli.groups import option
from walker_jax.execution.progress import bar
from walker_jax.identity import code_fingerprint
from walker_jax.systems.system import System, code_of
from walker_jax.walkers.parameters import describe_walker

if TYPE_CHECKING:
    import xarray


PICTURES = (".png", ".svg", ".pdf")
"""Formats with a title, which holds the signature of the request."""


def request_for(
    command: str, system: System, /, *, without: Container[str] = (), **asked: Any
) -> dict[str, Any]:
    """Return all that the answer of a command about a system depends on.

    The description of the system is `without` the parameters that the command varies.
    """
    about = {name: one for name, one in describe_walker(system).items() if name not in without}
    code = code_fingerprint(type(system), code_of(system))
    asked = {"walker": about} | asked | ({"code": code} if code else {})
    return {"command": command, **asked, "version": version("walker-jax")}


def slope_of(about: dict[str, Any]) -> dict[str, float]:
    """Return the slope of a walker that is described in a request, if it has one."""
    return {name: value for name, value in about.items() if name == "slope"}


def check_suffix(figure: Path) -> None:
    """Refuse a picture whose name ends in none of the `PICTURES`."""
    if figure.suffix not in PICTURES:
        raise WrongPlace(f"--figure {figure} must end in one of {', '.join(PICTURES)}")


def check_figure(path: Path, request: dict, *, overwrite: bool) -> None:
    """Refuse a place where a picture cannot go."""
    check_suffix(path)
    storage.check_picture(path, request, overwrite=overwrite)


def check_film(path: Path, request: dict, *, overwrite: bool) -> None:
    """Refuse a place where a film cannot go."""
    from walker_jax import figures

    figures.check_film(path)
    storage.check_picture(path, request, overwrite=overwrite, argument="animate")


def draw(axes, path: Path, request: dict) -> None:
    """Save the picture of these axes, signed with the request."""
    picture = axes.get_figure(root=True)
    with storage.atomic_file(path) as draft:
        picture.savefig(draft, dpi=150, metadata={"Title": storage.signature(request)})


@dataclass(frozen=True)
class Output:
    """The places of a command's data set and picture, and the form of its answer."""

    theme = "Output"
    out: Path = option(Path(), "Where the data set goes.")
    figure: Path | None = option(None, "Where the picture goes (default: beside it, .png).")
    overwrite: bool = option(False, "Replace what is there.")
    as_json: bool = option(False, "Print the answer as JSON.", "--json")

    @property
    def picture(self) -> Path:
        """The place of the picture."""
        return self.figure or self.out.with_suffix(".png")

    def check(self) -> None:
        """Refuse places without a name or with a wrong ending, and one place for both."""
        if not self.out.name:
            raise WrongPlace(
                f"--out {self.out} is not the name of a data set: give one, such as a.zarr"
            )
        check_suffix(self.picture)
        place = storage.absolute(self.picture)
        if storage.absolute(self.out) in (place, *place.parents):
            raise WrongPlace(f"--figure {self.picture} must be another place than --out {self.out}")

    def find(self, request: dict) -> "xarray.Dataset | None":
        """Find the data set that the same command has completed; refuse places that are taken."""
        self.check()
        found = storage.find(
            self.out, request, overwrite=self.overwrite
        )  # first, as it says what differs
        earlier = request if found is None else storage.request_in(found.attrs)
        storage.check_picture(self.picture, request, earlier, overwrite=self.overwrite)
        if earlier["version"] != request["version"]:
            print(f"{self.out} was computed by version {earlier['version']}", file=sys.stderr)
        return found

    def draw(self, axes: Any, request: dict) -> None:
        """Save the picture of these axes."""
        draw(axes, self.picture, request)

    def place(self, request: dict) -> dict[str, Any]:
        """Return the arguments of library functions that save their results."""
        return {"out": self.out, "request": request, "overwrite": self.overwrite}

    def produce(
        self,
        request: dict,
        compute: "Callable[[], xarray.Dataset]",
        picture: str,
        kept: bool = False,
    ) -> "xarray.Dataset":
        """Return the data set of a request, computed unless it exists, and draw its picture.

        `picture` is the name of a function in `figures`. With `kept`, `compute` itself saves.
        """
        data = self.find(request)
        if data is None:
            with bar(request["command"], True):
                data = compute()
            data = data if kept else storage.save(data, self.out, request)
        from walker_jax import figures  # which takes half a second to load

        self.draw(getattr(figures, picture)(data), request)
        return data

    def tell(self, answer: dict, lines: Iterable[str], film: Path | None = None) -> None:
        """Print the answer and the places of the files."""
        shot = f", film {film}" if film is not None else ""
        places = f"  data set {self.out}, picture {self.picture}{shot}"
        tell(answer, chain(lines, [places]), as_json=self.as_json)


class Stopwatch:
    """Wall-clock time, and the part of it that JAX spent on tracing and compiling."""

    def __init__(self):
        self.compiling: list[tuple[float, float]] = []
        self.start = time.perf_counter()
        jax.monitoring.register_event_duration_secs_listener(self.record)

    def record(self, event: str, duration_secs: float, **kwargs: str | int) -> None:
        if "/compile" in event or "compilation_cache" in event:
            now = time.perf_counter()
            self.compiling.append((max(now - duration_secs, self.start), now))

    def seconds(self) -> dict[str, float]:
        """Return the seconds so far; simultaneous compilations in several threads count once."""
        total, end = 0.0, self.start
        for begin, finish in sorted(self.compiling):
            total += max(0.0, finish - max(begin, end))
            end = max(end, finish)
        return {"compile": total, "run": time.perf_counter() - self.start - total}


def tell(answer: dict, lines: Iterable[str], *, as_json: bool) -> None:
    """Print an answer as JSON, or in words, line by line."""
    if as_json:
        print(json.dumps(jsonable(answer), allow_nan=False))
    else:
        print(*lines, sep="\n")


def jsonable(value: Any) -> Any:
    """Convert a value to the types of JSON; NaN and infinities become null."""
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
    """Write numbers with commas between them."""
    return ", ".join(f"{number:{form}}" for number in numbers)


def points_listed(points: Sequence[Any]) -> str:
    """Write the first four of some points."""
    more = ", ..." if len(points) > 4 else ""
    return ", ".join(f"({listed(point)})" for point in points[:4]) + more

"""The answers of commands: printed, drawn and saved."""

import math
import re
import sys
import time
from collections.abc import Callable, Container, Iterable, Iterator, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import walker_jax as wj
from walker_jax.cli import library as lib
from walker_jax.cli.options import Group, option
from walker_jax.refusals import WrongPlace

PICTURES = (".png", ".svg", ".pdf")
"""Formats with a title, which holds the signature of the request."""
OVERWRITE: Any = option(False, "Replace what is there.", theme="Output")


def request_for(
    command: str, system: "wj.System", /, *, without: Container[str] = (), **asked: Any
) -> dict[str, Any]:
    """Return all that the answer of a command about a system depends on.

    The description of the system is `without` the parameters that the command varies.
    """
    about = {name: one for name, one in lib.describe_walker(system).items() if name not in without}
    code = lib.code_fingerprint(type(system), lib.code_of(system))
    asked = {"walker": about} | asked | ({"code": code} if code else {})
    return {"command": command, **asked, "version": version("walker-jax")}


def slope_of(about: dict[str, Any]) -> dict[str, float]:
    """Return the slope of a walker that is described in a request, if it has one."""
    return {name: value for name, value in about.items() if name == "slope"}


def draw(axes: Any, path: Path, request: dict) -> None:
    """Save the picture of these axes, signed with the request."""
    picture = axes.get_figure(root=True)
    with lib.storage.atomic_file(path) as draft:
        picture.savefig(draft, dpi=150, metadata={"Title": lib.storage.signature(request)})


def check_suffix(figure: Path) -> None:
    """Refuse a picture whose name ends in none of the `PICTURES`."""
    if figure.suffix not in PICTURES:
        raise WrongPlace(f"--figure {figure} must end in one of {', '.join(PICTURES)}")


def check_picture(path: Path | None, request: dict, *, overwrite: bool, film: bool = False) -> None:
    """Refuse a place where a picture, or a film, cannot go."""
    if path is not None:
        (wj.figures.check_film if film else check_suffix)(path)
        argument = "animate" if film else "figure"
        lib.storage.check_picture(path, request, overwrite=overwrite, argument=argument)


class Output(Group):
    """The places of a command's data set and picture."""

    theme = "Output"
    out: Path = option(Path(), "Where the data set goes.")
    figure: Path | None = option(None, "Where the picture goes (default: beside it, .png).")
    overwrite: bool = OVERWRITE

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
        place = lib.storage.absolute(self.picture)
        if lib.storage.absolute(self.out) in (place, *place.parents):
            raise WrongPlace(f"--figure {self.picture} must be another place than --out {self.out}")

    def find(self, request: dict) -> "lib.xarray.Dataset | None":
        """Find the data set that the same command has completed; refuse places that are taken."""
        self.check()
        # The data set first, as it says what differs.
        found = lib.storage.find(self.out, request, overwrite=self.overwrite)
        earlier = request if found is None else lib.storage.request_in(found.attrs)
        lib.storage.check_picture(self.picture, request, earlier, overwrite=self.overwrite)
        if earlier["version"] != request["version"]:
            print(f"{self.out} was computed by version {earlier['version']}", file=sys.stderr)
        return found

    def draw(self, axes: Any, request: dict) -> None:
        """Save the picture of these axes."""
        draw(axes, self.picture, request)

    def place(self, request: dict) -> dict[str, Any]:
        """Return the arguments of library functions that save their results, and show progress."""
        return dict(out=self.out, request=request, overwrite=self.overwrite, progress=True)

    def produce(
        self,
        request: dict,
        compute: "Callable[[], lib.xarray.Dataset]",
        picture: str,
        kept: bool = False,
    ) -> "lib.xarray.Dataset":
        """Return the data set of a request, computed unless it exists, and draw its picture.

        `picture` is the name of a function in `figures`. With `kept`, `compute` itself saves.
        """
        data = self.find(request)
        if data is None:
            with lib.bar(request["command"], True):
                data = compute()
            if not kept:
                data = lib.storage.save(data, self.out, request, overwrite=self.overwrite)
        self.draw(getattr(wj.figures, picture)(data), request)
        return data


class Pieces(Group):
    """The processes that compute the pieces of a data set."""

    theme = "Processes"
    workers: int | None = option(
        None, "Processes that share the cores (Dask).", excludes=("scheduler",)
    )
    scheduler: str | None = option(
        None, "Scheduler of a Dask cluster, to compute pieces there.", metavar="ADDRESS"
    )

    @property
    def cluster(self) -> int | str | None:
        """The number of workers or the scheduler's address; None stands for this process."""
        return self.scheduler if self.workers is None else self.workers


def files_in_words(given: Mapping[str, Any]) -> Iterator[str]:
    """Yield the line that says where the files are which a command was to write."""
    output, picture = given.get("output"), given.get("figure")
    places = {"data set": output and output.out, "picture": output.picture if output else picture}
    places |= {"film": given.get("animate")}
    if written := [f"{what} {place}" for what, place in places.items() if place is not None]:
        yield f"  {', '.join(written)}"


class Stopwatch:
    """Wall-clock time, and the part of it that JAX spent on tracing and compiling."""

    def __init__(self):
        self.compiling: list[tuple[float, float]] = []
        self.start = time.perf_counter()
        lib.monitoring.register_event_duration_secs_listener(self.record)

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


def jsonable(value: Any) -> Any:
    """Convert a value to the types of JSON; NaN and infinities become null."""
    if isinstance(value, dict):
        return {key: jsonable(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [jsonable(item) for item in value]
    if hasattr(value, "dtype"):  # an array
        return jsonable(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value


MOTIONS = {"gait": "cycle", "Gait": "Cycle", "stride": "iterate", "walker": "start"}
MOTIONS |= {"walks on": "goes on", "walks": "goes on", "walking": "the motion", "falls": "fails"}
"""Words for motions of walkers, and those of other systems."""
OF_MOTIONS = re.compile(
    r"(?<!walker-jax )(?<![\w./-])"  # of no command, option or file
    r"(gait|Gait|stride|walker|walks on|walks|walking|falls(?= from))(s?)(?![\w/-]|\.\w)"
)


def reword(line: str, system: "wj.System") -> str:
    """Return a line of an answer in the words for motions of a system, which may not walk."""
    if isinstance(system, wj.Walker) or isinstance(system, lib.Robot):
        return line
    other = lambda text: OF_MOTIONS.sub(lambda found: MOTIONS[found[1]] + found[2], text)
    return system.label().join(map(other, line.split(system.label())))  # its name stays


def is_map(system: "wj.System", times: Any) -> bool:
    """Return whether steps of these times are those of a map, which take none."""
    return not isinstance(system, wj.HybridSystem) and all(time == 1 for time in times)


def listed(numbers: Iterable[Any], form: str = ".6f") -> str:
    """Write numbers with commas between them."""
    return ", ".join(f"{number:{form}}" for number in numbers)


def points_listed(points: Sequence[Any]) -> str:
    """Write the first four of some points."""
    more = ", ..." if len(points) > 4 else ""
    return ", ".join(f"({listed(point)})" for point in points[:4]) + more

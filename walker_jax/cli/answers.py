"""The answers of commands: printed, drawn and saved."""

import math
import sys
import time
from collections.abc import Callable, Container, Iterable, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

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

    def places(self, film: Path | None = None) -> str:
        """Write where the files are."""
        shot = f", film {film}" if film is not None else ""
        return f"  data set {self.out}, picture {self.picture}{shot}"


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


class Terms(NamedTuple):
    """Words for motions: those of walkers; `terms_of` has those of a system."""

    cycle: str = "gait"
    step: str = "stride"
    start: str = "walker"
    goes: str = "walks"
    fails: str = "falls"
    motion: str = "walking"


WALKING = Terms()


def terms_of(system: "wj.System") -> Terms:
    """Return the words for motions of a system, which only walks if it is a walker or a robot."""
    if isinstance(system, wj.Walker) or isinstance(system, lib.Robot):
        return WALKING
    return Terms("cycle", "iterate", "start", "goes", "fails", "the motion")


def is_map(system: "wj.System", times: Any) -> bool:
    """Return whether steps of these times are those of a map, which take none."""
    return not isinstance(system, wj.HybridSystem) and all(time == 1 for time in times)


def in_words(outcome: str, system: "wj.System") -> str:
    """Write the name of an outcome in words; only a walker walks."""
    goes_on = outcome == "STRIDE" and terms_of(system) is not WALKING
    return "goes on" if goes_on else lib.outcome_in_words(outcome)


def listed(numbers: Iterable[Any], form: str = ".6f") -> str:
    """Write numbers with commas between them."""
    return ", ".join(f"{number:{form}}" for number in numbers)


def points_listed(points: Sequence[Any]) -> str:
    """Write the first four of some points."""
    more = ", ..." if len(points) > 4 else ""
    return ", ".join(f"({listed(point)})" for point in points[:4]) + more

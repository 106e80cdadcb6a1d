"""What commands print and draw."""

import json
import math
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from walker_jax import storage
from walker_jax.checks import WrongUse
from walker_jax.walkers.model import Walker
from walker_jax.walkers.parameters import parameters
from walker_jax.walkers.simplest import SimplestWalker

if TYPE_CHECKING:
    import xarray


PICTURES = (".png", ".svg", ".pdf")  # those that carry a title, by which a picture is known again


def description(walker: Walker) -> dict:
    """A walker by name and parameters, for a request or an answer."""
    values = {one.name: float(getattr(walker, one.name)) for one in parameters(walker)}
    return {"name": type(walker).__name__, **values}


def said(walker: Walker) -> str:
    """A walker in words."""
    name, *values = description(walker).items()
    return ", ".join([name[1], *(f"{key} {value:g}" for key, value in values)])


def no_gait(walker: Walker, period: int, gait: Any, guessed: bool) -> str:
    """That no gait was found, why, given how a search ended, if there was one, and what to try."""
    one = guessed or (isinstance(walker, SimplestWalker) and period == 1)
    if gait is None or not (np.isfinite(gait.residual) or one):
        why = "none of the searches all over the section led to one"
    elif not np.isfinite(gait.residual):
        where = "--guess" if guessed else "the state where the search begins"
        why = f"the walker makes no stride from {where}"
    elif gait.residual > 1e-6:
        why = f"the search ended where a stride misses the next state by {gait.residual:.2g}"
    elif period > 1:
        why = "the search ended in a gait of a shorter period, or too close to a bifurcation"
    else:
        why = "the search ended too close to a bifurcation"
    other = "another --guess" if guessed else "--guess THETA THETADOT"
    return (
        f"no gait of period {period} found for {said(walker)}: {why}; "
        f"try {other}, or another --slope"
    )


def picture_of(out: Path, figure: Path | None) -> Path:
    """Where the picture of a data set goes, both places checked."""
    if not out.name:
        raise WrongUse(f"--out {out} is not the name of a data set")
    figure = figure or out.with_suffix(".png")
    check_suffix(figure)
    if out.absolute() in (figure.absolute(), *figure.absolute().parents):
        raise WrongUse(f"--figure {figure} must be another place than --out {out}")
    return figure


def made_before(
    out: Path, figure: Path | None, request: dict, *, overwrite: bool
) -> "tuple[Path, xarray.Dataset | None]":
    """Where the picture goes, and what the same command has left at `out`, if it has ended.

    Something else at either place is refused.
    """
    figure = picture_of(out, figure)
    found = storage.find(out, request, overwrite=overwrite)  # first: it says what is other
    storage.check_picture(figure, request, overwrite=overwrite)
    return figure, found


def check_suffix(figure: Path) -> None:
    if figure.suffix not in PICTURES:
        raise WrongUse(f"--figure {figure} must end in one of {', '.join(PICTURES)}")


def draw(axes, path: Path, request: dict) -> None:
    """Save the picture to which axes belong, signed with the request."""
    picture = axes.get_figure(root=True)
    with storage.atomic_file(path) as draft:
        picture.savefig(draft, dpi=150, metadata={"Title": storage.signature(request)})


class Stopwatch:
    """Wall-clock time, that in which JAX traced or compiled anything apart."""

    def __init__(self):
        self.compiling: list[tuple[float, float]] = []
        self.start = time.perf_counter()
        jax.monitoring.register_event_duration_secs_listener(self.record)

    def record(self, event: str, duration_secs: float, **kwargs: str | int) -> None:
        if "/compile" in event or "compilation_cache" in event:
            now = time.perf_counter()
            self.compiling.append((max(now - duration_secs, self.start), now))

    def seconds(self) -> dict[str, float]:
        """Seconds so far; what was compiled in several threads at once counts once."""
        total, end = 0.0, self.start
        for begin, finish in sorted(self.compiling):
            total += max(0.0, finish - max(begin, end))
            end = max(end, finish)
        return {"compile": total, "run": time.perf_counter() - self.start - total}


def print_json(answer: dict) -> None:
    print(json.dumps(plain(answer), allow_nan=False))


def plain(value):
    """The same in what JSON has: null for NaN and infinities."""
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value

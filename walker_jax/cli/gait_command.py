"""`walker-jax gait`."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from walker_jax.cli.answers import check_figure, draw, listed, request_for, slope_of, tell
from walker_jax.cli.conclusions import conclude_gaits
from walker_jax.cli.groups import option
from walker_jax.cli.options import OUTPUT, PHIDOT_HELP, check_finite, refuse
from walker_jax.cli.section import START, has_own_options, refuse_own, start_from, state_from
from walker_jax.cli.walker_options import takes_walker
from walker_jax.execution.progress import bar
from walker_jax.gaits import selection
from walker_jax.gaits.cycles import Gait
from walker_jax.gaits.gait_summary import summarise_gait
from walker_jax.systems.system import System
from walker_jax.walkers.parameters import describe_briefly


@dataclass(frozen=True)
class Search:
    """The kind of gaits to search for, and the start of the search."""

    theme = "Search"
    period: int = option(1, "Strides in a cycle.", min=1)
    all: bool = option(False, "All gaits of the period, stable or not.")
    guess: tuple[float, float] | None = option(
        None, "Where the search begins.", metavar="THETA THETADOT"
    )
    phidot: float | None = option(None, f"{PHIDOT_HELP}: with --guess.")
    start: list[str] | None = START

    def coordinates(self, walker: System) -> dict[str, float]:
        """Return the coordinates of the state in which the search begins, if it is given."""
        start = self.start or None
        refuse_own(walker, guess=self.guess, phidot=self.phidot)
        if start is not None:
            return start_from(walker, start)
        if self.guess is None:
            refuse("is for --guess alone: give it too", phidot=self.phidot)
            return {}
        for value in self.guess:
            check_finite(guess=value)
        check_finite(phidot=self.phidot)
        given = dict(zip(("theta", "thetadot"), self.guess, strict=True))
        return given | ({} if self.phidot is None else {"phidot": self.phidot})

    def instead(self, walker: System) -> str:
        """Return the advice to give if no gait is found."""
        if self.guess is not None or self.start:
            return f"try another {'--start' if self.start else '--guess'}"
        form = "--guess THETA THETADOT" if has_own_options(walker) else "--start NAME=VALUE"
        return f"try {form}"


@dataclass(frozen=True)
class Picture:
    theme = "Picture"
    figure: Path | None = option(None, "Where a picture of the Floquet multipliers goes.")
    overwrite: bool = option(False, "Replace what is there.", **OUTPUT)
    as_json: bool = option(False, "Print the answer as JSON.", "--json", **OUTPUT)


@takes_walker(systems=True)
def gait(walker: System, search: Search, picture: Picture) -> None:
    """Find the gaits of a walker: cycles of strides, and their stability."""
    given = search.coordinates(walker)
    begin = state_from(walker, given) if given else None
    guess = None if begin is None else begin.tolist()
    request = request_for("gait", walker, period=search.period, guess=guess, all=search.all)
    if picture.figure is not None:
        check_figure(picture.figure, request, overwrite=picture.overwrite)
    with bar("search for gaits", True):
        found = selection.select_gaits(
            walker, search.period, begin, every=search.all, instead=search.instead(walker)
        )
    if picture.figure is not None:
        from walker_jax import figures

        title = f"{describe_briefly(walker)}: Floquet multipliers"
        draw(figures.multipliers(found, title=title), picture.figure, request)
    about = request["walker"]
    answer = {"gaits": [summarise_gait(one) for one in found], "walker": about}
    lines = [line for one in found for line in gait_in_words(walker, about, one)]
    lines.append(conclude_gaits(sum(bool(one.stable) for one in found), len(found)))
    lines += [] if picture.figure is None else [f"picture {picture.figure}"]
    tell(slope_of(about) | answer, lines, as_json=picture.as_json)


def gait_in_words(walker: System, about: dict, gait: Gait) -> Iterator[str]:
    """Write the stability of a gait, and a line for each stride."""
    kind, period = "stable" if gait.stable else "unstable", len(gait.states)
    where = f"at slope {about['slope']:g} rad" if "slope" in about else f"of {about['name']}"
    multipliers = listed(gait.multipliers, ".8g")
    yield f"{kind} gait of period {period} {where}, multipliers {multipliers}"
    for state, duration in zip(gait.states, gait.step_times, strict=True):
        named = zip(walker.section, state, strict=True)
        coordinates = "  ".join(f"{name} {value:.13f}" for name, value in named)
        yield f"  {coordinates}  step time {duration:.10f}"

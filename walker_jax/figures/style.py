"""Colours, signs, lines and sizes that all pictures share."""

from collections.abc import Sequence
from typing import Any

from matplotlib import rcParams
from matplotlib.font_manager import FontProperties

from walker_jax.systems.outcomes import WORDS, Outcome, name_of_outcome, outcome_in_words

INK = "#1a1a1a"
SIGNS = {
    Outcome.LEFT_GRID: ("#f7f7f7", ""),
    Outcome.BACKWARD: ("#fae0b5", "B"),
    Outcome.FORWARD: ("#b4d1e9", "F"),
    Outcome.RUNNING: ("#e1abb8", "R"),
    Outcome.OUTSIDE: ("#a7a7a7", ""),
    Outcome.STOPPED: ("#648f4b", ""),
    Outcome.UNDECIDED: ("#d1361b", ""),
    Outcome.BENT_KNEE: ("#6e51a0", "K"),
    Outcome.BUCKLED: ("#6b4828", ""),
    Outcome.SCUFFED: ("#1d4843", ""),
    Outcome.SIDEWAYS: ("#c68739", "S"),
    Outcome.OWN_1: ("#9f88cb", ""),
    Outcome.OWN_2: ("#4b3364", ""),
    Outcome.OWN_3: ("#8f437c", ""),
    Outcome.OWN_4: ("#4d5417", ""),
}
"""Colour and letter (Schwab and Wisse 2001, Figure 2), from light to dark; then those of a system's
own failures."""
FAILURES = {outcome: (*signs, WORDS[outcome.name]) for outcome, signs in SIGNS.items()}
"""The same, and words."""


def failure_words(outcome: int, failures: Sequence[str] = ()) -> str:
    """How a walk fails, in words, of a system with these failures of its own."""
    return outcome_in_words(name_of_outcome(outcome, failures))


BASINS = ("#0d2c5e", "#8c2566", "#0f7a72")
MARKERS = "os^"
"""Colours of the basins, from dark to light, and signs of their attractors; the largest first."""
OTHERS = "#4d4d4d"
UNMATCHED, ARTEFACTS = "#7a5c00", "#8a63b8"
"""Colours of cells that converge to other attractors, to none that is known, and in cycles that
cell mapping makes up."""
PERIODS = (
    (INK, "o"),
    ("#4a1a86", "s"),
    ("#8f1230", "^"),
    ("#04599b", "D"),
    ("#187d4b", "v"),
    ("#c6691d", "P"),
    ("#d377b4", "X"),
    ("#dfac02", "h"),
)
"""Colours, from dark to light, and signs of gaits of period 1, 2, ..."""
LONGER = ("#9b9b9b", "*")
"""Those of longer periods."""
SOLID: dict[str, Any] = {"lw": 2, "ls": "-"}
DASHED: dict[str, Any] = {"lw": 0.7, "ls": (0, (6, 3))}
"""Lines of stable and of unstable gaits."""
LETTER, NOTE, SMALL = "x-large", "medium", "small"
"""Sizes of text, to that of `rcParams`: letters of regions, second lines of titles, and other."""
TITLE: dict[str, Any] = {"loc": "left", "fontweight": "bold"}


def points_of(size: str) -> float:
    """A size of text in points: one of those above, or what `rcParams` has under a name."""
    chosen: Any = rcParams  # whose own types name each key
    return FontProperties(size=chosen.get(size, size)).get_size_in_points()


def period_style(period: int) -> tuple[str, str]:
    """Colour and sign of gaits of a period."""
    return PERIODS[period - 1] if period <= len(PERIODS) else LONGER


def gait_marker(period: int, stable: bool) -> dict[str, Any]:
    """How a multiplier of a gait is drawn: filled where the gait is stable, open where not."""
    colour, marker = period_style(period)
    face = colour if stable else "white"
    return {"color": colour, "marker": marker, "mfc": face, "mew": 1.2, "ms": 7, "ls": ""}

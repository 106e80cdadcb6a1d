"""Colours, signs, lines and sizes that all pictures share.

Any two that can touch are apart by 12 or more in CIEDE2000, in normal vision, protanopia and
deuteranopia, and ways to fail by 6 in lightness, for prints in grey.
"""

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
    Outcome.RUNNING: ("#d19b8b", "R"),
    Outcome.OUTSIDE: ("#b9b9b9", ""),
    Outcome.STOPPED: ("#8e8459", ""),
    Outcome.UNDECIDED: ("#b25900", ""),
    Outcome.BENT_KNEE: ("#5d34ff", "K"),
    Outcome.BUCKLED: ("#604d3e", ""),
    Outcome.SCUFFED: ("#184646", ""),
    Outcome.SIDEWAYS: ("#d3841b", "S"),
    Outcome.OWN_1: ("#a782ef", ""),
    Outcome.OWN_2: ("#9a0344", ""),
    Outcome.OWN_3: ("#755967", ""),
    Outcome.OWN_4: ("#164537", ""),
}
"""Colour and letter (Schwab and Wisse 2001, Figure 2), from light to dark; then those of a system's
own failures."""
FAILURES = {outcome: (*signs, WORDS[outcome.name]) for outcome, signs in SIGNS.items()}
"""The same, and words."""


def failure_words(outcome: int, failures: Sequence[str] = ()) -> str:
    """How a walk fails, in words, of a system with these failures of its own."""
    return outcome_in_words(name_of_outcome(outcome, failures))


BASINS = ("#0d2c5e", "#6e3e97", "#3e7b92")
MARKERS = "os^"
"""Colours of the basins, from dark to light, and signs of their attractors; the largest first."""
OTHERS = "#828282"
UNMATCHED, ARTEFACTS = "#594000", "#a695bb"
"""Colours of cells that converge to other attractors, to none that is known, and in cycles that
cell mapping makes up."""
PERIODS = (
    (INK, "o"),
    ("#441780", "s"),
    ("#8f1a2e", "^"),
    ("#005daa", "D"),
    ("#158257", "v"),
    ("#c7691c", "P"),
    ("#d375b8", "X"),
    ("#dfad09", "h"),
)
"""Colours, from dark to light, and signs of gaits of period 1, 2, ..."""
LONGER = ("#9c9c9b", "*")
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

"""Colours, signs, lines and sizes that all pictures share.

Any two colours that can touch differ by 12 or more in CIEDE2000, in normal vision, protanopia and
deuteranopia. Colours of failures differ by 6 or more in lightness, for prints in grey.
"""

from collections.abc import Sequence
from typing import Any

from matplotlib import rcParams
from matplotlib.font_manager import FontProperties

from walker_jax.systems.outcomes import OUTCOMES, OWN, Outcome, name_of_outcome, outcome_in_words

INK = "#1a1a1a"
SIGNS = {
    Outcome.LEFT_GRID: ("#f7f7f7", ""),
    Outcome.BACKWARD: ("#fae0b5", "B"),
    Outcome.FORWARD: ("#b4d1e9", "F"),
    Outcome.RUNNING: ("#d19b8b", "R"),
    Outcome.OUTSIDE: ("#b9b9b9", ""),
    Outcome.STOPPED: ("#8e8459", ""),
    Outcome.UNDECIDED: ("#b25900", ""),
    Outcome.BENT_KNEE: ("#c58c2b", "K"),
    Outcome.BUCKLED: ("#573434", ""),
    Outcome.SCUFFED: ("#775c44", ""),
    Outcome.SIDEWAYS: ("#22535d", "S"),
}
OWN_COLOURS = "#a782ef", "#9a0344", "#755967", "#164537"
"""Colours of the failures that a system names itself, in turn."""
SIGNS |= {Outcome(OWN + i): (OWN_COLOURS[i % 4], "") for i in range(OUTCOMES - OWN)}
"""Colour and letter of each failure (Schwab and Wisse 2001, Figure 2), from light to dark; last
come a system's own failures."""


def failure_words(outcome: int, failures: Sequence[str] = ()) -> str:
    """Say how a walk fails; `failures` are the system's own failures."""
    return outcome_in_words(name_of_outcome(outcome, failures))


BASINS = ("#0d2c5e", "#6e3e97", "#3e7b92")
MARKERS = "os^"
"""Colours of the basins, from dark to light, and signs of their attractors; the largest first."""
OTHERS = "#828282"
UNMATCHED, ARTEFACTS = "#594000", "#a695bb"
"""Colours of cells that converge to other attractors, of cells that converge to no known one, and
of artefacts of cell mapping."""
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
"""Colour and sign of longer periods."""
SOLID: dict[str, Any] = {"lw": 2, "ls": "-"}
DASHED: dict[str, Any] = {"lw": 0.7, "ls": (0, (6, 3))}
"""Lines of stable and of unstable gaits."""
LEVEL: dict[str, Any] = {"color": INK, "lw": 0.8, "zorder": 1}
"""Line at a value that separates two cases, such as a multiplier of 1."""
LARGE, NOTE, SMALL = "x-large", "medium", "small"
"""Sizes of text, relative to `rcParams`: letters of regions, second lines of titles, and the
rest."""
TITLE: dict[str, Any] = {"loc": "left", "fontweight": "bold"}
"""Place and weight of titles of axes."""


def points_of(size: str) -> float:
    """Return a size of text in points, by one of these names or a name in `rcParams`."""
    chosen: Any = rcParams  # typed as Any, as its own types name each key
    return FontProperties(size=chosen.get(size, size)).get_size_in_points()


def period_style(period: int) -> tuple[str, str]:
    """Return colour and sign of gaits of a period."""
    return PERIODS[period - 1] if period <= len(PERIODS) else LONGER


def gait_marker(period: int, stable: bool) -> dict[str, Any]:
    """Return the style of a gait's multiplier: filled if the gait is stable, open otherwise."""
    colour, marker = period_style(period)
    face = colour if stable else "white"
    return {"color": colour, "marker": marker, "mfc": face, "mew": 1.2, "ms": 7, "ls": ""}

"""`walker-jax explain`."""

import re

from walker_jax.cli.answers import tell
from walker_jax.cli.conclusions import conclude_explanation
from walker_jax.cli.options import Json
from walker_jax.cli.section import Start, begin_at
from walker_jax.cli.walker_options import takes_walker
from walker_jax.systems.outcomes import WORDS, outcome_in_words
from walker_jax.systems.system import System
from walker_jax.walkers.parameters import describe_walker
from walker_jax.walking import explanation


@takes_walker(systems=True)
def explain(walker: System, start: Start, as_json: Json = False) -> None:
    """Say why the stride from one start ends as it does, and whether a model fits together.

    Mode by mode: which guards rose through zero, when, and whether that counted; how near the
    others came; the least values of conditions. Lines with ! say what does not fit together. By
    default the start is that of the gait.
    """
    found = explanation.explain(walker, begin_at(walker, start.coordinates(walker)))
    known = found.name == "STRIDE"
    answer = {
        "walker": describe_walker(walker),
        "start": found.start,
        "outcome": found.name,
        "modes": [
            one._asdict() | {"rises": [rise._asdict() for rise in one.rises]} for one in found.modes
        ],
        "complaints": found.complaints,
        "state": found.state if known else None,
        "jacobian": found.jacobian if known else None,
    }
    lines = [in_words(str(found)), conclude_explanation(found.name, found.complaints)]
    tell(answer, lines, as_json=as_json)


def in_words(text: str) -> str:
    """Write an explanation with words in the places of the names of outcomes."""
    text = re.sub(r"(?m)^  condition (\w+)", r"  condition (\1)", text)
    text = re.sub(rf"\bleads to ({'|'.join(WORDS)})\b", r"the end: \1", text)
    return re.sub(r"\b[A-Z][A-Z_]{3,}\b", lambda name: outcome_in_words(name[0]), text)

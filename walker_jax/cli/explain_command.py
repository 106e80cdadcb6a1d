"""`walker-jax explain`."""

import re

import walker_jax as wj
from walker_jax.cli import library as lib
from walker_jax.cli.answers import in_words, terms_of
from walker_jax.cli.commands import command
from walker_jax.cli.section import begin_at, start_on, start_option


@command(
    examples=(
        "explain --theta 0.3 --thetadot -0.1",
        "explain --walker kneed",
        "explain --system duffing --start x=0.5 --start v=0",
    ),
    time="3 s, of a kneed walker 20 s.",
)
def explain(walker: "wj.System", start: dict[str, float] = start_option()):
    """Say why the stride from one start ends as it does, and whether a model fits together.

    Mode by mode: which guards rose through zero, when, and whether that counted; how near the
    others came; the least values of conditions. Lines with ! say what does not fit together. By
    default the start is that of the gait.
    """
    found = wj.explain(walker, begin_at(walker, start_on(walker, start)))
    known = found.name == "STRIDE"
    modes = [
        one._asdict() | {"rises": [rise._asdict() for rise in one.rises]} for one in found.modes
    ]
    yield {
        "walker": lib.describe_walker(walker),
        "start": found.start,
        "outcome": found.name,
        "modes": modes,
        "complaints": found.complaints,
        "remarks": found.remarks,
        "state": found.state if known else None,
        "jacobian": found.jacobian if known else None,
    }
    advice = {
        "OUTSIDE": "walker-jax gait gives a start that is feasible",
        "STRIDE": f"walker-jax walk, from there, follows the next {terms_of(walker).step}s",
    }
    next_step = advice.get(found.name, "walker-jax basin shows which starts go on")
    if found.complaints and found.name != "OUTSIDE":
        several = "first " * (len(found.complaints) > 1)
        next_step = f"mend what the {several}line with ! says, and explain again"
    # Words in the places of the names of outcomes.
    text = re.sub(r"(?m)^  condition (\w+)", r"  condition (\1)", str(found))
    text = re.sub(rf"\bleads to ({'|'.join(wj.Outcome.__members__)})\b", r"the end: \1", text)
    text = re.sub(r"\b[A-Z][A-Z_]{3,}\b", lambda name: in_words(name[0], walker), text)
    yield text
    yield f"Next: {next_step}."

"""Requests in words that are compared: the attribute `request` of a data set."""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path

from walker_jax.storage.places import ANOTHER_PLACE_OR_OVERWRITE, StoreConflict, check_writable


def check_request(path: Path, attributes: Mapping, request: dict) -> None:
    """Raises `StoreConflict` for the attributes of another result, and says what is other.

    A whole result may be of another version of the package; one is not resumed by another version.
    """
    wanted = json.loads(canonical_json(request))
    try:
        there = request_in(attributes)
        ours = {} if attributes.get("unfinished") else {"version": wanted.get("version")}
        other = first_difference(there | ours, wanted)
        if not other:
            return
    except (TypeError, ValueError):  # nothing that was written here
        other = ""
    raise StoreConflict(
        f"{path} holds another result{other}",
        ANOTHER_PLACE_OR_OVERWRITE.format("out"),
        of="out overwrite",
    )


def request_in(attributes: Mapping) -> dict:
    """The request that the attributes of a data set hold."""
    there = json.loads(str(attributes.get("request")))
    if not isinstance(there, dict):
        raise TypeError
    return there


def first_difference(there: dict, wanted: dict, within: str = "") -> str:
    """Describes the first difference between the request that is stored and the one made."""
    for name in sorted(there | wanted, key=lambda name: name != "command"):
        old, new = there.get(name), wanted.get(name)
        if isinstance(old, dict) and isinstance(new, dict) and old != new:
            return first_difference(old, new, f"{within}{name} ")
        if old != new:
            said = json.dumps(old) if name in there else "none"
            return f" ({within}{name}: {said}, not {json.dumps(new)})"
    return ""


def check_picture(
    path: Path, *requests: dict, overwrite: bool = False, argument: str = "figure"
) -> None:
    """Raises as `find` does where a picture cannot go; one of any of the requests may stand there.

    `argument` is the name of that by which the place was given.
    """
    check_writable(path)
    if not path.exists():
        return
    signatures = [signature(request).encode() for request in requests]
    known = lambda: overwrite or any(one in path.read_bytes() for one in signatures)
    if not (path.is_file() and known()):
        raise StoreConflict(
            f"{path} is something else",
            ANOTHER_PLACE_OR_OVERWRITE.format(argument),
            of=f"{argument} overwrite",
        )


def signature(request: dict) -> str:
    """The title that a picture of `request` carries, by which it is known again."""
    return f"walker-jax {hashlib.sha256(canonical_json(request).encode()).hexdigest()}"


def canonical_json(request: dict) -> str:
    return json.dumps(request, sort_keys=True)

"""Requests, the attribute `request` of data sets, and their comparison."""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path

from walker_jax.storage.places import ANOTHER_PLACE_OR_OVERWRITE, StoreConflict, check_writable


def check_request(path: Path, attributes: Mapping, request: dict) -> None:
    """Raise `StoreConflict` for the attributes of another result, and name the difference.

    A complete result may be of another version of the package; an unfinished one may not.
    """
    wanted = json.loads(canonical_json(request))
    try:
        there = request_in(attributes)
        ours = {} if attributes.get("unfinished") else {"version": wanted.get("version")}
        other = first_difference(there | ours, wanted)
        if not other:
            return
    except (TypeError, ValueError):  # not written by this package
        other = ""
    raise StoreConflict(
        f"{path} holds another result{other}",
        ANOTHER_PLACE_OR_OVERWRITE.format("out"),
        of="out overwrite",
    )


def request_in(attributes: Mapping) -> dict:
    """Return the request in the attributes of a data set."""
    there = json.loads(str(attributes.get("request")))
    if not isinstance(there, dict):
        raise TypeError
    return there


def first_difference(there: dict, wanted: dict, within: str = "") -> str:
    """Describe the first difference between the stored request and the new one."""
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
    """Raise as `find` if a picture cannot be written; one of any of the requests may be there.

    `argument` is the name of the argument that gave the place.
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
    """Return the title of a picture of `request`, which identifies it."""
    return f"walker-jax {hashlib.sha256(canonical_json(request).encode()).hexdigest()}"


def canonical_json(request: dict) -> str:
    return json.dumps(request, sort_keys=True)

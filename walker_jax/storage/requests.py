"""What was asked for, in words that are compared: the attribute `request` of a data set."""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path

from walker_jax.storage.places import ANOTHER_PLACE_OR_OVERWRITE, StoreConflict, check_writable


def check_request(path: Path, attributes: Mapping, request: dict) -> None:
    """Raises `StoreConflict` for the attributes of another result, and says what is other."""
    there = attributes.get("request")
    if there == canonical_json(request):
        return
    try:
        other = first_difference(json.loads(str(there)), json.loads(canonical_json(request)))
    except (TypeError, ValueError):  # nothing that was written here
        other = ""
    raise StoreConflict(
        f"{path} holds another result{other}", ANOTHER_PLACE_OR_OVERWRITE.format("out")
    )


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
    path: Path, request: dict, *, overwrite: bool = False, argument: str = "figure"
) -> None:
    """Raises as `find` does where a picture of `request` cannot go; one of it may stand there.

    `argument` is the name of that by which the place was given.
    """
    check_writable(path)
    if not path.exists():
        return
    known = path.is_file() and (overwrite or signature(request).encode() in path.read_bytes())
    if not known:
        raise StoreConflict(
            f"{path} is something else", ANOTHER_PLACE_OR_OVERWRITE.format(argument)
        )


def signature(request: dict) -> str:
    """What a picture of `request` carries as its title, by which it is known again."""
    return f"walker-jax {hashlib.sha256(canonical_json(request).encode()).hexdigest()}"


def canonical_json(request: dict) -> str:
    return json.dumps(request, sort_keys=True)

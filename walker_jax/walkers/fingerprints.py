"""Fingerprints of walkers that are not of the package: has their code changed?

A stored result carries the fingerprint of the code that computed it, so that a result is not
resumed, or taken for its own, by a class whose equations are other ones by now.
"""

import hashlib
import sys

from walker_jax.walkers.live_code import Description, attributes
from walker_jax.walkers.sources import file_of, home_of, sources_of

DIGITS = 16
"""Hexadecimal digits of a fingerprint: two of a user's codes agree by chance once in 2^64."""


def code_fingerprint(kind: type, parts: tuple = ()) -> str:
    """A hash of the code of a walker's class, and of other parts of it, such as the function of a
    map; empty for a class of the package without them.

    It covers the files of the class and of its bases, and what these import from the same folder or
    package, as they were when they were loaded. Where a class has no file, it covers its functions
    and what they use. Data that the code reads from other files is not covered.
    """
    sources = sources_of(kind)
    live = Description(sources)
    described = []
    for base in kind.__mro__:
        path = file_of(home_of(base.__module__))
        if path is None and base.__module__ not in sys.builtin_module_names:
            described.append(live.describe(base))
        elif "<locals>" in base.__qualname__:  # it may hold what is in no file
            described.append(live.describe(attributes(base)))
    described += [live.describe(part) for part in parts]
    if not sources and not described:
        return ""
    content = repr([sorted(sources.items()), described])
    return hashlib.sha256(content.encode()).hexdigest()[:DIGITS]

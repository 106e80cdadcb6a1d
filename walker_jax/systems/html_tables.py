"""Systems and results as tables in notebooks, which show `_repr_html_` rather than the repr.

Where it is None, as for traced values, notebooks show the repr.
"""

from collections.abc import Iterable
from html import escape
from typing import Any

import numpy as np


def html_table(caption: str, head: Iterable[Any], rows: Iterable[Iterable[Any]]) -> str:
    """Return a table in HTML; its words are escaped."""
    line = lambda tag, cells: (
        "<tr>" + "".join(f"<{tag}>{escape(str(one))}</{tag}>" for one in cells) + "</tr>"
    )
    body = "".join(line("td", row) for row in rows)
    return f"<table><caption>{escape(caption)}</caption>{line('th', head)}{body}</table>"


def list_numbers(values: Any) -> str:
    """Write numbers with eight digits, and without imaginary parts that are zero."""
    plain = [one.real if one.imag == 0 else one for one in np.atleast_1d(values)]
    return ", ".join(f"{one:.8g}" for one in plain)

"""Values that were computed independently, in `data`, whose README says where they are from."""

import json
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
DATA = ROOT / "tests" / "data"


def read_values(name: str) -> Any:
    """A file of values."""
    return json.loads((DATA / f"{name}.json").read_text())

"""Every number of the README has the command that makes it, and the page says so."""

import re
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parent.parent
SCRIPT = ROOT / "benchmarks" / "verify_readme.py"


@pytest.fixture(scope="module")
def script() -> dict[str, Any]:
    names: dict[str, Any] = {"__name__": "verify_readme", "__file__": str(SCRIPT)}
    exec(compile(SCRIPT.read_text(), str(SCRIPT), "exec"), names)
    return names


def test_the_readme_says_what_is_checked(script):
    words = script["plain"]((ROOT / "README.md").read_text())
    for claim in script["CLAIMS"]:
        assert script["plain"](claim.quotation) in words
        assert claim.low <= claim.high


def test_every_number_of_the_readme_is_checked_or_given(script):
    text = re.sub(r"\]\([^)]*\)|https?://\S+", "]", (ROOT / "README.md").read_text())
    text = re.sub(r"```python.*?```", "", text.partition("## Tests")[0], flags=re.S)
    number = re.compile(r"(?<![\w.])-?\d(?:,?\d)*(?:\.\d+)?(?:e-?\d+)?")
    known = " ".join(one.quotation for one in script["CLAIMS"]) + " " + " ".join(script["GIVEN"])
    assert set(number.findall(text)) - set(number.findall(known)) == set()


def test_the_page_is_that_of_the_script(script):
    """After a change, `python benchmarks/verify_readme.py --page` writes it anew."""
    assert script["PAGE"].read_text() == script["page"]()


def test_numbers_are_found_in_what_programs_print(script):
    run = script["Run"]
    printed = (
        "walker_jax, 1e-11      0.016 3,159,884      1 (1-1)\n"
        "scipy, one core  84.3   593   5,350 (3,920-8,340)"
    )
    assert script["found"](r"^walker_jax, 1e-11 +([\d.]+)")(run(printed, 1.0)) == 0.016
    assert script["found"](r"^scipy.*?([\d,.]+) \(")(run(printed, 1.0)) == 5350
    table = "| strides | 50000 | 18000 |\n| largest error | 1.8e-10 | 5.3e-12 |"
    assert script["numbers_of"](run(table, 1.0), "strides") == [50000, 18000]

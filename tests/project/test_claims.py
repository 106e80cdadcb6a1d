"""Every claim of the pages has words, a command, a number within bounds, and a test."""

import re
from typing import Any

import numpy as np
import pytest
from reference import ROOT

import walker_jax as wj

SCRIPT = ROOT / "benchmarks" / "verify_readme.py"
PAGE = ROOT / "docs" / "claims.md"
PRINTED = {
    "python benchmarks/cell_mapping.py": {"| 1600 x 1600 | 0.0214 % |": 0.0214, "at 0.0185": 1.314},
    "python benchmarks/wada.py": {"Not the whole boundary": 0.0},
    "python benchmarks/disturbances.py": {"At nine slopes": 9},
    "python benchmarks/accuracy.py": {"| slope, period 1 to 2": 0.015088437941117},
}
"""Numbers of some claims, in what the headers of these scripts show of what they print."""


@pytest.fixture(scope="module")
def script() -> dict[str, Any]:
    names: dict[str, Any] = {"__name__": "verify_readme", "__file__": str(SCRIPT)}
    exec(compile(SCRIPT.read_text(), str(SCRIPT), "exec"), names)
    return names


@pytest.fixture(scope="module")
def claims(script):
    return script["read_claims"]()


def test_pages_say_what_is_checked(script, claims):
    assert len(claims) > 20
    for claim in claims:
        assert script["is_said"](claim), claim.quotation
        assert claim.low <= claim.high


def test_a_claim_that_is_not_said_any_more_is_marked(script, claims):
    assert not script["is_said"](claims[0]._replace(quotation="every start within 0.0022561"))


def test_the_page_has_the_tables_of_the_script(script):
    """After a change, `python benchmarks/verify_readme.py --page` writes them anew."""
    text = PAGE.read_text()
    assert script["with_tables"](text) == text
    emptied = re.sub(r"(<!-- \w+ -->\n).*?(<!-- end)", r"\1\2", text, flags=re.S)
    assert len(emptied) < len(text) / 2 and script["with_tables"](emptied) == text
    assert text.index("walks for ever") < text.index("<!-- measured -->")


def test_scripts_and_tests_of_claims_are_there():
    """And each of these tests may fail: it is a function of its file."""
    text = PAGE.read_text()
    tests = re.findall(r"`(tests/[\w/]+\.py)(?:::(\w+))?`", text)
    assert len(tests) > 40
    for file, name in tests:
        source = (ROOT / file).read_text()
        assert not name or f"\ndef {name}(" in source, name
    for file in re.findall(r"benchmarks/\w+(?:/\w+)?\.py", text):
        assert (ROOT / file).is_file(), file


def test_commands_name_tests_that_pytest_finds(claims):
    """`-k` of a command chooses the test that its claim names."""
    for claim in claims:
        if claim.command.startswith("pytest"):
            (words,) = re.findall(r"-k (\w+)", claim.command)
            assert words in claim.test, claim.quotation


def test_numbers_are_found_in_what_scripts_print(script, claims):
    found = 0
    for claim in claims:
        for words, number in PRINTED.get(claim.command, {}).items():
            if claim.quotation.startswith(words):
                path = ROOT / claim.command.split()[1]
                printed = path.read_text().partition('"""')[2].partition('"""')[0]
                assert claim.number(script["Run"](printed, 1.0)) == number, claim.quotation
                assert claim.low <= number <= claim.high
                found += 1
    assert found == sum(map(len, PRINTED.values()))


def test_what_is_not_printed_is_not_a_number(script, claims):
    """But a count of what must not be there is zero of nothing, so its command must not fail."""
    for claim in claims:
        assert np.isnan(script["measure"](claim, None))
        number = claim.number(script["Run"]("nothing of it", 1.0))
        assert np.isnan(number) or number == 0


def test_a_spring_makes_the_basin_75_times_as_large():
    """Cells of a coarse grid, against the area without a spring by 6400 x 6400 cells."""
    grid = wj.Grid.sheared(theta=(0, float(np.pi / 4), 150), sum=(-1, 0.3, 200))
    data = wj.basin(wj.SpringWalker(0.004, 11.24), grid, "direct")
    area = float((data.attractor >= 0).mean()) * np.pi / 4 * 1.3
    assert area / 0.0016744 == pytest.approx(75.5, abs=1.5)

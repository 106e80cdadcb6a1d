"""Every number of the README has the command that makes it, and the page says so."""

import json
import re
from typing import Any

import numpy as np
import pytest
from reference import ROOT

SCRIPT = ROOT / "benchmarks" / "verify_readme.py"
ANSWERS = ROOT / "benchmarks" / "answers.py"


TABLE = """
walker_jax, 1e-11                   0.016 3,159,884             1 (1-1)      0.7   3e-09     0
heyoka, batches of 16, 1e-11        0.159   315,047    10.7 (7.18-10.9)      0.2   3e-09     0
vmap(diffeqsolve), Dopri8, 1e-12    6.996     7,147       430 (383-592)      5.2   5e-09     8
the same, batches of 1000           3.075    16,261       192 (143-221)      5.2   5e-09     9
scipy, DOP853, 1e-11, one core     84.312       593   5,350 (3,920-8,340)      0.0   3e-10     1
simplest    float64  stride      0.1 | 14.3  11,428,371 | 28,546,657     2.5
simplest    float64  kernel      1.3 |  1.5   11,702,312 | 363,658,307    31.1
simplest    float32  kernel      0.6 |  0.7 46,061,739 | 1,497,747,471    32.5
round feet  float64  kernel      2.1 |  2.2     2,686,702 | 85,593,841    31.9
knees       float64  kernel      8.7 |  8.3     1,557,021 | 24,754,402    15.9
"""
"""Rows as benchmarks/strides.py and benchmarks/gpu.py print them."""


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


def test_the_script_takes_the_half_hour_that_it_says(script):
    seconds = {one.command: one.seconds for one in script["CLAIMS"] if one.command != script["GPU"]}
    assert 25 < sum(seconds.values()) / 60 < 35
    assert "half an hour" in script["__doc__"]
    assert "README quotes: half an hour" in (ROOT / "noxfile.py").read_text()


def test_what_a_command_does_not_print_is_marked(script, capsys):
    for claim in script["CLAIMS"][1:]:  # the first is a time
        for run in (None, script["Run"]("", 1.0), script["Run"]("{}", 1.0)):
            assert np.isnan(script["measure"](claim, run))
    answer = {"points": [{"total_area": 0}, {"total_area": 1}], "slopes": [], "lost": None}
    for claim in script["CLAIMS"]:
        if claim.command.endswith("--json"):
            assert np.isnan(script["measure"](claim, script["Run"](json.dumps(answer), 1.0)))
    assert "JSONDecodeError: " in capsys.readouterr().err


def test_numbers_are_found_in_what_programs_print(script):
    run = script["Run"]
    printed = (
        "walker_jax, 1e-11      0.016 3,159,884      1 (1-1)\n"
        "scipy, one core  84.3   593   5,350 (3,920-8,340)"
    )
    assert script["found"](r"^walker_jax, 1e-11 +([\d.]+)")(run(printed, 1.0)) == 0.016
    assert script["found"](r"^scipy.*?([\d,.]+) \(")(run(printed, 1.0)) == 5350
    ours = (script["STRIDES"], script["GPU"])
    claims = [one for one in script["CLAIMS"] if one.command in ours]
    numbers = [one.number(run(TABLE, 1.0)) for one in claims]
    assert numbers[:9] == [0.016, 0.159, 10.7, 3.075, 192, 6.996, 430, 84.312, 5350]
    assert numbers[-6:] == [363_658_307, 1_497_747_471, 31.1, 32.5, 15.9, 31.9]
    agree = [one.low <= number <= one.high for one, number in zip(claims, numbers, strict=True)]
    assert agree.count(False) == 1  # the basin, of which there is no row
    table = "| strides | 50000 | 18000 |\n| largest error | 1.8e-10 | 5.3e-12 |"
    assert script["numbers_of"](run(table, 1.0), "strides") == [50000, 18000]


def test_a_failure_of_this_checkout_ends_a_comparison(tmp_path):
    names: dict[str, Any] = {"__name__": "answers", "__file__": str(ANSWERS)}
    exec(compile(ANSWERS.read_text(), str(ANSWERS), "exec"), names)
    names["PROGRAM"] = "raise SystemExit('it is broken')"
    unknown = names["measure"](tmp_path, "import", tmp_path)
    assert np.isnan(unknown).all() and len(unknown) == 2
    with pytest.raises(RuntimeError, match="this checkout fails at import:\nit is broken"):
        names["measure"](ROOT, "import", tmp_path)

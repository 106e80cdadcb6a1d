"""Is every number that the README and the pages of docs/ claim still what its command gives?

    python benchmarks/verify_readme.py            # all, an hour and a half
    python benchmarks/verify_readme.py --readme   # those of the README alone, half an hour
    python benchmarks/verify_readme.py --quick    # without the slow ones
    python benchmarks/verify_readme.py --only 75  # numbers whose quotation contains this
    python benchmarks/verify_readme.py --gpu      # and those of a GPU, on a machine that has one
    python benchmarks/verify_readme.py --page     # writes docs/numbers.md and the tables of
                                                  # docs/claims.md anew, and ends

Claims of the README stand below, those of docs/ in claims.toml. Each command runs once, and its
output is searched for the number. Numbers that differ or are missing are marked, and the exit code
is then 1. Times are of another machine: they may be three times as long here.
"""

import argparse
import json
import re
import shlex
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

ROOT = Path(__file__).resolve().parent.parent
README = ROOT / "README.md"
PAGE = ROOT / "docs" / "numbers.md"
CLAIMS_PAGE = ROOT / "docs" / "claims.md"
SLOW_SECONDS = 180
"""Commands that take longer are left out by --quick."""
TIMES = 3.0
"""Factor by which a time, or a ratio of times, may differ on another machine."""


class Run(NamedTuple):
    """What a command printed, and how long it took."""

    out: str
    seconds: float

    @property
    def answer(self) -> dict[str, Any]:
        return json.loads(self.out)


class Claim(NamedTuple):
    """A number of a page, and where it comes from."""

    quotation: str
    """The page's own words."""
    command: str
    seconds: int
    """How long the command takes, about."""
    number: Callable[[Run], float]
    """The number, from what the command printed or left."""
    low: float
    high: float
    """Between which the number must be."""
    page: str = "README.md"
    test: str = ""
    """The test of it, where it is not that of its command in `TESTS`."""
    proved: bool = False
    """Whether the claim is a theorem."""


def within(value: float, factor: float) -> tuple[float, float]:
    """The range of a time."""
    return value / factor, value * factor


def found(pattern: str, last: bool = False) -> Callable[[Run], float]:
    """The number that a pattern finds in what a command prints."""

    def number(run: Run) -> float:
        hits = re.findall(pattern, run.out, re.M)
        return float(str(hits[-1 if last else 0]).replace(",", "")) if hits else float("nan")

    return number


def times_found(pattern: str) -> Callable[[Run], float]:
    """How often a pattern is found in what a command prints."""
    return lambda run: float(len(re.findall(pattern, run.out, re.M)))


def area_ratio(run: Run) -> float:
    areas = [point["total_area"] for point in run.answer["points"]]
    return areas[-1] / areas[0]


def slope_of_least_multiplier(run: Run) -> float:
    return min(run.answer["points"], key=lambda point: point["multiplier"])["slope"]


def slope_of_largest_shock(run: Run) -> float:
    rows = run.answer["slopes"]
    return max(rows, key=lambda row: row["least_disturbance"]["size"])["slope"]


def compared(
    quotation: str, row: str, seconds: float, low: float, high: float
) -> tuple[Claim, Claim]:
    """A row of the table of speeds: its seconds, and how many times as long it takes."""
    columns = rf"^{row}.*? ([\d.]+) +[\d,]+ +[\d,.]+ \("
    return (
        Claim(quotation, STRIDES, 540, found(columns), *within(seconds, TIMES)),
        Claim(quotation, STRIDES, 540, found(rf"^{row}.*?([\d,.]+) \("), low, high),
    )


SPRING = (
    "walker-jax sweep --walker spring --slope 0.004 --over hip-stiffness=0:11.24:2 --levels 4 "
    "--out spring.zarr --json"
)
MULTIPLIERS = (
    "walker-jax sweep --over slope=0.0134:0.0142:9 --theta 0 0.4 20 --sum -0.04 0.01 20 "
    "--levels 0 --check 0 --out multipliers.zarr --json"
)
BIFURCATION = "walker-jax bifurcation --from 0.001 --to 0.022 --json"
SHOCKS = (
    "walker-jax robustness --from 0.0074 --to 0.008 --count 7 --levels 1 --out shocks.zarr --json"
)
REPRODUCE = "walker-jax reproduce --out report"
STRIDES = "python benchmarks/strides.py"
ACCURACY = "python benchmarks/accuracy.py"
REFINEMENT = "python benchmarks/refinement.py"
GPU = "python benchmarks/gpu.py --without-xla"
"""What takes an NVIDIA GPU."""
GPU_ROW = r"^{} +{} +kernel .*\| +"
HEYOKA = "heyoka, batches of 16 or 32, a process for each core"
CLAIMS = [
    Claim("about five seconds", "walker-jax basin", 5, lambda run: run.seconds, 0, 5 * TIMES),
    Claim("makes the basin 75 times as large", SPRING, 120, area_ratio, 74.5, 76),
    Claim(
        *("falls until a slope of 0.0138", MULTIPLIERS, 60, slope_of_least_multiplier),
        *(0.01375, 0.01385),
    ),
    Claim("is greatest at 0.0077", SHOCKS, 300, slope_of_largest_shock, 0.00765, 0.00785),
    Claim("48 of its 53 numbers", REPRODUCE, 400, found(r"^(\d+) of \d+ numbers"), 48, 48),
    Claim("48 of its 53 numbers", REPRODUCE, 400, found(r"^\d+ of (\d+) numbers"), 53, 53),
    Claim(
        *("between slopes of 0.01904 and 0.01905", BIFURCATION, 80),
        *(lambda run: run.answer["lost"]["below"], 0.019035, 0.01905),
    ),
    Claim(
        *("between slopes of 0.01904 and 0.01905", BIFURCATION, 80),
        *(lambda run: run.answer["lost"]["above"], 0.01904, 0.019055),
    ),
    Claim(
        *("| walker_jax | 0.016 | 1 |", STRIDES, 540),
        *(found(r"^walker_jax, 1e-11 +([\d.]+)"), *within(0.016, TIMES)),
    ),
    *compared(f"| {HEYOKA} | 0.15 | 10 (7 to 11) |", "heyoka, batches of 16", 0.15, 7, 11),
    *compared("| 3.1 | 190 (140 to 220) |", "the same, batches of 1000", 3.1, 140, 220),
    *compared("| 7.0 | 430 (380 to 590) |", r"vmap\(diffeqsolve\), Dopri8", 7.0, 380, 590),
    *compared("| 84 | 5,300 (3,900 to 8,300) |", "scipy", 84, 3900, 8300),
    Claim(
        *("A basin of a million cells, followed directly, takes one second", STRIDES, 540),
        *(found(r"^walker_jax, 1e-11 +([\d.]+)", last=True), *within(1, TIMES)),
    ),
    Claim(
        *("outcomes of 68,000 strides", ACCURACY, 120),
        *(lambda run: sum(numbers_of(run, "strides")), 68000, 68000),
    ),
    Claim(
        *("outcomes of 68,000 strides", ACCURACY, 120),
        *(lambda run: sum(numbers_of(run, "outcomes that differ")), 0, 0),
    ),
    Claim(
        *("median error 1.5e-14", ACCURACY, 120),
        *(lambda run: numbers_of(run, "median error of a next state")[0], 1e-14, 2e-14),
    ),
    Claim(
        *("largest 8e-10", ACCURACY, 120),
        *(lambda run: numbers_of(run, "largest error")[0], 1e-10, 1.6e-9),
    ),
    Claim(
        *("in a stride that amplifies errors 260,000 times", ACCURACY, 120),
        *(found(r"norm of the Jacobian \|\n.*\n\| 0\.004 .* ([\d.e+]+) \|$"), 7e4, 3e5),
    ),
    Claim(
        *("0.0016744 ± 4e-7", REFINEMENT, 300),
        *(found(r"^0\.004: refined ([\d.]+)"), 0.0016740, 0.0016748),
    ),
    Claim(
        *("the two differ by 0.4 standard errors", REFINEMENT, 300),
        *(found(r"^0\.004: .* apart by ([\d.]+)"), 0, 2),
    ),
    Claim(
        *("364 million a second in float64", GPU, 300),
        *(found(GPU_ROW.format("simplest", "float64") + r"([\d,]+)"), *within(364e6, TIMES)),
    ),
    Claim(
        *("1.5 billion in float32", GPU, 300),
        *(found(GPU_ROW.format("simplest", "float32") + r"([\d,]+)"), *within(1.5e9, TIMES)),
    ),
    Claim(
        *("over 30 times as many as the 16 cores", GPU, 300),
        *(found(GPU_ROW.format("simplest", "float64") + r"[\d,]+ +([\d.]+)"), *within(30, TIMES)),
    ),
    Claim(
        *("over 30 times as many as the 16 cores", GPU, 300),
        *(found(GPU_ROW.format("simplest", "float32") + r"[\d,]+ +([\d.]+)"), *within(30, TIMES)),
    ),
    Claim(
        *("16 to 32 times as many", GPU, 300),
        *(found(GPU_ROW.format("knees", "float64") + r"[\d,]+ +([\d.]+)"), *within(16, TIMES)),
    ),
    Claim(
        *("16 to 32 times as many", GPU, 300),
        *(found(GPU_ROW.format("round feet", "float64") + r"[\d,]+ +([\d.]+)"), *within(32, TIMES)),
    ),
]
"""Every number that a change of the code could change."""
TESTS = {
    SPRING: "tests/project/test_claims.py::test_a_spring_makes_the_basin_75_times_as_large",
    MULTIPLIERS: "tests/paper/test_paper.py::test_the_most_stable_gait_is_where_multipliers_meet",
    SHOCKS: "tests/stability/test_robustness.py::test_no_point_of_a_fine_polar_grid_is_nearer",
    REPRODUCE: "tests/paper/test_paper.py::test_the_numbers_that_differ_are_what_the_project_finds",
    BIFURCATION: "tests/gaits/test_bifurcations.py::test_walking_is_lost_between_two_slopes",
    ACCURACY: "tests/walking/test_stride.py::test_every_stride_of_the_reference_map",
    REFINEMENT: "tests/basins/test_refinement.py"
    "::test_the_area_is_that_of_a_finer_grid_within_its_error",
}
"""The tests of the README's claims, by command; times have none."""
GIVEN = {
    "2001": "the year of the paper, here and below",
    "21363": "the number of the paper",
    "3.11": "the oldest Python, of pyproject.toml",
    "64": "float64",
    "0.01, 1.2": "values of an example",
    "4": "of π/4, the largest angle of the section",
    "0.004": "the slope of the paper's basin",
    "0.022": "printed in the paper, where `walker-jax reproduce` compares it",
    "512, 50,000, 1e-8": "the conditions of the table of speeds",
    "16": "the cores beside the H100",
    "1e8": "a size of large runs",
    "40": "the digits of the reference values: tests/data/README.md",
    "6400": "the cells of the comparison in benchmarks/refinement.py",
    "2.0": "of the licence",
}
"""Numbers of the README that no command makes, and what they are."""


def read_claims() -> list[Claim]:
    """The claims of docs/, from claims.toml."""
    claims = []
    for one in tomllib.loads((ROOT / "benchmarks" / "claims.toml").read_text())["claim"]:
        number = (times_found if one.get("count") else found)(one["pattern"])
        place = f"docs/{one['page']}", one["test"], one.get("proved", False)
        bounds = one["low"], one["high"]
        claims.append(Claim(one["says"], one["command"], one["seconds"], number, *bounds, *place))
    return claims


def numbers_of(run: Run, quantity: str) -> list[float]:
    """The numbers of a row of a table in Markdown."""
    rows = re.findall(rf"^\| {quantity} \| (.+) \|$", run.out, re.M)
    return [float(cell.split()[0]) for cell in rows[0].split(" | ")] if rows else [float("nan")]


def measure(claim: Claim, run: Run | None) -> float:
    """The number of a claim; NaN where its command has failed, or what it printed lacks it."""
    if run is None:
        return float("nan")
    try:
        return claim.number(run)
    except (LookupError, TypeError, ValueError, ZeroDivisionError) as error:
        print(f"        {type(error).__name__}: {error}", file=sys.stderr)
        return float("nan")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help=f"commands below {SLOW_SECONDS} s")
    parser.add_argument("--only", default="", help="part of quotations")
    parser.add_argument("--gpu", action="store_true", help="those that take an NVIDIA GPU too")
    parser.add_argument("--readme", action="store_true", help="those of the README alone")
    parser.add_argument("--page", action="store_true", help="write the pages and end")
    arguments = parser.parse_args()
    if arguments.page:
        PAGE.write_text(page())
        CLAIMS_PAGE.write_text(with_tables(CLAIMS_PAGE.read_text()))
        return
    runs, wrong = {}, 0
    with tempfile.TemporaryDirectory() as folder:
        for claim in CLAIMS if arguments.readme else [*CLAIMS, *read_claims()]:
            left = arguments.quick and claim.seconds > SLOW_SECONDS
            left |= claim.command == GPU and not arguments.gpu
            if left or arguments.only not in claim.quotation:
                continue
            if claim.command not in runs:
                runs[claim.command] = run_command(claim.command, Path(folder))
            run = runs[claim.command]
            number = measure(claim, run)
            agrees = claim.low <= number <= claim.high and is_said(claim)
            wrong += not agrees
            mark = "ok     " if agrees else "DIFFERS"
            print(f"{mark} {claim.quotation}: {number:.6g}, by {claim.command}", flush=True)
    sys.exit(wrong > 0)


def run_command(command: str, folder: Path) -> Run | None:
    """Run a command in a folder; None where it fails, with the reason on standard error."""
    program, *arguments = shlex.split(command)
    place = folder
    if program == "python":
        arguments = [str(ROOT / arguments[0]), *arguments[1:]]
    elif program == "pytest":
        arguments, place = ["-m", "pytest", "-q", *arguments], ROOT
    else:
        arguments = ["-m", "walker_jax", *arguments]
    began = time.monotonic()
    done = subprocess.run(
        [sys.executable, *arguments], cwd=place, text=True, stdout=subprocess.PIPE, check=False
    )
    seconds = time.monotonic() - began
    print(f"        {command}: {seconds:.0f} s", file=sys.stderr, flush=True)
    return None if done.returncode else Run(done.stdout, seconds)


def plain(text: str) -> str:
    """Text without marks of emphasis, on one line."""
    return " ".join(text.replace("**", "").split())


def is_said(claim: Claim) -> bool:
    """Whether the page of a claim has its words."""
    return plain(claim.quotation) in plain((ROOT / claim.page).read_text())


def table(claims: list[Claim]) -> str:
    """A table of claims, with the tests that hold them."""
    rows = {}
    for one in claims:
        words = one.quotation.strip("| ").replace(" | ", "; ")
        digits = ".14g" if f"{one.low:g}" == f"{one.high:g}" and one.low < one.high else "g"
        bounds = f"{one.low:{digits}}" + (f" to {one.high:{digits}}" if one.low < one.high else "")
        test = one.test or TESTS.get(one.command, "")
        cells = one.page.removeprefix("docs/"), words, f"`{one.command}`", test and f"`{test}`"
        rows.setdefault(cells, []).append(bounds)
    lines = ["| page | claim | figure | command | test |", "|---|---|---|---|---|"]
    for (place, words, command, test), bounds in rows.items():
        link = f"[{place}]({'../' if place == 'README.md' else ''}{place})"
        test = test or "a time: none"
        lines.append(f"| {link} | {words} | {'; '.join(bounds)} | {command} | {test} |")
    return "\n".join(lines) + "\n"


def with_tables(text: str) -> str:
    """The page of claims with its tables of what is proved and of what is measured."""
    claims = [*CLAIMS, *read_claims()]
    for name, chosen in (
        ("proved", [one for one in claims if one.proved]),
        ("measured", [one for one in claims if not one.proved]),
    ):
        marks = f"<!-- {name} -->\n", f"<!-- end of {name} -->"
        before, _, rest = text.partition(marks[0])
        text = (
            before + marks[0] + "\n" + table(chosen) + "\n" + marks[1] + rest.partition(marks[1])[2]
        )
    return text


def page() -> str:
    """The page that lists every number with its command."""
    lines = [
        "# Numbers of the README",
        "",
        "The README quotes these numbers; each stands beside the command that makes it, and the",
        "range in which the check before a release accepts it. The script",
        "`python benchmarks/verify_readme.py` runs them all and marks what differs; with `--page`",
        "it writes this page. Seconds are those of two cores. With `--gpu`, on a machine with an",
        f"NVIDIA GPU, it checks those of `{GPU}` too.",
        "",
        "| the README says | accepted | command | seconds |",
        "|---|---|---|---:|",
    ]
    for claim in CLAIMS:
        accepted = (
            f"{claim.low:g} to {claim.high:g}" if claim.low < claim.high else f"{claim.low:g}"
        )
        quotation = claim.quotation.strip("| ").replace(" | ", "; ")
        lines.append(f"| {quotation} | {accepted} | `{claim.command}` | {claim.seconds} |")
    lines += ["", "These numbers no command makes:", "", "| number | what it is |", "|---|---|"]
    lines += [f"| {number} | {what} |" for number, what in GIVEN.items()]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main()

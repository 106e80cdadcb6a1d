"""Every number in the text and the table of Schwab and Wisse (2001), with ours.

The numbers are copied here from the paper once more, so that a slip in `walker_jax.paper` shows.
`python tests/paper/test_paper.py numbers.json`, with that file of a report, writes docs/paper.md.
"""

import json
import re
import shutil
import sys
from collections.abc import Iterable
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from matplotlib.figure import Figure

import walker_jax as wj
from walker_jax import storage
from walker_jax.paper import calculations, pictures, reproduction
from walker_jax.paper.numbers import Number, compare_numbers, compare_printed
from walker_jax.storage.schema import KINDS, check_dataset

PAGE = Path(__file__).parents[2] / "docs" / "paper.md"
TINY = calculations.Size(section=40, slopes=3, levels=None, strides=500, shifts=2)
FEW_SLOPES = 0.004, 0.012, 0.02
"""Of Figure 7, which has twice as many."""

TABLE_1 = """
1  0.2000  -0.2165  -0.01645
2  0.1788  -0.1917  -0.01290
3  0.1756  -0.1841  -0.00850
4  0.1878  -0.1888  -0.00100
5  0.1586  -0.1599  -0.00134
6  0.1459  -0.1488  -0.00295
7  0.1492  -0.1526  -0.00337
8  0.1539  -0.1569  -0.00302
9  0.1558  -0.1583  -0.00256
"""
FIXED_POINT = (0.1534, -0.1561, -0.00269)
OTHERS = {
    "θ of the cyclic motion": "0.1534",
    "θ̇ of the cyclic motion": "-0.1561",
    "u̇⁺, to -sin θ cos 2θ sin 2θ θ̇⁻": "1",
    "v̇⁺, to cos θ cos 2θ sin 2θ θ̇⁻": "1",
    "θ̇⁺, to cos²2θ θ̇⁻": "1",
    "φ̇⁺, to cos 2θ (cos 2θ - 1) θ̇⁻": "1",
    "ρ_x, to -sin θ sin 2θ θ̇⁻": "1",
    "ρ_y, to cos θ sin 2θ θ̇⁻": "1",
    "size of the impulse, to sin 2θ θ̇⁻": "1",
    "speed of the stance foot, to cos 2θ sin 2θ θ̇⁻": "1",
    "θ from which a heel strike turns the walker back, π/4": "0.7854",
    "Froude number at which the contact force vanishes, leg upright": "1",
    "θ + θ̇ on the boundary to B, at θ = 0.2: γ": "0.004",
    "inclination of that boundary, degrees": "-45",
    "slope up to which the gait is stable": "0.015",
    "the same, after Garcia and others (1998)": "0.0151",
    "cyclic solutions of period one": "one or two",
    "fate of (0.2, -0.23)": "F",
    "crossings of the basin along θ = 0.2": "at least 4",
    "slope at which the basin has vanished, on the paper's grid": "0.022",
    "slope at which the basin has vanished, followed directly": "0.022",
    "slope of the most stable gait": "0.012",
    "is the basin largest there?": "no",
}
DIFFER = {
    "ρ_x, to -sin θ sin 2θ θ̇⁻": "wrong sign",
    "cyclic solutions of period one": "slower ones",
    "slope at which the basin has vanished, on the paper's grid": "where cells lie",
    "slope at which the basin has vanished, followed directly": "No cells",
    "slope of the most stable gait": "meet on the real axis",
}
"""What does not come out, and a word of the reason that is given."""
LONGER = (
    "crossings of the basin along θ = 0.2",
    "slope at which the basin has vanished, on the paper's grid",
    "slope at which the basin has vanished, followed directly",
    "is the basin largest there?",
)
"""What is told more exactly by longer calculations than those of `TINY`."""


@pytest.fixture(scope="module")
def data():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(calculations, "ROW_SLOPES", FEW_SLOPES)
        return {name: compute(TINY) for name, compute in calculations.CALCULATIONS.items()}


@pytest.fixture(scope="module")
def numbers(data):
    return {number.what: number for number in compare_numbers(data)}


def test_table_1_comes_out_in_every_digit(numbers):
    for line in TABLE_1.split("\n")[1:-1]:
        step, *printed = line.split()
        for name, text in zip(("θ", "θ̇", "θ + θ̇"), printed, strict=True):
            number = numbers[f"step {step}, {name}"]
            places = len(text.partition(".")[2])
            assert number.printed == text and number.agrees
            assert abs(float(number.ours) - float(text)) < 0.501 * 10**-places


def test_table_1_is_that_of_the_strides():
    """The values by another way than the report's: one stride after the other."""
    walker, x = wj.SimplestWalker(0.004), np.array([0.2, -0.21645])
    for line in TABLE_1.split("\n")[1:-1]:
        _, theta, thetadot, total = map(float, line.split())
        assert x[0] == pytest.approx(theta, abs=0.501e-4)
        assert x[1] == pytest.approx(thetadot, abs=0.501e-4)
        assert x.sum() == pytest.approx(total, abs=0.501e-5)
        x = np.asarray(wj.stride(walker, x).state)


def test_the_fixed_point_comes_out_in_every_digit(numbers):
    for name, value in zip(("θ", "θ̇", "θ + θ̇"), FIXED_POINT, strict=True):
        number = numbers[f"fixed point, {name}"]
        assert float(number.printed) == value and number.agrees


@pytest.mark.parametrize("what", OTHERS)
def test_a_number_of_the_text(what, numbers):
    number = numbers[what]
    assert number.printed == OTHERS[what]
    assert number.agrees == (what not in DIFFER)
    if what in DIFFER:
        assert DIFFER[what] in number.why


def test_no_number_is_left_out(numbers):
    listed = {name for name in numbers if not re.match(r"step \d|fixed point", name)}
    assert listed == set(OTHERS)
    assert len(numbers) == 9 * 3 + 3 + len(OTHERS)


def test_the_page_has_every_number(numbers):
    page = PAGE.read_text().splitlines()
    computed = page_of(numbers.values()).splitlines()
    assert len(page) == len(computed)
    longer = lambda line: any(what in line for what in LONGER)
    for there, here in zip(page, computed, strict=True):
        assert there == here or (longer(there) and longer(here))


def page_of(numbers: Iterable[Number]) -> str:
    """The page of the documentation that lists all numbers."""
    numbers = [*numbers]
    agree = sum(number.agrees for number in numbers)
    of_table = [one for one in numbers if one.where == "Table 1"]
    others = [one for one in numbers if one.where != "Table 1"]
    assert all(one.agrees for one in of_table)
    lines = [
        "# Numbers of the paper",
        "",
        "Every number in the text and the table of Schwab and Wisse (2001), beside what this",
        "package finds. `walker-jax reproduce` computes them all, and the figures. Of "
        f"{len(numbers)}",
        f"numbers {agree} agree at the digits that are printed, among them all of Table 1:",
        "",
        "| | θ, paper | here | θ̇, paper | here | θ + θ̇, paper | here |",
        "|---|---:|---:|---:|---:|---:|---:|",
    ]
    for row in zip(*[iter(of_table)] * 3, strict=True):
        values = " | ".join(f"{one.printed} | {one.ours}" for one in row)
        lines.append(f"| {row[0].what.partition(',')[0]} | {values} |")
    lines += ["", "| where | what | paper | here | |", "|---|---|---:|---:|---|"]
    for one in others:
        mark = "" if one.agrees else "differs"
        lines.append(f"| {one.where} | {one.what} | {one.printed} | {one.ours} | {mark} |")
    lines += ["", "## Why some differ", ""]
    lines += [f"- {one.where}, {one.what}: {one.why}" for one in numbers if one.why]
    return "\n".join(lines) + "\n"


def test_the_numbers_that_differ_are_what_the_project_finds(numbers):
    vanished = "slope at which the basin has vanished"
    low, high = map(float, numbers[f"{vanished}, followed directly"].ours.split(" to "))
    assert 0.0190 < low < high < 0.0192  # 500 strides are not many there
    assert float(numbers["slope of the most stable gait"].ours) == pytest.approx(0.0138, abs=1e-4)
    assert "0.002 apart, 0.012 has" in numbers["slope of the most stable gait"].why
    assert float(numbers["ρ_x, to -sin θ sin 2θ θ̇⁻"].ours) == -1
    assert float(numbers[f"{vanished}, on the paper's grid"].ours) == 0.026
    why = numbers[f"{vanished}, on the paper's grid"].why
    low, high = map(float, re.findall(r"from (0\.\d+) to (0\.\d+) on", why)[0])
    assert low < 0.022 < high


def test_crossings_are_counted_where_a_line_enters_the_basin(data, numbers):
    """By runs of cells that walk, along starts at the angle of 0.2."""
    line = data["line"]
    fates = "".join("x" if number >= 0 else "." for number in line["attractor"].values.ravel())
    crossings = len(re.findall("x+", fates))
    assert int(numbers["crossings of the basin along θ = 0.2"].ours) == crossings >= 4
    assert float(line["theta"]) == pytest.approx(0.2)


def test_the_grid_is_that_of_the_paper():
    """About 200 x 250 points, 0.002 and 0.0002 apart."""
    grid = calculations.paper_grid()
    assert grid.shape == (200, 250)
    np.testing.assert_allclose(grid.spacing, [0.002, 0.0002], rtol=1e-12)
    half = np.asarray(calculations.paper_grid((0.5, 0.5)).lower) - np.asarray(grid.lower)
    np.testing.assert_allclose(half, [-0.001, 0.0001], rtol=1e-9)


def test_few_cells_walk_where_the_paper_sees_the_basin_vanish(data):
    """Cells in single figures, on the paper's own grid, from 0.0205 on."""
    cells = data["surviving_cells"].isel(shift=0)
    steep = cells["cells"].values[cells["slope"].values > 0.0205]
    assert 0 < steep.max() < 6


def test_the_most_stable_gait_is_where_multipliers_meet():
    """The modulus shrinks where they are a complex pair, and the larger one grows beyond that."""
    at = 0.0138
    for slope, complex_ in ((at - 1e-4, True), (at + 1e-4, False)):
        pair = wj.find_gait(wj.SimplestWalker(slope)).multipliers
        assert np.all(np.imag(pair) != 0) == complex_


@pytest.mark.parametrize(
    "name, kind",
    [
        *(("stride", "walk"), ("walk", "walk"), ("gaits", "bifurcation diagram")),
        *(("section", "basin"), ("cell_mapping", "basin"), ("direct_iteration", "basin")),
        *(("basins", "basins over slopes"), ("areas", "areas over slopes")),
    ],
)
def test_the_data_sets_are_of_the_kinds_that_pictures_draw(name, kind, data):
    check_dataset(data[name], kind)
    assert set(map(str, data[name].data_vars)) <= {*KINDS[kind].variables}


def test_every_figure_is_drawn_of_the_data(data, report):
    for figure in pictures.FIGURES:
        assert figure.title and figure.text and report.drawn[figure.number].axes
    assert [figure.number for figure in pictures.FIGURES] == list(range(1, 9))
    panels = [ax for ax in report.drawn[7].axes if ax.get_visible()]
    assert len(panels) == data["basins"].sizes["slope"] == len(FEW_SLOPES)
    areas = data["basins"]["area"].values
    assert np.all(np.diff(areas) < 0) and areas[-1] == 0


def test_letters_in_a_caption_are_on_the_picture(report):
    figure = pictures.FIGURES[1]
    (axes,) = report.drawn[2].axes
    shown = {text.get_text() for text in axes.texts}
    named = set(re.findall(r"\b[A-Z]\b", figure.text))
    assert named == {text for text in shown if re.fullmatch("[A-Z]", text)} == {"F", "B", "R"}
    below = [
        text.get_text()
        for legend in axes.artists + axes.get_children()
        for text in getattr(legend, "get_texts", list)()
    ]
    assert any("basin of attraction" in text for text in below)  # so it has no letter


def test_a_number_agrees_at_the_digits_that_are_printed():
    assert compare_printed("", "", "0.15", 0.1549999).agrees
    assert not compare_printed("", "", "0.15", 0.1550001).agrees
    assert compare_printed("", "", "0.150", 0.1502).ours == "0.150200"
    assert not compare_printed("", "", "0.150", 0.1506).agrees
    assert compare_printed("", "", "1", 1 - 1e-7, 6).ours == "1.000000"


def stopping(name, data, computed):
    """The parts of the tiny data, told as they are computed; the first time one is interrupted."""

    def part(one):
        def compute(size):
            computed.append(one)
            if one == name and computed.count(name) == 1:
                raise KeyboardInterrupt
            return data[one]

        return compute

    return {one: part(one) for one in data}


class Report(NamedTuple):
    """A report, and how it came about."""

    out: Path
    numbers: list[Number]
    computed: list[str]
    """The parts, as often as they are computed."""
    drawn: dict[int, Figure]


@pytest.fixture(scope="module")
def report(tmp_path_factory, data, numbers, few_dots):
    """A report of the tiny data, interrupted and begun again."""
    out, computed, drawn = tmp_path_factory.mktemp("reproduce") / "report", [], {}

    def draw(figure, data):
        drawn[figure.number] = figure.draw(data)
        return drawn[figure.number]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            "walker_jax.paper.reproduction.FIGURES",
            tuple(one._replace(draw=partial(draw, one)) for one in pictures.FIGURES),
        )
        patch.setattr(
            "walker_jax.paper.reproduction.CALCULATIONS", stopping("walk", data, computed)
        )
        patch.setattr(
            "walker_jax.paper.reproduction.compare_numbers", lambda data: [*numbers.values()]
        )
        with pytest.raises(KeyboardInterrupt) as interruption:
            reproduction.reproduce(out, quick=True)
        assert interruption.value.__notes__ == [f"run the same again to resume from {out}"]
        assert not (out / "report.html").exists()
        found = reproduction.reproduce(out, quick=True)
    return Report(out, found, computed, drawn)


def test_an_interrupted_report_goes_on_where_it_was(report):
    """Only the part that was interrupted is computed twice; parts are computed side by side."""
    assert sorted(report.computed) == sorted([*calculations.CALCULATIONS, "walk"])


def test_a_report_holds_everything(report):
    out, numbers, *_ = report
    for k in range(1, 9):
        for suffix in (".png", ".svg"):
            assert (out / f"figure-{k}{suffix}").stat().st_size > 5_000
    page = (out / "report.html").read_text()
    assert page.count("<img ") == 8 and "http" not in page
    assert all(number.ours in page for number in numbers)
    kept = json.loads((out / "numbers.json").read_text())
    assert kept["numbers"] == [number._asdict() for number in numbers]
    assert storage.load(out / "data" / "cell_mapping.zarr") is not None


def files_of(out):
    return {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}


def test_another_request_is_refused_and_changes_nothing(report):
    out, *_ = report
    before = files_of(out)
    with pytest.raises(storage.StoreConflict, match=r"stride\.zarr holds another result \(size "):
        reproduction.reproduce(out)
    assert files_of(out) == before


@pytest.mark.slow
def test_what_is_overwritten_begins_anew_and_may_go_on(
    report, data, numbers, monkeypatch, tmp_path
):
    """What is there goes first, so that the same command without --overwrite completes it."""
    out = tmp_path / "report"
    shutil.copytree(report[0], out)
    computed = []
    monkeypatch.setattr(
        "walker_jax.paper.reproduction.CALCULATIONS", stopping("gaits", data, computed)
    )
    monkeypatch.setattr(
        "walker_jax.paper.reproduction.compare_numbers", lambda data: [*numbers.values()]
    )
    with pytest.raises(KeyboardInterrupt):
        reproduction.reproduce(out, overwrite=True)
    reproduction.reproduce(out)
    assert sorted(computed) == sorted([*data, "gaits"])


def test_files_of_something_else_are_kept(tmp_path):
    (tmp_path / "letter.txt").write_text("dear")
    with pytest.raises(storage.StoreConflict, match="is not a folder"):
        reproduction.reproduce(tmp_path / "letter.txt", overwrite=True)
    with pytest.raises(ValueError, match="there is no folder"):
        reproduction.reproduce(tmp_path / "none" / "report")
    (tmp_path / "report.html").write_text("of the year")
    with pytest.raises(storage.StoreConflict, match=r"report\.html is something else"):
        reproduction.reproduce(tmp_path)
    assert (tmp_path / "report.html").read_text() == "of the year"
    assert not (tmp_path / "data").exists()


def test_an_empty_folder_will_do(tmp_path, data, numbers, monkeypatch):
    monkeypatch.setattr(
        "walker_jax.paper.reproduction.CALCULATIONS",
        {name: lambda _, name=name: data[name] for name in ("stride", "walk")},
    )
    monkeypatch.setattr(
        "walker_jax.paper.reproduction.compare_numbers", lambda data: [*numbers.values()]
    )
    monkeypatch.setattr("walker_jax.paper.reproduction.FIGURES", pictures.FIGURES[:1])
    reproduction.reproduce(tmp_path, quick=True)
    assert (tmp_path / "report.html").is_file()


@pytest.mark.slow
def test_the_quick_report_in_earnest(tmp_path):
    found = reproduction.reproduce(tmp_path / "report", quick=True)
    differ = {number.what for number in found if not number.agrees}
    assert differ == set(DIFFER)
    lost = next(n for n in found if n.what.endswith("followed directly"))
    assert lost.ours == "0.01904 to 0.01905"


if __name__ == "__main__":
    PAGE.write_text(
        page_of(Number(**one) for one in json.loads(Path(sys.argv[1]).read_text())["numbers"])
    )

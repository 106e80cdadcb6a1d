"""The programs in the pages run."""

import inspect
import re
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from jax import export
from reference import ROOT

import walker_jax as wj
from walker_jax import storage
from walker_jax.cli import answers, main
from walker_jax.storage.requests import canonical_json

PAGE = ROOT / "docs" / "write-your-own.md"
OWN_MAP, OWN_MACHINE = (ROOT / "docs" / f"{name}.md" for name in ("own-map", "own-machine"))


def programs(page):
    """The Python programs of a page."""
    return re.findall(r"```python\n(.*?)```", page.read_text(), re.S)


def program(title):
    """The Python program of the page that follows a comment."""
    (found,) = re.findall(rf"<!-- {title} -->\n```python\n(.*?)```", PAGE.read_text(), re.S)
    return found


def test_the_quickstart_gives_a_basin_and_a_derivative():
    sources = programs(ROOT / "docs" / "quickstart.md")
    basin, derivative = sources
    assert len(basin.splitlines()) <= 6
    assert programs(ROOT / "README.md")[0] == basin
    names: dict[str, Any] = {}
    for source in sources:
        exec(compile(source, "quickstart.md", "exec"), names)
    assert 3000 < int((names["basin"].attractor >= 0).sum()) < 3100
    many = wj.strides(names["walker"], names["starts"])
    np.testing.assert_allclose(names["ends"].state, many.state, rtol=1e-13)
    high, low = map(names["angle_after_ten_strides"], (0.004 + 1e-8, 0.004 - 1e-8))
    assert float(names["rate"]) == pytest.approx(float(high - low) / 2e-8, rel=1e-5)
    (printed,) = re.findall(r"^print\(.*rate.*\)  # (\S+)$", derivative, re.M)
    assert f"{names['rate']:.4f}" == printed


@pytest.mark.slow
def test_programs_for_devices_and_processes_give_strides():
    """Those that are exported call no kernel, and have derivatives."""
    names: dict[str, Any] = {}
    for source in programs(ROOT / "docs" / "large-runs.md")[-2:]:
        exec(compile(source, "large-runs.md", "exec"), names)
    xs, ends = names["xs"][:2], names["ends"]
    assert ends.state.sharding.is_equivalent_to(names["xs"].sharding, 2)
    exported = export.deserialize(names["saved"])
    assert "custom_call @walker_jax" in names["many"].lower(xs).as_text()
    assert "custom_call @walker_jax" not in exported.mlir_module() and exported.has_vjp()
    state, outcome, time = exported.call(xs)
    assert outcome.tolist() == [wj.Outcome.STRIDE] * 2
    np.testing.assert_allclose(state, ends.state[:2], rtol=1e-11)
    np.testing.assert_allclose(time, ends.time[:2], rtol=1e-11)


class Begun(BaseException):
    """A command has taken its places."""


@pytest.mark.parametrize("first", ["the first command", "the table"])
def test_commands_of_the_pages_run_after_each_other_in_a_folder(first, monkeypatch, tmp_path):
    """No two of them want one place for different results, and none what is not there."""
    beginning = (ROOT / "README.md").read_text() + (ROOT / "docs" / "quickstart.md").read_text()
    page = (ROOT / "docs" / "cli.md").read_text()
    _, table, rest = re.split(r"(^\| `walker-jax .*?\n\n)", page, flags=re.M | re.S)
    blocks = lambda text: re.findall(r"(?:^|&& )walker-jax ((?:[^#\n])*)", text, re.M)
    commands = blocks(beginning) if first == "the first command" else []
    commands += [*re.findall(r"^\| `(?!walker-jax)([a-z][^`]*)` \|", table, re.M), *blocks(rest)]
    assert len(commands) >= 14
    taken: dict[str, str] = {}

    def take(path, request):
        words = canonical_json(request)
        assert taken.setdefault(str(path), words) == words

    def begin(*_, **__):
        raise Begun

    def of_data(output, request):
        output.check()
        take(output.out, request)
        take(output.picture, request)
        raise Begun

    def of_report(out, **_):
        take(out, {"command": "reproduce"})
        raise Begun

    def of_export(data, file, **_):
        assert str(data) in taken
        take(file, {"data": str(data)})
        raise Begun

    monkeypatch.chdir(tmp_path)
    for name, source in re.findall(r"```python\n# (\w+\.py)\n(.*?)```", beginning, re.S):
        Path(name).write_text(source)  # the walker of one's own
    monkeypatch.setattr("walker_jax.cli.startup.keep_compiled", lambda: None)
    monkeypatch.setattr(answers.Output, "find", of_data)
    monkeypatch.setattr("walker_jax.paper.reproduction.reproduce", of_report)
    monkeypatch.setattr(storage, "export", of_export)
    monkeypatch.setattr(storage, "check_picture", lambda path, request, **_: take(path, request))
    monkeypatch.setattr("walker_jax.explorer.server.run_server", begin)
    monkeypatch.setattr(wj, "walk", begin)
    monkeypatch.setattr(wj, "read_recordings", begin)  # of a file that a reader has
    monkeypatch.setattr(wj, "most_probable_fall", begin)
    monkeypatch.setattr("walker_jax.gaits.selection.select_gaits", begin)
    for command in commands:
        monkeypatch.setattr(sys, "argv", ["walker-jax", *command.split()])
        with pytest.raises(Begun):
            main.main()


def test_links_within_the_pages_lead_somewhere():
    pages = [
        path
        for folder in (".", "docs", "notebooks", "benchmarks")
        for path in (ROOT / folder).glob("*.md")
    ]
    for page in pages:
        for target in re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", page.read_text()):
            if "://" not in target:
                assert (page.parent / target).exists(), (page.name, target)


def test_the_pages_name_no_function_that_is_not_public():
    for page in (
        *(ROOT / "docs").glob("*.md"),
        ROOT / "README.md",
        ROOT / "notebooks" / "README.md",
    ):
        names = set(re.findall(r"\bwj\.(\w+)\.?(\w*)", page.read_text()))
        modules = {name for name in dir(wj) if inspect.ismodule(getattr(wj, name))}
        assert {name for name, _ in names} <= {*wj.__all__, *modules}, page.name
        inner = {name: set(dir(getattr(wj, name))) for name in ("fractals", "systems", "figures")}
        assert all(two in inner.get(one, {two}) for one, two in names), page.name


SEARCHED = """
URDF, MJCF, MuJoCo, animation, neural network, reinforcement learning, export, Simulink, MATLAB,
limit cycle, domain of attraction, rough terrain, stairs, system identification, parameter
estimation, calibration, tutorial, getting started, GUI, API, HPC, Monte Carlo, optimization,
autodiff, event detection, hybrid automaton, PD control, license, cite, GPU, CSV, NetCDF, torque,
push-off, knee, quadruped, Lyapunov, Floquet, viability
"""


def test_search_finds_the_words_that_people_type():
    """The search of the site has the text of pages and the tags above it."""
    text = " ".join(" ".join(page.read_text().split()) for page in (ROOT / "docs").glob("*.md"))
    missing = [one for one in " ".join(SEARCHED.split()).split(", ") if one not in text]
    assert not missing


@pytest.mark.parametrize("address", ["", "https://example.org/walkers"])
def test_the_site_links_to_a_repository_from_one_variable(address):
    hook: dict[str, Any] = {}
    exec((ROOT / "docs" / "hooks" / "repository.py").read_text(), hook)
    config = hook["on_config"](SimpleNamespace(extra={"repository": address}, nav=[]))
    links = [{"Repository": address}, {"Issues": f"{address}/issues"}]
    assert config.nav == ([{"Source": links}] if address else [])
    assert '  repository: "' in (ROOT / "mkdocs.yml").read_text()


def test_every_public_function_is_in_a_table_or_the_glossary():
    text = "".join((ROOT / "docs" / name).read_text() for name in ("tasks.md", "glossary.md"))
    functions = {f"wj.{name}" for name in wj.__all__ if name[0].islower()}
    functions |= {f"wj.fractals.{name}" for name in wj.fractals.__all__}
    assert {name for name in functions if name not in text} == set()


def test_functions_are_few_enough_to_choose_from():
    assert len(wj.__all__) <= 95


def test_a_map_takes_ten_lines_and_a_runner_forty():
    lines = lambda source: [line for line in source.splitlines() if line.strip()]
    the_map, runner = lines(programs(OWN_MAP)[0]), lines(programs(OWN_MACHINE)[1])
    setup = 3  # imports of JAX, and its precision
    assert len(the_map) <= 12 + setup - 1
    assert len(runner) <= 40 + setup + 10  # six lines of assertions and docstrings


def test_a_walker_of_your_own_takes_less_than_60_lines():
    assert len(program("a walker of your own").splitlines()) < 60


def test_one_with_phases_takes_less_than_80_lines():
    assert len(program("phases of your own").splitlines()) < 80


@pytest.mark.slow
def test_one_with_phases_has_the_gait_of_the_walker_with_knees():
    names: dict[str, Any] = {"__name__": "own"}
    exec(compile(program("phases of your own"), PAGE.name, "exec"), names)
    assert 0.4 < names["knee_strike"] / names["heel_strike"] < 0.8


@pytest.mark.slow
def test_a_walker_of_your_own_has_a_gait_and_a_picture(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {"__name__": "own"}
    exec(compile(program("a walker of your own"), PAGE.name, "exec"), names)
    assert names["gait"].stable and np.abs(names["gait"].multipliers[0]) < 1
    assert int((names["data"].fate == 0).sum()) > 500
    assert (tmp_path / "shank.png").stat().st_size > 20_000


def test_the_page_of_the_command_line_lists_every_option():
    """It is made by the site's own hook, from the program."""
    hooks = ROOT / "docs" / "hooks" / "command_line.py"
    place: dict[str, Any] = {"__name__": "hooks"}
    exec(compile(hooks.read_text(), str(hooks), "exec"), place)
    page = place["on_page_markdown"](place["PLACE"], page=None, config=None, files=None)
    for option in ("--foot-radius", "--hip-stiffness", "--period-max", "--at-least", "--scheduler"):
        assert f"`{option}" in page or f"{option} " in page, option


WORDS = dict(enumerate("no one two three four five six seven eight nine ten eleven twelve".split()))
WORDS |= {13: "thirteen", 14: "fourteen"}


def measured(text):
    """A number and its error, as a table prints them; NaN for words."""
    value, _, error = text.partition(" ± ")
    try:
        return float(value), float(error or "nan")
    except ValueError:
        return np.nan, np.nan


def test_what_is_said_of_knees_and_feet_follows_from_the_table():
    page = (ROOT / "docs" / "results.md").read_text()
    plain = " ".join(page.split())
    lines = re.findall(r"^\| ((?:default|human-like) \|.*?) \|$", page, re.M)
    rows = {tuple((cells := line.split(" | "))[:3]): cells[3:] for line in lines}
    volumes = {key: tuple(map(measured, cells[:2])) for key, cells in rows.items()}
    known = {key: pair for key, pair in volumes.items() if np.isfinite(pair).all()}
    gain = {  # by knees, in standard errors of the difference
        key: (knees[0] - straight[0]) / np.hypot(knees[1], straight[1])
        for key, (straight, knees) in known.items()
    }
    smaller = [key for key, one in gain.items() if one < -2]
    clearly = [key for key in smaller if gain[key] < -6]
    (other,) = gain.keys() - set(smaller)
    (barely,) = set(smaller) - set(clearly)
    assert (other, barely) == (("default", "0.09", "points"), ("default", "0.08", "points"))
    readme = " ".join((ROOT / "README.md").read_text().split())
    assert f"{WORDS[len(smaller)]} of {WORDS[len(known)]} pairs" in readme
    said = f"Of the {WORDS[len(known)]} pairs in which both volumes are known, "
    said += f"{WORDS[len(smaller)]} are smaller with knees: {WORDS[len(clearly)]} by six"
    assert said in plain and f"0.08 by {-gain[barely]:.1f}. " in plain
    finely = re.findall(r"([\d.]+ ± [\d.]+) with knees against ([\d.]+ ± [\d.]+)", plain)
    ratios = []
    for (knees, straight), key in zip(finely, (barely, other), strict=True):
        pair = measured(straight), measured(knees)
        for (fine, _), (coarse, error) in zip(pair, known[key], strict=True):
            assert abs(fine - coarse) < 3 * error
        assert abs(pair[1][0] - pair[0][0]) > 10 * np.hypot(pair[0][1], pair[1][1])
        ratios.append(pair[1][0] / pair[0][0])
    assert ratios[0] < 1 and f"which is {ratios[1] - 1:.0%} more".replace("%", " %") in plain
    assert f"it is {WORDS[round(100 * ratios[1]) - 100]} per cent larger" in readme
    taken = lambda *key: f"{1 - known[key][1][0] / known[key][0][0]:.0%}".replace("%", " %")
    human = [taken("human-like", slope, "points") for slope in ("0.04", "0.06")]
    assert f"masses {human[0]} at 0.04 and {human[1]} at 0.06" in plain
    round_feet = {
        (masses, legs): [
            volumes[masses, slope, "round"][legs][0] / volumes[masses, slope, "points"][legs][0]
            for slope in dict.fromkeys(key[1] for key in rows if key[0] == masses)
        ]
        for masses in ("default", "human-like")
        for legs in (0, 1)
    }
    spans = {key: (np.nanmin(ratio), np.nanmax(ratio)) for key, ratio in round_feet.items()}
    assert min(low for low, _ in spans.values()) > 1.3
    words = {key: tuple(f"{end:.1f}" for end in span) for key, span in spans.items()}
    assert "{} to {} times for straight legs, ".format(*words["default", 0]) in plain
    assert "{} times (0.05) to {} times (0.09) for knees".format(*words["default", 1]) in plain
    human = (*words["human-like", 0], *words["human-like", 1])
    assert "{} and {} times for straight legs, {} and {} times for knees".format(*human) in plain
    lost = [key for key in rows if "no gait" in rows[key]]
    assert (
        lost == [("human-like", "0.04", "round")] and "one kneed walker has none on round" in readme
    )

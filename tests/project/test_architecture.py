"""The package is laid out as docs/architecture.md says."""

import ast
import graphlib
import inspect
import re
from functools import cache
from pathlib import Path

import pytest
from reference import ROOT
from test_shape_checks import ROOMS

import walker_jax as wj

PACKAGE = ROOT / "walker_jax"
PAGE = (ROOT / "docs" / "architecture.md").read_text()
MOST, MOST_OF_TESTS = 400, 600
"""Lines that a file has at most."""

OUTSIDE = PACKAGE / "__init__.py", PACKAGE / "__main__.py"
PATHS = sorted(path for path in PACKAGE.rglob("*.py") if path not in OUTSIDE)


def name_of(path: Path) -> str:
    """The module in a file."""
    name = ".".join(path.relative_to(ROOT).with_suffix("").parts)
    return name.removesuffix(".__init__")


def room_of(module: str) -> str:
    """Its folder or file; `python -m walker_jax` is part of the command line."""
    room = module.split(".")[1]
    return "cli" if room == "__main__" else room


MODULES = {name_of(path): path for path in PATHS}


def imported(path: Path) -> set[str]:
    """The modules of the package that a file imports, anywhere in it."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {one.name for one in node.names}
        if isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path.name} has a relative import"
            parent = node.module or ""
            inner = {f"{parent}.{one.name}" for one in node.names}
            found |= {one if one in MODULES else parent for one in inner}
    return {one for one in found if one in MODULES}


@cache
def all_imports() -> dict[str, set[str]]:
    """The modules that each module imports."""
    return {name: imported(path) for name, path in MODULES.items()}


def rooms_of_the_page() -> list[str]:
    """From top to bottom."""
    (picture,) = re.findall(r"<!-- the rooms -->\n```text\n(.*?)```", PAGE, re.S)
    return re.findall(r"^ *(\w+) {2,}\S", picture, re.M)


def test_the_page_lists_every_room():
    rooms = rooms_of_the_page()
    assert len(rooms) > 10 and len(set(rooms)) == len(rooms)
    assert set(rooms) == set(map(room_of, MODULES))


def test_imports_lead_down_the_rooms():
    rooms = rooms_of_the_page()
    rank = {room: i for i, room in enumerate(rooms)}
    checked = [
        (name, other)
        for name, others in all_imports().items()
        for other in others
        if room_of(name) != room_of(other)
    ]
    assert len(checked) > 100
    up = [pair for pair in checked if rank[room_of(pair[0])] > rank[room_of(pair[1])]]
    assert not up


def test_no_files_import_each_other():
    # A room's __init__.py collects names of its files, so a file may not import its own room.
    try:
        graphlib.TopologicalSorter(all_imports()).prepare()
    except graphlib.CycleError as error:
        pytest.fail(" -> ".join(error.args[1]))


def test_tests_stand_in_the_folders_of_their_rooms():
    """Those in `project` are of the whole: its pages, messages and versions."""
    folders = {one.name for one in (ROOT / "tests").iterdir() if any(one.glob("test_*.py"))}
    assert folders - set(rooms_of_the_page()) == {"project"}
    assert not list((ROOT / "tests").glob("test_*.py"))


def test_no_room_has_the_name_of_a_public_function():
    """Or `import walker_jax.basin` would be a function, or a module, by what was imported first."""
    functions = {
        name for name in wj.__all__ if inspect.isfunction(inspect.unwrap(getattr(wj, name)))
    }
    assert {"stride", "basin", "find_gait"} <= functions
    assert not functions & set(map(room_of, MODULES))


def test_files_are_short():
    lines = {path.name: len(path.read_text().splitlines()) for path in PATHS}
    assert {name for name, count in lines.items() if count > MOST} == set()


def test_docstrings_begin_with_their_subject():
    """A noun or a verb: a sentence that begins with a relative clause is read twice."""
    kinds = (ast.Module, ast.ClassDef, ast.FunctionDef)
    described = [
        (name, found)
        for name, path in MODULES.items()
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, kinds) and (found := ast.get_docstring(node))
    ]
    assert len(described) > 1000
    unclear = r"(What|Which|Whose|Of|That|Those)\b"
    assert [one for one in described if re.match(unclear, one[1])] == []


def test_files_of_tests_and_names_of_tests_are_short():
    texts = {path: path.read_text() for path in (ROOT / "tests").rglob("*.py")}
    assert {path for path, text in texts.items() if text.count("\n") > MOST_OF_TESTS} == set()
    names = re.findall(r"^(?:async )?def (test_\w+)", "\n".join(texts.values()), re.M)
    assert len(names) > 1000
    assert {name for name in names if len(name) >= 60} == set()


def test_signatures_are_checked_in_every_room_with_shapes(pytestconfig):
    """In the others it takes a tenth of all processor time, and would look at a type or two."""
    hardly = {"cli", "execution", "identity", "integrators", "kernels", "lazy_names", "paper"}
    hardly |= {"fingerprints", "origins", "proofs", "refusals", "state_of_objects", "storage"}
    hardly |= {*ROOMS}  # checked in a process of their own
    option = pytestconfig.getoption("--jaxtyping-packages")
    checked = {name.removeprefix("walker_jax.") for name in option.split(",")[:-1]}
    assert checked == {room_of(module) for module in MODULES} - hardly


def test_only_the_command_line_imports_the_package_itself():
    """Its public names are of all rooms, and lead up from most of them."""
    own = re.compile(r"^\s*(import walker_jax\b(?!\.)|from walker_jax import \w*[A-Z])", re.M)
    users = {room_of(name) for name, path in MODULES.items() if own.search(path.read_text())}
    assert users <= {"cli"}

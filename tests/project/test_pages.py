"""What the pages print runs, and comes out as printed: `benchmarks/pages.py`."""

import contextlib
import importlib.util
import io
import sys
from types import ModuleType

import jax
import pytest
from reference import ROOT


def load() -> ModuleType:
    path = ROOT / "benchmarks" / "pages.py"
    spec = importlib.util.spec_from_file_location("pages", path)
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    sys.modules["pages"] = module
    spec.loader.exec_module(module)
    return module


pages = load()
ALL = {
    page.stem if page.parent != ROOT / "notebooks" else "notebooks": page
    for page in pages.find_pages([])
}
QUICK = "own-map"
"""A page whose programs run in a few seconds."""

MADE_UP = """# A page

<!-- not run: it fails -->
```python
1 / 0
```

```python
# three.py
x = 3
print(x / 7, "of", 10**6 / 3)  # 0.43 of 333,333.3
```

Two commands, and `walker-jax-of-another-name`:

```console
$ grep {word} three.py  # a comment
```

```text
x = 3
```

```python
print({last})  # 4
```
"""


@pytest.mark.parametrize(
    ("word", "last", "wrong"),
    [
        ("x", "x + 1", []),
        ("x", "x", ["page.md:25 3 for 4"]),
        ("x", "'four'", ["page.md:25 printed 'four'"]),
        ("x", "y", ["page.md:25 NameError: name 'y' is not defined"]),
        ("nothing", "4", ["page.md:17 exit code 1: "]),
    ],
)
def test_a_page_that_prints_something_else_is_found(word, last, wrong, tmp_path, monkeypatch):
    page = tmp_path / "page.md"
    page.write_text(MADE_UP.replace("{word}", word).replace("{last}", last))
    monkeypatch.setitem(pages.FILES, "three.py", "x = 3\n")
    monkeypatch.setattr(pages, "LONG", 100.0)
    assert pages.run_page(page) == wrong


@pytest.mark.parametrize(
    ("printed", "given", "same"),
    [
        ("-0.7298", "-0.72984999", True),
        ("-0.7298", "-0.7299", False),
        ("1,045", "1045.4", True),
        ("5.1368e-07", "5.13686e-07", False),  # noise is below 1e-9
        ("5.1368e-03", "5.13684e-03", True),
        ("4.9e-15", "-1e-13", True),
        ("4.9e-15", "1e-3", False),
    ],
)
def test_numbers_are_compared_to_their_printed_digits(printed, given, same):
    assert pages.same_number(printed, given) == same


def test_a_page_tells_how_long_its_blocks_take():
    block = "\n\n```python\nx\n```\n\n"
    text = f"Words.{block}It takes ten seconds.{block}More.{block}"
    told = [pages.tells_time(text, one.start(), one.end()) for one in pages.FENCE.finditer(text)]
    assert told == [True, True, False]
    assert pages.tells_time(text + "\nBlocks on this page take a minute.", len(text) - 5, len(text))


def test_commands_are_found_in_blocks_tables_and_text():
    found = [block for page in ALL.values() for block in pages.read_blocks(page)]
    commands = {block.source for block in found if block.kind == "command"}
    assert len(commands) >= 45 and sum(block.kind == "python" for block in found) >= 55
    for one in ("walker-jax basin", "walker-jax gait --slope 0.009", "walker-jax reproduce"):
        assert one in commands
    assert all(one.startswith(("walker-jax ", "dask ")) for one in commands)
    left_out = [block.source for block in found if block.kind == "not run"]
    assert len(left_out) <= 9


def test_programs_of_a_quick_page_run_as_printed(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names = {"__name__": "page"}
    programs = [block for block in pages.read_blocks(ALL[QUICK]) if block.kind == "python"]
    assert programs
    for block in programs:
        printed = io.StringIO()
        with jax.numpy_dtype_promotion("standard"), contextlib.redirect_stdout(printed):
            exec(compile(block.source, f"{QUICK}.md", "exec"), names)
        assert block.difference(printed.getvalue()) is None


@pytest.mark.slow
@pytest.mark.parametrize("name", ALL)
def test_a_page_runs_as_printed(name):
    """From an empty folder, each command and the programs of a page in processes of their own."""
    wrong = pages.run_page(ALL[name])
    assert [one for one in wrong if "takes long" not in one] == []

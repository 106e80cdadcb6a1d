"""The line that says what a run of the tests waits for."""

from types import SimpleNamespace

from waiting import Waiting


def test_a_run_names_the_tests_it_waits_for(monkeypatch):
    lines: list[str] = []
    waiting = Waiting(SimpleNamespace(write_line=lines.append))
    for name in ("a", "b"):
        waiting.pytest_runtest_logstart(name)
    waiting.tell()
    assert not lines, "it is too early"
    monkeypatch.setattr("waiting.PATIENCE", 0.0)
    waiting.tell()
    waiting.pytest_runtest_logfinish("a")
    waiting.tell()
    waiting.pytest_runtest_logfinish("b")
    waiting.tell()
    assert lines == ["\nwaiting for a, b", "\nwaiting for b"]

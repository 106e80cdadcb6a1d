"""Fixtures of more than one file."""

import sys

import pytest

from walker_jax.cli import main


@pytest.fixture
def run(monkeypatch, capsys, tmp_path, few_dots):
    """Run a command in an empty folder; returns exit code, standard output and error."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("walker_jax.cli.startup.keep_compiled", lambda: None)

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["walker-jax", *map(str, arguments)])
        with pytest.raises(SystemExit) as stop:
            main.main()
        return (stop.value.code, *capsys.readouterr())

    return run

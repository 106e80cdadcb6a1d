"""Commands in poor surroundings: no home, no device, a notebook's settings, no working folder."""

import os
import pwd
import subprocess
import sys
import sysconfig
from pathlib import Path

import jax
import pytest
from command_lines import SMALL

from walker_jax.kernels.object_cache import VARIABLE, cache_folder
from walker_jax.refusals import WrongPlace
from walker_jax.storage import check_writable

COMMAND = "import sys; from walker_jax.cli.main import main; sys.argv[0] = 'walker-jax'; main()"


def run(*arguments, before="", without=(), cwd=None, **settings):
    """Run a command after some lines of Python; returns exit code, standard output and error."""
    kept = {name: value for name, value in os.environ.items() if name not in without}
    program = f"{before}\n{COMMAND}"
    done = subprocess.run(
        [sys.executable, "-c", program, *arguments],
        capture_output=True,
        text=True,
        env=kept | settings,
        cwd=cwd,
    )
    return done.returncode, done.stdout, done.stderr


HOMELESS = {"HOME", "XDG_CACHE_HOME", VARIABLE, "JAX_COMPILATION_CACHE_DIR"}


def nameless(uid):
    raise KeyError(uid)


def test_a_user_without_a_home_has_no_folder_of_programs(monkeypatch):
    for name in HOMELESS:
        monkeypatch.delenv(name, raising=False)
    assert cache_folder() is not None
    monkeypatch.setattr(pwd, "getpwuid", nameless)
    assert cache_folder() is None


def test_a_command_runs_for_a_user_without_a_home():
    """A container's number of a user, of whom the system knows neither name nor home."""
    nobody = "import pwd\ndef nameless(uid): raise KeyError(uid)\npwd.getpwuid = nameless"
    walk = "walk --system henon --start x=0.5 --start y=0.2 --strides 1".split()
    code, out, err = run(*walk, before=nobody, without=HOMELESS)
    assert (code, err) == (0, "") and "0.850000" in out


def test_a_command_draws_whatever_backend_a_notebook_has(tmp_path):
    """A kernel of Jupyter sets its own, which need not be installed beside the command."""
    missing = "module://no_such_package.backend_inline"
    small = "--system henon --axis x=-2:2:9 --axis y=-2:2:9 --method direct".split()
    code, _, err = run("basin", *small, "--quiet", cwd=tmp_path, MPLBACKEND=missing)
    assert (code, err) == (0, "")
    assert (tmp_path / "basin.png").stat().st_size > 1000


@pytest.mark.skipif(jax.default_backend() != "cpu", reason="there is a device for JAX's platforms")
@pytest.mark.parametrize(
    ("name", "platform"),
    [("JAX_PLATFORMS", "cuda"), ("JAX_PLATFORMS", "abacus"), ("JAX_PLATFORM_NAME", "gpu")],
)
@pytest.mark.parametrize("command", [["gait"], pytest.param(["--version"], marks=pytest.mark.slow)])
def test_one_line_says_that_jax_has_no_device(command, name, platform):
    code, out, err = run(*command, **{name: platform})
    assert (code, out) == (1, "")
    assert err == (
        f"walker-jax: JAX finds no device by {name}={platform}: unset {name}, or set it to cpu\n"
    )


GONE = 'mkdir gone && cd gone && rmdir ../gone && exec "$0" "$@"'
WHERE = "the working folder is gone: change to another, or give a whole path"


def test_one_line_says_that_the_working_folder_is_gone(tmp_path):
    script = Path(sysconfig.get_path("scripts")) / "walker-jax"
    command = ["sh", "-c", GONE, str(script), "basin", *SMALL]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == f"walker-jax: basin.png cannot be found: {WHERE}\n"


def test_a_folder_that_is_gone_matters_only_to_relative_paths(tmp_path, monkeypatch):
    folder = tmp_path / "gone"
    folder.mkdir()
    monkeypatch.chdir(folder)
    folder.rmdir()
    check_writable(tmp_path / "basin.zarr")
    with pytest.raises(WrongPlace, match="working folder is gone"):
        check_writable(type(tmp_path)("basin.zarr"))

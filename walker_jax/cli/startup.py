"""Settings of JAX for the commands."""

import atexit
import os
from contextlib import suppress
from pathlib import Path

import jax

from walker_jax.kernels.object_cache import private_folder
from walker_jax.kernels.private_files import FILE_MODE, is_own, is_private
from walker_jax.refusals import ComputationFailed

SUFFIXES = "-cache", "-atime"
"""Suffixes of JAX's files."""
PLATFORMS = "JAX_PLATFORMS", "JAX_PLATFORM_NAME"
"""Variables that choose JAX's devices, the present one and the old one."""


def configure_jax() -> None:
    """Turn on float64, and keep what XLA compiles."""
    jax.config.update("jax_enable_x64", True)
    keep_compiled()
    find_devices()


def find_devices() -> list:
    """Return JAX's devices; raise `ComputationFailed` if it has none, as without a card."""
    try:
        return jax.devices()
    except (AssertionError, RuntimeError) as error:
        name = next((one for one in PLATFORMS if os.environ.get(one)), PLATFORMS[0])
        named = os.environ.get(name, "")
        reason = f" by {name}={named}" * bool(named)
        raise ComputationFailed(
            f"JAX finds no device{reason}: unset {name}, or set it to cpu"
        ) from error


def keep_compiled() -> None:
    """Keep what XLA compiles in a folder beside the kernels, so that the next start is fast."""
    if "JAX_COMPILATION_CACHE_DIR" in os.environ:
        return
    try:
        folder = private_folder("xla-programs", make=True)
        if folder is None or not os.access(folder, os.W_OK):
            return
        remove_foreign(folder)
    except OSError:
        return
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0)
    atexit.register(close_to_others, folder)


def programs(folder: Path) -> list[Path]:
    """Return JAX's files in a folder."""
    return [path for path in folder.iterdir() if path.name.endswith(SUFFIXES)]


def remove_foreign(folder: Path) -> None:
    """Remove programs that others may have written, as JAX checks neither owner nor mode."""
    for path in programs(folder):
        with suppress(FileNotFoundError):  # another process removed it
            if not is_private(path.lstat()):
                path.unlink()


def close_to_others(folder: Path) -> None:
    """Let nobody else read or write the programs; JAX writes them with the mode of the umask."""
    with suppress(OSError):  # the folder may be gone
        for path in programs(folder):
            if is_own(path.lstat()) and not path.is_symlink():
                path.chmod(FILE_MODE)

"""Settings of JAX for the commands."""

import os

import jax

from walker_jax.kernels.object_cache import private_folder
from walker_jax.kernels.private_files import FOLDER_MODE
from walker_jax.refusals import ComputationFailed

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
    """Keep what XLA compiles in a folder beside the kernels, so that the next start is fast.

    Nobody else may enter the folder, as JAX checks neither the owner nor the mode of its files.
    """
    if "JAX_COMPILATION_CACHE_DIR" in os.environ:
        return
    try:
        folder = private_folder("xla-programs", make=True)
        if folder is None or not os.access(folder, os.W_OK):
            return
        modes = hasattr(os, "geteuid")  # Windows has none
        if modes and folder.stat().st_mode & ~FOLDER_MODE & 0o777:  # others may have written there
            folder.chmod(FOLDER_MODE)
            for program in (*folder.glob("*-cache"), *folder.glob("*-atime")):
                program.unlink(missing_ok=True)
    except OSError:
        return
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0)

"""Settings of JAX for the commands."""

import os

import jax

from walker_jax.kernels.object_cache import cache_folder


def configure_jax() -> None:
    """Turn on float64, and keep what XLA compiles."""
    jax.config.update("jax_enable_x64", True)
    keep_compiled()


def keep_compiled() -> None:
    """Keep what XLA compiles in the folder of the kernels, so that the next start is fast."""
    folder = cache_folder()
    if folder is None or "JAX_COMPILATION_CACHE_DIR" in os.environ:
        return
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return
    if os.access(folder, os.W_OK):
        jax.config.update("jax_compilation_cache_dir", str(folder))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0)

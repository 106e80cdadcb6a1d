"""Primitives of JAX without a known Taylor series, and what to write instead."""

from walker_jax.integrators.branches import MAX_TURNS

INSTEAD = {
    **dict.fromkeys(("argmax", "argmin", "sort", "top_k"), "jnp.maximum and jnp.where"),
    **dict.fromkeys(("eigh", "householder_product", "qr", "svd"), "jnp.linalg.solve"),
    "scan": f"loops of at most {MAX_TURNS} turns",
    "while": f"lax.fori_loop between two numbers, at most {MAX_TURNS} turns",
}
"""What to write instead of some primitives that have no series."""


def no_series(name: str) -> NotImplementedError:
    instead = f", with {INSTEAD[name]}" if name in INSTEAD else ""
    return NotImplementedError(
        f"no Taylor series is known of the JAX primitive {name!r}: write the equations without "
        f"it{instead}, or integrate them with one of diffrax's Runge-Kutta solvers"
    )

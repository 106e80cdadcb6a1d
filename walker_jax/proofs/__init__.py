"""Proofs: rigorous interval arithmetic, verified strides, proved gaits and basins."""

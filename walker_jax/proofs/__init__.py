"""Proofs: arithmetic with rigorous bounds, verified strides, proved gaits and basins."""

"""Robustness of gaits: how large a disturbance a gait survives."""

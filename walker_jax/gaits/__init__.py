"""Gaits: their search, derivatives, branches and bifurcations."""

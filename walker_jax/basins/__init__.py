"""Basins of attraction: by cell mapping, by direct iteration, refined along their boundaries."""

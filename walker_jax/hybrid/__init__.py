"""Hybrid systems: modes of motion with guards that end them, followed to the first event."""

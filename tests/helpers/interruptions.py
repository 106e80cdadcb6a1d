"""Runs that are interrupted while they write a store."""

import pytest

from walker_jax import storage


def stop_writes(monkeypatch: pytest.MonkeyPatch, stops: set[int], arrays: int) -> list[int]:
    """Interrupt the write of a piece after each of these numbers of whole ones, once.

    Of an interrupted piece so many arrays are written. Returns the whole ones, as they come; a stop
    that has happened leaves `stops`.
    """
    write, written = storage.Pieces.write, []

    def stopped(place, piece, values, done=False):
        if len(written) in stops:
            stops.discard(len(written))
            write(place, piece, dict(list(values.items())[:arrays]))
            raise KeyboardInterrupt
        written.append(piece)
        write(place, piece, values, done=done)

    monkeypatch.setattr(storage.Pieces, "write", stopped)
    return written

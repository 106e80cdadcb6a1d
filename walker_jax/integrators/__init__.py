"""Taylor series of solutions, a diffrax solver that uses them, and the roots of events."""

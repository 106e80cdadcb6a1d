"""Taylor series of solutions, the diffrax solver that uses them, and the roots of events."""

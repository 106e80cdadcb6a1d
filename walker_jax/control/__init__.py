"""How much any control can do: viability, and policies for each of three objectives."""

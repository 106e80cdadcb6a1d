"""How much any control can do: viability, and what leads to a gait in the fewest strides."""

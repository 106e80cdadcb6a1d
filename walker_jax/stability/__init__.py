"""How large a disturbance a gait survives."""

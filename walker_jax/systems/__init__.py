"""Return maps: systems in general, maps, systems of modes, and outcomes of strides."""

"""Return maps: systems in general, maps, hybrid systems, and outcomes of strides."""

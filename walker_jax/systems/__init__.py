"""What a return map must provide: maps, systems of modes, and outcomes of strides."""

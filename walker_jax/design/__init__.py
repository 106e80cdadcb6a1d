"""Design: objectives and their gradients, optimisation of any parameter, sweeps."""

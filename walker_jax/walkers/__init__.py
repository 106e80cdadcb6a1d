"""The models of walkers, and the methods that a model must provide."""

"""The models of walkers, and what a model must provide."""

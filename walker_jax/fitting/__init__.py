"""Walkers from recordings: fits of parameters with errors, and how errors go on to results."""

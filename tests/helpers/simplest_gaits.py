"""Gaits of the simplest walker: where they are, and that they repeat themselves."""

import numpy as np

import walker_jax as wj

REGION = wj.Grid.sheared(theta=(0.1, 0.3, 40), sum=(-0.03, 0.018, 60))


def walker(slope=0.009):
    return wj.SimplestWalker(slope)


def assert_repeats(slope, states):
    """A walk from the first of these states leads through them and back; returns its times."""
    walked = wj.walk(walker(slope), states[0], len(states))
    np.testing.assert_allclose(walked.states[:-1], states, rtol=0, atol=1e-10)
    np.testing.assert_allclose(walked.states[-1], states[0], rtol=0, atol=1e-10)
    return walked.times

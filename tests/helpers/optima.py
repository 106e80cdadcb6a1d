"""What optimisations of the tests have in common."""

import walker_jax as wj

WALKER = wj.SimplestWalker(0.004)
SLOPES = {"slope": (0.001, 0.015)}
"""On all of them the gait with the largest basin is the long one of period one."""
GRID = wj.Grid.sheared(theta=(0, 0.4, 100), sum=(-0.04, 0.01, 60))
FEW = wj.Grid.sheared(theta=(0, 0.4, 20), sum=(-0.02, 0.01, 12))
"""Walkers reach the gait from a few of its cells, and the search for it is quick."""


def measure(name, slope):
    return wj.measure(wj.SimplestWalker(slope), name, ()).value


def values(data, name):
    return data[name].values.tolist()

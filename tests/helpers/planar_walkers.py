"""The walkers in the plane: one of each, gaits, states, and ranges of their parameters."""

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import strategies as st
from reference import read_values

from walker_jax import (
    KneedWalker,
    PointFootWalker,
    RoundFootWalker,
    SimplestWalker,
    SpringWalker,
    State,
    UpperBodyWalker,
)
from walker_jax.walkers.family import PLANAR_WALKERS
from walker_jax.walkers.parameters import parameters

VALUES = read_values("values")
GAIT = VALUES["gaits"][0]  # of the simplest walker: long, slope 0.009
FINITE = {gait["name"]: gait for gait in VALUES["finite_mass"]}
PUBLISHED = read_values("published_gaits")
CLASSES = tuple(cls for cls in PLANAR_WALKERS.values() if not cls.__name__.startswith("Powered"))
"""Walkers without motors; those with motors have tests of their own (test_powered.py)."""
MASSLESS = SimplestWalker, SpringWalker
GENERAL = PointFootWalker, RoundFootWalker, UpperBodyWalker
SLOW = pytest.mark.slow
name = lambda cls: cls.__name__
GAITS = {
    SimplestWalker: (SimplestWalker(0.009), GAIT["state"], GAIT["step_time"]),
    SpringWalker: (SpringWalker(0.009, 2.0), [0.15, -0.16], 2.2),
    PointFootWalker: (PointFootWalker(0.009, 1e-3), [0.200161, -0.199906], 3.88),
    RoundFootWalker: (RoundFootWalker(0.01, leg_length=1.2), [0.18944, -0.23901, -0.0514], 2.428),
    UpperBodyWalker: (UpperBodyWalker(0.01), [0.196, -0.2434, -0.033], 2.36),
    KneedWalker: (KneedWalker(0.05), [0.23793, -0.35396, -0.33328], 1.77),
}
"""A walker of each kind, a start close to a gait of it, and about how long a stride then takes."""


def states(count=40):
    """States of all kinds, also fast and steep ones."""
    rng = np.random.default_rng(1)
    many = [*rng.uniform(-1.3, 1.3, (2, count)), *rng.uniform(-1.5, 1.5, (2, count))]
    return State(*map(jnp.asarray, many))


def strikes(count=40):
    """States at heel strike: phi = 2 theta, theta and thetadot negative."""
    rng = np.random.default_rng(2)
    theta, thetadot = rng.uniform(-1.2, -0.01, count), rng.uniform(-1.5, -0.01, count)
    phidot = rng.uniform(-2, 2, count)
    return State(*map(jnp.asarray, (theta, 2 * theta, thetadot, phidot)))


RANGES = {
    "slope": (1e-3, 0.3),
    "hip_stiffness": (0, 20),
    "foot_mass": (1e-4, 10),
    "hip_mass": (0, 10),
    "leg_mass": (0.05, 10),
    "leg_inertia": (1e-3, 2),
    "leg_length": (0.5, 2),
    "com_from_hip": (-0.5, 1.5),
    "com_offset": (-0.3, 0.3),
    "foot_radius": (0, 0.45),
    "body_mass": (0.01, 10),
    "body_inertia": (0, 2),
    "body_com": (-0.5, 1),
    "thigh_mass": (0.05, 10),
    "shank_mass": (0.05, 10),
    "thigh_length": (0.3, 1),
    "shank_length": (0.3, 1),
    "thigh_com": (-0.2, 0.8),
    "shank_com": (-0.2, 0.8),
    "thigh_inertia": (1e-3, 1),
    "shank_inertia": (1e-3, 1),
}


def drawn(ranges):
    return st.tuples(*(st.floats(*ends, allow_subnormal=False) for ends in ranges))


def cases(cls):
    return drawn(RANGES[parameter.name] for parameter in parameters(cls))

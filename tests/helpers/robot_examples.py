"""The robots of docs/robots, and their twins in the package."""

import numpy as np
from reference import ROOT

import walker_jax as wj
from walker_jax.walkers.references import load_file

FILES = ROOT / "docs" / "robots"
TELESCOPE = ROOT / "tests" / "data" / "telescope.xml"
"""Slides, springs, dampers, armatures, servos, arms, capsules and turned frames."""
UNIT = np.sqrt(9.81)
"""Rates of robots with legs of 1 m, over those of walkers in units of leg length and gravity."""

BIPED_GAIT = -0.09676383, -0.41464963, 0.14491769, 0.16472847, 0.54253041
BIPED_GAIT = *BIPED_GAIT, 1.54454963, 0.49844993, 0.92745759, 1.35589186
"""The gait of the five-link biped, to eight decimals."""


def five_link():
    """The five-link biped, with its controller."""
    return load_file(FILES / "five_link.py").biped


def round_foot():
    """The twin of compass.xml."""
    legs = dict(leg_mass=5.0, leg_inertia=0.1, com_from_hip=0.5, foot_radius=0.05)
    return wj.RoundFootWalker(0.05, hip_mass=10.0, **legs)


def kneed():
    """The twin of kneed.xml."""
    legs = dict(thigh_com=0.325, shank_com=0.125, thigh_inertia=0.05, shank_inertia=0.002)
    masses = dict(hip_mass=10.0, thigh_mass=10.0, shank_mass=1.0)
    return wj.KneedWalker(0.05, foot_radius=0.05, **masses, **legs)


def as_robot(x):
    """A point of a robot's section from that of its twin, (theta, thetadot, phidot)."""
    x = np.asarray(x)
    rates = np.stack([-x[..., 1], x[..., 2] - x[..., 1]], -1) * UNIT
    return np.concatenate([-x[..., :1], rates], -1)

"""A walker with knees, its published gaits, and where its masses are."""

import dataclasses

import numpy as np
import pytest
from reference import read_values

import walker_jax as wj
from walker_jax import KneedWalker

PUBLISHED = read_values("kneed_walkers")
HSU_CHEN, HUMAN_LIKE = PUBLISHED["hsu_chen_2007"], PUBLISHED["human_like"]


def published(entry, slope=None):
    """The walker of an entry; lengths in m, times in sqrt(1 m / g)."""
    return KneedWalker(
        slope or entry.get("slope") or np.radians(entry["slope_degrees"]),
        hip_mass=entry["hip_mass"],
        thigh_mass=entry["thigh_mass"],
        shank_mass=entry["shank_mass"],
        thigh_length=entry["thigh_length"],
        shank_length=entry["shank_length"],
        thigh_com=entry["thigh_length"] - entry["thigh_mass_above_knee"],
        shank_com=entry["shank_length"] - entry["shank_mass_above_foot"],
        foot_radius=entry.get("foot_radius", 0.0),
    )


def section_of(entry):
    """The state of its gait, on the section."""
    walker, exact = published(entry), entry["exact"]
    first, second = (exact[name] / np.sqrt(entry["gravity"]) for name in ("q1dot", "q2dot"))
    return np.array([exact["q1"] + float(walker.slope), first, first - second])


WALKER = KneedWalker(0.05, thigh_inertia=0.01, shank_inertia=0.001, foot_radius=0.05)
START = np.array([0.2482, -0.3581, -0.2933])
"""A walker with feet that roll and all that a walker may have, and a state close to its gait."""


def changed(walker, **values):
    return dataclasses.replace(walker, **values)


def starts(count, seed=0):
    """Starts all over the section."""
    rng = np.random.default_rng(seed)
    ranges = (0.02, 0.7), (-1.2, -0.02), (-1.5, 1.0)
    return np.stack([rng.uniform(*one, count) for one in ranges], axis=1)


def knee_strike(walker, x):
    """When the knee has struck, by where it is bent: of the last of a few trajectories."""
    low, high = 0.0, 2.5
    for _ in range(7):
        times = np.linspace(low, high, 120)
        bent = np.flatnonzero(np.asarray(wj.trajectory(walker, x, times).knee) > 0)[-1]
        low, high = times[bent], times[bent + 1]
    return high


SLOW = pytest.mark.slow  # derivatives of a stride with knees take long to compile


def places(walker, q):
    """The five masses, from the stance foot on the ground, and the angles of thighs and shanks."""
    theta, phi, knee = q
    get = lambda name: float(getattr(walker, name))
    up = lambda angle: np.array([-np.sin(angle), np.cos(angle)])
    radius, thigh, shank = get("foot_radius"), get("thigh_length"), get("shank_length")
    hip = np.array([-radius * theta, radius]) + (thigh + shank - radius) * up(theta)
    swing = theta - phi
    swing_knee = hip - thigh * up(swing)
    points = [
        hip,
        hip - get("thigh_com") * up(theta),
        hip - get("thigh_com") * up(swing),
        hip - (thigh + get("shank_com")) * up(theta),
        swing_knee - get("shank_com") * up(swing - knee),
    ]
    return np.array(points), np.array([theta, swing, theta, swing - knee])


def masses(walker):
    M, m, n, j, k = (float(getattr(walker, name)) for name in MASSES)
    return np.array([M, m, m, n, n]), np.array([j, j, k, k])


MASSES = "hip_mass", "thigh_mass", "shank_mass", "thigh_inertia", "shank_inertia"


def velocities(walker, q, rates):
    """By complex steps: right to rounding."""
    moved = lambda i: (
        np.imag(complex_places(walker, np.array(q) + 1e-30j * np.array(rates))[i]) / 1e-30
    )
    return moved(0), moved(1)


def complex_places(walker, q):
    return places(walker, q)


def energy(walker, q, rates):
    points, _ = places(walker, q)
    v, turn = velocities(walker, q, rates)
    m, inertia = masses(walker)
    slope = float(walker.slope)
    height = points @ [-np.sin(slope), np.cos(slope)]
    return (m @ (v**2).sum(axis=1) + inertia @ turn**2) / 2 + m @ height

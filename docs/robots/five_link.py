"""The robot of five_link.xml, by the virtual constraints of walker_jax.systems.FiveLinkBiped."""

from pathlib import Path

import jax
import jax.numpy as jnp

import walker_jax as wj

GAINS = {
    "lean": 0.15,  # of the torso
    "bend": 0.2,  # of the stance knee
    "swing_bend": 0.6,  # more of the swing knee
    "reach": 0.3,  # of the stance leg
    "stiffness": 400.0,
    "damping": 40.0,
}


def outputs(q, p):
    """The angles that the motors hold at zero, from those of the joints."""
    thighs = [q["pitch"] + q[f"{leg}_hip"] for leg in ("stance", "swing")]
    shanks = [q["pitch"] + q[f"{leg}_hip"] + q[f"{leg}_knee"] for leg in ("stance", "swing")]
    theta = (thighs[0] + shanks[0]) / 2
    swung = p["swing_bend"] * (1 - (theta / p["reach"]) ** 2)
    mirrored = theta + (thighs[1] + shanks[1]) / 2
    knees = q["stance_knee"] - p["bend"], q["swing_knee"] - p["bend"] - swung
    return jnp.stack([knees[0], q["pitch"] - p["lean"], mirrored, knees[1]])


def controller(q, rates, p):
    """Springs and dampers on the outputs, as torques of the motors."""
    y, speeds = jax.jvp(lambda q: outputs(q, p), (q,), (rates,))
    knee, torso, leg, swing_knee = -p["stiffness"] * y - p["damping"] * speeds
    return {
        "stance_knee": knee,
        "stance_hip": -torso - leg,
        "swing_hip": leg,
        "swing_knee": swing_knee,
    }


biped = wj.robot(Path(__file__).with_name("five_link.xml"), controller=controller, parameters=GAINS)

"""The package's systems other than walkers, by their names on the command line."""

from walker_jax.systems.bouncing_ball import BouncingBall
from walker_jax.systems.bounding_quadruped import BoundingQuadruped
from walker_jax.systems.duffing import DuffingOscillator
from walker_jax.systems.five_link_biped import FiveLinkBiped
from walker_jax.systems.henon import HenonMap
from walker_jax.systems.impact_oscillator import ImpactOscillator
from walker_jax.systems.raibert_hopper import RaibertHopper
from walker_jax.systems.rimless_wheel import TorsoWheel
from walker_jax.systems.spring_mass_biped import SpringMassBiped
from walker_jax.systems.spring_mass_runner import SpringMassRunner
from walker_jax.systems.stick_slip import StickSlip
from walker_jax.systems.switched_compass import SwitchedCompass
from walker_jax.systems.system import System

SYSTEMS: dict[str, type[System]] = {
    "henon": HenonMap,
    "duffing": DuffingOscillator,
    "bouncing-ball": BouncingBall,
    "impact-oscillator": ImpactOscillator,
    "runner": SpringMassRunner,
    "spring-biped": SpringMassBiped,
    "quadruped": BoundingQuadruped,
    "hopper": RaibertHopper,
    "stick-slip": StickSlip,
    "torso-wheel": TorsoWheel,
    "switched-compass": SwitchedCompass,
    "five-link-biped": FiveLinkBiped,
}

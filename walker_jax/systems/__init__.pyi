"""The public names; `__init__.py` loads each from here on its first use."""

from walker_jax.systems.bouncing_ball import BouncingBall as BouncingBall
from walker_jax.systems.bounding_quadruped import BoundingQuadruped as BoundingQuadruped
from walker_jax.systems.duffing import DuffingOscillator as DuffingOscillator
from walker_jax.systems.five_link_biped import FiveLinkBiped as FiveLinkBiped
from walker_jax.systems.henon import HenonMap as HenonMap
from walker_jax.systems.impact_oscillator import ImpactOscillator as ImpactOscillator
from walker_jax.systems.raibert_hopper import RaibertHopper as RaibertHopper
from walker_jax.systems.rimless_wheel import TorsoWheel as TorsoWheel
from walker_jax.systems.spring_mass_biped import SpringMassBiped as SpringMassBiped
from walker_jax.systems.spring_mass_runner import SpringMassRunner as SpringMassRunner
from walker_jax.systems.stick_slip import StickSlip as StickSlip
from walker_jax.systems.switched_compass import SwitchedCompass as SwitchedCompass

__all__: list[str]

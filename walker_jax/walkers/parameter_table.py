"""The parameters of the package's walkers: meanings, units, defaults and bounds.

This module loads without JAX, so that the command line can list and check options at once. A
parameter's name has one meaning and one unit in all walkers.
"""

from math import inf, pi

from walker_jax.systems.parameter import Option, Parameter

SLOPE = Parameter("slope", "of the ground", "rad", 0.004, high=pi / 2, span=(0.001, 0.022))
ANY_SLOPE = SLOPE._replace(low=-pi / 2)
"""The slope of walkers with motors: level ground and uphill too."""
KNEED_SLOPE = SLOPE._replace(default=0.05, span=(0.03, 0.12))
"""On gentle slopes no gait bends its knees: with default masses on point feet, below 0.0318."""
SPATIAL_SLOPE = SLOPE._replace(default=0.0702)

HIP_STIFFNESS = Parameter(
    "hip_stiffness", "of a spring between the legs, per foot mass", "g l", 0.0, closed=True
)
HIP_DAMPING = Parameter(
    "hip_damping", "of a damper between the legs, per foot mass", "m l sqrt(g l)", 0.0, closed=True
)
HIP_SPRING = Parameter(
    "hip_spring", "stiffness of a spring between the legs", "mass g length", 0.0, closed=True
)
HIP_DAMPER = Parameter(
    "hip_damper", "of a damper between the legs", "mass length sqrt(g length)", 0.0, closed=True
)
HIP_ANGLE = Parameter(
    "hip_angle", "between the legs where the hip's spring is slack", "rad", 0.0, low=-inf
)
PUSH_OFF = Parameter(
    "push_off",
    "impulse along the trailing leg before heel strike",
    "mass sqrt(g length)",
    0.0,
    closed=True,
)
MOTORS = HIP_SPRING, HIP_DAMPER, HIP_ANGLE, PUSH_OFF

FOOT_MASS = Parameter("foot_mass", "of each foot, per hip mass", "hip mass", 0.01)
HIP_MASS = Parameter("hip_mass", "at the hip", "mass", 1.0, closed=True)
LEG_MASS = Parameter("leg_mass", "of each leg", "mass", 0.5)
LEG_INERTIA = Parameter(
    "leg_inertia", "of each leg about its centre of mass", "mass length^2", 0.02, closed=True
)
LEG_LENGTH = Parameter("leg_length", "from the hip to the sole", "length", 1.0)
COM_FROM_HIP = Parameter(
    "com_from_hip", "distance of a leg's centre of mass below the hip", "length", 0.5, low=-inf
)
COM_OFFSET = Parameter(
    "com_offset", "of a leg's centre of mass before the leg's line", "length", 0.0, low=-inf
)
FOOT_RADIUS = Parameter(
    "foot_radius", "of the foot's arc, centred on the leg", "length", 0.2, closed=True
)
LEGS = LEG_MASS, LEG_INERTIA, LEG_LENGTH, COM_FROM_HIP, COM_OFFSET, FOOT_RADIUS

BODY_MASS = Parameter("body_mass", "of the upper body", "mass", 1.0)
BODY_INERTIA = Parameter(
    "body_inertia", "of the upper body about its centre of mass", "mass length^2", 0.0, closed=True
)
BODY_COM = Parameter(
    "body_com", "distance of the upper body's centre of mass above the hip", "length", 0.1, -inf
)
BODY = BODY_MASS, BODY_INERTIA, BODY_COM

THIGH_MASS = Parameter("thigh_mass", "of each thigh", "mass", 1.0, closed=True)
SHANK_MASS = Parameter("shank_mass", "of each shank", "mass", 0.1)
THIGH_LENGTH = Parameter("thigh_length", "from the hip to the knee", "length", 0.5)
SHANK_LENGTH = Parameter("shank_length", "from the knee to the sole", "length", 0.5)
THIGH_COM = Parameter(
    "thigh_com", "distance of a thigh's centre of mass below the hip", "length", 0.325, -inf
)
SHANK_COM = Parameter(
    "shank_com", "distance of a shank's centre of mass below the knee", "length", 0.125, -inf
)
THIGH_INERTIA = Parameter(
    "thigh_inertia", "of each thigh about its centre of mass", "mass length^2", 0.0, closed=True
)
SHANK_INERTIA = Parameter(
    "shank_inertia", "of each shank about its centre of mass", "mass length^2", 0.0, closed=True
)
POINT_FOOT = FOOT_RADIUS._replace(default=0.0)
CHECK_LOCK = Option("check_lock", "a stance knee that its stop alone does not hold is a failure")
CHECK_SCUFFING = Option("check_scuffing", "a bent leg's foot below the ground is a failure")

SPATIAL_LEG_MASS = LEG_MASS._replace(default=1.0)
HIP_WIDTH = Parameter("hip_width", "between the planes of the two discs", "length", 0.3624)
DISC_RADIUS = Parameter("disc_radius", "of the foot's disc", "length", 0.1236, closed=True)
COM_FORWARD = Parameter(
    "com_forward", "of a leg's centre of mass before the leg's line", "length", 0.0, low=-inf
)
COM_OUTWARD = Parameter(
    "com_outward", "of a leg's centre of mass from its own disc", "length", 0.6969, low=-inf
)
COM_HEIGHT = Parameter(
    "com_height", "of a leg's centre of mass above its sole", "length", 0.3137, low=-inf
)


def inertia_parameter(name: str, default: float) -> Parameter:
    """Make an entry of the matrix of inertia of the left leg."""
    meaning = f"entry {name[-2:]} of the left leg's matrix of inertia"
    low = 0.0 if name[-1] == name[-2] else -inf
    return Parameter(name, meaning, "mass length^2", default, low=low)


INERTIA_XX = inertia_parameter("inertia_xx", 0.1982)
INERTIA_YY = inertia_parameter("inertia_yy", 0.0186)
INERTIA_ZZ = inertia_parameter("inertia_zz", 0.1802)
INERTIA_XY = inertia_parameter("inertia_xy", 0.0071)
INERTIA_XZ = inertia_parameter("inertia_xz", -0.0023)
INERTIA_YZ = inertia_parameter("inertia_yz", 0.0573)
INERTIA = INERTIA_XX, INERTIA_YY, INERTIA_ZZ, INERTIA_XY, INERTIA_XZ, INERTIA_YZ
ALLOW_SCUFFING = Option("allow_scuffing", "a disc below the slope before heel strike is no failure")

DESCRIBED: dict[str, tuple[Parameter | Option, ...]] = {
    "simplest": (SLOPE,),
    "spring": (SLOPE, HIP_STIFFNESS),
    "point-foot": (SLOPE, FOOT_MASS),
    "round-foot": (SLOPE, HIP_MASS, *LEGS),
    "upper-body": (SLOPE, *BODY, *LEGS),
    "kneed": (
        *(KNEED_SLOPE, HIP_MASS, THIGH_MASS, SHANK_MASS, THIGH_LENGTH, SHANK_LENGTH, THIGH_COM),
        *(SHANK_COM, THIGH_INERTIA, SHANK_INERTIA, POINT_FOOT, CHECK_LOCK, CHECK_SCUFFING),
    ),
    "spatial": (
        *(SPATIAL_SLOPE, SPATIAL_LEG_MASS, LEG_LENGTH, HIP_WIDTH, DISC_RADIUS, COM_FORWARD),
        *(COM_OUTWARD, COM_HEIGHT, *INERTIA, ALLOW_SCUFFING),
    ),
    "powered": (ANY_SLOPE, HIP_STIFFNESS, HIP_DAMPING, HIP_ANGLE, PUSH_OFF),
    "powered-point-foot": (ANY_SLOPE, FOOT_MASS, *MOTORS),
    "powered-round-foot": (ANY_SLOPE, HIP_MASS, *LEGS, *MOTORS),
    "powered-upper-body": (ANY_SLOPE, *BODY, *LEGS, *MOTORS),
}
"""The parameters and options of each walker, in the order of its constructor's arguments."""

OPENING = {"spring": {"hip_stiffness": 1.0}}
"""Values with which the explorer opens a walker that is like another one at its defaults."""

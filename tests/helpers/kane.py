"""Kane's equations by SymPy for legs that share an axle, each with a disc that rolls on a slope.

An independent model: vectors and frames of sympy.physics.mechanics, without any code of the
package. Angles are yaw, lean and pitch of the stance leg, and pitch of the swing leg against it.
"""

from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import numpy as np
import sympy
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from sympy.physics import mechanics

SIZES = "slope mass length width radius forward outward height xx yy zz xy xz yz"
Values = dict[str, float]


Derived = Callable[[], Callable]
"""Derives a function when it is first called, and returns it: Kane's method takes long."""


class Equations(NamedTuple):
    """Functions of (angles, x, y; rates, xdot, ydot) in one array, and of the sizes."""

    matrix: Derived
    """Of the derivatives of the rates, those of the contact's place last."""
    forcing: Derived
    momentum: Derived
    """Linear momentum, angular momentum about the origin, and of each leg about its disc's
    centre along the axle; all in the axes of the slope."""
    places: Derived
    """Centres of the discs, and the axle's frame."""
    slides: Derived
    """Velocity of the stance disc's point at its contact; of the swing disc's lowest point."""
    energy: Derived


@cache
def equations(legs: int) -> Equations:
    """Of one leg alone, a body on a disc, or of two."""
    names = ["yaw", "lean", "pitch", "swing"][: legs + 2]
    q, u = (mechanics.dynamicsymbols([head + one for one in names]) for head in ("", "u_"))
    (x, y), (ux, uy) = (mechanics.dynamicsymbols(pair) for pair in ("x y", "u_x u_y"))
    sizes = sympy.symbols(SIZES)
    slope, m, length, width, R, forward, outward, height, xx, yy, zz, xy, xz, yz = sizes
    ground, origin = mechanics.ReferenceFrame("N"), mechanics.Point("O")
    heading = ground.orientnew("A", "Axis", (q[0], ground.z))
    axle = heading.orientnew("B", "Axis", (q[1], heading.x))
    heading.set_ang_vel(ground, u[0] * ground.z)
    axle.set_ang_vel(heading, u[1] * heading.x)
    origin.set_vel(ground, 0)
    pitches = [(q[2], u[2])] + [
        (q[2] + one, u[2] + rate) for one, rate in zip(q[3:], u[3:], strict=True)
    ]
    frames = []
    for number, (angle, rate) in enumerate(pitches):
        frames.append(axle.orientnew(f"C{number}", "Axis", (angle, axle.y)))
        frames[-1].set_ang_vel(axle, rate * axle.y)
    contact = origin.locatenew("P", x * ground.x + y * ground.y)
    contact.set_vel(ground, ux * ground.x + uy * ground.y)
    centre = contact.locatenew("D0", R * axle.z)
    turns = axle.ang_vel_in(ground).cross(R * axle.z)
    centre.set_vel(ground, contact.vel(ground) + turns)
    centres = [centre]
    if legs == 2:
        hip = centre.locatenew("H0", (length - R) * frames[0].z)
        hip.v2pt_theory(centre, ground, frames[0])
        other = hip.locatenew("H1", -width * axle.y)
        other.v2pt_theory(hip, ground, axle)
        centres.append(other.locatenew("D1", -(length - R) * frames[1].z))
        centres[1].v2pt_theory(other, ground, frames[1])
    bodies, weights, momenta = [], [], []
    down = sympy.sin(slope) * ground.x - sympy.cos(slope) * ground.z
    linear, angular = mechanics.Vector(0), mechanics.Vector(0)
    for number, (frame, disc) in enumerate(zip(frames, centres, strict=True)):
        side = 1 - 2 * number
        arm = forward * frame.x + side * outward * frame.y + (height - R) * frame.z
        mass_centre = disc.locatenew(f"G{number}", arm)
        mass_centre.v2pt_theory(disc, ground, frame)
        inertia = mechanics.inertia(frame, xx, yy, zz, side * xy, side * yz, xz)
        body = mechanics.RigidBody(f"leg{number}", mass_centre, frame, m, (inertia, mass_centre))
        bodies.append(body)
        weights.append((mass_centre, m * down))
        linear += body.linear_momentum(ground)
        angular += body.angular_momentum(origin, ground)
        hip_arm = arm - (length - R) * frame.z
        spin = inertia.dot(frame.ang_vel_in(ground))
        momenta.append((spin + hip_arm.cross(m * mass_centre.vel(ground))).dot(axle.y))
    slides = []
    for frame, disc in zip(frames, centres, strict=True):
        slide = disc.vel(ground) + frame.ang_vel_in(ground).cross(-R * axle.z)
        slides.append(slide.to_matrix(ground))

    @cache
    def method():
        method = mechanics.KanesMethod(
            ground,
            q_ind=[*q, x, y],
            u_ind=u,
            kd_eqs=[one.diff() - rate for one, rate in zip([*q, x, y], [*u, ux, uy], strict=True)],
            u_dependent=[ux, uy],
            velocity_constraints=list(slides[0][:2]),
        )
        method.kanes_equations(bodies, weights)
        return method

    names = [*q, x, y, *u, ux, uy]
    plain = [sympy.Dummy() for _ in names]
    exchange = dict(zip(names, plain, strict=True))
    energy = sum(body.kinetic_energy(ground) for body in bodies)
    energy -= sum(one.pos_from(origin).dot(weight) for one, weight in weights)
    stack = lambda vectors: sympy.Matrix.vstack(*[one.to_matrix(ground) for one in vectors])

    def compiled(derive):
        return cache(lambda: sympy.lambdify([plain, sizes], derive().subs(exchange), cse=True))

    return Equations(
        compiled(lambda: method().mass_matrix),
        compiled(lambda: method().forcing),
        compiled(lambda: sympy.Matrix.vstack(stack([linear, angular]), sympy.Matrix(momenta))),
        compiled(
            lambda: stack([*[one.pos_from(origin) for one in centres], axle.x, axle.y, axle.z])
        ),
        compiled(lambda: sympy.Matrix.vstack(*slides)),
        compiled(lambda: sympy.Matrix([energy])),
    )


class Rolling:
    """A body, or a walker, of given sizes, in numbers."""

    def __init__(self, sizes: Values, legs: int):
        self.sizes, self.angles = [sizes[name] for name in SIZES.split()], legs + 2
        self.radius = sizes["radius"]
        self.equations = equations(legs)

    def look(self, name: str, z: np.ndarray) -> np.ndarray:
        return np.squeeze(np.asarray(getattr(self.equations, name)()(z, self.sizes), float))

    def state(self, angles, rates, place=(0.0, 0.0)) -> np.ndarray:
        """All coordinates and rates, of a disc that does not slip."""
        z = np.array([*angles, *place, *rates, 0.0, 0.0], float)
        z[-2:] -= self.look("slides", z)[:2]  # the contact's velocity enters as itself
        return z

    def rates_of(self, z: np.ndarray) -> np.ndarray:
        n = self.angles
        z = self.state(z[:n], z[n + 2 : 2 * n + 2], z[n : n + 2])
        change = np.linalg.solve(self.look("matrix", z), self.look("forcing", z))
        return np.concatenate([z[n + 2 :], change])


class Toy(Rolling):
    """The walker of two legs: one step, by scipy's integration and by its momenta at heel strike.

    States on the section are yaw, lean, pitch, swing and their rates, as published.
    """

    def __init__(self, sizes: Values):
        super().__init__(sizes, 2)

    def clearance(self, z: np.ndarray) -> float:
        places = self.look("places", z)
        return places[5] - self.radius * places[14]

    def on_section(self, free: np.ndarray) -> np.ndarray:
        """The lean at which both discs touch, from the seven coordinates that are free."""
        yaw, pitch, swing, *rates = free
        touches = lambda lean: self.clearance(self.state([yaw, lean, pitch, swing], [0] * 4))
        lean = brentq(touches, -1, 1, xtol=1e-15, rtol=np.float64(1e-14))
        return self.state([yaw, lean, pitch, swing], rates)

    def step(self, free: np.ndarray) -> tuple[np.ndarray, float]:
        """The free coordinates after the next heel strike, in a mirror, and the time of that."""
        start = self.on_section(free)

        def strikes(t, z):
            return self.clearance(z) if z[3] < -0.05 else 1.0

        strikes.terminal, strikes.direction = True, -1
        found = solve_ivp(
            lambda t, z: self.rates_of(z),
            (0, 5),
            start,
            method="DOP853",
            rtol=1e-12,
            atol=1e-13,
            events=strikes,
        )
        (time,), (z,) = found.t_events[0], found.y_events[0]
        yaw, lean, pitch, swing = z[:4]
        angles = -yaw, -lean, pitch + swing, -swing
        z = self.state(z[:4], z[6:10], z[4:6])
        places, before = self.look("places", z), self.look("momentum", z)
        contact = places[3:6] - self.radius * places[12:15]
        about = before[3:6] - np.cross(contact, before[:3])
        kept = np.array([-about[0], about[1], -about[2], before[6]])
        columns = np.stack([self.kept_after(self.state(angles, one)) for one in np.eye(4)], axis=1)
        rates = np.linalg.solve(columns, kept)
        return np.array([angles[0], *angles[2:], *rates]), time

    def kept_after(self, z: np.ndarray) -> np.ndarray:
        momentum = self.look("momentum", z)
        return np.append(momentum[3:6], momentum[7])

    def jacobian(self, free: np.ndarray) -> np.ndarray:
        """By central differences, extrapolated twice."""

        def difference(direction, h):
            return (self.step(free + h * direction)[0] - self.step(free - h * direction)[0]) / h / 2

        columns = []
        for direction in np.eye(7):
            coarse, fine = (difference(direction, h) for h in (2e-3, 1e-3))
            columns.append((4 * fine - coarse) / 3)
        return np.stack(columns, axis=1)

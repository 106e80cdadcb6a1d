"""An independent solution: legs and upper body as free bodies, held by forces at joints."""

import jax
import numpy as np
from scipy.integrate import solve_ivp

from walker_jax import UpperBodyWalker
from walker_jax.walkers.parameters import parameters


class Bodies:
    """A walker with round feet, and an upper body or a mass at the hip, as three bodies.

    Their coordinates are (x, y, angle), each. Joints and the ground are constraints, whose forces
    are unknowns besides the accelerations.
    """

    def __init__(self, walker):
        self.walker = walker
        get = lambda name, otherwise=0.0: float(getattr(walker, name, otherwise))
        self.slope, self.radius, self.length = get("slope"), get("foot_radius"), get("leg_length")
        self.down, self.offset, self.body_com = (
            get("com_from_hip"),
            get("com_offset"),
            get("body_com"),
        )
        self.upper = isinstance(walker, UpperBodyWalker)
        leg = [get("leg_mass"), get("leg_mass"), get("leg_inertia")]
        body = get("body_mass") if self.upper else get("hip_mass")
        inertia = get("body_inertia") if self.upper else 1.0  # of what does not turn otherwise
        self.masses = np.array([*leg, *leg, body, body, inertia])
        pull = np.array([np.sin(self.slope), -np.cos(self.slope), 0.0])
        self.gravity = self.masses * np.tile(pull, 3)

    def place(self, angles, body, up, forward):
        """Rows of the derivative of a point of a body, and its acceleration at constant rates.

        The point is `up` from the centre of mass along the leg or trunk, and `forward` across.
        """
        s, c = np.sin(angles[body]), np.cos(angles[body])
        along, across = np.array([-s, c]), np.array([c, s])
        rows = np.zeros((2, 9))
        rows[0, 3 * body], rows[1, 3 * body + 1] = 1, 1
        rows[:, 3 * body + 2] = -up * across + forward * along
        return rows, -up * along - forward * across

    def constraints(self, state, foot):
        """Rows that take the bodies' rates to zero, and what velocities add to accelerations."""
        theta, phi, thetadot, phidot = state
        angles = [theta, theta - phi, theta - phi / 2]
        rates = np.array([thetadot, thetadot - phidot, thetadot - phidot / 2])
        rows, extra = [], []
        hip, bend = self.place(angles, 0, self.down, -self.offset)
        for body, up, forward in ((1, self.down, -self.offset), (2, -self.body_com, 0.0)):
            other, turn = self.place(angles, body, up, forward)
            rows.append(hip - other)
            extra.append(bend * rates[0] ** 2 - turn * rates[body] ** 2)
        if self.upper:
            bisects = np.zeros((1, 9))
            bisects[0, [2, 5, 8]] = 0.5, 0.5, -1
            rows.append(bisects)
            extra.append(np.zeros(1))
        # The arc's centre moves with the foot's rolling, and the sole below it is at rest.
        to_centre = self.down - (self.length - self.radius)
        sole, bend = self.place(angles, foot, to_centre, -self.offset)
        sole[0, 3 * foot + 2] += self.radius
        rows.append(sole)
        extra.append(bend * rates[foot] ** 2)
        return np.concatenate(rows), np.concatenate(extra)

    def solve(self, rows, right, zero):
        """M a - rows^T forces = right, rows a = zero."""
        n = len(rows)
        matrix = np.block([[np.diag(self.masses), -rows.T], [rows, np.zeros((n, n))]])
        solution = np.linalg.solve(matrix, np.concatenate([right, zero]))
        return solution[:9], solution[9:]

    def motion(self, state):
        """Accelerations of theta and phi, and the force of the ground."""
        rows, extra = self.constraints(state, 0)
        accelerations, forces = self.solve(rows, self.gravity, -extra)
        first, second = accelerations[2], accelerations[5]
        return np.array([first, first - second]), forces[-2:]

    def velocities(self, state):
        """Of all bodies, with the stance foot on the ground: the only ones that the joints let."""
        _, _, thetadot, phidot = state
        rows, _ = self.constraints(state, 0)
        turns = np.zeros((2, 9))
        turns[0, 2], turns[1, 5] = 1, 1
        if not self.upper:
            turns = np.concatenate([turns, np.eye(9)[8:]])
        right = np.zeros(9)
        right[len(rows) :][:2] = thetadot, thetadot - phidot
        return np.linalg.solve(np.concatenate([rows, turns]), right)

    def impact(self, state):
        """The state after heel strike, legs not yet exchanged, and the trailing sole's velocity."""
        rows, _ = self.constraints(state, 1)
        before = self.velocities(state)
        after, _ = self.solve(rows, self.masses * before, np.zeros(len(rows)))
        old, _ = self.constraints(state, 0)
        rates = after[2], after[2] - after[5]
        return np.array([state[0], state[1], *rates]), (old @ after)[-2:]

    def stride(self, x):
        """Next state on the section, time, and normal forces until heel strike."""
        theta, thetadot, phidot = x
        start = np.array([theta, 2 * theta, thetadot, phidot])

        def rates(t, y):
            return np.concatenate([y[2:], self.motion(y)[0]])

        def strike(t, y):
            return y[1] - 2 * y[0]

        def stands(t, y):
            return y[2]

        def down(t, y):
            return y[0] + np.pi / 2

        strike.direction = 1
        stands.terminal = down.terminal = True
        solution = solve_ivp(
            rates,
            (0, 12),
            start,
            method="DOP853",
            rtol=1e-12,
            atol=1e-14,
            dense_output=True,
            max_step=0.05,
            events=[strike, stands, down],
        )
        ahead = [t for t in solution.t_events[0] if t > 1e-3 and solution.sol(t)[0] < 0]
        if not ahead:
            return None, np.nan, np.array([])
        time = ahead[0]
        times = np.linspace(0, time, 200)
        forces = np.array([self.motion(solution.sol(t))[1][1] for t in times])
        (angle, _, stance, relative), _ = self.impact(solution.sol(time))
        return np.array([-angle, stance - relative, -relative]), time, forces


def a_family(cls, count, seed):
    """Walkers of random parameters, with none far from those that walk."""
    near = dict(leg_length=1.2, slope=0.02)
    known = parameters(cls)
    drawn = np.random.default_rng(seed).uniform(-1, 1, (count, len(known)))
    values = {}
    for parameter, random in zip(known, drawn.T, strict=True):
        value = near.get(parameter.name, parameter.default)
        spread = 0.05 if value == 0 else 0.3 * value
        low = 0.0 if parameter.low == 0 else -np.inf
        values[parameter.name] = np.maximum(low, value + spread * random)
    many = jax.tree.map(np.asarray, jax.vmap(lambda one: cls(**one))(values))
    return [jax.tree.map(lambda leaf, i=i: leaf[i], many) for i in range(count)]

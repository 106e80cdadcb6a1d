"""What is said of a stride agrees with the stride, and what does not fit together is found."""

import json
import re
from functools import cache

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import walker_jax as wj
from walker_jax.kernels.program import programs
from walker_jax.walking import explanation, steps_of_modes
from walker_jax.walking.undecided import doubts

WALKER = wj.SimplestWalker(0.009)


@cache
def explained(*x: float) -> explanation.Explanation:
    return wj.explain(WALKER, x)


@pytest.mark.parametrize(
    "x",
    [
        *([0.2, -0.2], [0.2, -0.4], [0.3, -0.1], [0.9, -0.5]),
        pytest.param([0.5, -0.36], marks=pytest.mark.slow),
    ],
    ids=str,
)
def test_the_last_rise_is_what_ended_the_stride(x):
    found, made = explained(*x), wj.stride(WALKER, jnp.array(x))
    assert found.outcome == made.outcome
    if found.outcome == wj.Outcome.OUTSIDE:
        assert found.complaints == ["the start is not feasible"] and found.modes == []
        return
    assert found.complaints == []
    (mode,) = found.modes
    last = mode.rises[-1]
    assert last.admitted and mode.time == last.time
    if found.outcome == wj.Outcome.STRIDE:
        assert last.time == pytest.approx(float(made.time), rel=1e-12)
        np.testing.assert_array_equal(found.state, made.state)
    else:
        assert mode.led_to == last.leads_to
    assert f": {found.outcome.name}\n" in str(found)


def test_another_start_takes_the_same_programs():
    explained(0.2, -0.2)
    known = set(programs)
    assert wj.explain(WALKER, (0.21, -0.21)).outcome == wj.Outcome.STRIDE
    assert set(programs) == known


@pytest.mark.slow
def test_a_rise_that_is_not_admitted_is_told():
    found = wj.explain(wj.systems.SpringMassRunner(), jnp.array([2.0]))
    assert found.outcome == wj.Outcome.BACKWARD and len(found.modes) == 2
    counted = {rise.leads_to: rise.admitted for rise in found.modes[1].rises}
    assert counted == {"BACKWARD": True, "STOPPED": False, "rise": False}
    assert "guard 3 (rise) rose at 0.667038549, not admitted" in str(found)


def test_conditions_have_their_least_values():
    found = explained(0.2, -0.4)
    assert found.modes[0].least["RUNNING"] < 0 and "violated" in str(found)
    margin = wj.margins(WALKER, jnp.array([0.2, -0.2])).running
    least = explained(0.2, -0.2).modes[0].least["RUNNING"]
    assert least == pytest.approx(float(margin), rel=1e-9)


class Spinner(wj.HybridSystem):
    """A clock, with mistakes to choose from."""

    wrong_lift: float = 0.0
    blows_up: float = 0.0

    section = ("angle",)

    def lift(self, x):
        return jnp.stack([x[0] + self.wrong_lift, 0 * x[0]])

    def project(self, state):
        return state[:1] - 2 * np.pi

    def feasible(self, x):
        return jnp.abs(x[0]) < 1

    def modes(self):
        speed = 1 + jnp.sqrt(-self.blows_up)
        field = lambda y: jnp.stack([speed, speed])
        turned = wj.Guard(lambda y: y[1] - 2 * np.pi, wj.SECTION)
        return {"turn": wj.Mode(field, (turned,))}


class Lost(Spinner):
    def project(self, state):
        return state[:1]


class Shut(Lost):
    def modes(self):
        (mode,) = super().modes().values()
        shut = mode.guards[0]._replace(admits=(lambda y: -1 - y[1],))
        return {"turn": mode._replace(guards=(shut,))}


@pytest.mark.parametrize(
    ("system", "complaint"),
    [
        (Lost(0.1), r"project\(lift\(x\)\) is \(0.3\); no stride begins at"),
        (Lost(), r"no stride begins at the next point, \(6.48"),
        pytest.param(
            Shut(),
            "guard 0 of mode 'turn' rose, but was never admitted; mode 'turn' is not ended",
            marks=pytest.mark.slow,
        ),
        (Lost(blows_up=1.0), "the vector field at the start is not finite"),
    ],
    ids=lambda one: one if isinstance(one, str) else type(one).__name__,
)
def test_what_does_not_fit_together_is_found(system, complaint):
    found = wj.explain(system, jnp.array([0.2]))
    assert re.search(complaint, "; ".join(found.complaints))
    *_, first = [line for line in str(found).splitlines() if found.complaints[0] in line]
    several = len(found.complaints) > 1
    assert first == f"! {'first: ' * several}{found.complaints[0]}"
    assert str(found).count("\n! then: ") == len(found.complaints) - 1


def test_modes_are_told_where_lift_and_project_do_not_fit():
    found = wj.explain(Lost(0.1), jnp.array([0.2]))
    (mode,) = found.modes
    assert mode.led_to == wj.SECTION and mode.time == pytest.approx(2 * np.pi, rel=1e-12)


class Switched(Lost):
    """A rate that jumps, or is not finite, past an angle; or a clock that is slow."""

    limit: float = 1.0

    def rate(self, angle):
        return jnp.where(angle > self.limit, 1.5, 1.0)

    def modes(self):
        field = lambda y: {"angle": self.rate(y["angle"]), "clock": 1 + 0 * y["clock"]}
        ends = wj.Guard(lambda y: y["clock"] - 6, wj.SECTION)
        return {"turn": wj.Mode(field, (ends,), most_steps=30)}

    def lift(self, x):
        return {"angle": x[0], "clock": 0 * x[0]}

    def project(self, state):
        return state["angle"][None]


class Vanishing(Switched):
    def rate(self, angle):
        return 1 + 1e-3 * jnp.log(self.limit - angle)


class Slow(Switched):
    def rate(self, angle):
        return jnp.cos(30 * angle)


class Overflowing(Switched):
    def modes(self):
        (mode,) = super().modes().values()
        root = lambda y: y | {"angle": jnp.sqrt(-y["angle"])}
        return {"turn": mode._replace(guards=(mode.guards[0]._replace(reset=root),))}


@pytest.mark.parametrize(
    ("system", "reason"),
    [
        (
            Switched(),
            r"vector field, in gt, line \d+ of test_explanation.py: the rate of angle jumps by 0.5 "
            r"at 0.8, in \(1, 0.8\)",
        ),
        (Vanishing(), r"field is not finite at 0.8.*, from \(1, 0.8.*: the rate of angle"),
        (Slow(), r"none has risen when its 30 steps run out \(most_steps\) at [0-5]\.\d+, in \(0"),
        (Overflowing(limit=9.0), "the state after the last reset is not finite: angle"),
    ],
    ids=lambda one: "" if isinstance(one, str) else type(one).__name__,
)
def test_why_a_stride_is_undecided(system, reason):
    found = wj.explain(system, jnp.array([0.2]))
    assert found.outcome == wj.Outcome.UNDECIDED
    assert re.search(reason, "; ".join(found.complaints))


@pytest.mark.slow
def test_a_solver_that_rejects_all_steps_is_told():
    found = wj.explain(Vanishing(), jnp.array([0.2]), solver=diffrax.Bosh3(), tolerance=1e-4)
    assert found.outcome == wj.Outcome.UNDECIDED
    assert re.search(r"30 steps run out|rejects all steps at 0\.8", found.complaints[0])


class Decaying(Switched):
    """A clock, beside a variable that becomes small, and a step that is smooth."""

    drive: float = eqx.field(static=True, default=1e-30)

    def modes(self):
        (mode,) = super().modes().values()
        smooth = lambda y: 1e-9 * jnp.tanh(y["clock"] - 3)
        driven = lambda y: self.drive * y["clock"] if self.drive else 0.0
        rate = lambda y: -9 * y["angle"] + driven(y)
        field = lambda y: {"angle": rate(y), "clock": 1 + smooth(y)}
        return {"turn": mode._replace(field=field, most_steps=1000)}


def test_noise_and_features_that_may_be_missed_are_told():
    found = wj.explain(Decaying(), jnp.array([0.2]))
    assert found.outcome == wj.Outcome.STRIDE and found.complaints == []
    (mode,) = found.modes
    noise, sharp = mode.doubts
    assert re.match(r"in mode 'turn' angle falls to \S+, beside variables of \S+: .* scales", noise)
    assert re.match(r"the longest step of mode 'turn' takes 0\.\d+: .* longest_step", sharp)
    assert f"? {noise}" in str(found).splitlines()
    times = np.linspace(0.0, 6.0, 60)
    way = [(t, {"angle": jnp.array(0.2 * np.exp(-9 * t)), "clock": jnp.array(t)}) for t in times]
    both, sharp_alone = (
        doubts("turn", Decaying(drive=drive).modes()["turn"], way) for drive in (1e-30, 0)
    )
    assert len(both) == 2 and both[1:] == sharp_alone  # its error is relative to itself
    assert wj.explain(Lost(), jnp.array([0.2])).modes[0].doubts == ()


@pytest.mark.slow
def test_a_variable_that_decays_alone_has_digits():
    alone = wj.explain(Decaying(drive=0), jnp.array([0.2]))
    assert ["longest step" in doubt for doubt in alone.modes[0].doubts] == [True]
    expected = 0.2 * np.exp(-9 * alone.modes[0].time)
    np.testing.assert_allclose(alone.state, expected, rtol=1e-11)


class Begun(Lost):
    """Its first mode is over as it begins."""

    def modes(self):
        (mode,) = super().modes().values()
        back = mode.guards[0]._replace(reset=lambda y: y.at[0].add(-2 * np.pi))
        over = wj.Guard(lambda y: y[1] + 1, "turn")
        return {"over": mode._replace(guards=(over,)), "turn": mode._replace(guards=(back,))}


def test_a_mode_that_is_over_as_it_begins_is_told():
    found = wj.explain(Begun(), jnp.array([0.2]))
    assert found.outcome == wj.Outcome.STRIDE
    assert [one.name for one in found.modes] == ["over", "turn"]
    assert [one.led_to for one in found.modes] == ["turn at once", wj.SECTION]
    assert found.modes[0].time == 0 and found.modes[1].time == pytest.approx(2 * np.pi)
    assert [one.due for one in found.modes] == [0, None]
    assert "  guard 0 (turn) was due as the mode began: 1\n" in str(found)
    assert "did not rise" not in str(found)


class Bouncer(wj.HybridSystem):
    """A ball between a fall and a rise, whose impact multiplies its speed."""

    restitution: float = 0.8
    at_apex: float = 1.0

    section = ("height",)

    def lift(self, x):
        return jnp.stack([x[0], 0 * x[0]])

    def project(self, state):
        return state[:1]

    def modes(self):
        field = lambda y: jnp.stack([y[1], 0 * y[1] - 1])
        bounce = lambda y: y.at[1].multiply(-self.restitution)
        raised = lambda y: y.at[0].multiply(self.at_apex)
        lands = wj.Guard(lambda y: -y[0], "rise", reset=bounce)
        top = wj.Guard(lambda y: -y[1], wj.SECTION, reset=raised)
        energy = lambda y: y[1] ** 2 / 2 + y[0]
        guards = {"fall": (lands,), "rise": (top,)}
        return {name: wj.Mode(field, one, energy=energy) for name, one in guards.items()}


class Motorised(Bouncer):
    def motor_work(self, start, end):
        return start[0] * (self.restitution**2 - 1)


class WithoutEnergy(Bouncer):
    def modes(self):
        return {name: mode._replace(energy=None) for name, mode in super().modes().items()}


@pytest.mark.parametrize(
    ("kind", "changes", "doubtful"),
    [
        (Bouncer, (0.8, 1.0), {}),  # an impact takes energy
        (Bouncer, (1.5, 1.0), {"fall": "'fall' to 'rise' adds 2.5 to an energy of 2: "}),
        (Motorised, (1.5, 1.1), {}),  # and the section may count heights from another place
        pytest.param(Bouncer, (1.0, 1.1), {}, marks=pytest.mark.slow),
        pytest.param(Bouncer, (1.0, 1.0), {}, marks=pytest.mark.slow),
        pytest.param(WithoutEnergy, (1.5, 1.1), {}, marks=pytest.mark.slow),
    ],
)
def test_a_reset_that_adds_energy_is_doubted(kind, changes, doubtful):
    """A speed v becomes 1.5 v, so the energy 2 becomes 4.5."""
    found = wj.explain(kind(*changes), jnp.array([2.0]))
    assert found.outcome == wj.Outcome.STRIDE and found.complaints == []
    assert [mode.name for mode in found.modes if mode.doubts] == [*doubtful]
    for words in doubtful.values():
        assert f"\n? the reset from mode {words}wrong, unless motors" in str(found)


class WithEnergy(wj.SimplestWalker):
    """Of its mass at the hip."""

    def energy(self, state):
        return state.thetadot**2 / 2 + jnp.cos(state.theta - self.slope)


class Leaky(WithEnergy):
    def energy(self, state):
        return super().energy(state) + 0.1 * state.theta


@pytest.mark.slow
def test_energy_that_should_be_constant_is_looked_at():
    sound = wj.explain(WithEnergy(0.009), jnp.array([0.2, -0.2]))
    start, end = sound.modes[0].energy
    assert start == pytest.approx(0.02 + np.cos(0.191), rel=1e-14) and abs(end - start) < 1e-12
    assert sound.complaints == [] and f"energy {start:.9g} at the start" in str(sound)
    found = wj.explain(Leaky(0.009), jnp.array([0.2, -0.2]))
    (complaint,) = found.complaints
    assert complaint.startswith("in mode 'swing' the energy changes by -0.0")
    runner = wj.explain(wj.systems.SpringMassRunner(), jnp.array([1.0]))
    energies = np.array([mode.energy for mode in runner.modes])
    np.testing.assert_allclose(energies, wj.systems.SpringMassRunner().energy, rtol=1e-11)


def test_an_angle_may_be_wrapped():
    found = wj.explain(wj.systems.BouncingBall(), jnp.array([0.8 + 2 * np.pi, 3.1]))
    assert found.outcome == wj.Outcome.STRIDE and found.complaints == [] and found.modes


class Waving(Lost):
    """A clock that counts from its third second on, and when a wave rises."""

    def modes(self):
        ((name, mode),) = super().modes().items()
        wave = wj.Guard(lambda y: jnp.sin(5 * y[1]) - 0.5, wj.SECTION, (lambda y: y[1] - 3,))
        held = wj.Condition(lambda y: 1.25 + jnp.cos(5 * y[1]), "RUNNING")
        return {name: mode._replace(guards=(wave,), conditions=(held,))}


@pytest.mark.parametrize(
    "solver",
    [
        pytest.param(None, id="Taylor"),
        pytest.param(diffrax.Dopri8(), id="Dopri8", marks=pytest.mark.slow),
    ],
)
def test_rises_are_all_of_them(solver):
    """The sine of 5 t rises through a half at (pi / 6 + 2 pi k) / 5."""
    (mode,) = wj.explain(Waving(), jnp.array([0.2]), solver=solver).modes
    times = (np.pi / 6 + 2 * np.pi * np.arange(4)) / 5
    np.testing.assert_allclose([rise.time for rise in mode.rises], times, atol=1e-11)
    assert [rise.admitted for rise in mode.rises] == [False, False, False, True]
    assert mode.time == mode.rises[-1].time and mode.led_to == wj.SECTION
    assert mode.least["RUNNING"] == pytest.approx(0.25, abs=1e-12)


def test_the_command_says_the_same(run):
    words = "explain --slope 0.009 --theta 0.3 --thetadot -0.1".split()
    (code, told, _), (again, answer, _) = run(*words), run(*words, "--json")
    assert code == again == 0
    expected = explained(0.3, -0.1)
    report, _, conclusion = told.rstrip().rpartition("\n")
    words = {"BACKWARD": "falls backward", "FORWARD": "falls forward", "STRIDE": "walks"}
    words |= {"condition RUNNING": "condition (runs)", ", leads to falls": ", the end: falls"}
    said = str(expected)
    for name, word in words.items():
        said = said.replace(name, word)
    assert report == said
    assert "mode swing: " in said and "steps, the end: falls backward\n" in said
    assert conclusion == "Next: walker-jax basin shows which starts go on."
    data = json.loads(answer)
    assert data["outcome"] == "BACKWARD" and data["state"] is None
    assert data["modes"][0]["rises"][0]["time"] == expected.modes[0].rises[0].time
    code, walked, _ = run(*"explain --slope 0.009 --theta 0.2 --thetadot -0.2".split())
    assert code == 0 and "condition (stops on both feet) at the end: 0." in walked
    assert "steps, leads to section\n" in walked and "not the end" not in walked


def test_a_map_is_explained_too():
    found = wj.explain(wj.systems.HenonMap(), jnp.array([0.1, 0.2]))
    assert found.outcome == wj.Outcome.STRIDE and found.modes == []
    np.testing.assert_allclose(found.jacobian, [[-0.28, 1.0], [0.3, 0.0]], rtol=1e-14)
    with pytest.raises(ValueError, match="must not be traced"):
        jax.jit(lambda x: wj.explain(wj.systems.HenonMap(), x))(jnp.zeros(2))


@pytest.mark.parametrize(
    "system",
    [Decaying(), *(pytest.param(one, marks=pytest.mark.slow) for one in (Slow(), Vanishing()))],
    ids=lambda one: one.label(),
)
def test_after_the_steps_that_are_recorded_the_end_is_found(system, monkeypatch):
    x = jnp.array([0.2])
    (whole,), of_whole = (found := wj.explain(system, x)).modes, found.complaints
    monkeypatch.setattr(steps_of_modes, "MOST_RECORDED", 2)
    (part,), of_part = (found := wj.explain(system, x)).modes, found.complaints
    assert (part.steps, part.led_to, of_part) == (whole.steps, whole.led_to, of_whole)
    assert part.steps > 2 and part.time == whole.time and part.rises == whole.rises

"""How far are strides, gaits, bifurcations and areas from reference values?

The reference values are those of `tests/data`, computed elsewhere with 40 digits, or published. In
a minute or two this prints the tables of `docs/accuracy.md` and most of those of
`docs/accuracy-published.md`, and the first of `docs/accuracy-basins.md`, in Markdown. The times are
on standard error.

The answer: none of 68,000 outcomes and as many fates differs. Gaits and period doublings agree to
5e-14, step times to 5e-13, multipliers to 6e-12: half a unit of the last digit given, or little
more. Two published values are not recovered: T1 of the long gait's expansion, which disagrees with
the reference gaits too; and a gait on round feet, from an impact with one term too many. Shortened:

| quantity | slope 0.004, 200 x 250 cells | slope 0.0165, 120 x 150 cells |
| strides | 50000 | 18000 |
| outcomes that differ | 0 | 0 |
| median error of a next state | 1.5e-14 | 2.7e-14 |
| largest error | 7.8e-10 | 1.3e-12 |
| fates that differ | 0 | 0 |
...
| slope | gait | quantity | reference | walker_jax | difference |
| 0.009 | long | theta | 0.2003109005442 | 0.200310900544248 | +4.8e-14 |
|  |  | multipliers 1, 2, real | -0.19009984107 | -0.1900998410659 | +4.1e-12 |
...
| slope, period 1 to 2 | 0.01508843794111946 | 0.015088437941117 | -2.5e-15 |
...
|  | T1 | -0.270837 | -0.18656907 | +8.4e-02 |
...
|  | stance rate | -1.139899112182 | -1.13989911217952 | +2.5e-12 | 11 |
...
| refined to 3200 x 4000 cells | 0.0012074 | 1.1e-07 |
"""

import json
import sys
import time
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import walker_jax as wj
from walker_jax import multibody
from walker_jax.gaits.branches import continue_gaits
from walker_jax.gaits.continuation import start_at_doubling
from walker_jax.gaits.cycles import linearise
from walker_jax.integrators.integrator import Integrator
from walker_jax.kernels.scalars import unroll
from walker_jax.multibody.single_support import coordinates_and_rates
from walker_jax.walkers.model import State
from walker_jax.walkers.parameters import parameters

DATA = Path(__file__).parents[1] / "tests" / "data"
VALUES = json.loads((DATA / "values.json").read_text())
PUBLISHED = json.loads((DATA / "published_gaits.json").read_text())
KNEED = json.loads((DATA / "kneed_walkers.json").read_text())

DRIVER = {  # by Garcia and by Bhounsule, of the simplest walker at 0.009; VALUES has them in words
    "long": [0.20031090049483, -0.19983247291764],
    "short": [0.193937369810188, -0.203866927442012],
}
ROUND_FEET = [0.189472782205104, -0.239124222551699, -0.053691703909393]
"""Printed with Bhounsule's passive walker of 2009, for that of `finite_mass`."""
WINDOW = wj.Grid.sheared(theta=(0, 0.4, 200), sum=(-0.04, 0.01, 250))
SECTION = wj.Grid.plain(theta=(0, np.pi / 4, 120), thetadot=(-1.2, 0, 150))
MAPS = {"strides_slope_0.004": (0.004, WINDOW), "strides_slope_0.0165_plain": (0.0165, SECTION)}
FOLLOWED = 300  # strides, in the reference
FEIGENBAUM = 4.669201609


def table(title: str, header: str, rows: list[list[Any]]) -> None:
    """Print Markdown: a colon in the header marks numbers, leading cells as above stay empty."""
    names = [name.strip() for name in header.split("|")]
    marks = ["---:" if name.endswith(":") else "---" for name in names]
    print(f"**{title}**\n")
    above: list[str] = []
    for row in ([name.removesuffix(":") for name in names], marks, *rows):
        cells = [str(cell) for cell in row]
        same = 0
        while same < len(above) and cells[same] == above[same]:
            same += 1
        print(f"| {' | '.join([''] * same + cells[same:])} |")
        above = cells
    print(flush=True)


def decimals(value: float) -> int:
    """That are printed of a number."""
    return len(f"{value!r}".partition(".")[2])


def compared(reference: float, ours: Any) -> list[str]:
    """A reference value, ours with two decimals more, and the difference."""
    places = decimals(reference)
    more = min(places + 2, 15)
    return [f"{reference:.{places}f}", f"{float(ours):.{more}f}", f"{float(ours) - reference:+.1e}"]


def agreeing(printed: float, ours: Any) -> list[Any]:
    """The same, and how many of the printed decimals agree."""
    away = 2 * abs(ours - printed)
    agree = decimals(printed) if away == 0 else int(np.floor(-np.log10(away)))
    return [*compared(printed, ours), min(agree, decimals(printed))]


def parts(multipliers: Any) -> dict[str, float]:
    """Multipliers as real numbers: of a conjugate pair, its real and its imaginary part."""
    named = {}
    for number, one in enumerate(map(complex, multipliers), 1):
        if one.imag == 0:
            named[f"multiplier {number}"] = one.real
        elif one.imag > 0:
            named[f"multipliers {number}, {number + 1}, real"] = one.real
            named[f"multipliers {number}, {number + 1}, imaginary"] = one.imag
    return named


def known_multipliers(value: dict) -> dict[str, float]:
    return parts(complex(*pair) for pair in value["multipliers"])


def expansion(kind: str, slope: float) -> list[float]:
    """A gait as printed, to first order in the slope: a guess."""
    known = VALUES["small_slope_expansion"][kind]
    theta = known["T0"] * slope ** (1 / 3) + known["T1"] * slope
    return [theta, known["a"] * theta + known["c1"] * slope]


def gaits() -> None:
    rows = []
    for value in VALUES["gaits"]:
        slope = value["slope"]
        guess = None if value["kind"] == "long" else expansion("short", slope)
        gait = wj.find_gait(wj.SimplestWalker(slope), guess)
        known = {"theta": value["state"][0], "thetadot": value["state"][1]}
        known |= {"step time": value["step_time"]} | known_multipliers(value)
        ours = dict(zip(known, [*gait.states[0], gait.step_times[0]], strict=False))
        ours |= parts(gait.multipliers)
        for name, reference in known.items():
            rows.append([slope, value["kind"], name, *compared(reference, ours[name])])
    header = "slope: | gait | quantity | reference: | walker_jax: | difference:"
    table("Gaits of the simplest walker", header, rows)


def derivatives() -> None:
    value, known = VALUES["gaits"][0], VALUES["gait_slope_derivative"]
    walker = wj.SimplestWalker(value["slope"])
    gait = wj.find_gait(walker)
    local = linearise(walker, np.asarray(gait.states)[None], Integrator(1e-12))
    names = ["theta", "thetadot"]
    rows = [
        [f"d(next {names[i]}) / d({names[j]})", *compared(entry, local.jacobian[0, 0, i, j])]
        for i, row in enumerate(value["jacobian"])
        for j, entry in enumerate(row)
    ]
    moves = wj.measure(walker, "states", "slope", gait).gradient[0, :, 0]
    for name, reference, ours in zip(names, known["d_state_d_slope"], moves, strict=True):
        rows.append([f"d({name} of the gait) / d(slope)", *compared(reference, ours)])
    lifted = walker.lift(gait.states[0])
    rows.append(["phidot just after heel strike", *compared(value["swing_velocity"], lifted[3])])
    header = "quantity | reference: | walker_jax: | difference:"
    table("The long gait at a slope of 0.009", header, rows)


def doublings() -> None:
    interval = 0.014, 0.0185
    branch = wj.continue_gait(wj.SimplestWalker(interval[0]), "slope", interval)
    found = []
    while branch.doublings and len(found) < 7:
        found.append(branch.doublings[0])
        start = start_at_doubling(found[-1])
        (branch,) = continue_gaits(wj.SimplestWalker(start.value), "slope", interval, [start])
    known = VALUES["period_doublings"]
    rows = [
        [f"slope, period {value['from']} to {value['to']}", *compared(value["slope"], one.value)]
        for value, one in zip(known, found, strict=False)
    ]
    theta = found[0].states[0, 0]
    rows.append(["theta, period 1 to 2", *compared(known[0]["theta"], theta)])
    apart = np.diff([one.value for one in found])
    header = "period doubling | reference: | walker_jax: | difference:"
    table("Period doublings of the long gait", header, rows)
    rows = [
        [f"{2**i}, {2 ** (i + 1)}, {2 ** (i + 2)}", f"{ratio:.6f}", f"{ratio - FEIGENBAUM:+.1e}"]
        for i, ratio in enumerate(apart[:-1] / apart[1:])
    ]
    header = f"doublings from periods | ratio of distances: | to {FEIGENBAUM}:"
    table("Towards Feigenbaum's ratio", header, rows)


def small_slopes() -> None:
    """As polynomials in slope^(2/3), fitted to gaits at slopes from 1e-5 to 3e-4."""
    slopes, rows = np.geomspace(1e-5, 3e-4, 12), []
    u = np.cbrt(slopes)
    powers = np.stack([u ** (2 * i) for i in range(5)], axis=1)
    fit = lambda basis, values: np.linalg.lstsq(basis, values, rcond=None)[0][:2]
    for kind in ("long", "short"):
        known = VALUES["small_slope_expansion"][kind]
        found = [wj.find_gait(wj.SimplestWalker(slope), expansion(kind, slope)) for slope in slopes]
        theta, thetadot = np.array([gait.states[0] for gait in found]).T / u
        ours = dict(zip(("T0", "T1"), fit(powers, theta), strict=True))
        basis = np.column_stack([theta, powers[:, 1:]])
        ours |= dict(zip(("a", "c1"), fit(basis, thetadot), strict=True))
        times = np.array([gait.step_times[0] for gait in found])
        ours |= dict(zip(("t0", "t1"), fit(powers, times), strict=True))
        for name, value in known.items():
            rows.append([kind, name, *compared(value, ours[name])])
    header = "gait | coefficient | printed: | walker_jax: | difference:"
    table("Expansion for small slopes", header, rows)

    known = VALUES["small_slope_expansion"]["long"]
    remains = lambda theta, slope: (theta - known["T0"] * np.cbrt(slope)) / slope
    exact = sorted(
        (value["slope"], value["state"][0]) for value in VALUES["gaits"] if value["kind"] == "long"
    )
    rows = [[slope, theta, f"{remains(theta, slope):.6f}"] for slope, theta in exact]
    theta = DRIVER["long"][0]
    rows.append(["0.009, Garcia's driver", theta, f"{remains(theta, 0.009):.6f}"])
    slopes, thetas = np.array(exact).T
    limit = np.polynomial.Polynomial.fit(np.cbrt(slopes) ** 2, remains(thetas, slopes), 4)
    rows.append(["to 0, by a polynomial of degree 4 in g^(2/3)", "", f"{limit(0.0):.4f}"])
    table("T1 from reference values alone", "slope g: | theta: | (theta - T0 g^(1/3)) / g:", rows)


def stride_maps() -> None:
    columns, worst = [], []
    for name, (slope, grid) in MAPS.items():
        with np.load(DATA / f"{name}.npz") as data:
            known = {key: data[key] for key in data}
        starts = np.asarray(jax.vmap(grid.centre)(np.arange(grid.size)))
        following = np.stack([known["next_theta"], known["next_velocity"]], axis=-1).reshape(-1, 2)
        walker = wj.SimplestWalker(slope)
        found = wj.strides(walker, starts)
        outcomes = known["outcome"].ravel()
        walks = (outcomes == 0) & (found.outcome == 0)
        errors = np.abs(found.state[walks] - following[walks]).max(axis=1)
        local = linearise(walker, starts[walks][:, None], Integrator(1e-12)).jacobian[:, 0]
        growth = np.linalg.norm(local, 2, axis=(1, 2))
        fates = wj.basin(walker, grid, "direct", strides=FOLLOWED)
        fails = (known["fate"] != 0) & (fates.fate.values == known["fate"])
        differ = (fates.strides.values != known["strides"])[fails].sum()
        columns.append(
            {
                "strides": len(starts),
                "outcomes that differ": int((found.outcome != outcomes).sum()),
                "next states compared": int(walks.sum()),
                "median error of a next state": f"{np.median(errors):.1e}",
                "99 % of the errors are below": f"{np.quantile(errors, 0.99):.1e}",
                "largest error": f"{errors.max():.1e}",
                "largest of error / norm of the Jacobian": f"{(errors / growth).max():.1e}",
                "fates that differ": int((fates.fate.values != known["fate"]).sum()),
                "falls after another number of strides": int(differ),
            }
        )
        for i in np.argsort(-errors)[:3]:
            start = [f"{value:.4f}" for value in starts[walks][i]]
            worst.append([slope, *start, f"{errors[i]:.1e}", f"{growth[i]:.2g}"])
    rows = [[name, *(column[name] for column in columns)] for name in columns[0]]
    header = "quantity | slope 0.004, 200 x 250 cells: | slope 0.0165, 120 x 150 cells:"
    table("Stride maps with 40 digits", header, rows)
    header = "slope: | theta: | thetadot: | error of the next state: | norm of the Jacobian:"
    table("The three largest errors of each", header, worst)


def finite_masses() -> None:
    rows = []
    for value in VALUES["finite_mass"]:
        known = value["state"]
        if value["name"] == "point feet":
            foot = value["leg_mass"] / value["hip_mass"]
            walker = wj.PointFootWalker(value["slope"], foot)
        else:
            walker = wj.RoundFootWalker(**settings_of(value))
        gait = wj.find_gait(walker, [known[name] for name in walker.section])
        full = walker.lift(gait.states[0])._asdict()
        named = {name: (known[name], float(full[name])) for name in State._fields}
        if "step_time" in value:
            named["step time"] = value["step_time"], float(gait.step_times[0])
            ours = parts(gait.multipliers)
            named |= {key: (one, ours[key]) for key, one in known_multipliers(value).items()}
        rows += [[value["name"], name, *agreeing(*pair)] for name, pair in named.items()]
    for kind, state in DRIVER.items():
        gait = wj.find_gait(wj.SimplestWalker(0.009), state)
        for name, printed, ours in zip(("theta", "thetadot"), state, gait.states[0], strict=True):
            rows.append([f"simplest, {kind}", name, *agreeing(printed, ours)])
    header = "walker | quantity | reference: | walker_jax: | difference: | decimals in agreement:"
    table("Reference walkers of finite mass, and printed gaits of the simplest", header, rows)


class ExtraInertia(wj.RoundFootWalker):
    """With one term too many at heel strike: the trailing leg gets the angular momentum
    -leg_inertia phidot about the hip, and the leading leg the opposite one."""

    def impact(self, state):
        def equations(walker, state):
            q, qdot = coordinates_and_rates(state)
            system = walker.system()
            matrix = multibody.block(multibody.mass_matrix(system, q), range(4))
            none = jnp.zeros_like(state.phidot)
            momentum = [none, none, none, -walker.leg_inertia * state.phidot]
            kick = jnp.stack(multibody.solve_factored(multibody.factorise(matrix), momentum))
            return list(multibody.impact(system, walker.swing_foot, q, qdot + kick).velocities)

        u, v, thetadot, phidot = unroll(equations)(self, state)
        return (u, v), State(state.theta, state.phi, thetadot, phidot)


def round_feet() -> None:
    value, rows = VALUES["finite_mass"][1], []
    settings = settings_of(value)
    for name, kind in (("as it is", wj.RoundFootWalker), ("one term too many", ExtraInertia)):
        walker = kind(**settings)
        x = wj.strides(walker, np.array([ROUND_FEET])).state[0]
        for coordinate, printed, ours in zip(walker.section, ROUND_FEET, x, strict=True):
            rows.append([name, coordinate, *compared(printed, ours)])
    header = "impact | coordinate | printed: | after a stride from there: | difference:"
    table("The other printed gait on round feet", header, rows)


def settings_of(value: dict) -> dict[str, float]:
    """A `RoundFootWalker`'s; there leg_length is that to the centre of the foot's arc."""
    settings = {one.name: value[one.name] for one in parameters(wj.RoundFootWalker)}
    return settings | {"leg_length": value["leg_length"] + value["foot_radius"]}


def slope_of(entry: dict) -> float:
    return entry["slope"] if "slope" in entry else float(np.deg2rad(entry["slope_degrees"]))


def on_section(entry: dict) -> list[float]:
    """A published state; legs have length 1, so times are in 1 / sqrt(gravity)."""
    state, unit = entry["state"], np.sqrt(entry["gravity"])
    tilt = slope_of(entry) if entry["convention"] == "vertical" else 0.0
    rate = state["stance_rate"]
    apart = -state["relative_rate"] if "relative_rate" in state else rate - state["swing_rate"]
    return [state["stance"] + tilt, rate / unit, apart / unit]


def as_printed(entry: dict, x: Any) -> dict[str, float]:
    """A state on the section as its source would print it."""
    (theta, thetadot, phidot), unit = x, np.sqrt(entry["gravity"])
    tilt = slope_of(entry) if entry["convention"] == "vertical" else 0.0
    every = {
        "stance": theta - tilt,
        "stance_rate": thetadot * unit,
        "swing": -theta - tilt,
        "swing_rate": (thetadot - phidot) * unit,
        "relative_rate": -phidot * unit,
    }
    return {name: every[name] for name in entry["state"]}


def published() -> None:
    rows, misses, compass = [], [], {}
    for entry in PUBLISHED["gaits"]:
        walker = wj.RoundFootWalker(slope_of(entry), **PUBLISHED["walkers"][entry["walker"]])
        printed, period = on_section(entry), entry["period"]
        gait = wj.find_gait(walker, printed, period)
        compass[entry["name"]] = walker, gait
        ours = as_printed(entry, gait.states[0])
        known = dict(entry["state"])
        if "step_time" in entry:
            known |= {"step time": entry["step_time"]} | known_multipliers(entry)
            ours |= {"step time": gait.step_times[0] / np.sqrt(entry["gravity"])}
            ours |= parts(gait.multipliers)
        for name, value in known.items():
            rows.append([entry["name"], name.replace("_", " "), *agreeing(value, ours[name])])
        x = np.array([printed])
        for _ in range(period):
            x = wj.strides(walker, x).state
        again = as_printed(entry, x[0])
        miss = max(abs(again[name] - value) for name, value in entry["state"].items())
        away = max(abs(ours[name] - value) for name, value in entry["state"].items())
        size = abs(gait.multipliers[0])
        misses.append([entry["name"], f"{away:.1e}", f"{miss:.1e}", f"{size:.4f}"])
    header = "gait | quantity | printed: | walker_jax: | difference: | decimals in agreement:"
    table("Published gaits", header, rows)
    header = (
        "gait | largest difference from ours: | after its strides, the printed state "
        "misses itself by: | largest multiplier of ours:"
    )
    table("How well published gaits repeat themselves", header, misses)

    known, rows = PUBLISHED["compass_gait"], []
    walker, gait = compass["compass gait, 4 deg"]
    interval = np.deg2rad(3.9), np.deg2rad(4.95)
    first = wj.continue_gait(walker, "slope", interval, gait).doublings[0]
    (branch,) = continue_gaits(walker, "slope", interval, [start_at_doubling(first)])
    slopes = np.rad2deg([first.value, branch.doublings[0].value])
    for which, slope in zip(("first", "second"), slopes, strict=True):
        printed = known[f"{which}_doubling_degrees"]
        rows.append([f"{which} period doubling (deg)", *agreeing(printed, slope)])
    _, gait = compass["compass gait, 3 deg"]
    sizes = np.abs(gait.multipliers) ** 2  # of two steps
    for i, (printed, size) in enumerate(
        zip(known["multiplier_sizes_of_two_steps"], sizes, strict=True), 1
    ):
        rows.append([f"modulus of multiplier {i} of two steps, 3 deg", *agreeing(printed, size)])
    header = "compass gait | printed: | walker_jax: | difference: | decimals in agreement:"
    table("Goswami, Thuilot and Espiau (1996)", header, rows)


def kneed_walker(entry: dict) -> wj.KneedWalker:
    """Lengths are in m, so times are in 1 / sqrt(gravity)."""
    same = "hip_mass", "thigh_mass", "shank_mass", "thigh_length", "shank_length"
    return wj.KneedWalker(
        slope_of(entry),
        thigh_com=entry["thigh_length"] - entry["thigh_mass_above_knee"],
        shank_com=entry["shank_length"] - entry["shank_mass_above_foot"],
        foot_radius=entry.get("foot_radius", 0.0),
        **{name: entry[name] for name in same},
    )


def knees() -> None:
    """Gaits of kneed walkers in the units and angles of their sources, and a period doubling."""
    names = {
        "hsu_chen_2007": "Hsu Chen, 0.0504 rad",
        "human_like": "human-like, 2 deg",
        "mcgeer_point_masses": "point masses on round feet, 0.0456 rad",
    }
    rows, found = [], {}
    for key, name in names.items():
        entry, walker = KNEED[key], kneed_walker(KNEED[key])
        known, unit = entry.get("exact") or entry["printed"], np.sqrt(entry["gravity"])
        theta = known["theta"] if "theta" in known else known["q1"] + slope_of(entry)
        first = known.get("q1dot") or known["stance_rate"]
        second = known.get("q2dot") or known["swing_rate"]
        gait = wj.find_gait(walker, [theta, first / unit, (first - second) / unit])
        found[key] = walker, gait
        (theta, thetadot, phidot), times = gait.states[0], wj.phase_times(walker, gait.states[0])
        ours = {
            "q1": theta - slope_of(entry),
            "theta": theta,
            "q1dot": thetadot * unit,
            "stance_rate": thetadot * unit,
            "q2dot": (thetadot - phidot) * unit,
            "swing_rate": (thetadot - phidot) * unit,
            "knee_strike": times[0] / unit,
            "heel_strike": times[1] / unit,
            "step_time": gait.step_times[0] / unit,
        } | parts(gait.multipliers)
        plain = {what: value for what, value in known.items() if what != "multipliers"}
        for what, value in (plain | known_multipliers(known)).items():
            rows.append([name, what.replace("_", " "), *compared(value, ours[what])])
    header = "walker | quantity | reference: | walker_jax: | difference:"
    table("Gaits of walkers with knees", header, rows)

    walker, gait = found["human_like"]
    branch = wj.continue_gait(walker, "slope", (np.deg2rad(2), np.deg2rad(5)), gait)
    (doubling,) = branch.doublings
    rows = [["period 1 to 2 (deg)", "4.8 to 4.9", f"{np.rad2deg(doubling.value):.12f}"]]
    table("Of the human-like walker", "period doubling | reference: | walker_jax:", rows)


def areas() -> None:
    walker = wj.SimplestWalker(0.004)
    with np.load(DATA / "strides_slope_0.004.npz") as data:
        reference = (data["fate"] == 0).sum() * WINDOW.cell_area
    direct = float(wj.basin(walker, WINDOW, "direct").area.sum())
    mapped = float(wj.basin(walker, WINDOW).area.sum())
    refined = wj.refine(walker, WINDOW, 4)
    rows = [
        ["40-digit reference, 200 x 250 cells", f"{reference:.7f}", ""],
        ["direct iteration, the same cells", f"{direct:.7f}", ""],
        ["cell mapping, the same cells", f"{mapped:.7f}", ""],
        [
            "refined to 3200 x 4000 cells",
            f"{float(refined.total_area):.7f}",
            f"{float(refined.total_area_error):.1e}",
        ],
    ]
    table("Area of the basin in the window", "method | area: | standard error:", rows)


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    first = stride_maps, gaits, derivatives, doublings, small_slopes
    for part in (*first, finite_masses, round_feet, published, knees, areas):
        begun = time.perf_counter()
        part()
        print(f"{part.__name__}: {time.perf_counter() - begun:.1f} s", file=sys.stderr)


if __name__ == "__main__":
    main()

"""The paper of Schwab and Wisse (2001), figure by figure and number by number.

*Basin of attraction of the simplest walking model*, ASME DETC2001/VIB-21363. Each part of it is
computed anew and kept as a data set; pictures and numbers follow from these. Where the paper's own
cells show in what it says, its number is found on its own grid, and the exact one stands beside it.
"""

import json
import shutil
from collections.abc import Callable, Sequence
from decimal import Decimal
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Float
from matplotlib.figure import Figure
from scipy.optimize import brentq, minimize_scalar

from walker_jax import figures, poses, report, store
from walker_jax.basin import basin
from walker_jax.bifurcations import bifurcation_diagram
from walker_jax.cells import Grid
from walker_jax.gaits import find_gait, find_gaits
from walker_jax.motion import motion
from walker_jax.progress import console
from walker_jax.refinement import refine
from walker_jax.robustness import default_region
from walker_jax.stride import Outcome, strides
from walker_jax.walkers import PointFootWalker, SimplestWalker, State

SLOPE = 0.004
"""Of the paper's examples."""
START = (0.2, -0.21645)
"""Of Table 1, whose theta + thetadot has one digit more than its thetadot."""
CELL = 0.002, 0.0002
"""Widths of the paper's cells, along theta and theta + thetadot."""
ROW = (0.004, 0.008, 0.012, 0.015, 0.018, 0.02)
"""Slopes of Figure 7, which the paper does not tell."""
TABLE_1 = (
    ("0.2000", "-0.2165", "-0.01645"),
    ("0.1788", "-0.1917", "-0.01290"),
    ("0.1756", "-0.1841", "-0.00850"),
    ("0.1878", "-0.1888", "-0.00100"),
    ("0.1586", "-0.1599", "-0.00134"),
    ("0.1459", "-0.1488", "-0.00295"),
    ("0.1492", "-0.1526", "-0.00337"),
    ("0.1539", "-0.1569", "-0.00302"),
    ("0.1558", "-0.1583", "-0.00256"),
)
FIXED_POINT = ("0.1534", "-0.1561", "-0.00269")


class Size(NamedTuple):
    """How much is computed."""

    section: int
    """Cells along each axis of Figure 2."""
    slopes: int
    """Of Figure 8."""
    levels: int | None
    """Of refinement, for the exact areas of Figure 8; none for none."""
    strides: int
    """After which a walker counts as walking for ever, where walking is lost."""
    shifts: int
    """Of the paper's grid along each axis, in search of where it shows nothing any more."""


FULL = Size(section=1000, slopes=22, levels=3, strides=3000, shifts=4)
QUICK = Size(section=400, slopes=15, levels=None, strides=1000, shifts=2)


class Number(NamedTuple):
    """What the paper says, and what comes out."""

    where: str
    what: str
    printed: str
    ours: str
    agrees: bool
    """At the digits that are printed."""
    why: str
    """It differs, or how it is to be read."""


def reproduce(
    out: Path, *, quick: bool = False, overwrite: bool = False, progress: bool = False
) -> list[Number]:
    """Compute all of the paper's figures and numbers, and write a report of them.

    **Arguments:**

    - `out`: a folder, which is made: `report.html`, a page with everything in it; the figures, as
      PNG and SVG; `numbers.json`; and in `data` the data sets. Those that are there from an earlier
      run, which may have been interrupted, are taken as they are.
    - `quick`: with fewer cells, slopes and strides, and without exact areas.
    - `overwrite`: whether to remove what is there of another run.
    - `progress`: whether to show on a terminal what is being computed.

    **Returns** the numbers. `ValueError` where something else stands in the place.
    """
    size = QUICK if quick else FULL
    request = {"command": "reproduce", "size": size._asdict(), "version": version("walker-jax")}
    places = {name: out / "data" / f"{name}.zarr" for name in PARTS}
    check_place(out, places, request, overwrite=overwrite)
    if overwrite:  # all at once, so that the same run can be gone on with when interrupted
        for path in files_of(out):
            path.unlink(missing_ok=True)
        for path in places.values():
            shutil.rmtree(path, ignore_errors=True)
    (out / "data").mkdir(parents=True, exist_ok=True)
    shown = console(progress)
    data: dict[str, xr.Dataset] = {}
    begun = lambda: any(path.exists() for path in places.values())
    with store.resumable(out, begun, overwrite=overwrite):
        for name, compute in PARTS.items():
            own = request | {"part": name}
            found = store.find(places[name], own)
            if found is None:
                with shown.status(f"{name} ({len(data) + 1} of {len(PARTS)})"):
                    found = store.save(compute(size), places[name], own)
            data[name] = found
        with shown.status("numbers and figures"):
            numbers = compared(data)
            title, images = store.signature(request), []
            for one in FIGURES:
                figure = one.draw(data)
                for path in pictures(out, one):
                    figure.savefig(path, dpi=150, metadata={"Title": title})
                images.append(pictures(out, one)[0].read_bytes())
        kept = {"signature": title, "numbers": [number._asdict() for number in numbers]}
        store.write(out / "numbers.json", json.dumps(kept, indent=1))
        store.write(out / "report.html", html(numbers, images, title, quick=quick))
    return numbers


def check_place(out: Path, places: dict[str, Path], request: dict, *, overwrite: bool) -> None:
    """Refuse a place in which something else would be lost, or that cannot be written to."""
    store.writable(out)
    if not out.exists():
        return
    if not out.is_dir():
        raise store.Occupied(f"{out} exists and is not a folder", store.ELSEWHERE.format("out"))
    store.writable(out / "data")
    if (out / "data").exists():
        for name, path in places.items():
            store.find(path, request | {"part": name}, overwrite=overwrite)
    for path in files_of(out):
        store.check_picture(path, request, overwrite=overwrite, argument="out")


def files_of(out: Path) -> list[Path]:
    """What a report consists of, beside its data sets."""
    figures = [path for one in FIGURES for path in pictures(out, one)]
    return [*figures, out / "numbers.json", out / "report.html"]


def pictures(out: Path, figure: "PaperFigure") -> tuple[Path, Path]:
    """Where a figure goes, as PNG and as SVG."""
    return out / f"figure-{figure.number}.png", out / f"figure-{figure.number}.svg"


def paper_grid(shift: Sequence[float] | Float[np.ndarray, " 2"] = (0, 0)) -> Grid:
    """That of Figure 4: 200 x 250 cells; shifted, by parts of a cell."""
    left, up = np.multiply(CELL, shift)
    return Grid.sheared(theta=(-left, 0.4 - left, 200), sum=(-0.04 + up, 0.01 + up, 250))


def stride_of_gait(size: Size) -> xr.Dataset:
    """Figure 1: one stride of the gait, where its steps are long enough to see."""
    walker = SimplestWalker(0.009)
    return motion(walker, find_gait(walker).states[0], 1, step=0.02)


def section(size: Size) -> xr.Dataset:
    """Figure 2: the whole section."""
    n = size.section
    grid = Grid.plain(theta=(0, np.pi / 4, n), thetadot=(-1.2, 0, n))
    return basin(SimplestWalker(SLOPE), grid, "direct")


def gaits(size: Size) -> xr.Dataset:
    """Figure 3: gaits of period one over the slope, where they double, and what is lost."""
    return bifurcation_diagram(
        SimplestWalker(SLOPE),
        "slope",
        (0.0005, 0.0225),
        period_max=1,
        strides=size.strides,
        scan=2,
    )


def mapped(size: Size) -> xr.Dataset:
    """Figure 4: cell mapping on the paper's own grid."""
    return basin(SimplestWalker(SLOPE), paper_grid())


def followed(size: Size) -> xr.Dataset:
    """Under Figure 5: the same cells, followed directly."""
    return basin(SimplestWalker(SLOPE), paper_grid(), "direct")


def walk(size: Size) -> xr.Dataset:
    """Table 1 and Figures 5 and 6: nine steps from just inside the basin."""
    return motion(SimplestWalker(SLOPE), np.array(START), 9, step=0.02)


def slopes(size: Size) -> xr.Dataset:
    """Figure 7: basins at a row of slopes, in a window that is higher than that of Figure 4.

    The basin rises with the slope.
    """
    grid = Grid.sheared(theta=(0, 0.4, 200), sum=(-0.04, 0.02, 300))
    found = [basin(SimplestWalker(slope), grid, "direct") for slope in ROW]
    kept = [one[["fate", "attractor"]].assign(area=one["area"].sum()) for one in found]
    joined = xr.concat(kept, "slope", coords="minimal", compat="override", combine_attrs="drop")
    return joined.assign_coords(slope=list(ROW)).assign_attrs(found[0].attrs)


def sizes(size: Size) -> xr.Dataset:
    """Figure 8: area of the whole basin over the slope, by the paper's cells and exactly."""
    theta, total = CELL
    grid = Grid.sheared(theta=(0, 392 * theta, 392), sum=(-600 * total, 150 * total, 750))
    at = np.linspace(0.0005, 0.0215, size.slopes).round(6)
    mapped_area, area, error = [], [], []
    for slope in at.tolist():
        walker = SimplestWalker(slope)
        mapped_area.append(float(basin(walker, grid)["area"].sum()))
        region = default_region(walker)
        if size.levels is None or region is None:
            area.append(np.nan)
            error.append(np.nan)
        else:
            fine = refine(walker, region, size.levels)
            area.append(float(fine["total_area"]))
            error.append(float(fine["total_area_error"]))
    over = {"mapped_area": mapped_area, "area": area, "area_error": error}
    return xr.Dataset({name: ("slope", values) for name, values in over.items()}, {"slope": at})


def vanishing(size: Size) -> xr.Dataset:
    """Section 5.2: cells of the paper's own grid that walk for ever, over steep slopes.

    And of grids that are that one shifted by parts of a cell.
    """
    at = np.arange(18, 28) / 1000
    shifts = np.stack(np.divmod(np.arange(size.shifts**2), size.shifts), axis=1) / size.shifts
    cells = [
        [
            int((basin(SimplestWalker(slope), paper_grid(shift))["attractor"] >= 0).sum())
            for slope in at.tolist()
        ]
        for shift in shifts
    ]
    return xr.Dataset({"cells": (("shift", "slope"), cells)}, {"slope": at})


def line(size: Size) -> xr.Dataset:
    """Section 5.1: fates along the line theta = 0.2 of Figure 4."""
    half = 1e-9
    grid = Grid.sheared(theta=(0.2 - half, 0.2 + half, 1), sum=(-0.04, 0.01, 50_000))
    return basin(SimplestWalker(SLOPE), grid, "direct").isel(theta=0)


PARTS: dict[str, Callable[[Size], xr.Dataset]] = {
    "stride": stride_of_gait,
    "section": section,
    "gaits": gaits,
    "mapped": mapped,
    "followed": followed,
    "walk": walk,
    "slopes": slopes,
    "sizes": sizes,
    "vanishing": vanishing,
    "line": line,
}
"""What is computed, by the names of the data sets."""


class PaperFigure(NamedTuple):
    """A figure of the paper."""

    number: int
    title: str
    draw: Callable[[dict[str, xr.Dataset]], Figure]
    text: str


def drawn(axes: Any) -> Figure:
    return axes.get_figure(root=True)


FIGURES = (
    PaperFigure(
        1,
        "A step",
        lambda data: poses.step(data["stride"]),
        "Drawn from a computed stride: the gait at a slope of 0.009, whose steps are longer than "
        "those at 0.004. The swing foot is a little above the ground until the legs are about to "
        "pass each other, below it for a moment between the third pose and the fourth, which the "
        "model allows, and then above it until the heel strike of the last pose.",
    ),
    PaperFigure(
        2,
        "The Poincaré section",
        lambda data: drawn(figures.basin(data["section"])),
        "The whole feasible section at a slope of 0.004, every cell followed until it fails or has "
        "come to the gait: F falls forward, B backward, and R runs (its foot pulls at the ground). "
        "The basin of attraction, which is too narrow for a letter, is dark; the dot is the gait. "
        "At the right border, a few walkers stop on both feet.",
    ),
    PaperFigure(
        3,
        "Fixed points over the slope",
        lambda data: drawn(figures.gait_branches(data["gaits"])),
        "The long gait, the middle line, is stable up to a slope of 0.01509, where it doubles its "
        "period; the short one below it never is, nor is a slower one above, whose leg swings to "
        "and fro once more. A fourth gait differs from that by less than 0.00002.",
    ),
    PaperFigure(
        4,
        "The basin, enlarged and sheared",
        lambda data: drawn(figures.basin(data["mapped"])),
        "Cell mapping on the paper's own grid: 200 × 250 cells, Δθ = 0.002, Δ(θ + θ̇) = 0.0002. A "
        "walker that leaves this window is lost to cell mapping; in the figure below each is "
        "followed to its end.",
    ),
    PaperFigure(
        5,
        "Nine steps towards the fixed point",
        lambda data: poses.steps_over_basin(data["followed"], data["walk"]),
        "From just inside the first tail of the basin. The basin is that of the same cells, each "
        "followed directly.",
    ),
    PaperFigure(
        6,
        "Leg angles on that walk",
        lambda data: drawn(poses.leg_angles(data["walk"])),
        "The legs exchange roles at every heel strike, the thin lines.",
    ),
    PaperFigure(
        7,
        "The basin at increasing slopes",
        lambda data: figures.basins_in_a_row(data["slopes"]),
        "The paper does not print its slopes. Where the basin is largest it has smooth edges; at "
        "steeper slopes fingers of failure reach into it; beyond 0.01905 it is lost.",
    ),
    PaperFigure(
        8,
        "Stability, and area of the basin",
        lambda data: drawn(figures.stability_and_area(data["gaits"], data["sizes"])),
        "The gait is most stable at a slope of 0.0138, and the basin is largest on the smallest "
        "slope: one says nothing about the other. Areas are those of the whole section up to "
        "θ = π/4, by cells of the paper's size, and by refinement.",
    ),
)


def compared(data: dict[str, xr.Dataset]) -> list[Number]:
    """Every number of the paper's text and table, with ours."""
    walker = SimplestWalker(SLOPE)
    gait = find_gait(walker)
    theta, thetadot = map(float, gait.states[0])
    states = data["walk"]["states"].values
    names = "θ", "θ̇", "θ + θ̇"
    found = [
        close("Fig. 2", f"{name} of the cyclic motion", text, value)
        for name, text, value in zip(names, FIXED_POINT, (theta, thetadot), strict=False)
    ]
    for step, row in enumerate(TABLE_1, 1):
        values = *states[step - 1], states[step - 1].sum()
        found += [
            close("Table 1", f"step {step}, {name}", text, float(value))
            for name, text, value in zip(names, row, values, strict=True)
        ]
    found += [
        close("Table 1", f"fixed point, {name}", text, value)
        for name, text, value in zip(
            names, FIXED_POINT, (theta, thetadot, theta + thetadot), strict=True
        )
    ]
    return [*found, *of_section_3(), *of_section_4(data, walker), *of_section_5(data, walker)]


def of_section_3() -> list[Number]:
    """The impact, of a walker whose feet have next to no mass, by the general method."""
    theta, rate = -0.25, -0.3
    walker = PointFootWalker(SLOPE, 1e-9)
    strike = State(*map(jnp.asarray, (theta, 2 * theta, rate, 0.1)))
    (u, v), after = walker.impact(strike)
    along, above = walker.impulse(strike)
    s, c = np.sin(2 * theta) * rate, np.cos(2 * theta)
    sine, cosine = np.sin(theta), np.cos(theta)
    slip = (
        "One component of (19) has the wrong sign: the impulse is directed along the swing leg, as "
        "the text says. For the impulse of the ground on the walker, which is upward, it is this."
    )
    formulas = (
        ("(18)", "u̇⁺, to -sin θ cos 2θ sin 2θ θ̇⁻", u, -sine * c * s, ""),
        ("(18)", "v̇⁺, to cos θ cos 2θ sin 2θ θ̇⁻", v, cosine * c * s, ""),
        ("(18)", "θ̇⁺, to cos²2θ θ̇⁻", after.thetadot, c**2 * rate, ""),
        ("(18)", "φ̇⁺, to cos 2θ (cos 2θ - 1) θ̇⁻", after.phidot, c * (c - 1) * rate, ""),
        ("(19)", "ρ_x, to -sin θ sin 2θ θ̇⁻", along, -sine * s, slip),
        ("(19)", "ρ_y, to cos θ sin 2θ θ̇⁻", above, cosine * s, ""),
        ("3.2", "size of the impulse, to sin 2θ θ̇⁻", np.hypot(along, above), np.abs(s), ""),
        ("3.2", "speed of the stance foot, to cos 2θ sin 2θ θ̇⁻", np.hypot(u, v), np.abs(c * s), ""),
    )
    return [
        close(where, what, "1", float(ours) / float(printed), 6, why)
        for where, what, ours, printed, why in formulas
    ]


def of_section_4(data: dict[str, xr.Dataset], walker: SimplestWalker) -> list[Number]:
    """Step-to-step behaviour."""
    at = lambda *values: State(*map(jnp.asarray, values))
    force: Any = lambda rate: float(walker.contact_force(at(SLOPE, 0.0, rate, 0.0))[1])
    fastest: Any = brentq(force, -2.0, -0.1)

    def following(angle: float) -> float:
        """The rate of the stance leg after heel strike at an angle."""
        _, after = walker.impact(at(angle, 2 * angle, -1.0, 0.0))
        return float(walker.exchange_legs(after).thetadot)

    turning: Any = following
    widest: Any = brentq(turning, -1.2, -0.4)
    edge = backward_edge(walker, np.array([0.1, 0.2, 0.3]))
    inclination = float(np.degrees(np.arctan((edge[2] - edge[0]) / 0.2)))
    folds = data["gaits"]["event_fold"].values
    doubling = float(data["gaits"]["event_value"].values[~folds].min())
    count = len(find_gaits(walker, 1))
    froude = "Froude number at which the contact force vanishes, leg upright"
    slower = "The long and the short gait, and slower ones whose leg swings to and fro once more."
    return [
        close("4.1", "θ from which a heel strike turns the walker back, π/4", "0.7854", -widest),
        close("4.1", froude, "1", fastest**2, 3),
        close("4.1", "θ + θ̇ on the boundary to B, at θ = 0.2: γ", "0.004", float(edge[1]) + 0.2),
        close("5.1", "inclination of that boundary, degrees", "-45", inclination),
        close("4.2", "slope up to which the gait is stable", "0.015", doubling),
        close("5.2", "the same, after Garcia and others (1998)", "0.0151", doubling),
        Number(
            where="4",
            what="cyclic solutions of period one",
            printed="one or two",
            ours=str(count),
            agrees=count in (1, 2),
            why="" if count in (1, 2) else slower,
        ),
    ]


def of_section_5(data: dict[str, xr.Dataset], walker: SimplestWalker) -> list[Number]:
    """Results."""
    fate = Outcome(int(strides(walker, np.array([[0.2, -0.23]])).outcome[0])).name
    walks = data["line"]["attractor"].values >= 0
    crossings = int((np.diff(walks.astype(int), prepend=0) > 0).sum())
    at = data["vanishing"]["slope"].values
    empty = data["vanishing"]["cells"].values == 0
    gone = np.where(empty.any(axis=1), at[empty.argmax(axis=1)], np.inf)
    below, above = map(float, data["gaits"]["lost"].values)
    radius = lambda slope: float(np.abs(find_gait(SimplestWalker(slope)).multipliers[0]))
    best: Any = minimize_scalar(radius, bounds=(0.008, 0.015), method="bounded")
    coarse = min((0.008, 0.010, 0.012, 0.014, 0.016), key=radius)
    areas = data["sizes"]["mapped_area"].values
    largest = float(data["sizes"]["slope"].values[areas.argmax()])
    vanished = "slope at which the basin has vanished"
    return [
        Number(
            where="5.1",
            what="fate of (0.2, -0.23)",
            printed="F",
            ours=fate[0],
            agrees=fate == "FORWARD",
            why="",
        ),
        Number(
            where="5.1",
            what="crossings of the basin along θ = 0.2",
            printed="at least 4",
            ours=str(crossings),
            agrees=crossings >= 4,
            why="",
        ),
        close(
            *("5.2", f"{vanished}, on the paper's grid", "0.022", float(gone[0])),
            why="The first slope, in steps of 0.001, at which no cell walks for ever. It depends "
            f"on where cells lie: from {gone.min():.3f} to {gone.max():.3f} on {len(gone)} grids, "
            "this one and others shifted by parts of a cell. From 0.0205 on only a few are left, "
            "each with an unstable gait that seems to stand still in it.",
        ),
        Number(
            where="5.2",
            what=f"{vanished}, followed directly",
            printed="0.022",
            ours=f"{np.floor(below * 1e5) / 1e5:.5f} to {np.ceil(above * 1e5) / 1e5:.5f}",
            agrees=bool(below <= 0.022 <= above),
            why="No cells. Between these slopes the chaotic attractor, to which the gait has come "
            "by doubling its period, is lost, and walkers fall after some hundred strides.",
        ),
        close(
            *("5.2", "slope of the most stable gait", "0.012", float(best.x)),
            why="Two complex multipliers meet on the real axis there; their modulus shrinks up to "
            "that slope, and that of the larger one grows steeply beyond it. Of slopes that are "
            f"0.002 apart, {coarse:g} has the most stable gait.",
        ),
        Number(
            where="5.2",
            what="is the basin largest there?",
            printed="no",
            ours="no" if largest < 0.011 else "yes",
            agrees=largest < 0.011,
            why=f"It is largest at the smallest slope measured, {largest:g}.",
        ),
    ]


def backward_edge(walker: SimplestWalker, theta: np.ndarray) -> np.ndarray:
    """The rate at which walkers begin to fall backward in their first stride, at each angle."""
    slow, fast = np.full(len(theta), -1e-6), -2 * theta
    for _ in range(50):
        middle = (slow + fast) / 2
        ends = strides(walker, np.stack([theta, middle], axis=1))
        falls = np.asarray(ends.outcome) == Outcome.BACKWARD
        slow, fast = np.where(falls, middle, slow), np.where(falls, fast, middle)
    return (slow + fast) / 2


def close(
    where: str, what: str, printed: str, ours: float, digits: int | None = None, why: str = ""
) -> Number:
    """A number that is printed to some digits, and ours with three more."""
    places = -int(Decimal(printed).as_tuple().exponent)
    agrees = bool(abs(ours - float(printed)) <= 0.5 * 10.0**-places * (1 + 1e-9))
    digits = places + 3 if digits is None else digits
    return Number(where, what, printed, f"{ours:.{digits}f}", agrees, why)


def html(numbers: list[Number], images: list[bytes], signature: str, *, quick: bool) -> str:
    """The report."""
    differ = [number for number in numbers if not number.agrees]
    rows = lambda chosen: [
        (one.where, one.what, one.printed, one.ours, "✓" if one.agrees else "differs", one.why)
        for one in chosen
    ]
    head = ("section", "number", "printed", "ours", "", "why")
    size = "with fewer cells and slopes than in full" if quick else "in full"
    intro = (
        f"{len(numbers)} numbers of the paper's text and table are compared, at the digits that "
        f"are printed: {len(numbers) - len(differ)} agree, {len(differ)} differ, and each of these "
        "has its reason beside it. Computed "
        f"{size} by walker_jax {version('walker-jax')}. Lengths are in units of the leg, times in "
        "√(l/g), angles in rad."
    )
    blocks = [report.table("What differs", head, rows(differ))]
    blocks += [
        report.picture(f"Figure {one.number}. {one.title}", image, one.text)
        for one, image in zip(FIGURES, images, strict=True)
    ]
    blocks.append(report.table("All numbers", head, rows(numbers)))
    title = "Basin of attraction of the simplest walking model"
    subtitle = "A. L. Schwab and M. Wisse, ASME DETC2001/VIB-21363 (2001), reproduced"
    return report.page(title, subtitle, intro, blocks, signature)

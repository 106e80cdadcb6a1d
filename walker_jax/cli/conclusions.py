"""The last sentence of a command's answer: what the answer means, and what to do next."""

from collections.abc import Mapping, Sequence
from typing import Any

from walker_jax.systems.outcomes import outcome_in_words


def conclude_walk(outcomes: Sequence[str]) -> str:
    """Write the conclusion of `walk` from the outcomes of its strides."""
    last, count = outcomes[-1], len(outcomes)
    if last == "STRIDE":
        made = "all its strides" if count > 1 else "this stride"
        return f"It makes {made}: a larger --strides shows whether it goes on."
    words = outcome_in_words(last)
    return f"The end ({words}) comes in stride {count}: walker-jax explain, from there, says why."


def conclude_explanation(outcome: str, complaints: Sequence[str]) -> str:
    """Write the conclusion of `explain`."""
    if complaints:
        return "The model does not fit together: mend what the lines with ! say, and explain again."
    if outcome == "STRIDE":
        return "This stride leads to the next one: walker-jax walk, from there, follows them."
    words = outcome_in_words(outcome)
    return f"The walk ends here ({words}): walker-jax basin shows which starts walk on."


def conclude_gaits(stable: int, count: int) -> str:
    """Write the conclusion of `gait`."""
    if not stable:
        return (
            "Walks leave an unstable gait: walker-jax bifurcation shows for which parameters one "
            "is stable."
        )
    which = "it" if count == 1 else f"{stable} of these {count}"
    return f"Nearby walks converge to {which}: walker-jax basin shows from where."


def conclude_basin(share: float, *, at_border: bool, refined: bool, zoomed: bool) -> str:
    """Write the conclusion of `basin` from the share of its cells that belong to a basin."""
    if not share:
        return (
            "No start in this window converges: walker-jax gait tells where a gait is, to put the "
            "window there."
        )
    part = f"{share:.2%} of these starts converge to an attractor"
    if zoomed:
        return f"{part}: a larger --zoom goes deeper into the boundary."
    if at_border:
        return f"{part}, and so do some beyond the window: widen its axes to see all of the basin."
    if refined:
        return f"{part}: walker-jax robustness tells how large a disturbance the gait survives."
    return f"{part}: --levels 2 gives the size of the basin with its error."


def conclude_boundary(fractal: bool | None) -> str:
    """Write the conclusion of `boundary`."""
    if fractal:
        return (
            "Near a fractal boundary hardly any accuracy of the start foretells its fate: "
            "walker-jax basin --zoom 1e4 shows why."
        )
    return "Nothing here says that the boundary is fractal: a finer grid is a stricter test."


def conclude_robustness(rows: Sequence[Mapping[str, Any]], name: str) -> str:
    """Write the conclusion of `robustness` from its measures at values of the named parameter."""
    known = [row for row in rows if row["gait"] is not None]
    sized = [row for row in known if row["least_disturbance"]["failure"] is not None]
    if not known:
        return "Without an attracting gait there is nothing to disturb: try other parameters."
    if not sized:
        return "No disturbance that was tried is too large: --disturbances sets larger ones."
    size = lambda row: row["least_disturbance"]["size"]
    best = max(sized, key=size)
    if len(rows) > 1:
        where = f"{name} {best[name.replace('-', '_')]:g}"
        return (
            f"The gait bears most, {size(best):.3g} in the worst direction, at {where}: "
            "walker-jax optimise searches between these values."
        )
    return (
        f"In the worst direction a disturbance of {size(best):.3g} is enough to lose the gait: "
        "--from and --to show how that depends on a parameter."
    )


def conclude_fall(*, filmed: bool) -> str:
    """Write the conclusion of `fall`."""
    return "On slightly rough ground nearly all falls are like this one" + (
        "." if filmed else ": --animate fall.gif shows it."
    )


def conclude_bifurcations(doublings: Sequence[float], over: str) -> str:
    """Write the conclusion of `bifurcation` from the values where the most stable gait doubles."""
    if not doublings:
        return (
            f"The most stable gait does not double its period for any {over} in this range: a "
            "wider one may show where it does."
        )
    return (
        f"Past the first doubling, at {over} {doublings[0]:.6g}, a cycle has two strides: "
        "walker-jax chart follows such points over a second parameter."
    )


def conclude_chart(curves: int) -> str:
    """Write the conclusion of `chart`."""
    if not curves:
        return "One kind of motion has all of this chart: wider ranges may hold others."
    return (
        "Across a curve the motion changes its period or ends: walker-jax bifurcation shows all "
        "gaits along one parameter."
    )


def conclude_continuation(attractors: Sequence[Mapping[str, Any]]) -> str:
    """Write the conclusion of `continuation`."""
    if not attractors:
        return "No start converges: try another --over, or a region that holds a gait."
    best = max(attractors, key=lambda one: one["largest_fraction"])
    return (
        f"A random start of the region converges most often to attractor {best['number']}: more "
        "--samples make these fractions more precise."
    )


def conclude_sweep(rows: Sequence[Mapping[str, Any]], names: Sequence[str]) -> str:
    """Write the conclusion of `sweep` from the rows of its table."""
    known = [row for row in rows if row["total_area"] > 0]
    if not known:
        return "No basin has any area: try other values, or a region that holds a gait."
    best = max(known, key=lambda row: row["total_area"])
    where = ", ".join(f"{name.replace('_', '-')} {best[name]:.6g}" for name in names)
    return f"The basin is largest at {where}: walker-jax optimise searches between these values."


def conclude_optimum(answer: Mapping[str, Any]) -> str:
    """Write the conclusion of `optimise`."""
    if answer["out_of_time"]:
        return "The search is not over: the same command goes on with it."
    if answer["at_bound"]:
        bounded = ", ".join(answer["at_bound"])
        return f"The best values may lie beyond the bound of {bounded}: a wider --bound would tell."
    return "No small change improves on it: another --seed tells whether a better one is farther."


def conclude_proof(*, proved: bool) -> str:
    """Write the conclusion of `prove`."""
    if proved:
        return "All of it is proved, whatever the rounding: proofs.md says what a proof rests on."
    return "Open cells are neither proved to walk nor to fall: more --levels decide more of them."


def conclude_kernel(area: float, passive: float) -> str:
    """Write the conclusion of `viable` from the areas of the kernel and of the passive basin."""
    if not area:
        return "No choice of these actions walks for ever: try a wider range of them."
    factor = f", {area / passive:.3g} times that of the passive basin" if passive else ""
    return f"No controller with these actions has a larger basin than the kernel{factor}."

"""The last sentence of a command's answer: what the answer means, and what to do next."""

from collections.abc import Mapping, Sequence
from typing import Any

from walker_jax.systems.outcomes import outcome_in_words


def conclude_walk(outcomes: Sequence[str], *, rough: bool) -> str:
    """Write the conclusion of `walk` from the outcomes of its strides, on rough ground or not."""
    last, count = outcomes[-1], len(outcomes)
    if last == "STRIDE":
        made = "all its strides" if count > 1 else "this stride"
        return f"It makes {made}: a larger --strides shows whether it goes on."
    end = f"The end ({outcome_in_words(last)}) comes in stride {count}"
    if rough:
        return f"{end}: another --seed gives other ground."
    return f"{end}: walker-jax explain, from there, says why."


def conclude_explanation(outcome: str, complaints: Sequence[str]) -> str:
    """Write the conclusion of `explain`."""
    if outcome == "OUTSIDE":
        return "This start is not feasible: walker-jax gait gives one that is."
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
            "No start in this window converges to an attractor: walker-jax gait tells where a gait "
            "is, and whether it is stable."
        )
    part = f"{share_in_words(share)} of these starts converge to an attractor"
    if zoomed:
        return f"{part}: a larger --zoom goes deeper into the boundary."
    if at_border:
        return f"{part}, and the basin reaches the window's border: wider axes may show more of it."
    if refined:
        return f"{part}: walker-jax robustness tells how large a disturbance the gait survives."
    return f"{part}: --levels 2 gives the size of the basin with its error."


def share_in_words(share: float) -> str:
    """Write a share in percent; one that is nearly none or nearly all is not rounded to that."""
    if share == 1:
        return "All"
    if share < 1e-4:
        return "Less than 0.01%"
    return "More than 99.99%" if share > 0.9999 else f"{share:.2%}"


def conclude_boundary(*, found: bool, fractal: bool) -> str:
    """Write the conclusion of `boundary`."""
    if not found:
        return (
            "No boundary between fates or attractors was found in this window: "
            "wider axes may hold one."
        )
    if fractal:
        return (
            "Near a fractal boundary hardly any accuracy of the start foretells its fate: "
            "walker-jax basin --zoom 1e4 shows why."
        )
    return "Nothing here says that the boundary is fractal: a finer grid is a stricter test."


def conclude_robustness(rows: Sequence[Mapping[str, Any]], name: str) -> str:
    """Write the conclusion of `robustness` from its measures at values of the named parameter."""
    known = [row for row in rows if row["gait"] is not None]
    if not known:
        return "Without an attracting gait there is nothing to disturb: try other parameters."
    where = lambda row: f"{name} {row[name.replace('-', '_')]:g}"
    unsized = [row for row in known if row["least_disturbance"]["failure"] is None]
    if unsized:
        place = f", at {where(unsized[0])}" if len(rows) > 1 else ""
        return f"The gait survives all disturbances that were tried{place}."
    size = lambda row: row["least_disturbance"]["size"]
    best = max(known, key=size)
    if len(rows) > 1:
        return (
            f"The gait bears most, {size(best):.3g} in the worst direction, at {where(best)}: "
            "walker-jax optimise searches between these values."
        )
    return (
        f"In the worst direction a disturbance of {size(best):.3g} is enough to lose the gait: "
        "--from and --to show how that depends on a parameter."
    )


def conclude_fall(*, converged: bool, chosen: bool, steps_only: bool, filmed: bool) -> str:
    """Write the conclusion of `fall`; whether its way was chosen, and whether only steps vary."""
    if not converged:
        return "The search has not converged, so another fall may be more probable: vary --strides."
    where = "On slightly rough ground" if steps_only else "Under slight disturbances"
    falls = "falls of this kind" if chosen else "falls"
    film = ": --animate fall.gif shows it." if steps_only and not filmed else "."
    return f"{where} nearly all {falls} are like this one{film}"


def conclude_bifurcations(doublings: Sequence[tuple[float, int]], over: str, *, found: bool) -> str:
    """Write the conclusion of `bifurcation`.

    The doublings are those of the most stable gait, if one was found: each is the value of the
    parameter, and the period of the cycle that branches off.
    """
    if not found:
        return f"No gait of period one was found for any {over} in this range: try another one."
    if not doublings:
        return (
            f"The most stable gait does not double its period for any {over} in this range: a "
            "wider one may show where it does."
        )
    value, period = doublings[0]
    return (
        f"At {over} {value:.6g} a cycle of period {period} branches off: walker-jax chart follows "
        "such points over a second parameter."
    )


def conclude_chart(curves: int, kinds: int) -> str:
    """Write the conclusion of `chart` from its number of curves and of kinds of cells."""
    if not curves and kinds > 1:
        return (
            "No curve of bifurcations crosses the two lines of the search: the kinds of cells meet "
            "at crises, or at curves that were missed."
        )
    if not curves:
        return "All cells of this chart are of one kind: wider ranges may hold others."
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
        f"The largest fraction at any one value, {best['largest_fraction']:.3%}, converges to "
        f"attractor {best['number']}: more --samples make these fractions more precise."
    )


def conclude_sweep(rows: Sequence[Mapping[str, Any]], names: Sequence[str]) -> str:
    """Write the conclusion of `sweep` from the rows of its table."""
    if all(row["failed"] for row in rows):
        return "Nothing could be computed: the lines above say why."
    known = [row for row in rows if row["total_area"] > 0]
    if not known:
        return "No basin has any area: try other values, or a region that holds a gait."
    if len(rows) == 1:
        return "This is one combination: more values of --over show where the basin is largest."
    best = max(known, key=lambda row: row["total_area"])
    where = ", ".join(f"{name.replace('_', '-')} {best[name]:.6g}" for name in names)
    return f"The basin is largest at {where}: walker-jax optimise searches between these values."


def conclude_optimum(answer: Mapping[str, Any]) -> str:
    """Write the conclusion of `optimise`."""
    if answer["out_of_time"]:
        return "The search is not over: the same command goes on with it."
    if not answer["converged"]:
        return (
            "The search ended before it converged: one that starts from the optimum may find a "
            "better one."
        )
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
    where = "In this window, as far as the grid tells,"
    if not area:
        return f"{where} no choice of these actions walks for ever: try a wider range of them."
    factor = f", {area / passive:.3g} times that of the passive basin" if passive else ""
    return f"{where} no controller with these actions has a larger basin than the kernel{factor}."

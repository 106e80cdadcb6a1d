"""Removal of the equations of a jaxpr whose results are not used.

JAX has rules for functions that are called, but none for a `lax.while_loop`: what a loop carries
may be used by nothing but its own next turn.
"""

from itertools import compress
from operator import or_

from jax.extend.core import ClosedJaxpr, JaxprEqn, primitives
from jax.interpreters import partial_eval


def without_unused(closed: ClosedJaxpr) -> ClosedJaxpr:
    """Return a jaxpr of the same arguments and results without equations that none depends on."""
    used = [True] * len(closed.jaxpr.outvars)
    jaxpr, _ = partial_eval.dce_jaxpr(closed.jaxpr, used, instantiate=True)
    return ClosedJaxpr(jaxpr, closed.consts)


def prune_loop(used: list[bool], equation: JaxprEqn) -> tuple[list[bool], JaxprEqn | None]:
    """Return which operands of a loop are used if some results are, and what is left of it."""
    if equation.effects:
        return [True] * len(equation.invars), equation
    if not any(used):
        return [False] * len(equation.invars), None
    params, prune = equation.params, partial_eval.dce_jaxpr
    condition, body = params["cond_jaxpr"], params["body_jaxpr"]
    fixed, more = [True] * params["cond_nconsts"], params["body_nconsts"]
    needed, old = prune(condition.jaxpr, [True])[1][len(fixed) :], []
    used = [*map(or_, used, needed)]
    while used != old:  # what is carried may need more of what is carried
        turn, needed = prune(body.jaxpr, used, [False] * more + used)
        old, used = used, [*map(or_, used, needed[more:])]
    others = needed[:more]
    asks = prune(condition.jaxpr, [True], fixed + used)[0]
    changed = {
        "cond_jaxpr": ClosedJaxpr(asks, condition.consts),
        "body_jaxpr": ClosedJaxpr(turn, body.consts),
        "body_nconsts": sum(others),
    }
    operands = [*fixed, *others, *used]
    return operands, equation.replace(
        invars=[*compress(equation.invars, operands)],
        outvars=[*compress(equation.outvars, used)],
        params={**params, **changed},
    )


partial_eval.dce_rules.setdefault(primitives.while_p, prune_loop)

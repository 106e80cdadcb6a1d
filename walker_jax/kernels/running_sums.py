"""Long arrays to which each turn of a loop adds, such as the cotangents of a network's weights.

The loop adds to the memory of the sum, in lanes that have not ended. Otherwise each turn would
write a new sum, and copy it to the old one.
"""

from collections import Counter
from typing import Any, NamedTuple, no_type_check

from jax.extend.core import ClosedJaxpr, JaxprEqn, Literal

from walker_jax.kernels.stored import Stored, is_long, is_long_product
from walker_jax.kernels.stored_products import add_product


class RunningSum(NamedTuple):
    """A value that a loop carries, to which its turns add."""

    place: int
    """Its place among the values that are carried."""
    parts: slice
    """Places of the results of a turn that are added: one array, or both factors of a product."""
    product: JaxprEqn | None


@no_type_check  # variables have no public type
def take_out_sums(body: ClosedJaxpr, constants: int) -> tuple[ClosedJaxpr, list[RunningSum]]:
    """Return the body of a loop without the additions to its running sums, and these.

    The body then returns, in place of a sum, its old value, and after all others what is added.
    """
    jaxpr = body.jaxpr
    carried, results = jaxpr.invars[constants:], list(jaxpr.outvars)
    uses = Counter(one for equation in jaxpr.eqns for one in equation.invars if is_variable(one))
    uses.update(filter(is_variable, results))
    makes = {one: equation for equation in jaxpr.eqns for one in equation.outvars}
    dropped, found = set(), []
    for i, (old, new) in enumerate(zip(carried, jaxpr.outvars, strict=True)):
        last = makes.get(new) if is_variable(new) and is_long(new.aval) else None
        if last is None or last.primitive.name not in ("add", "add_any") or uses[new] > 1:
            continue
        others = [one for one in last.invars if one is not old]
        if len(others) != 1 or uses[old] > 1 or others[0].aval.shape != new.aval.shape:
            continue
        product = makes.get(others[0]) if is_variable(others[0]) and uses[others[0]] == 1 else None
        product = product if product is not None and is_long_product(product) else None
        parts = others if product is None else product.invars
        found.append(RunningSum(i, slice(len(results), len(results) + len(parts)), product))
        results += parts
        results[i] = old
        dropped |= {id(last), id(product)}
    left = [equation for equation in jaxpr.eqns if id(equation) not in dropped]
    return ClosedJaxpr(jaxpr.replace(eqns=left, outvars=results), body.consts), found


def is_variable(one: Any) -> bool:
    return not isinstance(one, Literal)


@no_type_check  # as the emitter
def add_to(emitter, sums: list[RunningSum], buffers: list[Stored], results: list, flag: Any):
    """Add what a turn returns to the memory of each running sum, in the lanes of a flag."""
    store, builder = emitter.store, emitter.builder
    for one, buffer in zip(sums, buffers, strict=True):
        parts = results[one.parts]
        if one.product is not None:
            add_product(emitter, one.product, parts, buffer, flag)
            continue
        part = store.in_memory(parts[0], buffer.dtype)
        stored = isinstance(part, Stored)

        def act(offsets, buffer=buffer, part=part, stored=stored):
            old = store.load(buffer, offsets[0])
            more = store.load(part, offsets[1]) if stored else emitter.vector(part, buffer.dtype)
            new = builder.arithmetic("fadd", old, more)
            store.store(buffer, offsets[0], builder.select(flag, new, old))

        store.for_each(buffer.shape, [buffer, part if stored else None], act)

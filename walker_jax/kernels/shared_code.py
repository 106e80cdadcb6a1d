"""Kernels within kernels: each calls the machine code of the other.

A walk makes strides, and so do maps of cells and searches for attractors. The machine code of a
stride is made once for all of them: within a kernel, a call of another, large one is a primitive
of its own, and the emitter writes it as a call of that kernel's machine code. Everything else that
meets it takes the function instead: derivatives, `vmap`, XLA, threads on a GPU, and interpreters
of jaxprs.
"""

import functools
from collections.abc import Sequence
from typing import Any

import jax
from jax.experimental import jet
from jax.extend.core import ClosedJaxpr, Primitive, jaxpr_as_fun
from jax.interpreters import ad, batching, mlir

from walker_jax.kernels.jaxprs import SHARED_CALL
from walker_jax.kernels.jets import push_series

shared_call_p = Primitive(SHARED_CALL)
shared_call_p.multiple_results = True


def call_shared(program: Any, leaves: Sequence[jax.Array]) -> list[jax.Array]:
    """Call a program within another kernel; a small one becomes part of it."""
    if not program.shared:
        return program.function(*leaves)
    return shared_call_p.bind(*leaves, jaxpr=program.closed, program=program)


@shared_call_p.def_impl
def compute(*operands, jaxpr: ClosedJaxpr, program: Any) -> list[jax.Array]:
    return jaxpr_as_fun(jaxpr)(*operands)


@shared_call_p.def_abstract_eval
def results_of(*avals, jaxpr: ClosedJaxpr, program: Any) -> list:
    return jaxpr.out_avals


def push_forward(primals, tangents, **params):
    along = [i for i, tangent in enumerate(tangents) if not isinstance(tangent, ad.Zero)]

    def of_some(*some):
        values = dict(enumerate(primals)) | dict(zip(along, some, strict=True))
        return compute(*values.values(), **params)

    return jax.jvp(of_some, [primals[i] for i in along], [tangents[i] for i in along])


def batch(operands, axes, **params):
    results = jax.vmap(functools.partial(compute, **params), axes)(*operands)
    return results, [0] * len(results)


ad.primitive_jvps[shared_call_p] = push_forward
batching.primitive_batchers[shared_call_p] = batch
mlir.register_lowering(shared_call_p, mlir.lower_fun(compute, multiple_results=True))
jet.jet_rules[shared_call_p] = functools.partial(push_series, shared_call_p)

"""How a loop is differentiated: forwards as a loop with tangents (`tangent`), which becomes a
kernel as others do; backwards as many of these as numbers enter the loop that move."""

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir
from jax.interpreters import partial_eval as pe

from jaxclear.native.loop import loop_p, reference_of_batch
from jaxclear.native.program import avals_of
from jaxclear.native.tangent import motion_in, moving_state, tangent_program

# Tangents that go through a loop side by side, where it is differentiated backwards: they share the
# motion, and more of them gain little beside the memory that their rows take.
TOGETHER = 16

_forwards_p = Primitive("jaxclear_forwards_only")


def forwards_only(sentence: str, numbers: Any) -> Any:
    """The numbers as they are; a derivative in reverse mode raises `ValueError` with the sentence,
    in the place of what JAX says to a loop that it cannot go through backwards."""
    return jax.tree.map(
        lambda each: (
            _forwards_p.bind(each, sentence=sentence)
            if jnp.issubdtype(jnp.result_type(each), jnp.floating)
            else each
        ),
        numbers,
    )


def _refuse_backwards(_, __, *, sentence):
    raise ValueError(sentence)


def _as_it_is(primals, tangents, **params):
    (value,), (tangent,) = primals, tangents
    moved = tangent if isinstance(tangent, ad.Zero) else _forwards_p.bind(tangent, **params)
    return _forwards_p.bind(value, **params), moved


_forwards_p.def_impl(lambda value, *, sentence: value)
_forwards_p.def_abstract_eval(lambda aval, *, sentence: aval)
batching.defvectorized(_forwards_p)
mlir.register_lowering(_forwards_p, lambda _, value, *, sentence: [value])
ad.primitive_jvps[_forwards_p] = _as_it_is
ad.primitive_transposes[_forwards_p] = _refuse_backwards


def _differentiate(values, tangents, *, program, rank):
    if program.once:
        return _differentiate_once(values, tangents, program, rank)
    c, b = program.condition_constants, program.condition_constants + program.body_constants
    moving = [not isinstance(t, ad.Zero) for t in tangents]
    constants = moving[c:b]
    results = moving_state(program, constants, moving[b:])
    parts = len(values) - b
    wanted = [i for i, moves in enumerate([*constants, *results[:parts]], c) if moves]
    lead = jnp.shape(values[-1])[:rank]

    def tangent(i):
        shape = jnp.shape(values[i])
        # What is the same for all samples has tangents of its own for each.
        shape = (*lead, *shape) if i in program.shared else shape
        if isinstance(tangents[i], ad.Zero):
            return jnp.zeros(shape, jnp.result_type(values[i]))
        return jnp.broadcast_to(tangents[i], shape)

    given = {i: tangent(i) for i in wanted}
    with_tangents = tangent_program(program, constants, results)
    out = loop_p.bind(
        *values[:b],
        *(given[i] for i in wanted if i < b),
        *values[b:],
        *(given[i] for i in wanted if i >= b),
        program=with_tangents,
        rank=rank,
    )
    places = motion_in(with_tangents)
    own = [out[i] for i in places]
    found = iter(each for i, each in enumerate(out) if i not in places)
    still = lambda value: ad.Zero(jax.core.ShapedArray(value.shape, value.dtype).to_tangent_aval())
    return own, [
        next(found) if moves else still(value) for moves, value in zip(results, own, strict=True)
    ]


def _differentiate_once(values, tangents, program, rank):
    moving = [i for i, t in enumerate(tangents) if not isinstance(t, ad.Zero)]

    def of_moving(*some):
        filled = list(values)
        for i, value in zip(moving, some, strict=True):
            filled[i] = value
        return reference_of_batch(*filled, program=program, rank=rank)

    return jax.jvp(of_moving, [values[i] for i in moving], [tangents[i] for i in moving])


def _known_first(trace, *tracers, program, rank):
    """What is linearised about a known motion: the motion by itself, its tangents as a loop that
    goes through it again."""
    out = trace.default_process_primitive(loop_p, tracers, {"program": program, "rank": rank})
    if program.motion is None:
        return out
    c, b = program.condition_constants, program.motion.body_constants
    parts = len(avals_of(program.motion)[1])
    places = motion_in(program)
    state = c + program.body_constants
    known = [*tracers[: c + b], *tracers[state : state + parts]]
    if not all(tracer.pval.is_known() for tracer in known):
        return out
    alone = program.motion._replace(shared=program.shared)
    motion = loop_p.bind(*(t.pval.get_known() for t in known), program=alone, rank=rank)
    for place, value in zip(places, motion, strict=True):
        out[place] = trace.new_const(value)
    return out


def _backwards(cotangents, *values, program, rank):
    """What the results' cotangents make of the inputs': a loop with tangents is linear in these, so
    each column of its matrix is a run with one tangent. How many turns there are is known when they
    have ended, and runs forwards need not keep them."""
    unknown = [i for i, value in enumerate(values) if ad.is_undefined_primal(value)]
    heeded = [i for i, each in enumerate(cotangents) if not isinstance(each, ad.Zero)]
    shapes = [values[i].aval.shape for i in unknown]
    lead, sizes = shapes[0][:rank], [math.prod(shape[rank:]) for shape in shapes]
    splits = np.cumsum(sizes)[:-1]

    def entry(one):
        """What the results say to one entry of the inputs, for each sample of a batch."""
        given = list(values)
        for i, shape, own in zip(unknown, shapes, jnp.split(one, splits), strict=True):
            given[i] = jnp.broadcast_to(own.reshape(shape[rank:]), shape)
        out = loop_p.bind(*given, program=program, rank=rank)
        axes = lambda each: tuple(range(rank, jnp.ndim(each)))
        parts = [jnp.sum(_heard(out[i], cotangents[i]), axes(out[i])) for i in heeded]
        return sum(parts, jnp.zeros(lead))

    count = sum(sizes)
    together = max(1, min(count, TOGETHER))  # there is none where only empty arrays move
    portions = -(-count // together)

    def portion(first):
        """The same of some entries, side by side."""
        ways = (first + jnp.arange(together))[:, None] == jnp.arange(count)
        return jax.vmap(entry)(ways.astype(float))

    firsts = together * jnp.arange(portions)
    found = jax.lax.map(portion, firsts).reshape(-1, *lead)[:count]
    parts = (jnp.moveaxis(each, 0, -1) for each in jnp.split(found, splits))
    answers = [part.reshape(shape) for part, shape in zip(parts, shapes, strict=True)]
    given = dict(zip(unknown, answers, strict=True))
    return [given.get(i) for i in range(len(values))]


def _heard(said, cotangent):
    """Their product, where a result that does not count may have overflowed: inf * 0 is 0 here.
    A finite one stays, for its product has a slope where the cotangent passes through 0."""
    return jnp.where((cotangent == 0) & ~jnp.isfinite(said), 0.0, said) * cotangent


ad.primitive_jvps[loop_p] = _differentiate
ad.primitive_transposes[loop_p] = _backwards
pe.custom_partial_eval_rules[loop_p] = _known_first

"""How a loop is differentiated: forwards as a loop with tangents (`tangent`), which becomes a
kernel as others do. Backwards it is not: how many turns there are is known when it has ended."""

import jax
import jax.numpy as jnp
from jax.interpreters import ad
from jax.interpreters import partial_eval as pe

from jaxclear.native.loop import loop_p, reference_of_batch
from jaxclear.native.program import avals_of
from jaxclear.native.tangent import motion_in, moving_state, tangent_program


def _differentiate(values, tangents, *, program, rank):
    if program.once:
        return _differentiate_once(values, tangents, program, rank)
    c, b = program.condition_constants, program.condition_constants + program.body_constants
    moving = [not isinstance(t, ad.Zero) for t in tangents]
    constants = moving[c:b]
    results = moving_state(program, constants, moving[b:])
    parts = len(values) - b
    wanted = [i for i, moves in enumerate([*constants, *results[:parts]], c) if moves]
    given = {
        i: jnp.zeros_like(values[i]) if isinstance(tangents[i], ad.Zero) else tangents[i]
        for i in wanted
    }
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
    motion = loop_p.bind(*(t.pval.get_known() for t in known), program=program.motion, rank=rank)
    for place, value in zip(places, motion, strict=True):
        out[place] = trace.new_const(value)
    return out


def _backwards(*_, **__):
    raise ValueError(
        "a derivative in reverse mode (jax.grad, jax.vjp) does not go through time steps whose "
        "number depends on the motion: give the integrator steps_per_save, which fixes it, or take "
        "forward mode (jax.jvp, jax.jacfwd)."
    )


ad.primitive_jvps[loop_p] = _differentiate
ad.primitive_transposes[loop_p] = _backwards
pe.custom_partial_eval_rules[loop_p] = _known_first

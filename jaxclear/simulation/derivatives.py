"""Which derivatives through a run are refused.

Where contacts open and close, steps by themselves do not know how the instant of a touch moves
with a number, and the derivative of one finished run scatters about that of the motion: by a share
after one bounce, by a multiple after a few (-3.0 for 0.24 after three lossless ones in steps of 20
us), and nothing tells by how much. So it is refused while it is being traced, unless the derivative
of the discrete run is what was asked for. Steps that end at touches know it (`saltation`), those by
rk4 whose derivatives are taken apart there (`saltation`), those through rigid contact
(`moreau_jean`), and implicit ones and explicit ones of lower order, beside which the motion goes in
finer parts where it is differentiated (`variational`). Where nothing opens (ideal joints, permanent
contact) the derivative of the discrete run converges to that of the motion, and passes: forwards
through the steps, backwards as so many of these as numbers move.
"""

import functools
import operator
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax

from jaxclear.ground.quantity import is_traced
from jaxclear.ground.wording import public_name
from jaxclear.integrators.base import AbstractIntegrator
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.native import by_columns
from jaxclear.results.trajectory import Trajectory

# What a run has computed; its mechanism and its saving times were given.
COMPUTED = lambda run: (
    run.history.states,
    run.history.read,
    run.worn,
    run.ended,
    run.noted,
    run.extremes,
    run.invariants,
)


def backwards(integrator: AbstractIntegrator) -> Callable:
    """How a function of runs by an integrator is called, as (function, *arguments). Backwards a run
    is as many runs forwards as numbers move where these arguments are handed over, side by side;
    counted steps are gone through themselves."""
    return by_columns if integrator.steps_between_saves is None else operator.call


def refusal(mechanism: Mechanism, integrator: AbstractIntegrator, discrete: bool = False) -> str:
    """Why derivatives through runs of a mechanism are not those of its motion; "" where they are.
    `mechanism`: as its formulation sees it; `discrete`: derivatives of the discrete run.
    """
    joints = mechanism.topology.clearances
    unknown = integrator.beyond_touches(mechanism)
    if not joints or not (unknown or discrete):
        return ""
    unknown = unknown or "how the instants of touch move"
    name = public_name(type(integrator))
    named = " and ".join(f'"{joint}"' for joint in joints[:2])
    some = f"joint {named}" if len(joints) == 1 else f"joints {named}{' …' * (len(joints) > 2)}"
    return (
        f"contacts in {some} open and close, and a derivative through the steps of {name} does not "
        f"know {unknown}"
    )


def guarded(run: Trajectory, integrator: AbstractIntegrator, discrete: bool = False) -> Trajectory:
    """The run itself; differentiating it raises `ValueError` with a sentence where its derivative
    is not that of the motion. `discrete`: derivatives of the discrete run are wanted, and pass
    where the integrator has them (`pathwise`).
    """
    why = refusal(run.mechanism, integrator) if is_traced(COMPUTED(run)) else ""
    if not why or (discrete and integrator.pathwise):
        return run
    ways = (
        "take jaxclear.integrator.Adaptive() with an explicit solver, FixedStep() or "
        "ImplicitStep() without steps_per_save, which follow touches, or jaxclear.sensitivity, "
        "which compares methods and gives an error"
    )
    if integrator.pathwise:
        ways += (
            ", or jaxclear.Problem.evaluate(values, discrete_derivatives=True) for the derivative "
            "of the discrete run as it is"
        )
    sentence = f"the derivative of this run is not to be trusted: {why}; {ways}."
    numbers, rest = eqx.partition(COMPUTED(run), eqx.is_inexact_array)
    found = eqx.combine(_undifferentiated(sentence, numbers), rest)
    return eqx.tree_at(COMPUTED, run, found, is_leaf=lambda part: part is None)


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def _undifferentiated(sentence: str, numbers: Any) -> Any:
    """The numbers as they are."""
    return numbers


@_undifferentiated.defjvp
def _refuse(sentence, primals, tangents):
    raise ValueError(sentence)

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

A derivative has a companion, as values have: the same in other steps, or at a tighter tolerance.
It is that of the finest steps among them, and nan where the others show that it is off.
"""

import functools
import operator
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, Float

from jaxclear.errors.estimates import HALF
from jaxclear.ground.numerics import safe_divide
from jaxclear.ground.outcome import Unknown
from jaxclear.ground.quantity import Scalar, constant, is_traced
from jaxclear.ground.tangents import pushed
from jaxclear.ground.wording import public_name
from jaxclear.integrators.base import SLIVER, AbstractIntegrator
from jaxclear.integrators.checks import Outcome
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.multibody.topology import rubbing_in
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

    Args:
        mechanism: as its formulation models it.
        integrator: of the run.
        discrete: whether derivatives of the discrete run are wanted, instants of touch fixed.
    """
    name = public_name(type(integrator))
    reason = "a derivative through the steps of"
    joints = mechanism.topology.clearances
    unknown = integrator.beyond_touches(mechanism) if joints else ""
    if joints and (unknown or discrete):
        some = _list_names("joint", joints)
        unknown = unknown or "how the instants of touch move"
        return f"contacts in {some} open and close, and {reason} {name} does not know {unknown}"
    plays = tuple(each for each, one in mechanism.couplings.items() if one.play is not None)
    unknown = integrator.beyond_flanks(mechanism) if plays else ""
    if not plays or not (unknown or discrete):
        return ""
    some = _list_names("coupling", plays)
    unknown = unknown or "how the instants move at which flanks meet"
    return f"flanks of {some} meet and part, and {reason} {name} does not know {unknown}"


def _list_names(kind: str, names: tuple[str, ...]) -> str:
    named = " and ".join(f'"{name}"' for name in names[:2])
    return f"{kind} {named}" if len(names) == 1 else f"{kind}s {named}{' …' * (len(names) > 2)}"


def guarded(run: Trajectory, integrator: AbstractIntegrator, discrete: bool = False) -> Trajectory:
    """The run; its derivative raises `ValueError` where it is not that of the motion.

    Args:
        run: whose computed numbers are guarded where they are traced.
        integrator: of the run.
        discrete: whether derivatives of the discrete run are wanted, which pass where the
            integrator has
            them (`pathwise`).
    """
    why = refusal(run.mechanism, integrator) if is_traced(COMPUTED(run)) else ""
    if not why or (discrete and integrator.pathwise):
        return run
    has_play = any(coupling.play is not None for coupling in run.mechanism.couplings.values())
    steps = 'FixedStep() by "rk4"' if has_play else "FixedStep() or ImplicitStep()"
    passages = (
        f"take jaxclear.integrator.Adaptive() with an explicit solver, {steps} without "
        "steps_per_save, which follow touches, or jaxclear.sensitivity, which compares methods and "
        "gives an error"
    )
    if integrator.pathwise:
        passages += (
            ", or jaxclear.Problem.evaluate(values, discrete_derivatives=True) for the derivative "
            "of the discrete run as it is"
        )
    sentence = f"the derivative of this run is not to be trusted: {why}; {passages}."
    numbers, rest = eqx.partition(COMPUTED(run), eqx.is_inexact_array)
    result = eqx.combine(_refuse_derivative(sentence, numbers), rest)
    return eqx.tree_at(COMPUTED, run, result, is_leaf=lambda part: part is None)


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def _refuse_derivative(sentence: str, numbers: Any) -> Any:
    """The numbers as they are."""
    return numbers


@_refuse_derivative.defjvp
def _refuse(sentence, primals, tangents):
    raise ValueError(sentence)


def until_the_end(run: Trajectory) -> Trajectory:
    """The run, whose states at saving times that it did not reach have no derivative: nan."""
    if not is_traced(run.states):
        return run
    reached = (run.time <= run.ended) | (run.outcome == Outcome.REACHED)
    states = _guard_states(run.states, constant(reached))
    return eqx.tree_at(lambda run: run.history.states, run, states)


@jax.custom_jvp
def _guard_states(states: Array, reached: Array) -> Array:
    """The states as they are."""
    return states


@_guard_states.defjvp
def _guard_jvp(primals, tangents):
    reached, nan = primals[1][:, None], Unknown.NOT_REACHED.number
    forwards = lambda _, tangent: jnp.where(reached, tangent, nan)
    # What is not asked for in reverse mode stays 0.
    backwards = lambda _, cotangent: jnp.where(reached | (cotangent == 0), cotangent, nan)
    # Of JAX's linear functions with a transpose of their own the one that `vmap` maps.
    linear = jax.lax.custom_linear_solve
    return primals[0], linear(lambda x: x, tangents[0], forwards, backwards)


# The lengths of the other steps beside that of the run, by the order of its derivatives; and where
# saving intervals have fewer than so many steps, which cannot be as many times longer.
LONGER = {1: (1.5, 2.0), 2: (2.0,)}
SHORTER, FEWEST = {1: (1 / 2, 1 / 3), 2: (1 / 2,)}, 4
# Share of a derivative by which the other steps may tell it to be off.
TRUSTED = 0.01
# A derivative that moves something by less than this share of the least by which a number moves
# counts as one that does by so much: of equal steps it is rounding (a drive, not friction, says
# where a mechanism is); of those that a tolerance decides that tolerance (1e-7) over `TRUSTED`, or
# the second share for what is not under its control: peaks, which lie between steps, and states
# much less moved than the largest of their kind, beside which errors are controlled.
SMALLEST = {"equal": (1e-9, 0.0), "by tolerance": (1e-7 / TRUSTED, 1e-2)}


def is_compared(mechanism: Mechanism, integrator: AbstractIntegrator) -> bool:
    """Whether derivatives of runs of a mechanism, as its formulation sees it, are taken in other
    steps as well: where these can be finer."""
    return integrator.with_finer_steps(HALF) is not None and not refusal(mechanism, integrator)


def in_other_steps(integrator: Any, share: Any, times: Any) -> Any:
    """The integrator with steps of another length.

    Steps that a tolerance decides are also bounded by the saving interval: at rest no tolerance
    shortens them, and they are too long for a derivative.

    Args:
        integrator: of the run.
        share: ratio of the new steps to the usual ones [1]; None: unchanged.
        times: saving times of the run [s].
    """
    if share is None:
        return integrator
    finer = integrator.with_finer_steps(share)
    if integrator.requested_step() is not None:
        return finer
    return finer.with_max_step(jnp.where(share < 1, share * jnp.max(jnp.diff(times)), jnp.inf))


def order_of(mechanism: Mechanism, integrator: AbstractIntegrator) -> int:
    """Power of the step in proportion to which derivatives of runs of a mechanism are off, on the
    safe side: forces that switch within a step leave its first."""
    acting: list[Any] = [*mechanism.loads.values(), *mechanism.couplings.values()]
    switch = any(law.switches for law in acting) or rubbing_in(mechanism.connections)
    return 1 if integrator.first_order_slopes or switch else 2


def compared(
    function: Callable, finer: Callable, judged: Callable, steps: Callable, order: int
) -> Callable:
    """As `function(*arguments)`, with derivatives that are judged by those in other step sizes.

    Args:
        function: whose results and derivatives are wanted.
        finer: `finer(share, *arguments)`: arguments for steps that are this share of the usual
            ones.
        judged: `judged(result, tangents, ratios, least, shares)`: the derivatives to return; of
            `tangents` the nominal run's come first, `ratios` are errors at all step sizes over the
            nominal one's, `least` is the least share of itself by which a number moves, `shares`
            are those of `SMALLEST`.
        steps: `steps(*arguments)`: step size [s] or None, and times [s] at which a step ends.
        order: of the method, by which `ratios` are computed.
    """

    def evaluate(*arguments: Any) -> Any:
        arrays, rest = eqx.partition(arguments, eqx.is_array)
        slot: list[Any] = []

        def at_share(share: Any, arrays: Any) -> tuple[Any, Any]:
            result = function(*finer(share, *eqx.combine(arrays, rest)))
            result, others = eqx.partition(result, eqx.is_array)
            slot.append(others)
            return eqx.partition(result, eqx.is_inexact_array)

        def moving(_, numbers, tangents):
            step, times = steps(*eqx.combine(numbers[0], rest))
            shares, ratios = _shares(step, times, order)
            smallest = SMALLEST["by tolerance" if step is None else "equal"]

            def one(share):
                (out, others), (moved, _) = pushed(lambda arrays: at_share(share, arrays), *both)
                return out, others, moved

            both = numbers, tangents
            out, floats, moved = jax.vmap(one)(shares)
            nominal, floats = jax.tree.map(lambda each: each[0], (out, floats))
            still = jax.tree.map(lambda each: np.zeros(each.shape, jax.dtypes.float0), floats)
            verdict = judged(eqx.combine(nominal, floats), moved, ratios, _least(*both), smallest)
            return (nominal, floats), (verdict, still)

        nominal = jax.custom_jvp(at_share, nondiff_argnums=(0,))
        nominal.defjvp(moving, symbolic_zeros=True)
        return eqx.combine(*nominal(None, arrays), slot[0])

    return evaluate


def _shares(step: Scalar | None, times: Float[Array, " saves"], order: int) -> tuple[Array, Array]:
    """(1 and the shares of a step [s] that others are, how large an error of this order is in each
    beside the first): steps end at all these times [s], so they are not as long as they are asked
    for. Of steps that a tolerance decides (None) errors are taken to fall no faster than with the
    step."""
    if step is None:
        return (jnp.array([1.0, HALF]),) * 2
    count = lambda step: jnp.maximum(jnp.ceil(jnp.diff(times) / step * (1 - SLIVER)), 1.0)
    nominal = count(step)
    longer, shorter = (jnp.asarray(shares[order]) for shares in (LONGER, SHORTER))
    others = jnp.where(jnp.min(nominal) >= FEWEST, longer, shorter)
    shares = jnp.concatenate([jnp.ones(1), others])
    counts = jnp.sum(jax.vmap(lambda share: count(share * step))(shares), axis=1)
    return shares, (counts[0] / counts) ** order


def _least(numbers: Any, tangents: Any) -> Scalar:
    """The least share of itself by which a number moves (0: none that is not 0 does)."""
    least = jnp.asarray(jnp.inf)
    for number, tangent in zip(*map(jax.tree.leaves, (numbers, tangents)), strict=True):
        if not isinstance(tangent, SymbolicZero):
            share = jnp.where(
                (number != 0) & (tangent != 0), abs(safe_divide(tangent, number)), jnp.inf
            )
            least = jnp.minimum(least, jnp.min(share, initial=jnp.inf))
    return jnp.where(jnp.isfinite(least), least, 0.0)


def refuse_steps(tangents: Array, ratios: Array, scale: Array, smallest: Any) -> Array:
    """Derivatives in the finest steps; nan where other step sizes show that steps decide them.

    Args:
        tangents: derivatives, the nominal run's first, then those at other step sizes.
        ratios: errors at these step sizes over the nominal one's.
        scale: size beside which the error of a derivative is judged.
        smallest: least such size.
    """
    finest = jnp.argmin(ratios)
    best = tangents[finest]
    factors = safe_divide(ratios[finest], abs(ratios - ratios[finest]))
    off = jnp.max(
        abs(tangents - best) * jnp.expand_dims(factors, tuple(range(1, tangents.ndim))), axis=0
    )
    trusted = off <= TRUSTED * jnp.maximum(scale, smallest)
    # A nan, of the nominal run or of others, carries its reason.
    reason = jnp.where(jnp.isnan(off), off, Unknown.STEPS_DECIDE.number)
    reason = jnp.where(jnp.isnan(tangents[0]), tangents[0], reason)
    return jnp.where(trusted, best, reason)


def refuse_run(
    run: Trajectory, tangents: Trajectory, ratios: Array, least: Scalar, shares: tuple
) -> Trajectory:
    """Derivatives of a run, nan where steps decide them.

    Those of states at the end are judged beside their own size, at an earlier instant beside the
    largest that the derivative of this number has been, anything else beside the largest of its
    kind.

    Args:
        run: the nominal run.
        tangents: its derivatives, the nominal ones first, then those at other step sizes.
        ratios: errors at these step sizes over the nominal one's.
        least: least share of itself by which a number moves [1].
        shares: of derivatives that count (`SMALLEST`).
    """
    largest = lambda each, axis=None: jnp.max(abs(each), axis=axis, initial=0.0)

    def judge(share, each, number):
        return refuse_steps(each, ratios, largest(each[0]), share * least * largest(number))

    numbers, peaks = eqx.filter(run, eqx.is_inexact_array), functools.partial(judge, max(shares))
    judged = jax.tree.map(functools.partial(judge, shares[0]), tangents, numbers)
    peaks = jax.tree.map(peaks, tangents.extremes, numbers.extremes)
    topology = run.mechanism.topology
    n, m = topology.coordinate_count, topology.speed_count

    def largest_of_kind(size):
        """A coordinate that is 0 is one among others; what a run sums up is in its own units."""
        kinds = jnp.split(size, (n, n + m), axis=-1)
        kinds[:2] = [jnp.zeros_like(kind) + largest(kind, -1)[..., None] for kind in kinds[:2]]
        return jnp.concatenate(kinds, axis=-1)

    states = tangents.history.states
    nominal = abs(states[0])
    scale = jax.lax.cummax(nominal, axis=0).at[-1].set(nominal[-1])
    scale = jnp.maximum(scale, shares[1] * largest_of_kind(scale))
    size = shares[0] * least * largest_of_kind(largest(run.history.states, 0))
    states = refuse_steps(states, ratios, scale, size)
    places = lambda run: (run.history.states, run.extremes)
    return eqx.tree_at(places, judged, (states, peaks), is_leaf=lambda each: each is None)

"""Whether steps see what loads and drives do in time. A push that is shorter than a step passes
between the instants at which a step looks, and nothing in a run's numbers tells of it.

So functions of time are looked at alone, before a run: what steps of that length make of their
impulse, by Simpson's rule over each, beside the impulse as it is. Steps that find their own length
(`Adaptive`) are to end where a function changes between coarser looks. Loads of the user's own may
change with the motion too: they are looked at along a run, behind it. Within a program that traces
these numbers (`jax.jit` and its like) it is the program that looks, at fewer instants.
"""

import dataclasses
import functools
import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxclear.components.drive import AbstractDrive
from jaxclear.components.function_of_time import AbstractFunctionOfTime
from jaxclear.components.joint.base import drive_of
from jaxclear.components.load_base import AbstractLoad, AbstractStateLoad
from jaxclear.formulations.state_rate import coordinate_rates
from jaxclear.ground import sparse as sp
from jaxclear.ground.quantity import concrete, constant, is_traced, on_device, on_host
from jaxclear.ground.recent_results import Key
from jaxclear.integrators.adaptive import Adaptive
from jaxclear.integrators.base import SLIVER, AbstractIntegrator
from jaxclear.integrators.checks import Check, Checks, Figure
from jaxclear.multibody.forces import forces_of_load
from jaxclear.multibody.kinematics import link_motions
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.multibody.state import unpack_followed, unpack_motion
from jaxclear.native.compiled import compiled_quickly
from jaxclear.results.state_history import StateHistory
from jaxclear.results.trajectory import Trajectory

# Instants at which a function is looked at: so many in a step, and in the whole run at least and at
# most. Of more steps than these nothing is said.
IN_A_STEP, LEAST, MOST = 4, 2**18, 2**23
# So many at once, whatever their number, so that nothing is compiled anew; and so many coarser
# looks, between which steps under error control are to end where a function departs from a straight
# line by this share of its integral, and changes by this share of that: at so many times at most.
TOGETHER, COARSE = 2**16, 2**13
RESOLVED, DIFFERENT, MOST_BREAKS = 1e-3, 0.01, 2**10
# Within a program: instants in a step, steps at once, and instants in a run whose steps find their
# own length.
TRACED_IN_A_STEP, TRACED_TOGETHER, TRACED = 32, 2**8, 2**14


def functions_of_time(mechanism: Mechanism) -> dict[str, Any]:
    """Of a mechanism the functions of time of loads, and drives, by name of the load or joint."""
    values = {
        name: value
        for name, load in mechanism.loads.items()
        for field in dataclasses.fields(load)
        # A callable in the place of a number, of which a load of the user's own may have others.
        if callable(value := getattr(load, field.name))
        and ("unit" in field.metadata or isinstance(value, AbstractFunctionOfTime))
    }
    joints = ((name, each.joint) for name, each in mechanism.connections.items())
    drives = ((name, drive_of(joint)) for name, joint in joints)
    return values | {name: drive for name, drive in drives if drive is not None}


def is_changing(function: Any) -> bool:
    """Whether a drive or function is more than a constant speed."""
    return not isinstance(function, AbstractDrive) or not sp.is_zero(function.motion(0.0)[2])


def check_finite(functions: Mapping[str, Any], times: np.ndarray) -> None:
    """Raises `ValueError` where what a load or drive gives at one of the `times` [s], or between
    two of them, is no finite number."""
    looked_at = np.linspace(times[0], times[-1], TOGETHER)
    values = jax.device_get(_rates_and_integrals(dict(functions), on_device(looked_at)))
    for name, value in values.items():
        bad = ~np.all([np.isfinite(row) for row in jax.tree.leaves(value)], axis=0)
        if np.any(bad):
            driven = isinstance(functions[name], AbstractDrive)
            what = f'the drive of joint "{name}"' if driven else f'load "{name}"'
            numbers = "its position, speed and acceleration" if driven else "what it gives"
            raise ValueError(
                f"{what} is not finite at {looked_at[np.argmax(bad)]:.6g} s; {numbers} must be "
                "finite from the start of a run to its end."
            )


@compiled_quickly
def _rates_and_integrals(functions: dict[str, Any], times: jax.Array) -> dict[str, tuple]:
    """Of each function its rates, and their integrals where these are known, at these times."""
    return {name: jax.vmap(functools.partial(_at, f))(times) for name, f in functions.items()}


def _at(function: Any, time: Any) -> tuple[list, list | None]:
    if isinstance(function, AbstractDrive):
        position, speed, acceleration = function.motion(time)
        # Of a drive that has no position nothing is known either.
        speed = jnp.where(jnp.isfinite(position), speed, jnp.nan)
        return [jnp.asarray(acceleration, float)], [jnp.asarray(speed, float)]
    integral = function.integral(time) if isinstance(function, AbstractFunctionOfTime) else None
    return _flat_numbers(function(time)), None if integral is None else _flat_numbers(integral)


def _flat_numbers(values: Any) -> list:
    return [x for leaf in jax.tree.leaves(values) for x in jnp.ravel(jnp.asarray(leaf, float))]


def _sample_rates(functions: dict[str, Any], times: np.ndarray) -> dict[str, tuple]:
    """By name the rates of each function at these times, and their integrals where these are known
    (None: they are not), as lists of histories."""
    padded = np.append(times, np.full(-len(times) % TOGETHER, times[-1]))
    rows = jnp.asarray(padded.reshape(-1, TOGETHER))
    values = [jax.device_get(_rates_and_integrals(functions, row)) for row in rows]
    return jax.tree.map(lambda *parts: np.concatenate(parts)[: len(times)], *values)


class LoadSteps(NamedTuple):
    """The `integrator` with which a run sees what its loads and drives do in time, and by name the
    shares that its steps pass over (`passed`)."""

    integrator: AbstractIntegrator
    passed: dict[str, Any]


def checked_by(missed: dict[str, Any], checks: Checks) -> Checks:
    """What is known of a run with what its loads and drives are judged by, where it has any."""
    if not missed:
        return checks
    names, shares = tuple(missed), jnp.array(list(missed.values()))
    figure = Figure(shares, jnp.zeros(len(names)), names)
    return Checks.of(checks.figures | {Check.LOAD_STEP: figure})


def load_steps(mechanism: Mechanism, integrator: AbstractIntegrator, times: Any) -> LoadSteps:
    """Whether the steps of a run resolve its functions of time.

    Args:
        mechanism: with loads and drives that are functions of time.
        integrator: that chooses the steps.
        times: saving times [s]; the run begins at the first.
    """
    return _examine(functions_of_time(mechanism), integrator, times)


def _examine(functions: dict[str, Any], integrator: AbstractIntegrator, times: Any) -> LoadSteps:
    step, fixed = integrator.requested_step(), integrator.steps_between_saves
    if not functions:
        return LoadSteps(integrator, {})
    if is_traced((functions, step, integrator.breaks, times)):
        changing = constant({name: f for name, f in functions.items() if is_changing(f)})
        if step is not None or fixed is not None:
            steps = constant((times, step, fixed))
            shares = {name: _traced_share(f, *steps) for name, f in changing.items()}
            return LoadSteps(integrator, shares)
        return LoadSteps(_with_traced_breaks(integrator, changing, constant(times)), {})
    step, functions = concrete(step), on_host(functions)
    # What is known of them is looked at, also where something else is being traced.
    with jax.ensure_compile_time_eval():
        breaks, missed = _find_breaks(Key(functions, np.asarray(times), step, fixed))
    return LoadSteps(_with_breaks(integrator, breaks), missed)


def _with_breaks(integrator: AbstractIntegrator, breaks: np.ndarray) -> AbstractIntegrator:
    """The integrator with steps that end at these times [s] too; itself where there are none."""
    present: Any = [] if integrator.breaks is None else on_host(integrator.breaks)
    if not isinstance(integrator, Adaptive) or np.isin(breaks, present).all():
        return integrator
    every = np.append(np.union1d(present, breaks), np.full(MOST_BREAKS, np.inf))[:MOST_BREAKS]
    adaptive: Any = integrator
    return dataclasses.replace(adaptive, breaks=every)


@functools.lru_cache(maxsize=64)
def _find_breaks(question: Key) -> tuple[np.ndarray, dict[str, float]]:
    """The times [s] at which steps that find their own length are to end, and by name the shares
    that others pass over."""
    everything, times, step, fixed = question.arguments
    functions = {name: each for name, each in everything.items() if is_changing(each)}
    # Between saving times a load along a run may be asked where the run never was.
    given = {name: each for name, each in functions.items() if not isinstance(each, _AlongRun)}
    check_finite(given, times)
    if not functions:
        return np.zeros(0), {}
    if step is not None or fixed is not None:
        return np.zeros(0), missed_shares(functions, times, step, fixed)
    looks = np.linspace(times[0], times[-1], LEAST + 1)
    rates = [rate for column, _ in _sample_rates(functions, looks).values() for rate in column]
    return np.concatenate([_times_of_change(rate, looks) for rate in rates]), {}


def _times_of_change(rate: Any, looks: Any) -> Any:
    """The looks [s] between which a function changes that coarser ones do not tell; of traced
    numbers so many, of which those beyond the last are infinite."""
    every, of = LEAST // COARSE, jnp if is_traced((rate, looks)) else np
    off = abs(rate - of.interp(looks, looks[::every], rate[::every]))
    sums = of.maximum(abs(rate).sum(), 1e-300)
    unseen = off[1:].reshape(-1, every).sum(axis=1) > RESOLVED * sums
    changed = of.repeat(unseen, every) & (abs(of.diff(rate)) > DIFFERENT * off.max())
    which = of.append(changed, False) | of.append(False, changed)
    if of is np:
        return looks[which][:MOST_BREAKS]
    chosen = jnp.nonzero(which, size=MOST_BREAKS, fill_value=len(looks))[0]
    return jnp.append(looks, jnp.inf)[chosen]


def missed_shares(
    functions: Mapping[str, Any], times: np.ndarray, step: float | None, fixed: int | None = None
) -> dict[str, float]:
    """By name the share of what each gives that steps pass over: the largest error of its impulse,
    beside how far the impulse goes. Of what never changes that is 0, of too many steps nothing.

    Args:
        functions: loads and drives by name.
        times: saving times of the run [s].
        step: longest step [s]; None: no bound.
        fixed: number of steps between saving times; None: decided by `step`.
    """
    total, edge_at = _find_edges(np, times, step, fixed)
    parts = 2 * max(IN_A_STEP // 2, math.ceil(LEAST / (2 * total)))
    if total * parts > MOST:
        return {}
    edges, shares = edge_at(np.arange(total + 1)), {}
    for name, values in _sample_rates(dict(functions), _instants(edges, parts)).items():
        shares[name] = float(_share(_add_steps(_nothing(len(values[0])), edges, *values), total))
    return shares


def _find_edges(of: Any, times: Any, step: Any, fixed: int | None) -> tuple[Any, Callable]:
    """The number of steps of a run, and a function from their numbers to where they begin [s];
    `of`: NumPy or what it is for traced numbers."""
    intervals = of.diff(times)
    lengths = of.inf if step is None else step
    counts = of.maximum(of.ceil(intervals / lengths * (1 - SLIVER)), fixed or 1)
    ends = of.cumsum(counts)

    def edge_at(index):
        i = of.minimum(of.searchsorted(ends, index, side="right"), len(intervals) - 1)
        done = (index - (ends[i] - counts[i])) / counts[i]
        return of.asarray(times)[i] + intervals[i] * of.minimum(done, 1.0)

    return ends[-1], edge_at


def _instants(edges: Any, parts: int) -> Any:
    """Instants [s], so many in each step, and the last edge."""
    of = jnp if is_traced(edges) else np
    inside = edges[:-1, None] + of.diff(edges)[:, None] * np.arange(parts) / parts
    return of.append(inside.ravel(), edges[-1])


def _nothing(count: int) -> tuple:
    """What `_add_steps` adds to, at the start."""
    return (np.zeros(count),) * 5


def _add_steps(sums: tuple, edges: Any, rates: list, integrals: list | None) -> tuple:
    """Largest lasting error of the impulse, what is missed so far, the impulse so far, its least
    and most, behind further steps, of which Simpson's rule sees ends and middles.

    Args:
        sums: the same before them.
        edges: of the steps [s].
        rates: at equal numbers of instants in each step, a list of histories.
        integrals: likewise; None: not known, so taken by Simpson's rule over these instants.
    """
    of = jnp if is_traced((edges, rates)) else np
    lasting, missed, impulse, least, most = sums
    rate, steps = of.stack(rates), of.diff(edges)
    parts = (rate.shape[1] - 1) // len(steps)
    by_simpson = lambda n: rate[:, :-n:n] + 4 * rate[:, n // 2 :: n] + rate[:, n::n]
    if integrals is None:
        changes = by_simpson(2) * of.repeat(steps / (3 * parts), parts // 2)
    else:
        changes = of.diff(of.stack(integrals))
    in_steps = changes.reshape(len(rates), len(steps), -1).sum(axis=-1)
    errors = missed[:, None] + of.cumsum(steps * by_simpson(parts) / 6 - in_steps, axis=1)
    impulses = impulse[:, None] + of.cumsum(changes, axis=1)
    sizes = abs(of.column_stack([missed, errors]))
    # What the next step makes up for is nothing that a body feels.
    lasting = of.maximum(lasting, of.minimum(sizes[:, 1:], sizes[:, :-1]).max(axis=1))
    least = of.minimum(least, impulses.min(axis=1))
    most = of.maximum(most, impulses.max(axis=1))
    return lasting, errors[:, -1], impulses[:, -1], least, most


def _share(sums: tuple, count: Any) -> Any:
    """The largest error of an impulse beside how far it goes, behind so many steps."""
    of = jnp if is_traced(sums) else np
    lasting, missed, _, least, most = sums
    # The last step has none behind it that would make up for it.
    largest, total = of.maximum(lasting, abs(missed)), most - least
    rounding = count * np.finfo(float).eps * of.maximum(abs(most), abs(least))
    known = (total > rounding) & of.isfinite(largest)
    return of.max(of.where(known, largest / of.where(known, total, 1.0), 0.0), initial=0.0)


def _traced_share(function: Any, times: Any, step: Any, fixed: int | None) -> Any:
    """As `missed_shares`, of numbers that a program traces: some steps at once."""
    values_at = jax.vmap(functools.partial(_at, function))
    rates, integrals = jax.eval_shape(functools.partial(_at, function), 0.0)
    parts = TRACED_IN_A_STEP if integrals is None else 2
    total, edge_at = _find_edges(jnp, jnp.asarray(times), step, fixed)

    def look(carry):
        first, sums = carry
        edges = edge_at(first + jnp.arange(TRACED_TOGETHER + 1.0))
        sums = _add_steps(sums, edges, *values_at(_instants(edges, parts)))
        return first + TRACED_TOGETHER, sums

    last = jnp.where(total <= MOST, total, 0.0)
    start = jnp.zeros(()), tuple(map(jnp.asarray, _nothing(len(rates))))
    return _share(jax.lax.while_loop(lambda carry: carry[0] < last, look, start)[1], total)


def _with_traced_breaks(
    integrator: AbstractIntegrator, functions: dict[str, Any], times: Any
) -> AbstractIntegrator:
    """As `_with_breaks`, of numbers that a program traces; steps end at the times of tables too."""
    if not isinstance(integrator, Adaptive) or not functions:
        return integrator
    parts = jax.tree.leaves(functions, is_leaf=lambda x: isinstance(x, AbstractFunctionOfTime))
    pieced = [x for x in parts if isinstance(x, AbstractFunctionOfTime)]
    every = [function.knots(times[0], MOST_BREAKS) for function in pieced]
    looks = jnp.linspace(times[0], times[-1], TRACED + 1)
    for rates, _ in (jax.vmap(functools.partial(_at, f))(looks) for f in functions.values()):
        every += [_times_of_change(rate, looks) for rate in rates]
    present: Any = [] if integrator.breaks is None else [constant(integrator.breaks)]
    adaptive: Any = integrator
    breaks = jnp.sort(jnp.concatenate([*present, *every]))[:MOST_BREAKS]
    return dataclasses.replace(adaptive, breaks=breaks)


class _AlongRun(eqx.Module):
    """What a load does along a run, as a function of time [s]: coordinates are cubic polynomials
    between its saving times, all else of the state goes straight."""

    name: str = eqx.field(static=True)
    history: StateHistory

    def __call__(self, time):
        model, times, states = self.history.model(), self.history.time, self.history.states
        system, layout = model.system, model.layout
        i = jnp.clip(jnp.searchsorted(times, time, side="right") - 1, 0, len(times) - 2)
        length, begin, change = times[i + 1] - times[i], states[i], states[i + 1] - states[i]
        share = (time - times[i]) / length

        def bend(row):
            rates = jnp.stack([*coordinate_rates(system, *unpack_motion(system, row))])
            return length * rates - change[: layout.coordinates]

        row = begin + share * change
        if layout.coordinates:
            bent = (1 - share) * bend(begin) - share * bend(states[i + 1])
            row = row.at[: layout.coordinates].add(share * (1 - share) * bent)
        entries = [row[k] for k in range(layout.size)]
        motions = link_motions(system, *unpack_motion(system, entries), time)
        return forces_of_load(system, motions, self.name, time, unpack_followed(layout, entries))


def run_felt(
    run: Trajectory,
    integrator: AbstractIntegrator,
    passed: dict[str, Any],
    make_run: Callable[[AbstractIntegrator], Trajectory],
) -> tuple[Trajectory, AbstractIntegrator]:
    """A run, repeated where its steps are to end at what loads of the user's own do along it, and
    judged by what steps pass over; and the integrator that made it.

    Args:
        run: the run by `integrator`.
        integrator: as `load_steps` returns it.
        passed: shares of functions of time that its steps pass over, by name.
        make_run: makes a run by an integrator.
    """
    # A program repeats it once, whatever it feels: what is traced cannot decide.
    for _ in range(1 if is_traced(run.outcome) else 2):
        refined, more = felt_along(run, integrator)
        passed = passed | more
        if refined is integrator:
            break
        integrator, run = refined, make_run(refined)
    if passed:
        run = dataclasses.replace(run, invariants=checked_by(passed, run.invariants))
    return run, integrator


def own_loads(mechanism: Mechanism) -> list[str]:
    """Names of the loads and force couplings of the user's own, but of those that are sampled."""
    ours, present = __name__.partition(".")[0], mechanism.loads | mechanism.couplings
    return [
        name
        for name, load in present.items()
        if type(load).__module__.partition(".")[0] != ours
        and isinstance(load, AbstractLoad)
        and not (isinstance(load, AbstractStateLoad) and load.sampled_every() is not None)
    ]


def felt_along(run: Trajectory, integrator: AbstractIntegrator) -> LoadSteps:
    """As `load_steps`, of what loads of the user's own do along a run; the integrator itself where
    the run has felt them."""
    names = own_loads(run.mechanism)
    if not names or not (is_traced(run) or run.succeeded):
        return LoadSteps(integrator, {})
    history = dataclasses.replace(run.history, read={})
    return _examine({name: _AlongRun(name, history) for name in names}, integrator, run.time)

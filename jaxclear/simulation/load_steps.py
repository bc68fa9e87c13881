"""Whether steps see what loads and drives do in time. A push that is shorter than a step passes
between the instants at which a step looks, and nothing in a run's numbers tells of it.

So functions of time are looked at alone, before a run: what steps of that length make of their
impulse, by Simpson's rule over each, beside the impulse as it is. Steps that find their own length
(`Adaptive`) are held to one that sees them, and end where one changes between any looks
(`load_changes`). Loads of the user's own may change with the motion too: they are looked at along
a run, behind it (`felt_along`).
"""

import dataclasses
import functools
from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxclear.components.acting import AbstractStateLoad
from jaxclear.components.drive import AbstractDrive
from jaxclear.components.function_of_time import AbstractFunctionOfTime
from jaxclear.components.joint.base import drive_of
from jaxclear.ground import sparse as sp
from jaxclear.ground.latest import Key
from jaxclear.ground.quantity import concrete, is_traced, on_device, on_host
from jaxclear.integrators.base import SLIVER, AbstractIntegrator
from jaxclear.integrators.checks import Check, Checks, Figure
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.native.compiled import compiled_quickly
from jaxclear.results.trajectory import Trajectory
from jaxclear.simulation.load_changes import changes_between, with_signs

# Instants at which a function is looked at: so many in a step, and in the whole run at least and at
# most. Of more steps than these nothing is said.
IN_A_STEP, LEAST, MOST = 4, 2**13, 2**23
# So many at once, whatever their number, so that nothing is compiled anew.
TOGETHER = 2**13
# Share of an impulse up to which steps under error control see what changes, and so many steps at
# most a run is made to take by holding them.
SEEN, MOST_HELD = 0.02, 10**6


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


def changes(function: Any) -> bool:
    """Whether a drive or function is more than a constant speed."""
    return not isinstance(function, AbstractDrive) or not sp.is_zero(function.motion(0.0)[2])


def check_finite(functions: Mapping[str, Any], times: np.ndarray) -> None:
    """Raises `ValueError` where what a load or drive gives at one of the `times` [s], or between
    two of them, is no finite number."""
    looked_at = np.linspace(times[0], times[-1], TOGETHER)
    found = jax.device_get(_values(dict(functions), on_device(looked_at)))
    for name, (*told, _) in found.items():
        bad = ~np.all([np.isfinite(row) for row in jax.tree.leaves(told)], axis=0)
        if np.any(bad):
            driven = isinstance(functions[name], AbstractDrive)
            what = f'the drive of joint "{name}"' if driven else f'load "{name}"'
            numbers = "its position, speed and acceleration" if driven else "what it gives"
            raise ValueError(
                f"{what} is not finite at {looked_at[np.argmax(bad)]:.6g} s; {numbers} must be "
                "finite from the start of a run to its end."
            )


def passed_over(functions: Mapping[str, Any], edges: np.ndarray) -> dict[str, float]:
    """By name the share of what each gives that steps with these ends [s] pass over: the largest
    error of its impulse, beside how far the impulse goes. Of what never changes that is 0."""
    count = len(edges) - 1
    parts = 2 * max(IN_A_STEP // 2, -(-LEAST // (2 * count)))
    if count * parts > MOST:
        return {}
    steps = np.diff(edges)
    times = edges[:-1, None] + steps[:, None] * np.arange(parts) / parts
    times = np.append(times.ravel(), edges[-1])
    rates, impulses = _sampled(dict(functions), times)
    return {
        name: max(
            (
                _share(rate, impulse, steps, parts)
                for rate, impulse in zip(rates[name], impulses[name], strict=True)
            ),
            default=0.0,
        )
        for name in functions
    }


def _share(rate: np.ndarray, impulse: np.ndarray, steps: np.ndarray, parts: int) -> float:
    """The largest error of an impulse, beside how far it goes: by the end of each step what
    Simpson's rule over all of them is off by."""
    begin, middle, end = rate[:-1:parts], rate[parts // 2 :: parts], rate[parts::parts]
    seen = np.cumsum(steps * (begin + 4 * middle + end) / 6)
    missed = seen - (impulse[parts::parts] - impulse[0])
    # What the next step makes up for is nothing that a body feels.
    lasting = np.minimum(np.abs(missed), np.abs(np.append(missed[1:], missed[-1])))
    largest, whole = lasting.max(), np.ptp(impulse)
    rounding = len(impulse) * np.finfo(float).eps * np.abs(impulse).max()
    return float(largest / whole) if whole > rounding and np.isfinite(largest) else 0.0


@compiled_quickly
def _values(functions: dict[str, Any], times: jax.Array) -> dict[str, tuple]:
    """Of each function its rates, their integrals where these are known, and its signs
    (`load_changes`), at these times."""
    at = lambda own, t: (*(found := with_signs(lambda t: _at(own, t), t))[0], found[1])
    return {name: jax.vmap(functools.partial(at, own))(times) for name, own in functions.items()}


def _at(function: Any, time: Any) -> tuple[list, list | None]:
    if isinstance(function, AbstractDrive):
        position, speed, acceleration = function.motion(time)
        # Of a drive that has no position nothing is known either.
        speed = jnp.where(jnp.isfinite(position), speed, jnp.nan)
        return [jnp.asarray(acceleration, float)], [jnp.asarray(speed, float)]
    known = function.integral(time) if isinstance(function, AbstractFunctionOfTime) else None
    return _columns(function(time)), None if known is None else _columns(known)


def _columns(found: Any) -> list:
    return [x for leaf in jax.tree.leaves(found) for x in jnp.ravel(jnp.asarray(leaf, float))]


def _sampled(functions: dict[str, Any], times: np.ndarray) -> tuple[dict, dict]:
    """By name the rates and impulses of each function at these times, a list of histories."""
    padded = np.append(times, np.full(-len(times) % TOGETHER, times[-1]))
    rows = jnp.asarray(padded.reshape(-1, TOGETHER))
    without_signs = lambda row: {name: own[:2] for name, own in _values(functions, row).items()}
    found = [jax.device_get(without_signs(row)) for row in rows]
    joined = jax.tree.map(lambda *parts: np.concatenate(parts)[: len(times)], *found)
    rates = {name: rate for name, (rate, _) in joined.items()}
    impulses = {
        name: [_integrated(each, times) for each in rate] if known is None else known
        for name, (rate, known) in joined.items()
    }
    return rates, impulses


def _changes(found_at: Callable, times: np.ndarray) -> list:
    """The changes between samples over these times [s] (`changes_between`) of a function, of which
    `found_at(times)` are values, ..., and signs."""

    def sampled(at):
        rows = np.append(at, np.full(-len(at) % TOGETHER, at[-1])).reshape(-1, TOGETHER)
        found = [jax.device_get(found_at(row)) for row in rows]
        values = np.concatenate([np.stack(rates, axis=1) for rates, *_ in found])
        return values[: len(at)], np.concatenate([signs for *_, signs in found])[: len(at)]

    return list(changes_between(sampled, np.linspace(times[0], times[-1], TOGETHER)))


def _integrated(rate: np.ndarray, times: np.ndarray) -> np.ndarray:
    """The integral of a rate from the first time to each, by Simpson's rule over pairs of parts."""
    h = np.diff(times)[::2]
    begin, middle, end = rate[:-1:2], rate[1::2], rate[2::2]
    found = np.zeros(len(times))
    found[2::2] = np.cumsum(h * (begin + 4 * middle + end) / 3)
    found[1::2] = found[:-1:2] + h * (5 * begin + 8 * middle - end) / 12
    return found


def step_ends(times: np.ndarray, step: float | None, fixed: int | None = None) -> np.ndarray | None:
    """Ends [s] of steps no longer than `step` [s] between saving times, or of the `fixed` number;
    None where they are more than anybody looks at."""
    intervals = np.diff(times)
    if fixed is None:
        counts = np.maximum(np.ceil(intervals / step * (1 - SLIVER)), 1)
    else:
        counts = np.full(intervals.shape, fixed)
    if np.sum(counts) * IN_A_STEP > MOST:
        return None
    pairs = zip(times[:-1], intervals, counts.astype(int), strict=True)
    inside = [begin + length * np.arange(count) / count for begin, length, count in pairs]
    return np.append(np.concatenate(inside), times[-1])


class LoadSteps(NamedTuple):
    """The `integrator` with which a run sees what its loads and drives do in time, and by name the
    shares that its steps pass over (`passed`)."""

    integrator: AbstractIntegrator
    passed: dict[str, float]


def checked_by(passed: dict[str, float], known: Checks) -> Checks:
    """What is known of a run with what its loads and drives are judged by, where it has any."""
    if not passed:
        return known
    names, shares = tuple(passed), jnp.array(list(passed.values()))
    figure = Figure(shares, jnp.zeros(len(names)), names)
    return Checks.of(known.figures | {Check.LOAD_STEP: figure})


def judged_by(passed: dict[str, float], run: Trajectory) -> Trajectory:
    """The run with it."""
    return (
        dataclasses.replace(run, invariants=checked_by(passed, run.invariants)) if passed else run
    )


def load_steps(mechanism: Mechanism, integrator: AbstractIntegrator, times: Any) -> LoadSteps:
    """How a run that is saved at these times [s], the first of which it begins at, sees what its
    loads and drives do. Nothing is said of numbers that are being traced."""
    functions = on_host(functions_of_time(mechanism))
    if not functions or is_traced((functions, integrator, times)):
        return LoadSteps(integrator, {})
    step, fixed = concrete(integrator.asked_step()), integrator.steps_between_saves
    # What is known of them is looked at, also where something else is being traced.
    with jax.ensure_compile_time_eval():
        length, breaks, passed = _seen(Key(functions, np.asarray(times), step, fixed))
    integrator = integrator.ending_at(breaks) if len(breaks) else integrator
    return LoadSteps(integrator if length is None else integrator.held(length), passed)


@functools.lru_cache(maxsize=64)
def _seen(question: Key) -> tuple[float | None, np.ndarray, dict[str, float]]:
    """The length [s] to which steps that find it themselves are to be held (None: they need not
    be), the times [s] at which they are to end, and by name the shares that steps pass over."""
    everything, times, step, fixed = question.asked
    functions = {name: each for name, each in everything.items() if changes(each)}
    check_finite(functions, times)
    if not functions:
        return None, np.zeros(0), {}
    # Of what knows its integral samples tell all.
    unknown = [n for n, each in functions.items() if not isinstance(each, AbstractFunctionOfTime)]
    unseen = {n: _changes(lambda at, n=n: _values(functions, at)[n], times) for n in unknown}
    if step is not None or fixed is not None:
        edges = step_ends(times, step, fixed)
        if edges is None:
            return None, np.zeros(0), {}
        longest, passed = np.diff(edges).max(), passed_over(functions, edges)
        for name, own in unseen.items():
            short = sum(share for share, lasts, _ in own if lasts < longest)
            passed |= {name: max(passed.get(name, 0.0), short)}
        return None, np.zeros(0), passed
    breaks = [instant for own in unseen.values() for *_, each in own for instant in each]
    breaks = np.setdiff1d(breaks, times)
    times, passed = np.union1d(times, breaks), {}
    for halvings, (length, passed) in enumerate(_halved(functions, times)):
        if max(passed.values(), default=0.0) <= SEEN:
            return length if halvings else None, breaks, {}
    return None, breaks, passed


def _halved(
    functions: dict[str, Any], times: np.ndarray
) -> Iterator[tuple[float, dict[str, float]]]:
    """Steps [s] from the longest between saving times on, each half as long as the one before, with
    what they pass over."""
    length = np.diff(times).max()
    while times[-1] - times[0] <= MOST_HELD * length:
        edges = step_ends(times, length)
        if edges is None:
            return
        yield length, passed_over(functions, edges)
        length = 0.5 * length


def own_loads(mechanism: Mechanism) -> dict[str, AbstractStateLoad]:
    """Loads on coordinates of the user's own classes, which may change with anything, by name."""
    ours = __name__.partition(".")[0]
    return {
        name: load
        for name, load in mechanism.loads.items()
        if isinstance(load, AbstractStateLoad)
        and load.sampled_every() is None
        and type(load).__module__.partition(".")[0] != ours
    }


@compiled_quickly
def _effects(load: AbstractStateLoad, motion: tuple) -> tuple:
    """Forces of a load, and their signs, at (times, positions, speeds)."""
    states = tuple(jnp.asarray(each.start, float) for each in load.states())
    effect = lambda *now: _columns(load.effect(*now, states).forces)
    return jax.vmap(functools.partial(with_signs, effect))(*motion)


def felt_along(run: Trajectory, integrator: AbstractIntegrator) -> LoadSteps:
    """The integrator with which a run feels what the user's own loads do along its motion, and by
    name the shares that its steps have passed over; the same integrator where it has felt all."""
    from scipy.interpolate import CubicHermiteSpline

    if is_traced((run.states, run.time, integrator)) or not run.succeeded:
        return LoadSteps(integrator, {})
    loads, times = own_loads(run.mechanism), np.asarray(run.time)
    step, fixed = concrete(integrator.asked_step()), integrator.steps_between_saves
    step = step if fixed is None else np.diff(times).max() / fixed
    known = np.zeros(0) if integrator.breaks is None else np.asarray(integrator.breaks)
    breaks, passed = np.zeros(0), dict[str, float]()
    for name, load in loads.items():
        places, speeds = (
            np.stack([np.asarray(read(each)) for each in load.coordinates()])
            for read in (run.coordinate, run.speed)
        )
        path = CubicHermiteSpline(times, places, speeds, axis=1)
        moving = lambda at, path=path: (at, tuple(path(at)), tuple(path(at, 1)))
        for share, lasts, each in _changes(lambda at, own=load: _effects(own, moving(at)), times):
            near = np.any(abs(known - np.median(each)) <= lasts)
            if not near and (step is None or lasts < step):
                breaks = np.append(breaks, each)
                passed[name] = passed.get(name, 0.0) + share
    return LoadSteps(integrator.ending_at(breaks) if len(breaks) else integrator, passed)

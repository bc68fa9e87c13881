"""Random mechanisms, laws and rungs: is any derivative wrong without a sentence?

    python -m benchmarks.attack_slopes [--quick] [--json FILE] [--first N] [--draws N]
        [--only K ...] [--rung NAME ...] [--minutes N]

The mechanisms are those of `benchmarks.attack` with clearance, and its drives. Of each the slopes
of the last place of a body, of mean and peak forces of its first joint, and of what that wears, by
its clearance, the first number of its contact law and the mass of a body, as
`jax.jacfwd(problem.evaluate)` gives them; of a drive those of the last place and of the arm's mean
force, by the first number of its element, the arm's inertia and its mass. References are
extrapolated differences of a tight `Adaptive`, taken by three shares of each number, and of one ten
times looser. A slope is right within its rung's limit of the reference; refused, where it is nan or
a sentence; said, where the run warns of its response; undecidable, where the references disagree;
or silently wrong.
"""

import functools
import time
from collections import Counter
from collections.abc import Callable, Iterable
from enum import StrEnum
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import jaxclear as jc
from benchmarks.attacks import verdicts
from benchmarks.attacks.answers import surfaces
from benchmarks.attacks.bearings import Case
from benchmarks.attacks.coupled import COUPLED
from benchmarks.attacks.rungs import of_studies
from benchmarks.attacks.structures import ROOM, Structure, structures
from benchmarks.measure import arguments, report, sign

# Shares of a number by which differences are taken, and tolerances of the two references.
SHARES, TOLERANCES = (2e-4, 1e-4, 5e-5), (1e-10, 1e-9)
# A slope is measured by itself or, if that is larger, by this share of response by number (of a
# place, which is measured from far away, by a smaller one); references that are apart by more than
# `DECISIVE` of what it may be off do not decide.
LEAST, LEAST_OF_PLACES, DECISIVE = 1e-2, 1e-3, 0.25
SAVES, DENSE = 51, 20_001
# A peak of half as many saved instants tells how far that of all is sure.
HALF = "peak force of every second instant"
# From values at five places one apart to the powers of the polynomial through them, and Newton's
# steps to its summit.
THROUGH_FIVE = np.linalg.inv(np.vander(np.arange(-2.0, 3.0)))
NEWTON = 8
# The integrator of each rung, and by how much of itself a slope may be off.
RUNGS: dict[str, tuple[Callable[[Case], Any], float]] = {
    "default of studies": (of_studies, 0.05),
    "Adaptive": (lambda _: jc.integrator.Adaptive(), 0.02),
    "FixedStep": (lambda _: jc.integrator.FixedStep(), 0.05),
    "FixedStep(5e-6)": (lambda _: jc.integrator.FixedStep(5e-6), 0.05),
    "FixedStep(1e-5, heun)": (lambda _: jc.integrator.FixedStep(1e-5, "heun"), 0.05),
    "ImplicitStep(2e-5)": (lambda _: jc.integrator.ImplicitStep(2e-5), 0.05),
}
MIXED = 6
MINUTES = {"type": float, "help": "of CPU time, after which no other mechanism begins"}


class Verdict(StrEnum):
    """What a slope turned out to be."""

    RIGHT = "right"
    REFUSED = "refused"
    SAID = "said so"
    UNDECIDABLE = "undecidable"
    WRONG = "silently wrong"


class Row(NamedTuple):
    """One slope of one case by one rung, beside its reference and how far that is sure."""

    case: int
    mechanism: str
    rung: str
    response: str
    variable: str
    verdict: Verdict
    slope: float
    reference: float
    doubt: float
    scale: float


def _dense_peak(joint: str, every: int = 1) -> Callable[[jc.Trajectory], Any]:
    """The largest force of a contact at `every` so many of the saved instants, by the polynomial of
    fourth order through it and two on either side: steps end elsewhere for other numbers, and so
    the largest force at their ends has another slope. (A parabola's summit swings by 4e-4 with
    where instants lie in an impact that ten of them see: its slope is off by half.)"""

    def summit(forces: Any) -> Any:
        k = jnp.clip(jnp.argmax(forces), 2, len(forces) - 3)
        near = jax.lax.dynamic_slice_in_dim(forces, k - 2, 5)
        powers = jnp.asarray(THROUGH_FIVE) @ near
        slope, bend = (jnp.polyder(powers, order) for order in (1, 2))
        place = jnp.zeros(())
        for _ in range(NEWTON):
            bent = jnp.polyval(bend, place)
            place = place - jnp.polyval(slope, place) / jnp.where(bent < 0, bent, -jnp.inf)
        inside = jnp.all(near > 0) & (jnp.abs(place) < 1)
        return jnp.where(inside, jnp.polyval(powers, place), jnp.max(forces))

    return lambda run: jnp.max(jax.vmap(summit, 1)(run.contact(joint).normal_force[::every]))


def problem(case: Case, integrator: Any, dense: bool = False) -> jc.Problem:
    """What is asked of a case; `dense`: of its densely saved reference, which tells peaks."""
    rig = case.mechanism
    if not rig.topology.clearances:
        return _problem(case, integrator, *_of_a_drive(rig), SAVES)
    joint = rig.topology.clearances[0]
    body = next(iter(rig.bodies))
    worn = [one for one in surfaces(rig) if one[0] == joint]
    responses: dict[str, Any] = {
        "place": lambda run: jnp.sum(run.body(body).com[-1]),
        "mean force": jc.response.MeanContactForce(joint),
        "peak force": jc.response.PeakContactForce(joint),
    }
    if worn:
        responses["worn volume"] = lambda run: run.worn_volume(*worn[0])[-1]
    if dense:
        responses = {"peak force": _dense_peak(joint), HALF: _dense_peak(joint, 2)}
    law = lambda m: jax.tree.leaves(m.connections[joint].joint.contact)
    first = next(i for i, n in enumerate(law(rig)) if eqx.is_inexact_array(n) and n != 0)
    places: dict[str, Callable] = {
        "clearance": lambda m: m.connections[joint].joint.clearance,
        "contact": lambda m: law(m)[first],
        "mass": lambda m: m.bodies[body].mass,
    }
    return _problem(case, integrator, responses, places, DENSE if dense else SAVES)


def _problem(case: Case, integrator: Any, responses: Any, places: Any, saves: int) -> jc.Problem:
    variables = {
        name: jc.Variable(place, tolerance=1e-3 * float(np.max(np.abs(place(case.mechanism)))))
        for name, place in places.items()
    }
    return jc.Problem(
        case.mechanism,
        responses,
        variables,
        duration=case.duration,
        integrator=integrator,
        save=saves,
        state=jc.State(concentric=case.concentric),
    )


def _of_a_drive(rig: jc.Mechanism) -> tuple[dict[str, Any], dict[str, Callable]]:
    """(responses, numbers that vary) of a drive of `benchmarks.attacks.coupled`: its element is its
    coupling, or the load that comes last."""
    element = lambda m: jax.tree.leaves(
        next(iter(m.couplings.values())) if m.couplings else list(m.loads.values())[-1]
    )
    first = next(i for i, n in enumerate(element(rig)) if eqx.is_inexact_array(n) and n != 0)
    force = lambda run: run.reaction("A").force
    responses = {
        "place": lambda run: jnp.sum(run.body("arm").com[-1]),
        "mean force": lambda run: jnp.mean(jnp.sqrt(jnp.sum(force(run) ** 2, axis=-1))),
    }
    numbers = {
        "element": lambda m: element(m)[first],
        "inertia": lambda m: m.bodies["arm"].inertia,
        "mass": lambda m: m.bodies["arm"].mass,
    }
    return responses, numbers


def reference(case: Case) -> tuple[dict, dict, dict] | str:
    """(slopes, doubts, values) by response, or why there are none."""
    tight = jc.integrator.Adaptive()
    known = differences(problem(case, tight))
    if isinstance(known, str) or not case.mechanism.topology.clearances:
        return known
    peaks = differences(problem(case, tight, dense=True))
    if isinstance(peaks, str):
        return peaks
    for of_all, of_peaks in zip(known, peaks, strict=True):
        of_all |= of_peaks
    slopes, doubts, _ = known
    coarse = slopes.pop(HALF)
    doubts["peak force"] = doubts["peak force"] + abs(slopes["peak force"] - coarse)
    return known


def differences(
    asked: jc.Problem, tolerances: tuple[float, float] = TOLERANCES
) -> tuple[dict, dict, dict] | str:
    """(slopes, how far they are sure, values) by response, from runs of `Adaptive` at these
    tolerances for numbers on either side of the nominal ones, or why there are none."""
    at = np.asarray(asked.nominal())
    points = [at] + [
        at + sign * share * way for share in SHARES for way in np.diag(at) for sign in (1, -1)
    ]

    @jax.jit
    def function(rtol: Any, values: Any) -> Any:
        bounds = lambda own: (own.integrator.rtol, own.integrator.atol)
        return eqx.tree_at(bounds, asked, (rtol, 1e-2 * rtol)).evaluate(values)

    found = []
    for rtol in tolerances:
        results = [function(jnp.asarray(rtol), jnp.asarray(values)) for values in points]
        if any(int(result.outcome) != jc.integrator.Outcome.REACHED for result in results):
            return "the reference does not reach its end"
        names = asked.response_names
        found.append({name: np.array([r.responses[name] for r in results]) for name in names})
    slopes, doubts, values = {}, {}, {}
    for name, responses in found[0].items():
        tight, loose = (extrapolated(own[name][1:], at) for own in found)
        slopes[name], values[name] = tight[0], responses[0]
        doubts[name] = np.maximum(tight[1], abs(tight[0] - loose[0]))
    return slopes, doubts, values


def extrapolated(responses: np.ndarray, at: Any) -> tuple[np.ndarray, np.ndarray]:
    """(slopes, how far they hang on the shares), from responses by share, number and sign."""
    pairs = responses.reshape(len(SHARES), len(at), 2)
    steps = np.asarray(SHARES)[:, None] * np.asarray(at)
    plain = (pairs[..., 0] - pairs[..., 1]) / (2 * steps)
    rough, close = ((4 * fine - coarse) / 3 for coarse, fine in (plain[:2], plain[1:]))
    return close, abs(close - rough)


def attack(structure: Structure, draw: int, rungs: dict[str, tuple]) -> list[Row]:
    """All slopes of one case."""
    number = structure.number * ROOM + draw
    try:
        case = structure.case(draw)
        if not case.mechanism.topology.clearances and structure.build not in COUPLED:
            return []
        known = reference(case)
    except ValueError as error:
        known = str(error)
    if isinstance(known, str):
        print(f"case {number} has no reference: {known}", flush=True)
        return []
    rows, names = [], tuple(problem(case, jc.integrator.Adaptive()).names)
    for rung, (make, limit) in rungs.items():
        own = told(lambda make=make: problem(case, make(case)))
        rows += judged((number, structure.name, rung), names, known, own, limit)
    return rows


def told(ask: Callable[[], jc.Problem]) -> tuple[dict, frozenset[str], np.ndarray | None]:
    """(slopes by response, none where a sentence refuses them; responses that are warned of; the
    numbers) of a problem."""
    try:
        asked = ask()
        at = np.asarray(asked.nominal())

        def both(values):
            result = asked.evaluate(values)
            return result.responses, result

        slopes, result = jax.jit(jax.jacfwd(both, has_aux=True))(asked.nominal())
    except ValueError:
        return {}, frozenset(), None
    if int(result.outcome) != jc.integrator.Outcome.REACHED:
        return {}, frozenset(), None
    return slopes, verdicts.of_checks(result.checks), at


def judged(
    where: tuple[int, str, str], names: tuple[str, ...], known: tuple, given: tuple, limit: float
) -> list[Row]:
    """The rows of a case and rung, by the names of what varies, what is known and what was told."""
    (slopes, doubts, values), (own, warned, at) = known, given
    rows = []
    for name, of_name in slopes.items():
        for k, variable in enumerate(names):
            slope = float(own[name][k]) if own else np.nan
            scale = abs(of_name[k])
            if at is not None:
                least = LEAST_OF_PLACES if name == "place" else LEAST
                scale = max(scale, least * abs(values[name] / at[k]))
            numbers = slope, float(of_name[k]), float(doubts[name][k]), float(scale)
            verdict = judge(*numbers, limit)
            if verdict == Verdict.WRONG and name in warned:
                verdict = Verdict.SAID
            rows.append(Row(*where, name, variable, verdict, *numbers))
    return rows


def judge(slope: float, known: float, doubt: float, scale: float, limit: float) -> Verdict:
    """Verdict on a slope that nothing was said of."""
    if not np.isfinite(slope):
        return Verdict.REFUSED
    error = abs(slope - known)
    if error <= limit * scale:
        return Verdict.RIGHT
    decided = doubt <= DECISIVE * limit * scale or error > limit * scale + 3 * doubt
    return Verdict.WRONG if decided else Verdict.UNDECIDABLE


def summary(rows: list[Row], key: str) -> list[dict[str, Any]]:
    """Slopes by verdict and rung, or by response."""
    table = []
    for name in [*dict.fromkeys(getattr(row, key) for row in rows), "all"]:
        own = [row for row in rows if name in (getattr(row, key), "all")]
        counts = Counter(row.verdict for row in own)
        table.append({key: name, "slopes": len(own)} | {str(v): counts[v] for v in Verdict})
    return table


def main() -> None:
    given = arguments(
        str(__doc__),
        first={"type": int, "default": 40, "help": "the first draw"},
        draws={"type": int, "default": 1, "help": "how many draws"},
        only={"type": int, "nargs": "*", "help": "mechanisms by number"},
        rung={"nargs": "*", "choices": list(RUNGS), "default": list(RUNGS)},
        minutes=MINUTES,
    )
    wanted = [each for each in structures() if given.only is None or each.number in given.only]
    # Kinds mixed, so that what is measured first is of all kinds.
    wanted = [each for first in range(MIXED) for each in wanted[first::MIXED]]
    if given.quick:
        wanted = wanted[:: len(wanted) // 3]
    rungs = {name: RUNGS[name] for name in given.rung}
    cases = ((one, given.first + draw) for one in wanted for draw in range(given.draws))
    run_attack(
        "benchmarks.attack_slopes",
        (functools.partial(attack, *case, rungs) for case in cases),
        given,
    )


def run_attack(module: str, cases: Iterable[Callable[[], list[Row]]], given: Any) -> None:
    """Attacks all cases, tells each as it is found, with its wrong slopes, and writes their tables,
    so that a run may be ended at any time."""
    rows: list[Row] = []
    for case in cases:
        if given.minutes and time.process_time() > 60 * given.minutes:
            break
        found = case()
        rows += found
        for (mechanism, verdict), count in Counter((x.mechanism, x.verdict) for x in found).items():
            print(f"{mechanism}: {count} {verdict}", flush=True)
        for row in found:
            if row.verdict == Verdict.WRONG:
                print(f"   {row}", flush=True)
        jax.clear_caches()
        for key in ("rung", "response", "mechanism"):
            report(f"slopes by {key}", summary(rows, key), given)
        sign(module, given.json)


if __name__ == "__main__":
    main()

"""How long a step each integrator can take, by contact stiffness and clearance, and how its energy
drifts over a million steps.

A journal of 1 kg pressed into a bearing by ten times its weight. For the steps it starts in the
middle, turning: it falls onto the wall, bounces (restitution 0.9), rubs and comes to rest against
the wall. Energies are measured above that rest, in units of the start's. A step is stable if the
run ends and its energy exceeds that of a fine reference by no more than `MARGIN` at any saving
time; it is accurate if moreover the mean energy of the second half is within `MARGIN` of the
reference's. For the drift the same journal is thrown and loses nothing.
"""

import math
import time
from collections.abc import Callable
from itertools import product
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

import jaxclear as jc
from benchmarks.measure import arguments, report, sign
from jaxclear.studies.store.batch import evaluate_all

MASS, INERTIA, GRAVITY = 1.0, 1e-2, 9.81
LOAD = 10 * MASS * GRAVITY
# Spin of the journal [rad/s]: slides at 1 m/s on a bearing of 10 mm, and hardly slows in the time
# of a run.
SPIN, RADIUS = 100.0, 10e-3
STIFFNESSES, CLEARANCES = (1e6, 1e8, 1e10, 1e12), (1e-6, 1e-5, 1e-4, 1e-3)
# The longest step [s], and how often it is halved: down to 1.2e-7 s. Saving times lie one longest
# step apart.
LONGEST, HALVINGS = 1e-3, 13
SAVES = 101
MARGIN = 0.1
# A step counts if the two halved ones below it do, too: instability has windows, and a rough step
# may be right by chance.
CONFIRMED = 3
# Share of the stored energy of Hertz's law in force x indentation.
STORED = 2 / 5
CONTACT_STEPS = 16
# Implicit steps: backward Euler in the contacts, the default, and no loss in a contact that a step
# does not resolve.
REBOUNDS = (0.0, 0.95, 1.0)
# Newton iterations that leave nothing of the contact forces unsolved.
MANY = 30
# Of the drift: stiffness [N/m^1.5], clearance [m], how it is thrown [m/s], step [s]; about 40 steps
# a contact.
BOUNCE = (1e10, 1e-4, (0.2, 0.1), 1e-5)


def journal(stiffness: float, clearance: float, lossless: bool = False) -> jc.Mechanism:
    """The journal in its bearing; `lossless`: no damping, no friction, only its own weight."""
    contact = (
        jc.contact.Hertz(stiffness=stiffness)
        if lossless
        else jc.contact.LankaraniNikravesh(stiffness=stiffness, restitution=0.9)
    )
    friction = None if lossless else jc.friction.CoulombTanh(mu_kinetic=0.05, transition_speed=1e-2)
    return jc.Mechanism(
        bodies={"journal": jc.Body(MASS, INERTIA)},
        connections={
            "B": jc.Connection(
                jc.clearance.PlanarJournalBearing(
                    contact, friction, bearing_radius=RADIUS, clearance=clearance
                ),
                "ground",
                "journal",
            )
        },
        loads={"load": jc.load.Gravity((0.0, -GRAVITY if lossless else -LOAD / MASS))},
        speeds={"journal": (*BOUNCE[2], 0.0) if lossless else (0.0, 0.0, SPIN)},
    )


def energy(run: jc.Trajectory) -> Any:
    """Energy of the journal at the saving times [J]: moving, in the contact, and against its load;
    spin left out.
    """
    place, velocity = run.body("journal").com, run.body("journal").velocity
    depth = jnp.maximum(run.contact("B").indentation[:, 0], 0.0)
    stiffness = run.mechanism.connections["B"].joint.contact.stiffness
    load = -MASS * run.mechanism.loads["load"].acceleration[1]
    return (
        0.5 * MASS * jnp.sum(velocity**2, axis=1)
        + load * place[:, 1]
        + STORED * stiffness * depth**2.5
    )


def excess(run: jc.Trajectory) -> Any:
    """Energy above that of rest at the bottom, over what it was at the start."""
    joint = run.mechanism.connections["B"].joint
    sunk = (LOAD / joint.contact.stiffness) ** (2 / 3)
    start = LOAD * (joint.clearance + (1 - STORED) * sunk)
    return energy(run) / start + 1.0


def problem(integrator: Any, saves: int) -> jc.Problem:
    """The pressed journal; stiffness and clearance vary."""
    late = saves // 2
    return jc.Problem(
        journal(1e10, 1e-4),
        {
            "highest": lambda run: jnp.max(excess(run)),
            "late": lambda run: jnp.mean(excess(run)[late:]),
        },
        {
            "stiffness": jc.Variable(
                lambda rig: rig.connections["B"].joint.contact.stiffness, tolerance=1.0
            ),
            "clearance": jc.Variable(
                lambda rig: rig.connections["B"].joint.clearance, tolerance=1e-9
            ),
        },
        duration=(saves - 1) * LONGEST,
        integrator=integrator,
        save=saves,
    )


def rungs() -> dict[str, Any]:
    """The integrators whose steps have a length."""
    explicit = {
        method: jc.integrator.FixedStep(LONGEST, method)
        for method in ("euler", "semi_implicit", "heun", "rk4")
    }
    short = jc.integrator.FixedStep(LONGEST, "rk4", contact_steps=CONTACT_STEPS)
    implicit = {
        f"implicit {rebound:g}": jc.integrator.ImplicitStep(LONGEST, rebound=rebound)
        for rebound in REBOUNDS
    }
    solved = jc.integrator.ImplicitStep(LONGEST, newton_iterations=MANY)
    return (
        explicit
        | {f"rk4, {CONTACT_STEPS} in contact": short}
        | implicit
        | {f"implicit, newton {MANY}": solved}
    )


def linear_theory(stiffness: float, clearance: float) -> float:
    """2.8 / omega [s], omega of Hertz's contact at the deepest indentation after the fall through
    the clearance.
    """
    depth = (LOAD / stiffness) ** (2 / 3)
    for _ in range(100):
        depth = (LOAD * (clearance + depth) / (STORED * stiffness)) ** (2 / 5)
    return 2.8 / math.sqrt(1.5 * stiffness * math.sqrt(depth) / MASS)


def ladder(
    integrator: Any, cases: np.ndarray, mark: dict, halvings: int, saves: int, seconds: float
) -> dict[str, list]:
    """Largest stable and accurate step of each case; halving ends when all are found or one run of
    all cases takes too long.
    """
    question, spent = problem(integrator, saves), 0.0
    steps = [LONGEST / 2**k for k in range(halvings + 1)]
    found: dict[str, list[list[bool]]] = {
        what: [[] for _ in cases] for what in ("stable", "accurate")
    }
    evaluate_all(question, cases)  # compiles, so that the first step does not look dear
    for step in steps:
        confirmed = all(
            row[-CONFIRMED:] == [True] * CONFIRMED for rows in found.values() for row in rows
        )
        if 2 * spent > seconds or confirmed:
            break
        begun = time.perf_counter()
        got = evaluate_all(
            eqx.tree_at(lambda p: p.integrator.step, question, jnp.asarray(step, float)), cases
        )
        spent = time.perf_counter() - begun
        # Comparisons with what is not a number are False.
        stable = (got.outcome == jc.integrator.Outcome.REACHED) & (
            got.responses["highest"] <= mark["highest"] + MARGIN
        )
        accurate = stable & (np.abs(got.responses["late"] - mark["late"]) <= MARGIN)
        for what, flags in (("stable", stable), ("accurate", accurate)):
            for row, flag in zip(found[what], flags, strict=True):
                row.append(bool(flag))
    return {what: [_largest(row, steps) for row in rows] for what, rows in found.items()}


def _largest(row: list[bool], steps: list[float]) -> str | float:
    for k in range(len(row) - CONFIRMED + 1):
        if all(row[k : k + CONFIRMED]):
            return f">={steps[0]:.3g}" if k == 0 else steps[k]
    return f"<{steps[len(row) - CONFIRMED]:.2g}"


def ladder_rows(quick: bool) -> dict[str, list[dict[str, Any]]]:
    """The table of stable and that of accurate steps."""
    stiffnesses, clearances = (
        (STIFFNESSES[1::2], CLEARANCES[1:3]) if quick else (STIFFNESSES, CLEARANCES)
    )
    halvings, saves, seconds = (10, 21, 5.0) if quick else (HALVINGS, SAVES, 300.0)
    cases = np.array(list(product(stiffnesses, clearances)))
    exact = jc.integrator.Adaptive(rtol=1e-9, atol=1e-12)
    fine = evaluate_all(problem(exact, saves), cases, chunk=1)
    tables: dict[str, list[dict[str, Any]]] = {"stable": [], "accurate": []}
    for (k, c), outcome in zip(cases, fine.outcome, strict=True):
        ended = (
            "ok"
            if outcome == jc.integrator.Outcome.REACHED
            else jc.integrator.Outcome(outcome).sentence
        )
        for rows in tables.values():
            row = {"K [N/m^1.5]": float(k), "clearance [m]": float(c), "reference": ended}
            rows.append(row | {"2.8 / omega [s]": linear_theory(k, c)})
    for name, integrator in rungs().items():
        answers = _or_sentence(
            lambda: ladder(integrator, cases, fine.responses, halvings, saves, seconds)
        )
        for what, rows in tables.items():
            for i, row in enumerate(rows):
                row[f"{name} [s]"] = answers if isinstance(answers, str) else answers[what][i]
    return tables


def _or_sentence(what: Callable[[], Any]) -> Any:
    """The answer, or in its place the sentence with which it failed."""
    try:
        return what()
    except Exception as error:
        return f"{type(error).__name__}: {str(error).splitlines()[0]}"


def drift_rows(quick: bool) -> list[dict[str, Any]]:
    most = 100_000 if quick else 1_000_000
    return [_drift(name, integrator, most) for name, integrator in bouncing().items()]


def bouncing() -> dict[str, Any]:
    """The rungs at the step of the drift, and the reference that chooses its own."""
    step = BOUNCE[-1]
    fixed = {
        name: eqx.tree_at(lambda i: i.step, integrator, jnp.asarray(step, float))
        for name, integrator in rungs().items()
    }
    return fixed | {
        "adaptive, rtol 1e-7": jc.integrator.Adaptive(),
        "adaptive, rtol 1e-10": jc.integrator.Adaptive(rtol=1e-10, atol=1e-12),
    }


def _drift(name: str, integrator: Any, most: int) -> dict[str, Any]:
    stiffness, clearance, _, step = BOUNCE
    saves = 1000
    marks = [most // 100, most // 10, most]
    row: dict[str, Any] = {"integrator": name} | {f"after {n:.0e} steps": "-" for n in marks}
    row |= {"largest so far": "-", "energy": "-", "evaluated steps": "-", "result": "-"}

    def go():
        rig = journal(stiffness, clearance, lossless=True)
        return jc.simulate(
            rig,
            most * step,
            integrator=integrator,
            save=saves + 1,
            state=jc.State(concentric=False),
            throw=False,
        )

    run = _or_sentence(go)
    if isinstance(run, str):
        return row | {"result": run}
    level = np.asarray(energy(run))
    change = (level - level[0]) / level[0]
    reached = int(np.sum(np.asarray(run.time) <= float(run.ended) * (1 + 1e-12)))
    for n in marks:
        last = n * saves // most
        if last < reached:
            # The mean over the last tenth: within a contact the energy of a discrete path breathes.
            row[f"after {n:.0e} steps"] = float(np.mean(change[last - last // 10 : last + 1]))
    row["largest so far"] = float(np.abs(change[:reached]).max())
    row["evaluated steps"] = int(run.accepted_steps) + int(run.rejected_steps)
    tail = change[:reached][-max(reached // 10, 1) :]
    row["energy"] = "gained" if tail.min() > 0 else "lost" if tail.max() < 0 else "both"
    return row | {"result": "ok" if run.succeeded else run.result}


def main() -> None:
    options = arguments(__doc__)
    for what, rows in ladder_rows(options.quick).items():
        report(
            f"stability: largest {what} step of a journal pressed into its bearing", rows, options
        )
    title = (
        f"stability: relative drift of the energy of a bouncing journal, no losses, steps of "
        f"{BOUNCE[-1]:g} s"
    )
    report(title, drift_rows(options.quick), options)
    sign("benchmarks.claims.stability", options.json)


if __name__ == "__main__":
    main()

"""Derivatives through touches: how far they are off, by rung, step and contact law.

A journal is thrown down in its bearing and bounces; the slopes of its height by clearance, start
speed and the law's own numbers stand beside those of the motion: extrapolated differences of tight
`Adaptive` runs, and for rigid contact the closed form of the bounces. The largest error over these
numbers, behind one, two, three and five or six bounces; nan where a run says that it does not know.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import jaxclear as jc
from benchmarks.measure import run_tables

GRAVITY, CLEARANCE, SPEED, RESTITUTION = 9.81, 1e-3, -0.05, 0.8
# Ends of runs [s] behind one, two, three and five or six bounces.
ENDS = (0.025, 0.045, 0.062, 0.09)
STEPS = (5e-6, 2e-5, 1e-4)
# A share of each number, by which differences are taken.
SHARE = 1e-4
JOINT = lambda rig: rig.connections["B"].joint
ELASTIC = lambda rig: JOINT(rig).contact.elastic.stiffness
BOUNCE = lambda rig: JOINT(rig).contact.dissipation.restitution
STIFFNESS = lambda rig: JOINT(rig).contact.stiffness
DAMPING = lambda rig: JOINT(rig).contact.damping
# By law: the law, and which of its numbers vary.
LAWS: dict[str, tuple] = {
    "Flores": (jc.contact.Flores(stiffness=1e9, restitution=RESTITUTION), ELASTIC, BOUNCE),
    "AdamsImpact": (jc.contact.AdamsImpact(stiffness=1e9, damping=2e2), STIFFNESS, DAMPING),
}
RIGID = jc.contact.Rigid(restitution=RESTITUTION), lambda rig: JOINT(rig).contact.restitution
RUNGS: dict[str, Any] = {
    "FixedStep": jc.integrator.FixedStep(),
    "FixedStep, semi_implicit": jc.integrator.FixedStep(method="semi_implicit"),
    "ImplicitStep, rebound 1": jc.integrator.ImplicitStep(rebound=1.0),
}


def asked(law: Any, integrator: Any, *numbers: Callable) -> jc.Problem:
    """The bouncing journal's height [mm] at the end, by clearance, start speed and the numbers."""
    bearing = jc.clearance.PlanarJournalBearing(law, clearance=CLEARANCE)
    rig = jc.Mechanism(
        {"journal": jc.Body(1.0, 1e-4)},
        {"B": jc.Connection(bearing, "ground", "journal")},
        {"gravity": jc.load.Gravity((0.0, -GRAVITY))},
        speeds={"journal": (0.0, SPEED, 0.0)},
    )
    places = lambda rig: JOINT(rig).clearance, lambda rig: rig.speeds["journal"][1]
    return jc.Problem(
        rig,
        {"height": lambda run: 1e3 * run.body("journal").com[-1, 1]},
        {str(i): jc.Variable(place, tolerance=1e-9) for i, place in enumerate((*places, *numbers))},
        duration=0.01,
        integrator=integrator,
        save=2,
    )


def height(problem: jc.Problem, values: Any, end: Any, step: Any) -> Any:
    """The response of a run that ends then, in steps so long (None: of the integrator's own)."""
    problem = eqx.tree_at(lambda own: own.duration, problem, end)
    if step is not None:
        problem = eqx.tree_at(lambda own: own.integrator.step, problem, step)
    return problem.evaluate(values).responses["height"]


def of_the_motion(law: Any, *numbers: Callable) -> np.ndarray:
    """Slopes (ends, numbers) by differences of tight runs."""
    problem = asked(law, jc.integrator.Adaptive(rtol=1e-12, atol=1e-14), *numbers)
    values = problem.nominal()
    ways = SHARE * jnp.diag(values)
    around = jax.jit(jax.vmap(lambda v, end: height(problem, v, end, None), (0, None)))
    found = []
    for end in ENDS:
        whole, half = (
            (around(values + way, end) - around(values - way, end)) / (2 * jnp.diag(way))
            for way in (ways, 0.5 * ways)
        )
        found.append(half + (half - whole) / 3)
    return np.array(found)


def by_hand(values: Any, end: float) -> Any:
    """Height [mm] of a journal that bounces rigidly: parabolas from impact to impact. `values`:
    clearance, start speed, restitution."""
    clearance, speed, restitution = values
    first = (speed + jnp.sqrt(speed * speed + 2 * GRAVITY * clearance)) / GRAVITY
    fast, time = restitution * (GRAVITY * first - speed), first
    for _ in range(20):
        again = time + 2 * fast / GRAVITY
        time, fast = (
            jnp.where(again < end, ahead, now)
            for ahead, now in ((again, time), (restitution * fast, fast))
        )
    left = end - time
    return 1e3 * (-clearance + fast * left - 0.5 * GRAVITY * left * left)


def errors(problem: jc.Problem, wanted: np.ndarray, step: float | None) -> dict[str, float]:
    """The largest share by which a slope is off at each end."""
    slopes = jax.jit(jax.jacfwd(lambda v, end, step: height(problem, v, end, step)))
    found = [slopes(problem.nominal(), end, step) for end in ENDS]
    off = np.abs(np.array(found) / wanted - 1).max(axis=1)
    return {f"to {1e3 * end:g} ms": float(share) for end, share in zip(ENDS, off, strict=True)}


def row(law: str, rung: str, step: float | None, found: dict[str, float]) -> dict[str, Any]:
    """A row of the table."""
    return {"law": law, "rung": rung, "step [us]": None if step is None else 1e6 * step} | found


def rows_of(options: Any) -> list[dict[str, Any]]:
    """A row for each law, rung and step."""
    laws, steps = (dict([*LAWS.items()][:1]), STEPS[1:2]) if options.quick else (LAWS, STEPS)
    rows = []
    for law, (contact, *numbers) in laws.items():
        wanted = of_the_motion(contact, *numbers)
        adaptive = asked(contact, jc.integrator.Adaptive(), *numbers)
        rows.append(row(law, "Adaptive", None, errors(adaptive, wanted, None)))
        for rung, integrator in RUNGS.items():
            problem = asked(contact, integrator, *numbers)
            rows += [row(law, rung, step, errors(problem, wanted, step)) for step in steps]
            jax.clear_caches()
    problem = asked(RIGID[0], jc.integrator.MoreauJean(), *RIGID[1:])
    values = problem.nominal()
    wanted = np.array([jax.jacfwd(by_hand)(values, end) for end in ENDS])
    return rows + [
        row("Rigid", "MoreauJean", step, errors(problem, wanted, step)) for step in (1e-6, *steps)
    ]


if __name__ == "__main__":
    run_tables({"Derivatives through bounces: largest error": rows_of})

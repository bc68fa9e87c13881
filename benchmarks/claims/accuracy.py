"""Accuracy in, cost out: what is asked of a run, what it reaches, and what it costs.

    python -m benchmarks.claims.accuracy [--quick] [--json FILE]

Mechanisms of tests/rigs/accuracy_asked.py. "off" is the largest share by which places, mean forces,
friction loss and wear differ from those of `Adaptive` at rtol 1e-11; work is counted in evaluations
of forces, that of the choice too. Beside it what a study takes that asks for nothing.
"""

from typing import Any

import jaxclear as jc
from benchmarks.measure import arguments, report
from jaxclear.errors.accuracy import bounds_of_run
from jaxclear.simulation.simulate import How, chosen_for
from jaxclear.studies.usual_integrator import usual_integrator
from tests.rigs.accuracy_asked import CASES, Case, share_off, truth

ASKED, QUICK = (0.05, 0.01, 0.001), (0.01,)


def steps_of(run: Any) -> int:
    return int(run.accepted_steps) + int(run.rejected_steps)


def usual(name: str, case: Case, exact: Any) -> dict[str, Any]:
    """What a study takes unasked."""
    rig = case.make()
    integrator, _ = usual_integrator(rig, case.duration)
    given = {"save": case.saves, "balance": True, "verify": False}
    run = jc.simulate(rig, case.duration, integrator=integrator, **given)
    kind = type(integrator).__name__
    evaluations = integrator.evaluations(rig)
    step = integrator.asked_step()
    chosen = kind if step is None else f"{kind}({float(step):.3g})"
    return {
        "mechanism": name,
        "asked": "nothing",
        "chosen": chosen,
        "told": None,
        "off": share_off(run, exact),
        "work": evaluations * steps_of(run),
        "work of the choice": 0,
    }


def asked(name: str, case: Case, accuracy: float, exact: Any) -> dict[str, Any]:
    """What is chosen for an accuracy."""
    rig, question = case.make(), bounds_of_run(accuracy)
    how = How(case.saves, balance=True)
    found = chosen_for(rig, case.duration, question.observe, question.compare, how)
    given = {"save": case.saves, "balance": True, "verify": False}
    run = jc.simulate(rig, case.duration, integrator=found.integrator, **given)
    return {
        "mechanism": name,
        "asked": f"{accuracy:.1%}",
        "chosen": found.why.split(": ")[0].removeprefix("Run with integrator."),
        "told": found.error_ratio * accuracy,
        "off": share_off(run, exact),
        "work": found.work,
        "work of the choice": found.spent,
    }


def main() -> None:
    options = arguments(__doc__)
    rows = []
    for name, case in CASES.items():
        exact = truth(case)
        rows.append(usual(name, case, exact))
        rows += [asked(name, case, each, exact) for each in (QUICK if options.quick else ASKED)]
    report("accuracy in, cost out", rows, options)


if __name__ == "__main__":
    main()

"""Half a second of the flap: what ImplicitStep costs and how right its forces and friction are,
beside Adaptive, and what its runs warn of.

Of every joint the impulse of its contact over the run, which is its mean force, and its largest
force, that of an impact of some microseconds; of all joints together the energy that friction
takes, integrated with the motion (`balance`). Mean forces are right at any of these steps. What
friction takes is not: the warning at 5e-6 s is true.
"""

import time
from typing import Any

import equinox as eqx
import numpy as np

import jaxclear as jc
from benchmarks.measure import arguments, report, side_by_side, sign
from jaxclear.multibody.state import ENERGIES
from jaxclear.results.histories import contact_impulse
from jaxclear.scenes.flap import JOINTS

DURATION, SAVES = 0.5, 201
STEPS = (1e-5, 5e-6, 2e-6, 1e-6)
REFERENCES = (1e-7,)
MOST_STEPS = 10_000_000
QUICK = (5e-6,), (1e-7,), 0.02


def asked(run: jc.Trajectory) -> dict[str, np.ndarray]:
    """Impulses by joint [N s], friction's energy [J], and where the second rod is [m]."""
    energies = np.asarray(run.states)[-1, run.history.layout().energy_start :]
    peaks = [float(jc.response.PeakContactForce(joint)(run)) for joint in JOINTS]
    return {
        "mean forces": np.array([float(contact_impulse(run.history, j)[-1]) for j in JOINTS]),
        "peak forces": np.array(peaks),
        "friction loss": np.array([energies[ENERGIES.index("friction_loss")]]),
        "motion": np.asarray(run.body("rod 2").com[-1]),
    }


def off(found: dict[str, np.ndarray], wanted: dict[str, np.ndarray]) -> dict[str, float]:
    """Largest difference of each, as a share of the largest."""
    return {
        f"{name} off [1]": float(
            np.max(abs(found[name] - wanted[name])) / np.max(abs(wanted[name]))
        )
        for name in wanted
    }


def row(name: str, run: jc.Trajectory, wanted: dict[str, np.ndarray], spent: float) -> dict:
    """What is told of a run."""
    said = {"integrator": name, "CPU [s]": spent} | off(asked(run), wanted)
    return said | {
        "warns of": ", ".join(told.name for told in run.verification.entries if told.beyond),
    }


def main() -> None:
    options = arguments(__doc__)
    steps, rtols, duration = QUICK if options.quick else (STEPS, REFERENCES, DURATION)
    rig = jc.scenes.flap()

    def simulated(integrator: Any, balance: bool = True) -> jc.Trajectory:
        return jc.simulate(
            rig, duration, integrator=integrator, save=SAVES, balance=balance, verify=True
        )

    tight = []
    for rtol in rtols:
        begun = time.process_time()
        one = jc.integrator.Adaptive(rtol=rtol, atol=1e-2 * rtol, max_steps=MOST_STEPS)
        run = simulated(one)
        tight.append((rtol, run, time.process_time() - begun))
    wanted = asked(tight[-1][1])
    rows = [row(f"Adaptive(rtol={rtol:g}), compiled", run, wanted, s) for rtol, run, s in tight]
    for step in steps:
        own = jc.integrator.ImplicitStep(step)
        problem = jc.Problem(
            rig,
            {"mean force": jc.response.MeanContactForce("J1")},
            {},
            duration=duration,
            integrator=own,
            save=SAVES,
        )
        evaluate = {"": _evaluating(problem)}
        spent = side_by_side(evaluate, 2)[""][1]
        rows.append(row(f"ImplicitStep({step:g})", simulated(own), wanted, spent))
    report(f"{duration:g} s of the flap", rows, options)
    sign("benchmarks.claims.flap", options.json)


def _evaluating(problem: jc.Problem) -> Any:
    """The problem's nominal run, compiled."""
    one, values = eqx.filter_jit(lambda p, v: p.evaluate(v)), problem.nominal()
    return lambda: one(problem, values).responses


if __name__ == "__main__":
    main()

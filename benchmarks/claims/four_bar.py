"""Five seconds of the four-bar (spatial clearance, friction, wear): what a run costs at 1 % in its
statistics, rung by rung.

Statistics: mean normal force, peak worn depth, worn volume, root mean square of the follower's
error in the plane. Rattling is chaotic, so a rung is compared with the reference over a few runs
whose clearances differ by up to 0.1 um: the errors of the means, and the standard error of these
differences beside them. The cost is that of one run alone, and of a sample in a batch. Compilation
is not counted.
"""

import time

import equinox as eqx
import numpy as np

import jaxclear as jc
from benchmarks.measure import alone, arguments, report, sign
from jaxclear.integrators import Outcome
from jaxclear.scenes.four_bar import four_bar
from jaxclear.studies.store.batch import evaluate_all

SAVES_PER_SECOND = 400
# Clearances of the ensemble differ by this share: far below what moves a mean, far above rounding.
SPREAD = 5e-4
ACCURACY = 0.01
REFERENCE = {"rtol": 1e-9, "atol": 1e-11}
BATCH_SPREAD = 20e-6


def rungs() -> dict[str, jc.integrator.AbstractIntegrator]:
    """The ladder, dear to cheap within each family."""
    fixed, implicit = jc.integrator.FixedStep, jc.integrator.ImplicitStep
    found = {f"FixedStep rk4, {step:g} s": fixed(step) for step in (2e-5, 4e-5, 8e-5)}
    found |= {
        f"FixedStep semi-implicit, {step:g} s": fixed(step, "semi_implicit")
        for step in (5e-6, 1e-5, 2e-5)
    }
    found |= {
        f"FixedStep rk4, {step:g} s, 4 in contact": fixed(step, contact_steps=4.0)
        for step in (8e-5, 1.6e-4)
    }
    found |= {f"ImplicitStep, {step:g} s": implicit(step) for step in (2e-5, 5e-5, 1e-4)}
    found |= {
        f"Adaptive, rtol {rtol:g}": jc.integrator.Adaptive(rtol=rtol, atol=1e-2 * rtol)
        for rtol in (1e-7, 1e-5)
    }
    return found


def question(duration: float) -> jc.Problem:
    """The run and its statistics; the clearance may vary."""
    saves = round(SAVES_PER_SECOND * duration) + 1
    ideal = jc.simulate(four_bar("ideal"), duration, save=saves).body("follower").com
    return jc.Problem(
        four_bar(),
        {
            "mean force": jc.response.MeanContactForce("B"),
            "worn depth": jc.response.PeakWornDepth("B"),
            "worn volume": jc.response.WornVolume("B"),
            "follower error": jc.response.PositionError("follower", ideal, axes=(0, 1)),
        },
        {
            "clearance": jc.Variable(
                lambda rig: rig.connections["B"].joint.clearance, tolerance=BATCH_SPREAD
            )
        },
        duration=duration,
        save=saves,
    )


def with_integrator(
    problem: jc.Problem, integrator: jc.integrator.AbstractIntegrator
) -> jc.Problem:
    return eqx.tree_at(lambda p: p.integrator, problem, integrator)


def statistics(problem: jc.Problem, values: np.ndarray) -> tuple[dict[str, np.ndarray], bool]:
    """Responses of the ensemble, and whether all of it reached the end."""
    outcome = evaluate_all(problem, values)
    return outcome.responses, bool(np.all(outcome.outcome == Outcome.REACHED))


def main() -> None:
    options = arguments(__doc__)
    duration, members, samples = (0.5, 4, 64) if options.quick else (5.0, 8, 1024)
    problem = question(duration)
    nominal = float(problem.nominal()[0])
    values = nominal * (1 + SPREAD * np.linspace(-1, 1, members))[:, None]
    reference, sound = statistics(
        with_integrator(problem, jc.integrator.Adaptive(**REFERENCE)), values
    )
    if not sound:
        raise SystemExit("the reference did not reach its end")
    rows, good = [], []
    for name, integrator in rungs().items():
        asked = with_integrator(problem, integrator)
        found, sound = statistics(asked, values)
        row, worst, doubt = {"rung": name}, 0.0, 0.0
        for key, wanted in reference.items():
            difference = (found[key] - wanted) / wanted.mean()
            error = abs(difference.mean())
            row[f"{key} [%]"] = 100 * float(error)
            worst = max(worst, error)
            doubt = max(doubt, difference.std(ddof=1) / np.sqrt(members))
        wall, cpu = alone(asked, 2) if sound else (np.nan, np.nan)
        row |= {
            "standard error [%]": 100 * float(doubt),
            "alone [s]": wall,
            "alone, CPU [s]": cpu,
            "simulated / computed": duration / wall,
        }
        row["within 1 %"] = (
            "yes" if sound and worst < ACCURACY else ("no" if sound else "did not reach its end")
        )
        rows.append(row)
        if sound and worst < ACCURACY:
            good.append((wall, name))
    report(
        f"four-bar, {duration:g} s: statistics against the reference and cost alone", rows, options
    )
    rng = np.random.default_rng(0)
    batch = nominal + BATCH_SPREAD * rng.uniform(-1, 1, (samples, 1))
    rows = []
    for _, name in sorted(good)[:3]:
        asked = with_integrator(problem, rungs()[name])
        evaluate_all(asked, batch[:64])
        start, begun = time.perf_counter(), time.process_time()
        outcome = evaluate_all(asked, batch)
        wall, cpu = time.perf_counter() - start, time.process_time() - begun
        failed = int(np.sum(outcome.outcome != Outcome.REACHED))
        rows.append(
            {
                "rung": name,
                "samples": samples,
                "failed": failed,
                "wall [ms/sample]": 1e3 * wall / samples,
                "CPU [ms/sample]": 1e3 * cpu / samples,
            }
        )
    if rows:
        report(
            f"four-bar, {duration:g} s: a batch on all cores, the three cheapest rungs within 1 %",
            rows,
            options,
        )
    sign("benchmarks.claims.four_bar", options.json)


if __name__ == "__main__":
    main()

"""How often the band of the cycle of failure holds the true one: slider-cranks that the fit does
not know, whose clearance grows steadily, each recorded at three times.

    python -m benchmarks.claims.remaining_life [--quick] [--rigs N] [--runs N] [--json FILE]

Machines, sensors and what is hidden are those of benchmarks.claims.identification, case "crank". A
clearance of 0.06 to 0.14 mm grows by 0.02 to 0.08 mm in a million cycles; records are made after 0,
1 and 2 million, and 0.5 mm is the limit. All rigs share the fit's sample.
"""

import argparse
from pathlib import Path

import jax.numpy as jnp
import numpy as np

import jaxclear as jc
from benchmarks.claims.identification import (
    HIDDEN,
    NOISE,
    PER,
    crank,
    record_of,
    sensors,
)
from benchmarks.measure import report, sign
from jaxclear.integrators import Outcome
from jaxclear.studies.identification.identify import answered, fit
from jaxclear.studies.identification.laws import ensemble
from jaxclear.studies.identification.sample import sampled, watched
from jaxclear.studies.store.batch import evaluate_all
from jaxclear.studies.sampling import Drawing

CYCLES, LIMIT, NAME = (0.0, 1e6, 2e6), 0.5e-3, "clearance B"
FIRST, GROWTH = (0.06e-3, 0.14e-3), (0.02e-9, 0.08e-9)
LEVELS = (0.9, 0.95)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--rigs", type=int, default=100)
    parser.add_argument("--runs", type=int, default=256, help="of the sample")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    if options.quick:
        options.rigs, options.runs = 4, 64
    case, rng = crank(), np.random.default_rng(5)
    blank = {name: np.zeros(case.turns * PER + 1) for name in case.sensors}
    blank["crank"] = np.arange(case.turns * PER + 1.0)
    nothing = record_of(case, blank, dict.fromkeys(case.sensors, 0.0), 1.0)
    known = ensemble(case.hidden.mechanism, HIDDEN)
    asked = watched(case.hidden, nothing, known)
    # Each rig keeps its friction, restitution, modulus and laws; its clearance grows.
    values = np.repeat(Drawing(asked, 77, "sobol", 1).span(0, options.rigs), len(CYCLES), axis=0)
    first, growth = rng.uniform(*FIRST, options.rigs), rng.uniform(*GROWTH, options.rigs)
    grown = first[:, None] + growth[:, None] * np.array(CYCLES)
    values[:, asked.names.index(NAME)] = grown.ravel()
    found = evaluate_all(asked, jnp.asarray(values), label="hidden")
    signals = {name: np.asarray(found.responses[f"signal {name}"]) for name in nothing.sensors}
    noise = {n: NOISE * float(np.median(signals[n].std(axis=1))) for n in case.sensors}
    rate = PER * case.speed / (2 * np.pi)
    seen = {n: s.sensed(signals[n], rate, rng) for n, s in sensors(case, noise, 1.0).items()}
    records = [
        record_of(case, {n: own[i] for n, own in seen.items()}, noise, 1.0)
        for i in range(len(values))
    ]
    laws = ensemble(case.fit.mechanism, None)
    runs_of = watched(case.fit, records[0], laws)
    sample = sampled(case.fit, records[0], runs_of, laws, options.runs)
    fitted = fit(case.fit, records[0], sample, jc.signal.usual_statistics(True))
    told = [answered(fitted, own) for own in records]
    good = np.asarray(found.outcome).reshape(options.rigs, -1) == Outcome.REACHED
    truth = (LIMIT - first) / growth
    rows = []
    for count in (2, 3):
        at = (0, 2) if count == 2 else (0, 1, 2)
        for level in LEVELS:
            held, width, off = [], [], []
            for i in np.flatnonzero(good.all(axis=1)):
                own = {CYCLES[k]: told[len(CYCLES) * i + k] for k in at}
                middle, low, high = jc.remaining_life(own, NAME, LIMIT, level=level).failure_band
                held.append(low <= truth[i] <= high)
                width.append((high - low) / truth[i])
                off.append(middle / truth[i] - 1)
            rows.append(
                {
                    "records": count,
                    "band [%]": 100 * level,
                    "rigs": len(held),
                    "held [%]": 100 * np.mean(held),
                    "median width [% of the life]": 100 * np.median(width),
                    "median error [%]": 100 * np.median(np.abs(off)),
                }
            )
    report("Cycle of failure", rows, options)
    sign("benchmarks.claims.remaining_life", options.json, ["Cycle of failure"])


if __name__ == "__main__":
    main()

"""What a sample of a Monte Carlo study costs, by chunk size: the four-bar study's own problem, end
to end, on all cores.
"""

import numpy as np

import jaxclear as jc
from benchmarks.measure import arguments, report, side_by_side
from jaxclear.commands.four_bar import problem

STEP = 2e-5


def main() -> None:
    options = arguments(__doc__)
    duration, samples = (0.05, 64) if options.quick else (0.2, 256)
    question = problem(duration, 26)
    chunks = (16, 64) if options.quick else (1, 4, 16, 32, 64, 128, 256)
    cases = {
        f"chunks of {chunk}": lambda c=chunk: jc.monte_carlo(question, samples, chunk=c).responses[
            "follower error"
        ]
        for chunk in chunks
    }
    single = jc.scenes.four_bar()
    cases["one run at a time"] = lambda: np.asarray(
        jc.simulate(single, duration, save=26, integrator=jc.integrator.FixedStep(STEP)).states
    )
    times = side_by_side(cases, 2)
    mark = times["one run at a time"][0]
    rows = []
    for name, (wall, _) in times.items():
        runs = 1 if name == "one run at a time" else samples
        per_sample = wall / runs
        row = {"how": name, "samples": runs, "wall [ms/sample]": 1e3 * per_sample}
        row |= {
            "wall [ns/sample-step]": per_sample / (duration / STEP) * 1e9,
            "faster than one at a time": mark / per_sample,
        }
        rows.append(row)
    report(
        f"monte carlo: {duration:g} s of the four-bar a sample, rk4 steps of {STEP:g} s",
        rows,
        options,
    )


if __name__ == "__main__":
    main()

"""What a sample of a Monte Carlo study costs on an accelerator, by chunk size, beside this machine's
processor, and how far their answers are apart: the four-bar study's own problem.

Run it where JAX finds an accelerator; elsewhere it measures the processor alone.
"""

import time

import jax
import numpy as np

import jaxclear as jc
from benchmarks.measure import arguments, report
from jaxclear.commands.four_bar import problem
from jaxclear.studies.monte_carlo import MonteCarlo


def main() -> None:
    options = arguments(__doc__)
    duration, sizes = (0.02, (64, 512)) if options.quick else (0.1, (64, 512, 4096, 16384))
    question = problem(duration, 26)
    rows, mark = [], None
    for platform in dict.fromkeys(("cpu", jax.default_backend())):
        for samples in sizes[: 2 if platform == "cpu" else None]:
            with jax.default_device(jax.devices(platform)[0]):
                first, study = _timed(question, samples)
                again, study = _timed(question, samples)
            answers = np.asarray(study.responses["follower error"])[: sizes[0]]
            mark = answers if mark is None else mark
            rows.append(
                {
                    "on": jax.devices(platform)[0].device_kind,
                    "samples": samples,
                    "first [s]": first,
                    "wall [ms/sample]": 1e3 * again / samples,
                    "failed": len(study.failed),
                    "largest difference [1]": np.max(np.abs(answers / mark - 1)),
                }
            )
            print(rows[-1], flush=True)
    report(f"accelerator: {duration:g} s of the four-bar a sample", rows, options)


def _timed(question: jc.Problem, samples: int) -> tuple[float, MonteCarlo]:
    begun = time.perf_counter()
    study = jc.monte_carlo(question, samples, chunk=samples)
    return time.perf_counter() - begun, study


if __name__ == "__main__":
    main()

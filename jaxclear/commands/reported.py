"""What every study prints of its runs: what they warn of."""

from collections.abc import Mapping
from typing import Any

# So many samples of a Monte Carlo are told one by one; the table on disk has them all.
MOST_TOLD = 5


def report_warnings(runs: Mapping[str, Any]) -> None:
    """Prints a line for every warning of runs, each with what its run is called."""
    for name, run in runs.items():
        for sentence in run.warnings:
            print(f"warning, {name}: {sentence}", flush=True)


def report_samples(sample: Any) -> None:
    """Prints how many samples of a Monte Carlo failed and warn, and the first of them in words."""
    print(sample.sentence())
    told = {index: f"failed. {sentence}" for index, sentence in sample.failures().items()}
    told |= {index: f"warns. {' '.join(found)}" for index, found in sample.warnings().items()}
    for index in sorted(told)[:MOST_TOLD]:
        print(f"sample {index} {told[index]}")
    if len(told) > MOST_TOLD:
        print(f"and {len(told) - MOST_TOLD} more, in the table.", flush=True)

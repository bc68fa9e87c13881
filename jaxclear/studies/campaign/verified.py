"""Replicas of a campaign's first samples, in its folder: finer runs of theirs, written once all
samples are there, however many; a campaign that becomes larger keeps them, and adds what it lacks.
"""

import json
import secrets
from pathlib import Path

import numpy as np

from jaxclear.studies.campaign.layout import VALUES
from jaxclear.studies.campaign.samples import Samples
from jaxclear.studies.campaign.work import AbstractWork
from jaxclear.studies.replicas import MOST_REPLICAS, Replicas, joined, together_with

__all__ = ["known_replicas", "verify"]

REPLICAS = "replicas.json"
# Held by the process that adds replicas.
VERIFYING = ".verifying"


def known_replicas(folder: Path) -> Replicas | None:
    """The replicas in the folder of a campaign; None where there are none."""
    path = folder / REPLICAS
    if not path.exists():
        return None
    kept = json.loads(path.read_text())
    own, finer = (
        {name: np.array(numbers, float) for name, numbers in kept[side].items()}
        for side in ("own", "responses")
    )
    outcome, ended = np.array(kept["outcome"], int), np.array(kept["ended"], float)
    return Replicas(own, finer, outcome, ended, kept["share"])


def verify(samples: Samples, by: AbstractWork) -> None:
    """Adds the replicas that the finished samples in a folder lack, if their problem has any."""
    import filelock

    with filelock.FileLock(samples.folder / VERIFYING, thread_local=False):
        known = known_replicas(samples.folder)
        there = 0 if known is None else known.count
        lacking = slice(there, min(MOST_REPLICAS, samples.plan.samples))
        if lacking.start >= lacking.stop:
            return
        finer = by.replicated(samples.plan, samples.read(VALUES, lacking))
        if finer is None:
            return
        count = lacking.stop - lacking.start
        found = together_with(by.problem, samples.found(lacking), finer, count)
        _write(samples.folder, found if known is None else joined(known, found))


def _write(folder: Path, found: Replicas) -> None:
    told = {
        "share": found.share,
        "outcome": found.outcome.tolist(),
        "ended": found.ended.tolist(),
        "own": {name: own.tolist() for name, own in found.own.items()},
        "responses": {name: own.tolist() for name, own in found.responses.items()},
    }
    beside = folder / f".{secrets.token_hex(8)}"
    beside.write_text(json.dumps(told))
    beside.replace(folder / REPLICAS)

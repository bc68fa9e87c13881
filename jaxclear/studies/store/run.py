"""How a campaign comes to all the samples that are asked of it: a folder is begun or found, made
larger where more are asked for, what it lacks is computed, and its first samples get replicas.
"""

import dataclasses
import json
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import jax
import numpy as np
from tqdm import tqdm

from jaxclear.ground.warning import warn
from jaxclear.integrators.checks import Checks
from jaxclear.studies.campaign.recorded import in_json
from jaxclear.studies.problem import Problem
from jaxclear.studies.replicas import MOST_REPLICAS
from jaxclear.studies.sampling import groups
from jaxclear.studies.sequential import until_accurate
from jaxclear.studies.statistics.accuracy import Asked, Piece
from jaxclear.studies.store.digest import in_texts
from jaxclear.studies.store.result import Campaign
from jaxclear.studies.store.samples import KIND, RESPONSES, VALUES, Plan, Samples, batch_of, held
from jaxclear.studies.store.store import refuse_other
from jaxclear.studies.store.threads import AbstractWork, Heard

# Samples that are read together, about.
READ = 1 << 16
# Held by the process that adds replicas.
VERIFYING = ".verifying"


class Wanted(NamedTuple):
    """The plan to begin with, the most samples, and how accurate means are to be, if that decides
    how many there are."""

    plan: Plan
    most: int
    accuracy: Asked | None
    # Whether its number of scramblings was asked for, and not the usual one.
    scrambled: bool
    # Whether its first samples have replicas.
    verify: bool = True


def computed(by: AbstractWork, wanted: Wanted, folder: Any, shown: bool) -> Campaign:
    """The campaign in a folder with all samples that are wanted, those computed that it lacks."""
    run = _Run(by, _begun(by, wanted, folder), wanted.most, shown)
    short = ""
    if wanted.accuracy is None:
        run.grow(wanted.most)
    else:
        first = max(wanted.plan.samples, run.kept.plan.samples)
        short = until_accurate(by.problem, first, wanted.most, wanted.accuracy, run.grown)
    if wanted.verify:
        _verify(run.kept, by)
    run.kept.conclude()
    return Campaign(run.kept, by.problem, short)


def _begun(by: AbstractWork, wanted: Wanted, folder: Any) -> Samples:
    """The samples in a folder, which is told of them where there are none."""
    problem, plan = by.problem, wanted.plan
    texts = in_texts(problem)
    found = Samples.made(folder, plan, {"problem": json.dumps(texts), "recorded": in_json(problem)})
    refuse_other(found.folder, found.told, KIND, texts)
    for name in ("seed", "sampling", "scramblings")[: 3 if wanted.scrambled else 2]:
        there, here = getattr(found.plan, name), getattr(plan, name)
        if there != here:
            raise ValueError(
                f"the folder {found.folder} holds a campaign of this problem with "
                f"{name}={there!r}, not {here!r}. Ask for the same, or give another folder."
            )
    if found.plan.samples > wanted.most:
        raise ValueError(
            f"the folder {found.folder} holds a campaign of this problem with "
            f"samples={found.plan.samples}, more than {wanted.most}. Ask for as many or more, or "
            "give another folder."
        )
    # The plan first: whatever ends the process from here on, the folder knows what was asked of it.
    if wanted.accuracy is None:
        found = _with_room(found, wanted.most, wanted.most, problem)
    if len(found.finished()):
        found.warn_of_versions()
    return found


def _with_room(kept: Samples, samples: int, most: int, problem: Problem) -> Samples:
    """The same with room for so many samples; for more, up to the `most`, where other processes
    have planned these."""
    if kept.plan.samples >= samples:
        return kept
    return kept.extended(samples, batch_of(problem, samples)).view(most)


class _Run:
    """Grows what is in a folder, to the `most` samples that are asked for; other processes may
    make it larger."""

    def __init__(self, by: AbstractWork, kept: Samples, most: int, shown: bool):
        self.by, self.kept, self.most, self.shown = by, kept, most, shown

    def grow(self, samples: int) -> None:
        """Has so many samples in the folder, and computes those that it lacks."""
        self.kept = _with_room(self.kept, samples, self.most, self.by.problem)
        plan = self.kept.plan
        left = np.setdiff1d(np.arange(plan.chunks), self.kept.finished()).tolist()
        if lost := self.kept.lost(left):
            warn(lost)
        if left:
            with _progress(self.shown, plan, left) as heard:
                self.by.compute(self.kept, left, heard)

    def grown(self, samples: int) -> Iterator[Piece]:
        """Has so many samples in the folder, and reads all that are then there in pieces of some
        chunks: responses (samples,), and their scramblings."""
        self.grow(samples)
        names, plan = self.by.problem.response_names, self.kept.plan
        size = max(READ // plan.chunk, 1) * plan.chunk
        for first in range(0, plan.samples, size):
            at = slice(first, min(first + size, plan.samples))
            rows = self.kept.read(at, RESPONSES)[RESPONSES]
            own = groups(at.stop, plan.scramblings, at.start)
            yield {name: rows[:, i] for i, name in enumerate(names)}, own


def _verify(samples: Samples, by: AbstractWork) -> None:
    """Adds the replicas that the finished samples in a folder lack, if their problem has any:
    finer runs of the first ones, written once all samples are there. A campaign that becomes larger
    keeps them, and adds what it lacks."""
    if not len(_lacking(samples)) or by.problem.refine() is None:
        return
    with held(samples.folder / VERIFYING):
        known, lacking = samples.finer(), _lacking(samples)
        if not len(lacking):
            return
        values = samples.read(slice(lacking.start, lacking.stop), VALUES)[VALUES]
        found: Any = by.replicated(samples.plan, values)
        found = dataclasses.replace(found, checks=Checks())
        parts = [own for own in (known, found) if own is not None]
        samples.keep_finer(jax.tree.map(lambda *own: np.concatenate(own), *parts))


def _lacking(samples: Samples) -> range:
    """Numbers of the first samples without replicas."""
    known = samples.finer()
    return range(
        0 if known is None else len(known.outcome), min(MOST_REPLICAS, samples.plan.samples)
    )


@contextmanager
def _progress(shown: bool, plan: Plan, left: list[int]) -> Iterator[Heard]:
    """A bar with rate, time left and failures so far; what is told of each finished chunk."""
    sizes = {number: plan.span(number)[1] - plan.span(number)[0] for number in left}
    before = plan.samples - sum(sizes.values())
    failed = [0]
    with tqdm(
        total=plan.samples, initial=before, desc="campaign", unit=" samples", disable=not shown
    ) as bar:

        def heard(number: int, failures: int) -> None:
            failed[0] += failures
            bar.set_postfix_str(f"{failed[0]} failed", refresh=False)
            bar.update(sizes[number])

        yield heard

"""How a campaign comes to all the samples that are asked of it: a folder is begun or found, made
larger where more are asked for, and what it lacks is computed.
"""

import copy
import json
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np
from tqdm import tqdm

from jaxclear.studies.campaign.layout import KIND, RESPONSES
from jaxclear.studies.campaign.plan import Plan, usual_batch
from jaxclear.studies.campaign.recorded import in_json
from jaxclear.studies.campaign.result import READ, Campaign
from jaxclear.studies.campaign.samples import Extended, Samples
from jaxclear.studies.campaign.verified import verify
from jaxclear.studies.campaign.work import AbstractWork, Heard
from jaxclear.studies.growing import until_accurate
from jaxclear.studies.sampling import groups
from jaxclear.studies.statistics.accuracy import Asked, Piece
from jaxclear.studies.store import refuse_other
from jaxclear.studies.texts import in_texts

__all__ = ["Wanted", "computed"]


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
        verify(run.kept, by)
    run.kept.tidy()
    return Campaign(run.kept, by.problem, short)


def _begun(by: AbstractWork, wanted: Wanted, folder: Any) -> Samples:
    """The samples in a folder, with room made for them where there are none."""
    problem, plan = by.problem, wanted.plan
    texts = in_texts(problem)
    found = Samples.known(folder)
    if found is None:
        told = {"problem": json.dumps(texts), "recorded": in_json(problem)}
        found = Samples.made(folder, plan, told, by.begun(plan))
    # Another process may have been first.
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
    if len(found.finished()):
        found.warn_of_versions()
    return found


class _Run:
    """Grows what is in a folder, to the `most` samples that are asked for; other processes may
    make it larger."""

    def __init__(self, by: AbstractWork, kept: Samples, most: int, shown: bool):
        self.by, self.kept, self.most, self.shown = by, kept, most, shown

    def grow(self, samples: int) -> None:
        """Has so many samples in the folder."""
        while not self._finished(samples):
            # Another process was faster to make the campaign larger.
            self.kept = Samples(self.kept.folder)

    def grown(self, samples: int) -> Iterator[Piece]:
        """Has so many samples in the folder, and reads all that are then there in pieces of some
        chunks: responses (samples,), and their scramblings."""
        self.grow(samples)
        names, plan = self.by.problem.response_names, self.kept.plan
        size = max(READ // plan.chunk, 1) * plan.chunk
        for first in range(0, plan.samples, size):
            at = slice(first, min(first + size, plan.samples))
            rows = self.kept.read(RESPONSES, at)
            own = groups(at.stop, plan.scramblings, at.start)
            yield {name: rows[:, i] for i, name in enumerate(names)}, own

    def _finished(self, samples: int) -> bool:
        """Computes what the folder lacks; False where the plan has changed meanwhile."""
        if self.kept.plan.samples < samples:
            larger = self.kept.plan.larger(samples, usual_batch(self.by.problem))
            self.kept = self.kept.extended(larger)
            return self.kept.plan == larger and self._finished(samples)
        # Where there are to be more samples by now, the last chunk asked for is computed whole.
        asked = _first(self.kept, self.most)
        left = np.setdiff1d(np.arange(asked.plan.chunks), asked.finished())
        try:
            with _progress(self.shown, asked.plan, left.tolist()) as heard:
                self.by.compute(self.kept, left.tolist(), heard)
        except Extended:
            return False
        self.kept = asked
        return True


def _first(kept: Samples, most: int) -> Samples:
    """What is in a folder, as if no more than the most samples had been planned."""
    if kept.plan.samples <= most:
        return kept
    fewer = copy.copy(kept)
    fewer.plan = kept.plan._replace(samples=most)
    fewer.told = kept.told | {"plan": fewer.plan._asdict()}
    return fewer


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

"""Samples of a campaign in its folder: which ones are planned, a chunk of the store for so many of
them, found by what they are drawn from, and what the folder says of them.

A chunk is finished where its file has all its samples, or more: a sample is the same whatever
becomes of the plan. A last chunk that was not full is written again where the samples become more.
"""

import dataclasses
import json
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxclear.ground.datasets import library_versions
from jaxclear.ground.warning import warn
from jaxclear.studies.experiment import SampleResult
from jaxclear.studies.problem import Problem
from jaxclear.studies.replicas import Replicas, together_with
from jaxclear.studies.sampling import groups
from jaxclear.studies.store.batch import (
    COLUMNS,
    LEAST_CHUNK,
    WHEN,
    WORST,
    devices,
    pack,
    unpack,
    usual_batch,
)
from jaxclear.studies.store.store import Chunk, Store, check_folder, compute_address

# A campaign has about this many chunks at the most. Samples that are cheap beside a file come in
# fewer and larger ones.
MOST_CHUNKS, MOST_CHEAP_CHUNKS, LEAST_CHEAP_CHUNK = 1024, 32, 1 << 14
# A chunk of runs is a batch, of a large campaign so many batches (files cost where runs are quick),
# but no more than this part of it.
BATCHES, OF_CAMPAIGN = 4, 64
KIND = "a Monte Carlo campaign"
FINER = "finer"
# Up to how many samples all had been finished once.
COMPLETE = "whole"


class Plan(NamedTuple):
    """`samples` in independent `scramblings`, drawn from `seed`; computed in batches of `batch`,
    kept in chunks of `chunk` samples, a multiple of the batch."""

    samples: int
    seed: int
    sampling: str
    scramblings: int
    batch: int
    chunk: int

    @property
    def chunks(self) -> int:
        """Number of chunks."""
        return -(-self.samples // self.chunk)

    def larger(self, samples: int, usual: int) -> "Plan":
        """The plan of more samples. A campaign that was to be smaller than a batch of the `usual`
        size gets larger ones; nothing of it stays, for no chunk is smaller than such a batch."""
        small = self.samples < self.chunk
        larger = max(self.batch, min(usual, samples)) if small else self.batch
        return self._replace(samples=samples, batch=larger)

    def span(self, number: int) -> tuple[int, int]:
        """First sample of a chunk, and the one after its last."""
        return number * self.chunk, min((number + 1) * self.chunk, self.samples)

    def groups(self) -> np.ndarray:
        """The scrambling (samples,) of every sample."""
        return groups(self.samples, self.scramblings)


def batch_of(problem: Problem, samples: int) -> int:
    """Samples of a batch of a campaign. One of runs has many of them: each is lost where the
    process ends in it."""
    batch = usual_batch(problem)
    if problem.cost().idle is None:
        return batch
    return min(batch, max(LEAST_CHUNK, samples // OF_CAMPAIGN))


def planned(
    problem: Problem, drawn: tuple[int, int, str, int], chunk: int | None, most: int
) -> Plan:
    """The plan of a campaign's samples, in chunks of whole batches.

    Args:
        problem: says what a sample costs.
        drawn: number of samples to begin with, seed, sampling, scramblings.
        chunk: smallest number of samples of a chunk; None: chosen.
        most: largest number of samples.
    """
    # Runs have an idle form; what is evaluated at once has none.
    cheap, batch = problem.cost().idle is None, batch_of(problem, most)
    if chunk is None:
        some = min(BATCHES * batch, most // OF_CAMPAIGN)
        chunks, least = (MOST_CHEAP_CHUNKS, LEAST_CHEAP_CHUNK) if cheap else (MOST_CHUNKS, some)
        chunk = max(-(-most // chunks), least, batch * devices())
    return Plan(*drawn, min(batch, most), -(-chunk // batch) * batch)


class Samples:
    """The samples in a folder: what is planned, what is finished, and the numbers of both.
    `description`: what the folder says of them, as JSON."""

    def __init__(self, store: Store, description: dict[str, Any]):
        self.store, self.folder, self.description = store, store.folder, description
        self.plan = Plan(**description["plan"])
        self.names = description["recorded"]["response_names"]
        drawn = [*self.plan[1:4], self.plan.chunk]
        self._drawn = compute_address(json.loads(description["problem"]), drawn)
        # Of the finished chunks that have been read, what computed them.
        self._done: dict[int, dict[str, str]] = {}

    @classmethod
    def open(cls, folder: Any) -> "Samples":
        """Those in a folder. Raises `ValueError` with a sentence where there are none."""
        store = Store(check_folder(folder))
        description = store.describe()
        if description is None:
            raise ValueError(f"the folder {folder} holds no campaign.")
        if "plan" not in description:
            store.refuse_other(description, KIND, {})
        return cls(store, description)

    @classmethod
    def create(cls, folder: Any, plan: Plan, texts: dict[str, str], recorded: Any) -> "Samples":
        """The samples of a problem in a folder, which is initialised where it is empty.

        Args:
            folder: path.
            plan: of the samples, for a new folder.
            texts: the problem in texts, by which a folder is recognised.
            recorded: the problem as JSON, for a new folder.

        Raises:
            ValueError: the folder holds something else.
        """
        store = Store(check_folder(folder))
        saved = store.describe(mend=True)
        if saved is None:
            store.refuse_foreign("campaign")
            new = {"what": KIND, "plan": plan._asdict(), "recorded": recorded}
            new["problem"] = json.dumps(texts)
            # Two processes may begin at once.
            saved = store.update(lambda other: other or new)
        store.refuse_other(saved, KIND, texts)
        return cls(store, saved)

    def view(self, most: int) -> "Samples":
        """The same as if no more than the most samples were planned."""
        fewer = self.plan._replace(samples=min(self.plan.samples, most))
        view = Samples(self.store, self.description | {"plan": fewer._asdict()})
        view._done = {n: v for n, v in self._done.items() if self.plan.span(n) == fewer.span(n)}
        return view

    def extend(self, samples: int, usual: int) -> "Samples":
        """With room for so many, in batches of the `usual` size; for more, where another process
        has planned these."""

        def change(saved: dict[str, Any] | None) -> dict[str, Any]:
            saved = saved or self.description
            plan = Plan(**saved["plan"])
            larger = plan.larger(samples, usual) if plan.samples < samples else plan
            return saved | {"plan": larger._asdict()}

        return Samples(self.store, self.store.update(change))

    def conclude(self) -> None:
        """Writes that all samples are finished, and tidies up."""
        if self.description.get(COMPLETE, 0) < (count := self.plan.samples):

            def change(saved: dict[str, Any] | None) -> dict[str, Any]:
                saved = saved or self.description
                return saved | {COMPLETE: max(saved.get(COMPLETE, 0), count)}

            self.store.update(change)
        self.store.tidy()

    def address(self, number: int) -> str:
        """Of a chunk's file."""
        return compute_address(self._drawn, number)

    def chunk(self, number: int) -> Chunk | None:
        """A chunk; None where it is not finished."""
        first, last = self.plan.span(number)
        arrays = self.store.read(self.address(number))
        return None if arrays is None or arrays.about["samples"] < last - first else arrays

    def finished(self) -> np.ndarray:
        """Numbers of the finished chunks, whose checksums are right."""
        return np.array([n for n in range(self.plan.chunks) if self._is_complete(n)], int)

    def _is_complete(self, number: int) -> bool:
        if number not in self._done and (arrays := self.chunk(number)) is not None:
            self._done[number] = arrays.about["versions"]
        return number in self._done

    def describe_missing(self, remaining: list[int]) -> str:
        """A sentence on those of the chunks that are left that were there before; "" for none."""
        before = self.description.get(COMPLETE, 0)
        missing = [
            number
            for number in remaining
            if self.address(number) in self.store.damaged or self.plan.span(number)[1] <= before
        ]
        if not missing:
            return ""
        name = self.store.path(self.address(missing[0])).name
        return (
            f"{len(missing)} of {self.plan.chunks} chunks in {self.folder} are missing or do not "
            f"match their checksums (the first is {name}); they are computed again."
        )

    def write(self, number: int, values: np.ndarray, result: SampleResult) -> None:
        """Saves a chunk, with the versions that computed it; samples that failed have no responses.

        Args:
            number: of the chunk.
            values: of the variables, shape (samples, variables).
            result: of the samples.
        """
        reached: Any = result.reached_responses()
        result = dataclasses.replace(result, responses=reached)
        columns, about = pack(self.names, values, result)
        self.store.write(self.address(number), columns, about | {"versions": self._now})
        self._done[number] = self._now

    @cached_property
    def _now(self) -> dict[str, str]:
        return library_versions()

    @cached_property
    def figures(self) -> list[tuple[str, str]]:
        """Check and place of each figure that chunks hold, as the first finished one does."""
        chunks = (self.chunk(number) for number in range(self.plan.chunks))
        first = next((chunk for chunk in chunks if chunk is not None), None)
        return [] if first is None else [tuple(chunk) for chunk in first.about["figures"]]

    def read(self, at: slice, *names: str) -> dict[str, np.ndarray]:
        """These columns of some finished samples, or all, by name; figures in the order of
        `figures`, 0 where another version had others. Raises `ValueError` with a sentence where
        they are not there any more."""
        names, parts = names or COLUMNS, []
        for number in range(at.start // self.plan.chunk, -(-at.stop // self.plan.chunk)):
            first, last = self.plan.span(number)
            chunk = self.chunk(number)
            if chunk is None:
                raise ValueError(
                    f"{self.store.path(self.address(number))} is missing or does not match its "
                    "checksum; ask jaxclear.campaign the same again, which computes it again."
                )
            rows = slice(max(at.start, first) - first, min(at.stop, last) - first)
            columns = {name: chunk.arrays[name][rows] for name in names}
            there = [tuple(figure) for figure in chunk.about["figures"]]
            if there != self.figures:
                places = [there.index(f) if f in there else -1 for f in self.figures]
                for name in {WORST, WHEN} & {*names}:
                    columns[name] = np.pad(columns[name], ((0, 0), (0, 1)))[:, places]
            parts.append(columns)
        return {name: np.concatenate([part[name] for part in parts]) for name in names}

    def result_of(self, at: slice) -> SampleResult:
        """What was computed of some samples, as the problem gave it."""
        return unpack(self.names, self.figures, self.read(at))

    def finer(self) -> SampleResult | None:
        """What the first samples gave in finer runs; None where none is kept."""
        chunk = self.store.read(compute_address(self._drawn, FINER))
        return None if chunk is None else unpack(self.names, (), chunk.arrays)

    def keep_finer(self, values: np.ndarray, result: SampleResult) -> None:
        """Keeps what the first samples, of these values, gave in finer runs."""
        address = compute_address(self._drawn, FINER)
        # A warning, where that is damaged.
        self.store.load(address)
        self.store.write(address, *pack(self.names, values, result))

    def replicas(self) -> Replicas | None:
        """The replicas of the first samples; None where there are none."""
        finer = self.finer()
        count = 0 if finer is None else len(finer.outcome)
        if finer is None or len(self.finished()) < -(-count // self.plan.chunk):
            return None
        return together_with(self.names, self.result_of(slice(0, count)), finer, count)

    def versions(self) -> tuple[dict[str, str], ...]:
        """Versions of the programs that computed finished chunks."""
        versions = [self._done[int(number)] for number in self.finished()]
        return tuple({json.dumps(one, sort_keys=True): one for one in versions}.values())

    def warn_of_versions(self) -> None:
        """A warning where chunks were computed by other versions than those to come."""
        now = self._now
        for before in self.versions():
            names = [name for name in {**before, **now} if before.get(name) != now.get(name)]
            text = (
                f"{n} {before.get(n, 'absent')} then, {now.get(n, 'absent')} now" for n in names
            )
            if names:
                warn(
                    f"chunks in {self.folder} were computed by other versions ({', '.join(text)}); "
                    "numbers may differ from theirs in the last digits."
                )


def holds_campaign(folder: Path) -> bool:
    """Whether a folder holds a campaign, and no other study."""
    return "plan" in (Store(folder).describe() or {})

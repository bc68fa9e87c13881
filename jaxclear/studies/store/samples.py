"""Samples of a campaign in its folder: which ones are planned, a file for each chunk of them, found
by what they are drawn from, and what the folder tells of them.

A chunk is finished where its file has all its samples, or more: a sample is the same whatever
becomes of the plan. A last chunk that was not full is written again where the samples become more.
"""

import json
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxclear.ground.datasets import library_versions
from jaxclear.ground.warning import warn
from jaxclear.integrators.checks import Check, Checks, Figure
from jaxclear.studies.base import AbstractProblem, SampleResult
from jaxclear.studies.replicas import Replicas, together_with
from jaxclear.studies.sampling import groups
from jaxclear.studies.store.batch import LEAST_CHUNK, devices, usual_batch
from jaxclear.studies.store.files import (
    MENDED,
    Piece,
    Pieces,
    address_of,
    checked_folder,
    refuse_unwritable,
)
from jaxclear.studies.store.store import STUDY, DamagedFolder, refuse_foreign, tell, told_of

# A campaign has about this many chunks at the most. Samples that are cheap beside a file come in
# fewer and larger ones.
MOST_CHUNKS, MOST_CHEAP_CHUNKS, LEAST_CHEAP_CHUNK = 1024, 32, 1 << 14
# A chunk of runs is a batch, of a large campaign so many batches (files cost where runs are quick),
# but no more than this part of it.
BATCHES, OF_CAMPAIGN = 4, 64
KIND = "a Monte Carlo campaign"
# What is kept of each sample; the figures of its checks, and when they were met.
COLUMNS = ("values", "responses", "outcome", "ended", "worst", "when")
VALUES, RESPONSES, OUTCOME, ENDED, WORST, WHEN = COLUMNS
# Columns that repeat themselves.
SQUEEZED = (OUTCOME, ENDED, WORST, WHEN)
FINER = "finer"
# Held while the plan is changed.
PLANNING = ".planning"
# Up to how many samples all had been finished once.
WHOLE = "whole"


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


def batch_of(problem: AbstractProblem, samples: int) -> int:
    """Samples of a batch of a campaign. One of runs has many of them: each is lost where the
    process ends in it."""
    batch = usual_batch(problem)
    if problem.idle() is problem:
        return batch
    return min(batch, max(LEAST_CHUNK, samples // OF_CAMPAIGN))


def planned(
    problem: AbstractProblem, drawn: tuple[int, int, str, int], chunk: int | None, most: int
) -> Plan:
    """The plan of samples, seed, sampling and scramblings to begin with, of which there will be
    `most`; in chunks of at least so many samples if they are given. Chunks are of whole batches of
    the usual size, also where there are not as many samples."""
    # Runs have an idle form; what is evaluated at once has none.
    cheap, batch = problem.idle() is problem, batch_of(problem, most)
    if chunk is None:
        some = min(BATCHES * batch, most // OF_CAMPAIGN)
        chunks, least = (MOST_CHEAP_CHUNKS, LEAST_CHEAP_CHUNK) if cheap else (MOST_CHUNKS, some)
        chunk = max(-(-most // chunks), least, batch * devices())
    return Plan(*drawn, min(batch, most), -(-chunk // batch) * batch)


class Samples:
    """The samples in a folder: what is planned, what is finished, and the numbers of both. `told`:
    all that is known of them, as JSON."""

    def __init__(self, folder: Path, told: dict[str, Any]):
        self.folder, self.told = folder, told
        self.plan = Plan(**told["plan"])
        self.pieces = Pieces(folder)
        self._drawn = address_of(json.loads(told["problem"]), [*self.plan[1:4], self.plan.chunk])
        # Of the finished chunks that have been read, what computed them.
        self._whole: dict[int, dict[str, str]] = {}

    @classmethod
    def opened(cls, folder: Any) -> "Samples":
        """Those in a folder. Raises `ValueError` with a sentence where there are none."""
        path = checked_folder(folder)
        told = _told(path, mend=False)
        if told is None:
            raise ValueError(f"the folder {path} holds no campaign.")
        return cls(path, told)

    @classmethod
    def made(cls, folder: Any, plan: Plan, told: dict[str, Any]) -> "Samples":
        """Those in a folder. Where it holds none, it is told what there is to be known of them;
        raises `ValueError` with a sentence where it holds something else."""
        path = checked_folder(folder)
        known = _told(path, mend=True)
        if known is not None and (path / STUDY).exists():
            return cls(path, known)
        if known is None:
            refuse_foreign(path, "campaign")
            known = {"what": KIND, "plan": plan._asdict()} | told
        with held(path / PLANNING):
            with suppress(DamagedFolder):
                # Two processes may begin at once.
                known = told_of(path) or known
            tell(path, known)
        return cls(path, known)

    def view(self, most: int) -> "Samples":
        """The same as if no more than the most samples were planned."""
        fewer = self.plan._replace(samples=min(self.plan.samples, most))
        found = Samples(self.folder, self.told | {"plan": fewer._asdict()})
        found._whole = {n: v for n, v in self._whole.items() if self.plan.span(n) == fewer.span(n)}
        return found

    def extended(self, samples: int, usual: int) -> "Samples":
        """With room for so many, in batches of the `usual` size; for more, where another process
        has planned these."""
        with held(self.folder / PLANNING):
            told = told_of(self.folder) or self.told
            plan = Plan(**told["plan"])
            if plan.samples < samples:
                plan = plan.larger(samples, usual)
                told = told | {"plan": plan._asdict()}
                tell(self.folder, told)
        return Samples(self.folder, told)

    def conclude(self) -> None:
        """Puts down that all samples are finished, and tidies up."""
        if self.told.get(WHOLE, 0) < self.plan.samples:
            with held(self.folder / PLANNING):
                told = told_of(self.folder) or self.told
                tell(self.folder, told | {WHOLE: max(told.get(WHOLE, 0), self.plan.samples)})
        self.pieces.tidy()

    def address(self, number: int) -> str:
        """Of a chunk's file."""
        return address_of(self._drawn, number)

    def claimed(self, number: int) -> Any:
        """As `Pieces.claimed`, of a chunk."""
        return self.pieces.claimed(self.address(number))

    def chunk(self, number: int, *names: str) -> Piece | None:
        """A chunk's columns of these names, or all; None where it is not finished."""
        first, last = self.plan.span(number)
        found = self.pieces.read(self.address(number), names or None)
        if found is None or found.about["samples"] < last - first:
            return None
        return found

    def finished(self) -> np.ndarray:
        """Numbers of the finished chunks, whose checksums are right."""
        return np.array([n for n in range(self.plan.chunks) if self._is_whole(n)], int)

    def _is_whole(self, number: int) -> bool:
        if number not in self._whole and (found := self.chunk(number)) is not None:
            self._whole[number] = found.about["versions"]
        return number in self._whole

    def lost(self, left: list[int]) -> str:
        """A sentence on those of the chunks that are left that were there before; "" for none."""
        before = self.told.get(WHOLE, 0)
        lost = [
            number
            for number in left
            if self.address(number) in self.pieces.damaged or self.plan.span(number)[1] <= before
        ]
        if not lost:
            return ""
        name = self.pieces.path(self.address(lost[0])).name
        return (
            f"{len(lost)} of {self.plan.chunks} chunks in {self.folder} are missing or do not "
            f"match their checksums (the first is {name}); they are computed again."
        )

    def write(self, number: int, values: np.ndarray, found: SampleResult) -> None:
        """Keeps a chunk, signed with the versions that computed it. Samples that failed have no
        responses."""
        reached = found.reached_responses()
        responses = np.stack([reached[name] for name in self._names], axis=1)
        columns: dict[str, Any] = {VALUES: values, RESPONSES: responses}
        columns |= {OUTCOME: np.asarray(found.outcome, np.int8), ENDED: found.ended}
        figures = found.checks.figures
        if figures:
            columns[WORST] = np.concatenate([own.worst for own in figures.values()], axis=1)
            columns[WHEN] = np.concatenate([own.time for own in figures.values()], axis=1)
        named = [[check.name, place] for check, own in figures.items() for place in own.places]
        about = {"versions": self._now, "figures": named, "samples": len(values)}
        self.pieces.write(self.address(number), about, columns, SQUEEZED)
        self._whole[number] = self._now

    @cached_property
    def _now(self) -> dict[str, str]:
        return library_versions()

    @property
    def _names(self) -> list[str]:
        return self.told["recorded"]["response_names"]

    @cached_property
    def figures(self) -> list[tuple[str, str]]:
        """Check and place of each figure that chunks hold, as the first finished one does."""
        pieces = (self.chunk(number, OUTCOME) for number in range(self.plan.chunks))
        first = next((own for own in pieces if own is not None), None)
        return [] if first is None else [tuple(own) for own in first.about["figures"]]

    def read(self, at: slice, *names: str) -> dict[str, np.ndarray]:
        """Columns of some finished samples, by name; figures in the order of `figures`. Raises
        `ValueError` with a sentence where they are not there any more."""
        parts = []
        for number in range(at.start // self.plan.chunk, -(-at.stop // self.plan.chunk)):
            first, last = self.plan.span(number)
            piece = self.chunk(number, *names)
            if piece is None:
                raise ValueError(
                    f"{self.pieces.path(self.address(number))} is missing or does not match its "
                    "checksum; ask jaxclear.campaign the same again, which computes it again."
                )
            own = slice(max(at.start, first) - first, min(at.stop, last) - first)
            wanted = [name for name in piece.arrays if not names or name in names]
            columns = {name: piece.arrays[name][own] for name in wanted}
            parts.append(self._aligned(piece, columns, names))
        return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}

    def _aligned(self, piece: Piece, columns: dict[str, Any], names: tuple[str, ...]) -> dict:
        """Columns with the figures that all have; 0 where another version asked for others."""
        there = [tuple(own) for own in piece.about["figures"]]
        if there != self.figures:
            rows = len(next(iter(columns.values())))
            for name in (WORST, WHEN):
                if not names or name in names:
                    wide = np.zeros((rows, len(self.figures)))
                    for i, figure in enumerate(self.figures):
                        if figure in there:
                            wide[:, i] = columns[name][:, there.index(figure)]
                    columns[name] = wide
        return columns

    def found(self, at: slice) -> SampleResult:
        """What was computed of some samples, as the problem gave it."""
        columns: dict[str, Any] = self.read(at, *COLUMNS[1:])
        figures: dict[Check, Figure] = {}
        for check in dict.fromkeys(check for check, _ in self.figures):
            own = [i for i, (name, _) in enumerate(self.figures) if name == check]
            places = tuple(self.figures[i][1] for i in own)
            figures[Check[check]] = Figure(columns[WORST][:, own], columns[WHEN][:, own], places)
        by_name = {name: columns[RESPONSES][:, i] for i, name in enumerate(self._names)}
        outcome = columns[OUTCOME].astype(np.int32)
        return SampleResult(by_name, outcome, columns[ENDED], Checks.of(figures))

    def finer(self) -> SampleResult | None:
        """What the first samples gave in finer runs; None where none is kept."""
        piece = self.pieces.read(address_of(self._drawn, FINER))
        if piece is None:
            return None
        columns: dict[str, Any] = piece.arrays
        by_name = dict(zip(self._names, columns[RESPONSES], strict=True))
        return SampleResult(by_name, columns[OUTCOME], columns[ENDED])

    def keep_finer(self, found: SampleResult) -> None:
        """Keeps what the first samples gave in finer runs."""
        rows = np.stack([found.responses[name] for name in self._names])
        columns = {RESPONSES: rows, OUTCOME: found.outcome, ENDED: found.ended}
        address = address_of(self._drawn, FINER)
        if address in self.pieces.damaged:
            warn(MENDED.format(self.pieces.path(address)))
        self.pieces.write(address, {}, columns)

    def replicas(self) -> Replicas | None:
        """The replicas of the first samples; None where there are none."""
        finer = self.finer()
        count = 0 if finer is None else len(finer.outcome)
        if finer is None or len(self.finished()) < -(-count // self.plan.chunk):
            return None
        return together_with(self._names, self.found(slice(0, count)), finer, count)

    def versions(self) -> tuple[dict[str, str], ...]:
        """Versions of the programs that computed finished chunks."""
        told = [self._whole[int(number)] for number in self.finished()]
        return tuple({json.dumps(own, sort_keys=True): own for own in told}.values())

    def warn_of_versions(self) -> None:
        """A warning where chunks were computed by other versions than those to come."""
        now = self._now
        for before in self.versions():
            names = [name for name in {**before, **now} if before.get(name) != now.get(name)]
            told = (
                f"{n} {before.get(n, 'absent')} then, {now.get(n, 'absent')} now" for n in names
            )
            if names:
                warn(
                    f"chunks in {self.folder} were computed by other versions ({', '.join(told)}); "
                    "numbers may differ from theirs in the last digits."
                )


def holds_campaign(folder: Path) -> bool:
    """Whether a folder holds a campaign, and no other study."""
    return "plan" in (told_of(folder) or {})


def _told(path: Path, mend: bool) -> dict[str, Any] | None:
    """What a folder tells of its campaign, as `told_of`. Raises `ValueError` with a sentence where
    it holds another study."""
    told = told_of(path, mend)
    if told is not None and "plan" not in told:
        raise ValueError(
            f"the folder {path} holds {told['what']} and holds no campaign; give another one."
        )
    return told


@contextmanager
def held(path: Path) -> Iterator[None]:
    """Holds a file in a folder, which is made where there is none, against other processes."""
    import filelock

    lock = filelock.FileLock(path, thread_local=False)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        lock.acquire()
    except OSError as reason:
        refuse_unwritable(path.parent, reason)
    try:
        yield
    finally:
        lock.release()

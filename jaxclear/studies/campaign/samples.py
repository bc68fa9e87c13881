"""Samples of a campaign on disk: one Zarr group, an array for each kind of number, a mark for each
chunk that is finished.

A chunk of samples is a file in every array. Each file is written beside and renamed, and the mark
comes last: whatever happens, a chunk is finished and whole, or it counts for nothing. Two processes
that computed the same chunk wrote the same bytes. Where the samples become more, a last chunk that
is not full loses its mark before the plan changes; whoever writes such a chunk looks at the plan.
"""

import secrets
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxclear.ground.warning import warn
from jaxclear.integrators import Outcome
from jaxclear.integrators.checks import Check, Checks, Figure
from jaxclear.studies.base import SampleResult
from jaxclear.studies.campaign.chunk_files import ChunkFiles
from jaxclear.studies.campaign.layout import (
    CLAIMS,
    ENDED,
    FINISHED,
    ORDER,
    OUTCOME,
    RESPONSES,
    SAMPLES,
    VALUES,
    VERSIONS,
    WHEN,
    WORST,
    made,
    resized,
)
from jaxclear.studies.campaign.plan import Plan
from jaxclear.studies.campaign.versions import change, signed, signers, told_versions
from jaxclear.studies.store import checked_folder

__all__ = ["Extended", "Samples"]

# What versions up to 0.29 kept of the nominal sample.
NOMINAL = "second_look"
# Held while the plan is changed, or must not change.
PLANNING = ".planning"
# Age [s] of what a process that began no campaign left behind.
ABANDONED = 3600.0


class Extended(Exception):
    """Another process has planned more samples in the meantime."""


class Samples:
    """The samples in a folder: what is planned, what is finished, and the numbers of both."""

    def __init__(self, folder: Path):
        import zarr

        self.folder = folder
        self.group: Any = zarr.open_group(folder / SAMPLES, mode="r+")
        self.told: dict[str, Any] = dict(self.group.attrs)
        if self.told.get("order") != ORDER:
            raise ValueError(
                f"the folder {folder} is of an earlier version of jaxclear, whose samples came in "
                "another order; go on with that version, or give another folder."
            )
        self.plan = Plan(**self.told["plan"])
        self.figures = [tuple(figure) for figure in self.told["figures"]]
        # Looking whether a chunk is empty costs as much as compressing it, and none is.
        with zarr.config.set({"array.write_empty_chunks": True}):
            self.arrays: dict[str, Any] = dict(self.group.arrays())
        self._files = ChunkFiles(folder / SAMPLES, self.arrays)
        self._mark: int | None = None

    @classmethod
    def opened(cls, folder: Any) -> "Samples":
        """Those in a folder. Raises `ValueError` with a sentence where there are none."""
        path = checked_folder(folder)
        if not (path / SAMPLES / "zarr.json").exists():
            raise ValueError(f"the folder {path} holds no campaign.")
        return cls(path)

    @classmethod
    def known(cls, folder: Any) -> "Samples | None":
        """Those in a folder; None in an empty one. Raises `ValueError` with a sentence where it
        holds something else."""
        path = checked_folder(folder)
        if not (path / SAMPLES / "zarr.json").exists():
            if path.exists() and any(not name.name.startswith(".") for name in path.iterdir()):
                raise ValueError(
                    f"the folder {path} is not empty and holds no campaign; give another one."
                )
            return None
        return cls(path)

    @classmethod
    def made(cls, folder: Any, plan: Plan, told: dict, kind: SampleResult) -> "Samples":
        """Room for the samples of a plan in a folder. `told`: all that is to be known of them, as
        JSON; `kind`: what a batch of samples gives."""
        path = checked_folder(folder)
        path.mkdir(parents=True, exist_ok=True)
        # Made under a name of its own: two processes may begin at once, and one is too late.
        beside = path / f".{SAMPLES}.{secrets.token_hex(8)}"
        made(beside, plan, told, kind)
        try:
            beside.rename(path / SAMPLES)
        except OSError:
            shutil.rmtree(beside, ignore_errors=True)
        return cls(path)

    def extended(self, plan: Plan) -> "Samples":
        """The same samples with room for all of a larger plan; as they are in the folder, where
        another process has changed its plan."""
        with self._planning() as current:
            if current:
                resized(self.arrays, plan)
                if self.plan.samples % self.plan.chunk:
                    # The last chunk is to have more samples.
                    self.arrays[FINISHED][self.plan.chunks - 1] = 0
                self.group.attrs.put(self.told | {"plan": plan._asdict()})
        return Samples(self.folder)

    def trim(self) -> None:
        """Takes away the room that a process made which died before it changed the plan."""
        if not resized(self.arrays, self.plan, alter=False):
            return
        with self._planning() as current:
            if current:
                resized(self.arrays, self.plan)

    @contextmanager
    def _planning(self) -> Iterator[bool]:
        """Holds the plan of the folder as it is. Whether it is still the one known here."""
        import filelock
        import zarr

        with filelock.FileLock(self.folder / PLANNING, thread_local=False):
            there: Any = zarr.open_group(self.folder / SAMPLES, mode="r").attrs["plan"]
            yield there == self.told["plan"]

    def is_finished(self, number: int) -> bool:
        """Whether a chunk is."""
        there = self._files.are_there(FINISHED, number)
        return there and bool(self.arrays[FINISHED][number] != 0)

    def finished(self) -> np.ndarray:
        """Numbers of the finished chunks."""
        return np.flatnonzero(self.arrays[FINISHED][: self.plan.chunks])

    def write(self, number: int, values: np.ndarray, found: SampleResult) -> None:
        """Keeps a chunk, and marks it as finished. Samples that failed have no responses. Raises
        `Extended` where it is to have more samples by now."""
        at = slice(*self.plan.span(number))
        if at.stop - at.start == self.plan.chunk:
            self._write(number, at, values, found)
            return
        with self._planning() as current:
            if not current:
                raise Extended
            self._write(number, at, values, found)

    def _write(self, number: int, at: slice, values: np.ndarray, found: SampleResult) -> None:
        own = found.checks.figures
        good = (found.outcome == Outcome.REACHED)[:, None]
        names = self.told["recorded"]["response_names"]
        responses = np.stack([found.responses[name] for name in names], axis=1)
        self._put(VALUES, at, values)
        self._put(RESPONSES, at, np.where(good, responses, np.nan))
        if self.figures:
            figures = {check.name: figure for check, figure in own.items()}
            worst, when = self._columns(figures, len(values))
            self._put(WORST, at, worst)
            self._put(WHEN, at, when)
        self._put(OUTCOME, at, found.outcome)
        self._put(ENDED, at, found.ended)
        if self._mark is None:
            self._mark = signed(self.folder / VERSIONS, told_versions())
        self._files.put(FINISHED, number, [self._mark])

    def _columns(self, own: dict[str, Figure], rows: int) -> tuple[np.ndarray, np.ndarray]:
        """Of so many samples the figures of the checks that the folder keeps, and when they were
        met; 0 of those that an earlier version asked, and this one does not."""
        kept = list(dict.fromkeys(check for check, _ in self.figures))
        widths = [sum(check == name for name, _ in self.figures) for check in kept]
        none = [np.zeros((rows, width)) for width in widths]
        pairs = list(zip(kept, none, strict=True))
        worst = [own[check].worst if check in own else empty for check, empty in pairs]
        when = [own[check].time if check in own else empty for check, empty in pairs]
        return np.concatenate(worst, axis=1), np.concatenate(when, axis=1)

    def _put(self, name: str, at: slice, numbers: Any) -> None:
        if at.stop - at.start == self.plan.chunk:
            self._files.put(name, at.start // self.plan.chunk, numbers)
        else:
            self.arrays[name][at] = numbers

    def read(self, name: str, at: slice) -> Any:
        """Numbers of some samples."""
        return self.arrays[name][at]

    def found(self, at: slice) -> SampleResult:
        """What was computed of some samples, as the problem gave it."""
        names = self.told["recorded"]["response_names"]
        responses = self.read(RESPONSES, at)
        figures: dict[Check, Figure] = {}
        if self.figures:
            worst, time = self.read(WORST, at), self.read(WHEN, at)
            for check in dict.fromkeys(check for check, _ in self.figures):
                own = [i for i, (name, _) in enumerate(self.figures) if name == check]
                places = tuple(self.figures[i][1] for i in own)
                figures[Check[check]] = Figure(worst[:, own], time[:, own], places)
        by_name = {name: responses[:, i] for i, name in enumerate(names)}
        outcome = self.read(OUTCOME, at).astype(np.int32)
        return SampleResult(by_name, outcome, self.read(ENDED, at), Checks.of(figures))

    def earlier(self) -> tuple[str, ...]:
        """What a version up to 0.29 found to be off in a second look at the nominal sample."""
        kept: Any = self.told.get(NOMINAL, ())
        figures = {
            Check[name]: Figure(jnp.asarray(worst), jnp.asarray(when), tuple(places))
            for name, worst, when, places in kept
        }
        return Checks.of(figures).warnings

    @contextmanager
    def claimed(self, number: int) -> Iterator[bool]:
        """Whether this thread may compute a chunk, or another one, of this process or of another,
        is at it. The system takes claims back from processes that end."""
        import filelock

        path = self.folder / CLAIMS / f"{number:08d}"
        lock = filelock.FileLock(path, timeout=0, thread_local=False)
        try:
            path.parent.mkdir(exist_ok=True)
            lock.acquire()
        except (filelock.Timeout, FileNotFoundError, FileExistsError):
            # Somebody is at it, or has finished the campaign and tidies up: pathlib may find the
            # folder there, and a moment later not.
            yield False
            return
        try:
            yield True
        finally:
            lock.release()

    def tidy(self) -> None:
        """Takes away claims, and what chunks that were never finished left. Where others have
        planned more samples, these are theirs, and they stay."""
        self.trim()
        # All is finished, and nobody plans more now: nobody writes.
        with self._planning() as current:
            if current:
                shutil.rmtree(self.folder / CLAIMS, ignore_errors=True)
                for left in (self.folder / SAMPLES).rglob("*.partial"):
                    left.unlink(missing_ok=True)
        for left in self.folder.glob(f".{SAMPLES}.*"):
            # Another process may be about to begin.
            with suppress(FileNotFoundError):
                if time.time() - left.stat().st_mtime > ABANDONED:
                    shutil.rmtree(left, ignore_errors=True)

    def versions(self) -> dict[int, dict[str, str]]:
        """Versions of the programs that computed finished chunks, by their mark."""
        return signers(self.folder / VERSIONS)

    def warn_of_versions(self) -> None:
        """A warning where chunks were computed by other versions than those to come."""
        now = told_versions()
        for before in self.versions().values():
            differs = change(before, now)
            if differs:
                warn(
                    f"chunks in {self.folder} were computed by other versions ({differs}); numbers "
                    "may differ from theirs in the last digits.",
                )

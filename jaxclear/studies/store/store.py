"""The ledger of a study: what was asked of a problem, and what it answered.

An answer is found by what was asked: a digest of the problem's texts, of the function and of the
values. So an interrupted study that asks the same again goes on, bit for bit, in whatever order it
asks; a file that is missing or damaged is computed again. Samples of all studies are asked for by
`batch.evaluate_all`, which looks into the ledger that is `current`; what is no sample (a cycle of a
life) is taken and added by its study.
"""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxclear.ground.warning import warn
from jaxclear.studies.problem import Problem
from jaxclear.studies.store.digest import first_difference, in_texts
from jaxclear.studies.store.files import (
    MENDED,
    PIECES,
    Pieces,
    address_of,
    checked_folder,
    put,
    refuse_unwritable,
)

# What a folder tells of its study, with a checksum; and the result, for other programs.
STUDY, CHECKSUM, RESULT = "study.json", "checksum", "result.zarr"
CURRENT: ContextVar["Ledger | None"] = ContextVar("ledger of samples", default=None)


class OtherStudy(ValueError):
    """A folder holds another study than the one that is to go on there."""


class DamagedFolder(ValueError):
    """What a folder tells of its study does not match its checksum."""


class Question(NamedTuple):
    """What values are asked about: a problem, in texts, and what is done with it."""

    texts: dict[str, str]
    digest: str

    @classmethod
    def of(cls, problem: Problem, function: Any) -> "Question":
        """A function of this package of a problem."""
        own, texts = getattr(function, "__wrapped__", function), in_texts(problem)
        return cls(texts, address_of(texts, f"{own.__module__}.{own.__qualname__}"))


class Ledger:
    """Answers of a study in a folder. `what`: the kind of study, in words; `texts` describe the
    problem, part by part."""

    def __init__(self, folder: Path, what: str, texts: dict[str, str]):
        self.folder, self.what, self.texts = folder, what, texts
        self.pieces = Pieces(folder)
        self.grown = False
        self.question = Question(texts, address_of(texts))

    @classmethod
    def opened(cls, folder: Any, what: str, texts: dict[str, str]) -> "Ledger":
        """The ledger in a folder, which is made where there is none. Raises `ValueError` with a
        sentence where it holds something else, `ImportError` without zarr."""
        found = cls(checked_folder(folder), what, texts)
        told = told_of(found.folder, mend=True)
        if told is not None:
            refuse_other(found.folder, told, what, texts)
        else:
            refuse_foreign(found.folder, "study")
        return found

    def taken(self, asked: np.ndarray, kind: Any, of: Question | None = None) -> Any:
        """What was answered when these numbers were asked; None where nobody knows. `kind`: the
        answer with shapes in place of arrays; `of`: another question than the study's own."""
        of = self.question if of is None else of
        leaves, tree = jax.tree.flatten(kind)
        address = self._address(asked, of)
        piece = self.pieces.read(address)
        if piece is not None:
            arrays = [piece.arrays.get(str(i)) for i in range(len(leaves))]
            if [(np.shape(own), own.dtype) for own in arrays if own is not None] == [
                (leaf.shape, leaf.dtype) for leaf in leaves
            ]:
                return jax.tree.unflatten(tree, arrays)
        if address in self.pieces.damaged:
            warn(MENDED.format(self.pieces.path(address)))
        return None

    def add(self, asked: np.ndarray, answer: Any, of: Question | None = None) -> None:
        """Keeps what was answered when these numbers were asked."""
        self.begin()
        self.grown = True
        leaves = {str(i): leaf for i, leaf in enumerate(jax.tree.leaves(answer))}
        address = self._address(asked, self.question if of is None else of)
        self.pieces.write(address, {}, {"asked": asked} | leaves)

    def begin(self) -> None:
        """Puts down which study it is, where that is not there."""
        if not (self.folder / STUDY).exists():
            tell(self.folder, {"what": self.what, "problem": json.dumps(self.texts)})

    def conclude(self, result: Any) -> None:
        """Keeps the study's result, an xarray Dataset, beside its answers."""
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            result.to_zarr(self.folder / RESULT, mode="w", consolidated=False)
        except OSError as reason:
            # Of a folder that is read-only and has all, nothing is lost.
            if self.grown or not (self.folder / RESULT).exists():
                refuse_unwritable(self.folder, reason)

    def _address(self, asked: np.ndarray, of: Question) -> str:
        return address_of(of.digest, np.asarray(asked))


@contextmanager
def current(ledger: Ledger | None) -> Iterator[None]:
    """All samples that are asked for within are kept in a ledger; None: in none."""
    token = CURRENT.set(ledger)
    try:
        yield
    finally:
        CURRENT.reset(token)


def told_of(folder: Path, mend: bool = False) -> dict[str, Any] | None:
    """What a folder tells of its study; None where there is none. Where that is damaged, None too
    if it is to be mended, with a warning; else raises `DamagedFolder`."""
    path = folder / STUDY
    if not path.exists():
        return None
    try:
        told = json.loads(path.read_text())
        if told.pop(CHECKSUM) == address_of(told):
            return told
    except (ValueError, KeyError, AttributeError, TypeError):
        pass
    if mend:
        warn(f"{path} does not match its checksum; it is written again from what is asked.")
        return None
    raise DamagedFolder(
        f"{path} does not match its checksum; ask the same study of the same problem again, which "
        "writes it anew and computes nothing that is kept."
    )


def tell(folder: Path, told: dict[str, Any]) -> None:
    """Puts down what a folder tells of its study."""
    # Numbers and texts as they are read again.
    told = json.loads(json.dumps(told))
    whole = json.dumps(told | {CHECKSUM: address_of(told)}, indent=1)
    put(folder / STUDY, whole.encode(), folder)


def refuse_foreign(folder: Path, what: str) -> None:
    """Raises `ValueError` with a sentence for a folder with something else than files of a
    study."""
    there = {path.name for path in folder.iterdir()} if folder.exists() else set()
    if not there & {PIECES, STUDY} and any(not name.startswith(".") for name in there):
        raise ValueError(f"the folder {folder} is not empty and holds no {what}; give another one.")


def refuse_other(folder: Path, kept: dict[str, Any], what: str, texts: dict[str, str]) -> None:
    """Raises `OtherStudy` with a sentence where what a folder says of itself is another kind of
    study than `what`, or of a problem that differs from these texts."""
    if kept.get("what") != what:
        raise OtherStudy(
            f"the folder {folder} holds {kept.get('what')}, not {what}; give another one."
        )
    found = first_difference(json.loads(kept["problem"]), texts)
    if found:
        raise OtherStudy(
            f"the folder {folder} holds {what} of another problem: {found}. Give another "
            "folder, or delete this one."
        )
